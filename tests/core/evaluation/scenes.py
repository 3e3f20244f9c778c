"""Synthetic runs for the evaluation's tests: what the stages would have given, built by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.evaluation.evaluate import evaluate
from adcbf_cli.core.evaluation.report import Report
from adcbf_cli.core.types import Clusters, Notes, PointCounts, Predictions, Tracks, TrackStatus, Truth

STEP_NS = 100_000_000
START_NS = 1_700_000_000_000_000_000
Path = Callable[[np.ndarray], np.ndarray]
"""Seconds (k,) to xy positions (k, 2)."""


def line(x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> Path:
    return lambda t: np.stack([x + vx * t, y + vy * t], axis=-1)


@dataclass
class Labelled:
    """One labelled object, present at the frames in `frames`."""

    path: Path
    category: str = "person"
    yaw: Callable[[np.ndarray], np.ndarray] = lambda t: np.zeros_like(t)
    size: tuple[float, float] = (0.6, 0.6)
    frames: range | None = None


@dataclass
class Seen:
    """One track and the cluster behind it, at `measured` or at the same place. `ahead(t0, t)` predicts xy
    for times t (k,), seen at t0; by default it knows the future path."""

    path: Path
    static: bool = False
    frames: range | None = None
    sigma_m: float = 0.1
    ahead: Callable[[float, np.ndarray], np.ndarray] | None = None
    status: TrackStatus = TrackStatus.CONFIRMED
    measured: Path | None = None


@dataclass
class Run:
    """A run of `count` frames at 10 Hz, the sensor at `sensor` (a 4 x 4 pose a frame, or one for all)."""

    objects: Sequence[Labelled]
    seen: Sequence[Seen]
    count: int = 40
    steps: int = 30
    sensor: Sequence[np.ndarray] | None = None
    exhaustive: bool = True
    fov_rad: tuple[float, float] | None = None
    notes: Notes = field(default_factory=Notes)

    def pose(self, k: int) -> np.ndarray:
        return np.eye(4) if self.sensor is None else self.sensor[k]

    def truth(self) -> Truth:
        rows = []
        for track_id, thing in enumerate(self.objects):
            for k in thing.frames or range(self.count):
                t = np.array([k / 10])
                rows.append((START_NS + k * STEP_NS, track_id, thing, thing.path(t)[0], thing.yaw(t)[0]))
        rows.sort(key=lambda row: row[:2])
        size = np.array([row[2].size for row in rows]).reshape(-1, 2)
        return Truth(
            frame="world",
            stamp_ns=np.array([row[0] for row in rows], dtype=np.int64),
            track_id=np.array([row[1] for row in rows], dtype=np.int64),
            category=tuple(row[2].category for row in rows),
            position_m=np.array([[*row[3], 0.0] for row in rows]).reshape(-1, 3),
            yaw_rad=np.array([row[4] for row in rows]),
            length_m=size[:, 0],
            width_m=size[:, 1],
            height_m=np.full(len(rows), 1.7),
            labelled_fov_rad=self.fov_rad,
            source="by hand",
            exhaustive=self.exhaustive,
        )

    def alive(self, k: int) -> list[tuple[int, Seen, np.ndarray]]:
        return [
            (100 + i, seen, seen.path(np.array([k / 10]))[0])
            for i, seen in enumerate(self.seen)
            if k in (seen.frames or range(self.count))
        ]

    def clusters(self, k: int) -> Clusters:
        t = np.array([k / 10])
        centre = np.array([[*(s.measured or s.path)(t)[0], 0.0] for _, s, _ in self.alive(k)]).reshape(-1, 3)
        n = len(centre)
        ones = np.ones(n)
        return Clusters(
            frame_index=k,
            stamp_ns=START_NS + k * STEP_NS,
            world_from_sensor=self.pose(k),
            planar=False,
            pose_known=True,
            counts=PointCounts(n, n, n, n, n),
            cluster_id=np.arange(n),
            centre_m=centre,
            centre_sensor_m=centre,
            radius_m=0.3 * ones,
            height_m=ones,
            length_m=0.6 * ones,
            width_m=0.6 * ones,
            yaw_rad=0 * ones,
            points=np.full(n, 9),
            probability=ones,
            split_from=np.full(n, -1),
        )

    def tracks(self, k: int) -> Tracks:
        alive = self.alive(k)
        n = len(alive)
        state = np.zeros((n, 6))
        covariance = np.zeros((n, 6, 6))
        for i, (_, seen, at) in enumerate(alive):
            state[i, :2] = at
            state[i, 3:5] = (seen.path(np.array([k / 10 + 1e-3]))[0] - at) / 1e-3
            covariance[i] = np.eye(6) * seen.sigma_m**2
        return Tracks(
            frame_index=k,
            stamp_ns=START_NS + k * STEP_NS,
            world_from_sensor=self.pose(k),
            model="cv",
            track_id=np.array([t for t, _, _ in alive], dtype=np.int64),
            status=np.array([int(s.status) for _, s, _ in alive], dtype=np.int64),
            state=state,
            covariance=covariance,
            radius_m=np.full(n, 0.3),
            height_m=np.ones(n),
            is_static=np.array([s.static for _, s, _ in alive], dtype=bool),
            cluster_id=np.arange(n),
            age_s=np.ones(n),
            hits=np.full(n, 5),
            misses=np.zeros(n, dtype=np.int64),
            nis=np.ones(n),
        )

    def predictions(self, k: int) -> Predictions:
        alive = self.alive(k)
        n = len(alive)
        ahead_s = np.arange(1, self.steps + 1) / 10
        position = np.zeros((n, self.steps, 3))
        covariance = np.zeros((n, self.steps, 2, 2))
        for i, (_, seen, _) in enumerate(alive):
            t0 = k / 10
            position[i, :, :2] = seen.ahead(t0, t0 + ahead_s) if seen.ahead else seen.path(t0 + ahead_s)
            covariance[i] = np.eye(2) * seen.sigma_m**2
        return Predictions(
            frame_index=k,
            stamp_ns=START_NS + k * STEP_NS,
            step_s=0.1,
            track_id=np.array([t for t, _, _ in alive], dtype=np.int64),
            is_static=np.array([s.static for _, s, _ in alive], dtype=bool),
            position_m=position,
            velocity_mps=np.zeros((n, self.steps, 2)),
            covariance_m2=covariance,
            radius_m=np.full(n, 0.3),
            sigma_radius_m=np.full((n, self.steps), 0.5),
            conformal_radius_m=np.full((n, self.steps), np.nan),
        )

    def score(self, config: EvaluationConfig | None = None, with_truth: bool = True) -> Report:
        frames = range(self.count)
        return evaluate(
            map(self.clusters, frames),
            map(self.tracks, frames),
            lambda: map(self.predictions, frames),
            self.truth() if with_truth else None,
            config or EvaluationConfig(range_m=50.0),
            self.notes,
        )
