"""Predicted means and covariances against a loop of filterpy's predict, step by step."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.prediction.propagation import Propagator
from adcbf_cli.core.tracking.motion import build_motion_model
from adcbf_cli.core.types import Notes

STEPS, STEP_S, TRACKS = 30, 0.1, 5


def starts(dimension: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    states = rng.normal(0, 2, (TRACKS, dimension))
    root = rng.normal(0, 0.2, (TRACKS, dimension, dimension))
    return states, root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(dimension)


def reference(config: TrackingConfig, state: np.ndarray, covariance: np.ndarray, factors: list[float]) -> tuple:
    motion = build_motion_model(config, planar=False)
    d = motion.dimension
    points = MerweScaledSigmaPoints(d, config.ukf_alpha, config.ukf_beta, config.ukf_kappa)
    ukf = UnscentedKalmanFilter(d, 1, STEP_S, lambda x: x[:1], lambda x, dt: motion.propagate(x[None], dt)[0], points)
    ukf.x, ukf.P = state.copy(), covariance.copy()
    means, covariances = [], []
    for factor in factors:
        ukf.Q = factor * motion.process_noise(STEP_S)
        ukf.predict()
        means.append(ukf.x.copy())
        covariances.append(ukf.P[:2, :2].copy())
    return np.array(means), np.array(covariances)


@pytest.mark.parametrize(("model", "tolerance"), [("cv", 1e-8), ("ca", 1e-8), ("ct", 1e-6)])
def test_prediction_equals_filterpys_loop(model: str, tolerance: float) -> None:
    """One noise level. The oracle's own rounding (weights of 1e6) bounds the agreement for ct."""
    config = TrackingConfig(model=model, cruise_ratio=1.0)
    states, covariances = starts({"cv": 6, "ca": 9, "ct": 7}[model])
    horizon = Propagator(config, STEPS, STEP_S, Notes())(states, covariances, None)
    for i in range(TRACKS):
        means, planes = reference(config, states[i], covariances[i], [1.0] * STEPS)
        assert horizon.position_m[i] == pytest.approx(means[:, :3], rel=tolerance, abs=tolerance)
        assert horizon.velocity_mps[i] == pytest.approx(means[:, 3:5], rel=tolerance, abs=tolerance)
        assert horizon.covariance_m2[i] == pytest.approx(planes, rel=tolerance, abs=tolerance)


@pytest.mark.parametrize("model", ["cv", "ct"])
@pytest.mark.parametrize("manoeuvre", [0.0, 0.3, 1.0])
def test_noise_follows_the_modes(model: str, manoeuvre: float) -> None:
    """The expected noise level at each step, from the two-state chain's closed form."""
    config = TrackingConfig(model=model, cruise_ratio=0.1, cruise_s=4.0, manoeuvre_s=1.0)
    states, covariances = starts({"cv": 6, "ct": 7}[model])
    horizon = Propagator(config, STEPS, STEP_S, Notes())(states, covariances, np.full(TRACKS, manoeuvre))
    time_s = STEP_S * np.arange(1, STEPS + 1)
    share = 0.2 + (manoeuvre - 0.2) * np.exp(-1.25 * time_s)
    means, planes = reference(config, states[2], covariances[2], (share + (1 - share) * 0.01).tolist())
    assert horizon.covariance_m2[2] == pytest.approx(planes, rel=1e-6, abs=1e-6)
    assert horizon.position_m[2] == pytest.approx(means[:, :3], rel=1e-6, abs=1e-6)


def test_covariance_by_hand() -> None:
    """Constant velocity, one axis: P_xx + t^2 P_vv + q t^3 / 3."""
    config = TrackingConfig(cruise_ratio=1.0, sigma_accel_mps2=2.0)
    covariance = np.diag([0.04, 0.09, 0.01, 0.25, 0.36, 0.01])[None]
    horizon = Propagator(config, 10, 0.3, Notes())(np.zeros((1, 6)), covariance, None)
    t = 0.3 * np.arange(1, 11)
    assert horizon.covariance_m2[0, :, 0, 0] == pytest.approx(0.04 + 0.25 * t**2 + 4 * t**3 / 3)
    assert horizon.covariance_m2[0, :, 1, 1] == pytest.approx(0.09 + 0.36 * t**2 + 4 * t**3 / 3)
    assert horizon.covariance_m2[0, :, 0, 1] == pytest.approx(0.0)


@pytest.mark.parametrize("model", ["cv", "ca", "ct"])
def test_a_finer_step_predicts_the_same(model: str) -> None:
    config = TrackingConfig(model=model, cruise_ratio=1.0)
    states, covariances = starts({"cv": 6, "ca": 9, "ct": 7}[model])
    covariances *= 0.01
    coarse = Propagator(config, 10, 0.1, Notes())(states, covariances, None)
    fine = Propagator(config, 40, 0.025, Notes())(states, covariances, None)
    assert fine.position_m[:, 3::4] == pytest.approx(coarse.position_m, abs=2e-2)
    assert fine.covariance_m2[:, 3::4] == pytest.approx(coarse.covariance_m2, rel=0.1, abs=2e-2)
    if model != "ct":
        assert fine.covariance_m2[:, 3::4] == pytest.approx(coarse.covariance_m2, rel=1e-9, abs=1e-12)


def test_a_turning_track_goes_round() -> None:
    """1 m/s at 0.5 rad/s, hardly uncertain: after pi s it is half way round a circle of 2 m."""
    state = np.array([[0.0, 0, 0, 1, 0, 0, 0.5]])
    config = TrackingConfig(model="ct", sigma_turn_radps2=1e-3)
    horizon = Propagator(config, 20, 2 * np.pi / 20, Notes())(state, 1e-8 * np.eye(7)[None], np.zeros(1))
    assert horizon.position_m[0, -1, :2] == pytest.approx([0.0, 4.0], abs=1e-3)
