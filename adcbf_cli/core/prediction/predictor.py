"""From tracks to where they will be, N steps ahead, with two measures of how sure that is.

Predicted are the tracks that were confirmed, coasting ones included: an obstacle that is hidden for
a moment is still an obstacle. Standing tracks are predicted to stay where they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from scipy.special import chdtri

from adcbf_cli.core.config import PredictionConfig, TrackingConfig
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.prediction.calibration import Calibration, ResidualCollector
from adcbf_cli.core.prediction.propagation import Horizon, Propagator
from adcbf_cli.core.timing import Timer, no_timer
from adcbf_cli.core.types import BoolArray, FloatArray, Notes, Predictions, Tracks, TrackStatus

VIEW_DRIFT_SHARE = 0.5
"""Of the farthest that a seen surface's centre may wander while the line of sight turns (its radius
times the angle, see tracking/stillness.py): one standard deviation."""
MAX_VIEW_TURN_RAD = 2.0
CREEP_BOUNDS = (1 / 3, 3.0)
"""The speed that a standing track may have after all, one sigma: what its filter believes, within
these multiples of the static speed."""
LEARNING_WINDOW = 100_000
"""Residuals a step that a calibration is learned from, at most: the newest."""


class Predictor:
    """Takes each frame's tracks in order, returns their predictions. One instance a log."""

    def __init__(
        self,
        config: PredictionConfig,
        tracking: TrackingConfig,
        notes: Notes,
        timer: Timer = no_timer,
        calibration: Calibration | None = None,
    ) -> None:
        """calibration: radii learned from other logs, for `config.calibration` "file"."""
        self._config = config
        self._tracking = tracking
        self._notes = notes
        self._timer = timer
        self._propagators: dict[str, Propagator] = {}
        self._ego: tuple[int, FloatArray] | None = None
        self._ego_speed_mps = 0.0
        self._fixed = _radii_from_file(config, calibration) if config.calibration == "file" else None
        self.residuals: ResidualCollector | None = None
        if config.calibration == "past":
            self.residuals = ResidualCollector(config.steps, config.step_s, config.calibration_window)

    def __call__(self, tracks: Tracks) -> Predictions:
        """Predictions of this frame. Conformal radii use nothing later than this frame."""
        propagator = self._propagator(tracks.model)  # before the timer starts: it imports filterpy once
        with self._timer("predict"):
            rows = (tracks.status == TrackStatus.CONFIRMED) | (tracks.status == TrackStatus.COASTING)
            if self.residuals is not None:
                self.residuals.observe(tracks)
            self._follow_ego(tracks)
            horizon = self._horizon(propagator, tracks, rows)
            is_static = tracks.is_static[rows]
            predictions = Predictions(
                frame_index=tracks.frame_index,
                stamp_ns=tracks.stamp_ns,
                step_s=self._config.step_s,
                track_id=tracks.track_id[rows],
                is_static=is_static,
                position_m=horizon.position_m,
                velocity_mps=horizon.velocity_mps,
                covariance_m2=horizon.covariance_m2,
                radius_m=tracks.radius_m[rows],
                sigma_radius_m=sigma_radius(horizon.covariance_m2, self._config.probability),
                conformal_radius_m=self._conformal(is_static),
            )
            if self.residuals is not None:
                self.residuals.remember(predictions)
            return predictions

    def _propagator(self, model: str) -> Propagator:
        if model not in self._propagators:
            config = self._tracking.model_copy(update={"model": model})
            self._propagators[model] = Propagator(config, self._config.steps, self._config.step_s, self._notes)
        return self._propagators[model]

    def _horizon(self, propagator: Propagator, tracks: Tracks, rows: BoolArray) -> Horizon:
        still = tracks.is_static[rows]
        standing = self._standing(tracks, rows) if still.any() else None
        if standing is not None and still.all():
            return standing
        manoeuvre = None if tracks.manoeuvre is None else tracks.manoeuvre[rows]
        moving = propagator(tracks.state[rows], tracks.covariance[rows], manoeuvre)
        if standing is None:
            return moving
        return Horizon(
            np.where(still[:, None, None], standing.position_m, moving.position_m),
            np.where(still[:, None, None], standing.velocity_mps, moving.velocity_mps),
            np.where(still[:, None, None, None], standing.covariance_m2, moving.covariance_m2),
        )

    def _follow_ego(self, tracks: Tracks) -> None:
        """Keeps the sensor's speed, from this frame's pose and the last one's."""
        now = (tracks.stamp_ns, tracks.world_from_sensor[:3, 3])
        if self._ego is not None and now[0] > self._ego[0]:
            self._ego_speed_mps = float(np.linalg.norm(now[1] - self._ego[1]) * 1e9 / (now[0] - self._ego[0]))
        self._ego = now

    def _standing(self, tracks: Tracks, rows: BoolArray) -> Horizon:
        """Standing obstacles: the same place and no velocity. Uncertain is the creep that the filter,
        which does not know of the standing, believes in, and how far the seen centre wanders as the
        ego passes by; both are bounded."""
        state, covariance, steps = tracks.state[rows], tracks.covariance[rows], self._config.steps
        time_s = self._config.step_s * np.arange(1, steps + 1)
        lowest, highest = (factor * self._tracking.static_speed_mps for factor in CREEP_BOUNDS)
        creep = np.clip(np.linalg.norm(state[:, 3:5], axis=1), lowest, highest)[:, None] * time_s
        range_m = np.linalg.norm(state[:, :3] - tracks.world_from_sensor[:3, 3], axis=1)
        turn = self._ego_speed_mps * time_s / np.maximum(range_m, tracks.radius_m[rows] + 0.1)[:, None]
        wander = VIEW_DRIFT_SHARE * tracks.radius_m[rows][:, None] * np.minimum(turn, MAX_VIEW_TURN_RAD)
        return Horizon(
            np.repeat(state[:, None, :3], steps, axis=1),
            np.zeros((len(state), steps, 2)),
            covariance[:, None, :2, :2] + (creep**2 + wander**2)[:, :, None, None] * np.eye(2),
        )

    def _conformal(self, is_static: BoolArray) -> FloatArray:
        if self._fixed is not None:
            return self._fixed[is_static.astype(np.int64)]
        if self.residuals is None or not len(is_static):
            return np.full((len(is_static), self._config.steps), np.nan)
        return self.residuals.pool.quantiles(self._config.probability)[is_static.astype(np.int64)]


def predict_tracks(
    tracks: Iterable[Tracks],
    config: PredictionConfig,
    tracking: TrackingConfig,
    notes: Notes,
    timer: Timer = no_timer,
    calibration: Calibration | None = None,
) -> Iterator[Predictions]:
    """One `Predictions` a frame, in order."""
    predictor = Predictor(config, tracking, notes, timer, calibration)
    for frame in tracks:
        yield predictor(frame)


def learn_calibration(
    tracks: Iterable[Tracks], config: PredictionConfig, tracking: TrackingConfig, notes: Notes, source: str
) -> Calibration:
    """Conformal radii from a whole log's tracks, to be used on other logs. `source` names the log."""
    learning = config.model_copy(update={"calibration": "past", "calibration_window": LEARNING_WINDOW})
    predictor = Predictor(learning, tracking, notes)
    assert predictor.residuals is not None
    for frame in tracks:
        predictor(frame)
    pool = predictor.residuals.pool
    return Calibration(config.probability, config.step_s, pool.quantiles(config.probability), pool.samples, source)


def sigma_radius(covariance_m2: FloatArray, probability: float) -> FloatArray:
    """(..., 2, 2) -> (...): radius of the circle around the Gaussian's ellipse of this probability.

    sqrt(chi2_2(p) lambda_max): it covers more than p wherever the ellipse is not a circle.
    """
    half_trace = 0.5 * (covariance_m2[..., 0, 0] + covariance_m2[..., 1, 1])
    half_difference = 0.5 * (covariance_m2[..., 0, 0] - covariance_m2[..., 1, 1])
    largest = half_trace + np.hypot(half_difference, covariance_m2[..., 0, 1])
    radius: FloatArray = np.sqrt(chdtri(2, 1.0 - probability) * largest)
    return radius


def _radii_from_file(config: PredictionConfig, calibration: Calibration | None) -> FloatArray:
    """(2, N) radii for this horizon from a calibration made with the same steps and probability."""
    if calibration is None:
        raise UsageError("prediction.calibration is 'file', but no calibration file was given")
    if not np.isclose(calibration.step_s, config.step_s, rtol=1e-9):
        raise UsageError(
            f"the calibration has steps of {calibration.step_s:g} s, the prediction of {config.step_s:g} s: "
            "set prediction.step_s to match"
        )
    if not np.isclose(calibration.probability, config.probability, rtol=1e-9):
        raise UsageError(
            f"the calibration is for probability {calibration.probability:g}, prediction.probability is "
            f"{config.probability:g}: set them to match"
        )
    if calibration.radius_m.shape[1] < config.steps:
        raise UsageError(
            f"the calibration covers {calibration.radius_m.shape[1]} steps, prediction.steps is {config.steps}"
        )
    return calibration.radius_m[:, : config.steps]
