"""The plain road beside which adcbf is timed: the same libraries, one after the other, no batching.

Clusters come from `plain_clusters.PlainPipeline` (crop, Patchwork++, 0.1 m cubes, scikit-learn's HDBSCAN on
all of them). Each track is one filterpy UnscentedKalmanFilter with the paper's measurement, assigned by
scipy's linear_sum_assignment on distance; each confirmed track's horizon is a Python loop over
filterpy's predict. Track life and horizon are those of adcbf's defaults.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from plain_clusters import PlainPipeline
from scipy.optimize import linear_sum_assignment
from tracking import difference, observe, wrapped_mean

from adcbf_cli.core.config import PredictionConfig, TrackingConfig
from adcbf_cli.core.frames import invert, transform_points
from adcbf_cli.core.perception.ground import _quiet_stdout
from adcbf_cli.core.timing import RecordingTimer
from adcbf_cli.core.types import FloatArray, Frame, IntArray

GATE_M = 2.0


def move(state: FloatArray, dt: float) -> FloatArray:
    """Constant velocity: x, y, z, vx, vy, vz."""
    moved = state.copy()
    moved[:3] += dt * state[3:]
    return moved


def new_filter(config: TrackingConfig, state: FloatArray, covariance: FloatArray, dt: float) -> UnscentedKalmanFilter:
    points = MerweScaledSigmaPoints(6, config.ukf_alpha, config.ukf_beta, config.ukf_kappa)
    ukf = UnscentedKalmanFilter(6, 3, dt, observe, move, points, z_mean_fn=wrapped_mean, residual_z=difference)
    ukf.x, ukf.P = state, covariance
    ukf.Q = process_noise(config, dt)
    ukf.R = np.diag([config.sigma_range_m, config.sigma_azimuth_rad, config.sigma_elevation_rad]) ** 2
    return ukf


def process_noise(config: TrackingConfig, dt: float) -> FloatArray:
    noise: FloatArray = Q_discrete_white_noise(2, dt, config.sigma_accel_mps2**2, block_size=3, order_by_dim=False)
    return noise


def looped_horizon(
    config: TrackingConfig, states: FloatArray, covariances: FloatArray, steps: int, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Positions (n, N, 3) and covariances (n, N, 6, 6) by filterpy's predict, track by track, step by step."""
    positions = np.zeros((len(states), steps, 3))
    spreads = np.zeros((len(states), steps, 6, 6))
    for i in range(len(states)):
        ukf = new_filter(config, states[i].copy(), covariances[i].copy(), step_s)
        for k in range(steps):
            ukf.predict()
            positions[i, k] = ukf.x[:3]
            spreads[i, k] = ukf.P
    return positions, spreads


@dataclass(slots=True)
class _Track:
    ukf: UnscentedKalmanFilter
    hits: int = 1
    misses: int = 0


class PlainTracker:
    """One filter a track, in a list."""

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self._tracks: list[_Track] = []
        self._last_ns: int | None = None

    def __call__(self, stamp_ns: int, centres_m: FloatArray, world_from_sensor: FloatArray) -> list[_Track]:
        """centres_m: (n, 3) sensor frame. Returns the confirmed tracks, coasting ones included."""
        dt = 0.1 if self._last_ns is None else (stamp_ns - self._last_ns) / 1e9
        self._last_ns = stamp_ns
        sensor_from_world = invert(world_from_sensor)

        def expect(x: FloatArray) -> FloatArray:
            return observe(sensor_from_world[:3, :3] @ x[:3] + sensor_from_world[:3, 3])

        for track in self._tracks:
            track.ukf.Q = process_noise(self._config, dt)
            track.ukf.predict(dt=dt)
        centres_world = transform_points(world_from_sensor, centres_m)
        taken = np.zeros(len(centres_m), dtype=bool)
        for i, j in self._pairs(centres_world):
            track = self._tracks[i]
            track.ukf.update(observe(centres_m[j]), hx=expect)
            track.hits, track.misses, taken[j] = track.hits + 1, -1, True
        for track in self._tracks:
            track.misses += 1
        longest = round(self._config.max_coast_s / dt) if dt > 0 else 0
        self._tracks = [track for track in self._tracks if track.misses <= longest]
        for centre in centres_world[~taken]:
            spread = np.diag([0.04] * 3 + [self._config.sigma_speed_mps**2] * 3)
            self._tracks.append(_Track(new_filter(self._config, np.append(centre, np.zeros(3)), spread, 0.1)))
        return [track for track in self._tracks if track.hits >= self._config.confirm_hits]

    def _pairs(self, centres_world_m: FloatArray) -> list[tuple[int, int]]:
        if not self._tracks or not len(centres_world_m):
            return []
        places = np.array([track.ukf.x[:3] for track in self._tracks])
        distance = np.linalg.norm(places[:, None] - centres_world_m[None], axis=2)
        rows, columns = linear_sum_assignment(distance)
        return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if distance[i, j] < GATE_M]


@dataclass(frozen=True, slots=True)
class PlainResult:
    """One frame's: the points (n, 3) that were left, each cluster's centre (k, 3), and the tracks predicted."""

    points_m: FloatArray
    centres_m: FloatArray
    tracks: int


class PlainRoad:
    """The stages in a row, timed by `timer` under adcbf's stage names."""

    def __init__(self, range_m: float, timer: RecordingTimer) -> None:
        self._timer = timer
        with _quiet_stdout():
            self._clusters = PlainPipeline(range_m)
        self._tracking, self._prediction = TrackingConfig(), PredictionConfig()
        self._tracker = PlainTracker(self._tracking)

    def __call__(self, frame: Frame) -> PlainResult:
        points, label = self._clusters(frame, self._timer)
        with self._timer("obstacles"):
            centres = _centres(points, label)
        with self._timer("track"):
            tracks = self._tracker(frame.stamp_ns, centres, frame.world_from_sensor)
        with self._timer("predict"):
            states = np.array([track.ukf.x for track in tracks]).reshape(-1, 6)
            covariances = np.array([track.ukf.P for track in tracks]).reshape(-1, 6, 6)
            looped_horizon(self._tracking, states, covariances, self._prediction.steps, self._prediction.step_s)
        return PlainResult(points, centres, len(tracks))


def _centres(points_m: FloatArray, label: IntArray) -> FloatArray:
    """(k, 3): each cluster's mean."""
    owner = label[label >= 0]
    count = np.bincount(owner)
    return np.stack([np.bincount(owner, points_m[label >= 0, axis]) / count for axis in range(3)], axis=1)
