"""The case of the paper's Table I and Fig. 3: an obstacle on equation 11's circle, from LiDAR points to prediction.

A cylinder of 0.48 m radius goes around (8.5, 2.0) m with A = 2.5 m and w = 0.015 Hz, once (66.7 s). A
16-channel LiDAR with 0.02 m range noise stands at the origin and scans at 10 Hz. Every scan goes
through the package's own perception, tracking and prediction (N = 30 steps of 0.1 s), at their
default settings but for the crop, which has to hold the circle. Errors are against equation 11:

    centre      the obstacle's cluster, before any filter
    tracking    the confirmed track's position, at each frame's stamp
    prediction  each step 1..30 from each frame with a confirmed track, all steps together
    step 30     the last step alone, 3 s ahead
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.perception.pipeline import Perception
from adcbf_cli.core.prediction.predictor import Predictor
from adcbf_cli.core.reproduction.part import Row
from adcbf_cli.core.simulation.paths import motion_along
from adcbf_cli.core.simulation.scenario import CirclePath, Scenario
from adcbf_cli.core.simulation.simulator import Simulator
from adcbf_cli.core.tracking.tracker import Tracker
from adcbf_cli.core.types import Clusters, FloatArray, Frame, Notes, Predictions, Tracks, TrackStatus

MEASURES = ("centre", "tracking", "prediction", "step_30")
PERIOD_S = 1 / 0.015
MATCH_M = 1.0
"""A cluster or track farther than this from the obstacle is not the obstacle's."""

CIRCLE: dict[str, Any] = {"kind": "circle", "centre_m": [8.5, 2.0], "radius_m": 2.5, "frequency_hz": 0.015}
OBSTACLE_RADIUS_M = 0.48
LIDAR: dict[str, Any] = {
    "kind": "spinning",
    "channels": 16,
    "azimuth_step_deg": 0.2,
    "instantaneous": True,
    "range_sigma_m": 0.02,
    "max_range_m": 20.0,
}
SETTINGS: dict[str, Any] = {"perception.range_m": 12.0, "prediction.calibration": "none"}


@dataclass(frozen=True)
class Case:
    """The case, and what is changed in its LiDAR, its terrain and the package's settings."""

    name: str
    lidar: dict[str, Any] = field(default_factory=dict)
    terrain: dict[str, Any] = field(default_factory=lambda: {"kind": "flat"})
    settings: dict[str, Any] = field(default_factory=dict)

    def scene(self, duration_s: float) -> Scenario:
        mover = {"kind": "cylinder", "radius_m": OBSTACLE_RADIUS_M, "path": CIRCLE}
        return Scenario.model_validate(
            {
                "duration_s": duration_s,
                "terrain": self.terrain,
                "movers": [mover],
                "ego": {"path": {"kind": "stand", "at_m": [0, 0]}},
                "lidar": LIDAR | self.lidar,
            }
        )

    def config(self, extra: dict[str, Any]) -> Config:
        """The defaults with the case's settings, then `extra`; keys are dotted, as in `stage.key`."""
        nested: dict[str, dict[str, Any]] = {}
        for key, value in (SETTINGS | self.settings | extra).items():
            stage, name = key.split(".", 1)
            nested.setdefault(stage, {})[name] = value
        return Config.model_validate(nested)


BASE = Case("base")


class Road:
    """One case's stages, fed frame by frame, and the errors so far, (samples, 2) of x and y.

    seen_s, tracked_m, ahead_m: of each frame with a confirmed track its time, the track's position (2,), and
    the predicted positions (steps, 2).
    """

    def __init__(self, config: Config) -> None:
        notes = Notes()
        self._perceive = Perception(config.perception, notes)
        self._track = Tracker(config.tracking, notes)
        self._predict = Predictor(config.prediction, config.tracking, notes)
        self.step_s = config.prediction.step_s
        self.errors: dict[str, list[FloatArray]] = {measure: [] for measure in MEASURES}
        self.frames = 0
        self.ids: set[int] = set()
        self.seen_s: list[float] = []
        self.tracked_m: list[FloatArray] = []
        self.ahead_m: list[FloatArray] = []

    def feed(self, frame: Frame, now_s: float) -> None:
        clusters = self._perceive(frame)
        tracks = self._track(clusters)
        predictions = self._predict(tracks)
        self.frames += 1
        place = positions(np.array([now_s]))[0]
        self._score_cluster(clusters, place)
        self._score_track(tracks, predictions, place, now_s)

    def _score_cluster(self, clusters: Clusters, place: FloatArray) -> None:
        nearest = nearest_row(clusters.centre_m, place)
        if nearest is not None:
            self.errors["centre"].append(clusters.centre_m[nearest : nearest + 1, :2] - place)

    def _score_track(self, tracks: Tracks, predictions: Predictions, place: FloatArray, now_s: float) -> None:
        confirmed = np.flatnonzero((tracks.status == TrackStatus.CONFIRMED) | (tracks.status == TrackStatus.COASTING))
        nearest = nearest_row(tracks.state[confirmed], place)
        if nearest is None:
            return
        row = int(confirmed[nearest])
        self.ids.add(int(tracks.track_id[row]))
        ahead = predictions.position_m[np.flatnonzero(predictions.track_id == tracks.track_id[row])[0], :, :2]
        later_s: FloatArray = now_s + self.step_s * np.arange(1.0, len(ahead) + 1)
        error: FloatArray = ahead - positions(later_s)
        self.errors["tracking"].append(tracks.state[row : row + 1, :2] - place)
        self.errors["prediction"].append(error)
        self.errors["step_30"].append(error[-1:])
        self.seen_s.append(now_s)
        self.tracked_m.append(tracks.state[row, :2].copy())
        self.ahead_m.append(ahead.copy())

    def rmse(self) -> dict[str, FloatArray]:
        """Each measure's RMSE on x and y, (2,); NaN where nothing was found."""
        return {
            measure: np.sqrt(np.mean(np.concatenate(found) ** 2, axis=0)) if found else np.full(2, np.nan)
            for measure, found in self.errors.items()
        }

    def row(self) -> Row:
        """What the run came to: RMSE [x, y] in m by measure (None: nothing found), and how it was tracked."""
        rmse = {measure: [finite(value) for value in pair] for measure, pair in self.rmse().items()}
        return rmse | {"frames": self.frames, "tracked": len(self.seen_s), "identities": len(self.ids)}


def run_cases(cases: Sequence[Case], extra: dict[str, Any], seed: int, duration_s: float) -> Iterator[Road]:
    """Each case's finished road; cases that see the same scene share its simulation."""
    roads = [Road(case.config(extra)) for case in cases]
    scenes = [case.scene(duration_s) for case in cases]
    for scene in dict.fromkeys(scenes):
        simulator = Simulator(scene, seed)
        mine = [road for road, other in zip(roads, scenes, strict=True) if other == scene]
        for simulated in simulator:
            now_s = float(simulator.world.seconds(np.array(simulated.scan.stamp_ns)))
            for road in mine:
                road.feed(simulated.frame, now_s)
    yield from roads


def positions(time_s: FloatArray) -> FloatArray:
    """(n, 2) where equation 11 puts the obstacle."""
    motion = motion_along(CirclePath.model_validate(CIRCLE), time_s)
    return np.column_stack([motion.x_m, motion.y_m])


def nearest_row(places_m: FloatArray, place_m: FloatArray) -> int | None:
    """The row whose x, y is nearest to a place (2,), if it is within MATCH_M."""
    distance = np.hypot(*(places_m[:, :2] - place_m).T)
    return int(distance.argmin()) if len(distance) and distance.min() < MATCH_M else None


def straight_ahead(steps: int = 30, step_s: float = 0.1) -> tuple[FloatArray, FloatArray]:
    """RMSE (2,) of a constant velocity prediction that starts from the exact position and velocity:
    over all steps, and at the last alone. No such prediction can be expected to be better."""
    now = np.linspace(0, PERIOD_S, 2000, endpoint=False)
    motion = motion_along(CirclePath.model_validate(CIRCLE), now)
    start = np.column_stack([motion.x_m, motion.y_m])
    velocity = np.column_stack([motion.vx_mps, motion.vy_mps])
    ahead = step_s * np.arange(1, steps + 1)
    error = np.stack([start + velocity * t - positions(now + t) for t in ahead], axis=1)
    return np.sqrt(np.mean(error**2, axis=(0, 1))), np.sqrt(np.mean(error[:, -1] ** 2, axis=0))


def finite(value: float) -> float | None:
    """The value to the micrometre, None where there is none."""
    return round(float(value), 6) if np.isfinite(value) else None
