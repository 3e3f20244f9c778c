"""Small random records for tests that only move them about."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.frames import pose_matrix
from adcbf_cli.core.types import NO_ID, Clusters, PointCounts, PointLabels, Predictions, Tracks

STEP_NS = 100_000_000


def make_clusters(index: int, n: int, rng: np.random.Generator, with_labels: bool = False) -> Clusters:
    labels = PointLabels(rng.normal(size=(2 * n, 3)), np.arange(2 * n) // 2 - 1) if with_labels else None
    return Clusters(
        frame_index=index,
        stamp_ns=1_700_000_000_000_000_000 + index * STEP_NS,
        world_from_sensor=pose_matrix(rng.normal(size=3), rng.normal(size=4)),
        planar=False,
        pose_known=True,
        counts=PointCounts(1000 + n, 500, 400, 300, 5 * n),
        cluster_id=np.arange(n),
        centre_m=rng.normal(size=(n, 3)) * 10,
        centre_sensor_m=rng.normal(size=(n, 3)) * 10,
        radius_m=rng.uniform(0.1, 2, n),
        height_m=rng.uniform(0.1, 2, n),
        length_m=rng.uniform(1, 2, n),
        width_m=rng.uniform(0.1, 1, n),
        yaw_rad=rng.uniform(-1.5, 1.5, n),
        points=rng.integers(5, 50, n),
        probability=rng.uniform(0, 1, n),
        split_from=np.where(np.arange(n) % 3 == 0, NO_ID, 7),
        labels=labels,
    )


def make_tracks(index: int, n: int, d: int, rng: np.random.Generator) -> Tracks:
    root = rng.normal(size=(n, d, d))
    return Tracks(
        frame_index=index,
        stamp_ns=1_700_000_000_000_000_000 + index * STEP_NS,
        world_from_sensor=np.eye(4),
        model="cv" if d == 6 else "ca",
        track_id=np.arange(n) + 100,
        status=np.arange(n) % 4,
        state=rng.normal(size=(n, d)),
        covariance=root @ root.transpose(0, 2, 1) + np.eye(d),
        radius_m=rng.uniform(0.1, 2, n),
        height_m=rng.uniform(0.1, 2, n),
        is_static=np.arange(n) % 2 == 0,
        cluster_id=np.where(np.arange(n) % 2 == 0, NO_ID, np.arange(n)),
        age_s=rng.uniform(0, 9, n),
        hits=rng.integers(1, 9, n),
        misses=rng.integers(0, 3, n),
        nis=np.where(np.arange(n) % 2 == 0, np.nan, 3.0),
        manoeuvre=rng.uniform(0, 1, n) if d == 6 else None,
    )


def make_predictions(index: int, n: int, steps: int, rng: np.random.Generator) -> Predictions:
    root = rng.normal(size=(n, steps, 2, 2))
    conformal = rng.uniform(0, 1, (n, steps))
    conformal[:, -1] = np.nan
    return Predictions(
        frame_index=index,
        stamp_ns=1_700_000_000_000_000_000 + index * STEP_NS,
        step_s=0.1,
        track_id=np.arange(n) + 100,
        is_static=np.arange(n) % 2 == 0,
        position_m=rng.normal(size=(n, steps, 3)),
        velocity_mps=rng.normal(size=(n, steps, 2)),
        covariance_m2=root @ root.transpose(0, 1, 3, 2),
        radius_m=rng.uniform(0.1, 2, n),
        sigma_radius_m=rng.uniform(0, 1, (n, steps)),
        conformal_radius_m=conformal,
    )
