"""Synthetic cluster frames for the tracking tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from adcbf_cli.core.frames import invert, transform_points
from adcbf_cli.core.types import NO_ID, Clusters, PointCounts


def build_clusters(
    time_s: float,
    centres_m: object,
    radius_m: object = 0.3,
    *,
    world_from_sensor: np.ndarray | None = None,
    planar: bool = False,
    height_m: float = 1.0,
    split_from: object = None,
    index: int = 0,
) -> Clusters:
    """A frame of clusters at these world positions, (n, 3) or (n, 2), seen from this pose."""
    pose = np.eye(4) if world_from_sensor is None else world_from_sensor
    centres = np.asarray(centres_m, dtype=np.float64)
    centres = centres.reshape(-1, centres.shape[-1] if centres.size else 3)
    if centres.shape[1] == 2:
        centres = np.column_stack([centres, np.full(len(centres), pose[2, 3])])
    n = len(centres)
    radius = np.broadcast_to(np.asarray(radius_m, dtype=np.float64), (n,)).copy()
    parents = np.full(n, NO_ID) if split_from is None else np.asarray(split_from)
    return Clusters(
        frame_index=index,
        stamp_ns=10**18 + round(time_s * 1e9),
        world_from_sensor=pose,
        planar=planar,
        pose_known=True,
        counts=PointCounts(0, 0, 0, 0, 0),
        cluster_id=np.arange(n, dtype=np.int64),
        centre_m=centres,
        centre_sensor_m=transform_points(invert(pose), centres),
        radius_m=radius,
        height_m=np.full(n, height_m),
        length_m=2 * radius,
        width_m=2 * radius,
        yaw_rad=np.zeros(n),
        points=np.full(n, 20, dtype=np.int64),
        probability=np.ones(n),
        split_from=parents.astype(np.int64),
    )


@pytest.fixture(scope="session")
def make_clusters() -> Callable[..., Clusters]:
    return build_clusters
