"""Obstacles without a sensor: an object list (positions by time) seen as clusters.

It stands in for perception where a recording has trajectories only, such as pedestrians annotated
from above. What follows (tracking, prediction, planning) is the same as for a LiDAR.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.frames import identity, invert, transform_points
from adcbf_cli.core.paths import Paths
from adcbf_cli.core.types import NO_ID, Clusters, FloatArray, PointCounts, Truth

_STANDOFF_M = 5.0
"""The imagined sensor stands this far outside the scene, so that nobody walks through it, where an
azimuth means nothing."""


def listed_frames(truth: Truth, config: ReadConfig) -> int:
    """How many frames `listed_clusters` gives."""
    return 1 + int((truth.stamp_ns[-1] - truth.stamp_ns[0]) * config.object_rate_hz / 1e9) if len(truth) else 0


def listed_clusters(truth: Truth, config: ReadConfig) -> Iterator[Clusters]:
    """One record a frame, `config.object_rate_hz` of them a second, from the first sample to the last: every
    object that the list knows then, interpolated, with seeded noise on its centre. AdcbfError without objects.

    The pose is not known: nothing drove there. Objects are upright cylinders around their positions.
    """
    if not len(truth):
        raise AdcbfError(f"{truth.source}: lists no object")
    columns = np.column_stack([truth.position_m, _radius(truth, config), _height(truth)])
    paths = Paths(truth.track_id, truth.stamp_ns, columns, round(config.max_pose_gap_s * 1e9))
    pose = _beside(truth.position_m)
    period_ns = 1e9 / config.object_rate_hz
    rng = np.random.default_rng(config.object_seed)
    for index in range(listed_frames(truth, config)):
        stamp_ns = int(truth.stamp_ns[0] + round(index * period_ns))
        _, values = paths.present(stamp_ns)
        yield _record(index, stamp_ns, pose, values, rng.normal(0.0, config.object_noise_m, (len(values), 2)))


def _radius(truth: Truth, config: ReadConfig) -> FloatArray:
    """The circle around an object's box, where it has one."""
    around = 0.5 * np.hypot(truth.length_m, truth.width_m)
    return np.where(np.isfinite(around), around, config.object_radius_m)


def _height(truth: Truth) -> FloatArray:
    return np.where(np.isfinite(truth.height_m), truth.height_m, 1.7)


def _beside(position_m: FloatArray) -> FloatArray:
    """A pose in front of the scene's lower edge in y."""
    pose = identity()
    low, high = position_m.min(axis=0), position_m.max(axis=0)
    pose[:2, 3] = (low[0] + high[0]) / 2, low[1] - _STANDOFF_M
    return pose


def _record(index: int, stamp_ns: int, pose: FloatArray, values: FloatArray, noise_m: FloatArray) -> Clusters:
    n = len(values)
    centre = values[:, :3].copy()
    centre[:, :2] += noise_m
    radius = values[:, 3]
    return Clusters(
        frame_index=index,
        stamp_ns=stamp_ns,
        world_from_sensor=pose,
        planar=False,
        pose_known=False,
        counts=PointCounts(n, n, n, n, n),
        cluster_id=np.arange(n, dtype=np.int64),
        centre_m=centre,
        centre_sensor_m=transform_points(invert(pose), centre),
        radius_m=radius,
        height_m=values[:, 4],
        length_m=2 * radius,
        width_m=2 * radius,
        yaw_rad=np.zeros(n),
        points=np.ones(n, dtype=np.int64),
        probability=np.ones(n),
        split_from=np.full(n, NO_ID),
    )
