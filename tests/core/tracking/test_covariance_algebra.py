"""Repairing factorisations, and mixing modes, against hand-made cases and filterpy's IMM."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import IMMEstimator, KalmanFilter
from hypothesis import given
from hypothesis import strategies as st

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.bank import NOISE_SCALE_BOUNDS, adapted_noise, smoothed_size
from adcbf_cli.core.tracking.filters import BatchFilter
from adcbf_cli.core.tracking.linalg import cholesky_with_repair
from adcbf_cli.core.tracking.modes import ModeChain, combine, mix, reweighed
from adcbf_cli.core.types import Notes


def test_only_the_broken_matrix_is_repaired_and_counted() -> None:
    good = np.array([[2.0, 0.5], [0.5, 1.0]])
    broken = np.array([[1.0, 0.0], [0.0, -0.1]])
    notes = Notes()
    factor, repaired = cholesky_with_repair(np.stack([good, broken]), notes)
    assert notes.counters == {"repaired_factorisations": 1}
    assert np.array_equal(repaired[0], good)
    assert repaired[1] == pytest.approx(np.diag([1.0, 0.0]), abs=1e-9)
    assert np.linalg.eigvalsh(repaired[1]).min() > 0
    assert factor @ np.swapaxes(factor, 1, 2) == pytest.approx(repaired)


def test_a_zero_matrix_is_repaired_to_a_positive_one() -> None:
    _, repaired = cholesky_with_repair(np.zeros((1, 6, 6)), Notes())
    assert np.linalg.eigvalsh(repaired[0]).min() > 0


def test_modes_equal_filterpys_imm() -> None:
    config = TrackingConfig(filter="kf", cruise_ratio=0.1)
    kalman = BatchFilter(config, False, Notes())
    chain = ModeChain.from_config(config)
    dt = 0.1
    f, q = kalman.motion.jacobian(np.zeros((1, 6)), dt), kalman.motion.process_noise(dt)
    r = np.diag([0.01, 0.02, 0.03])
    state, covariance = np.array([4.0, 1, 0, 0, 0, 0]), np.diag([0.1, 0.1, 0.1, 4, 4, 0.1])
    filters = []
    for factor in chain.noise_factor:
        kf = KalmanFilter(6, 3)
        kf.x, kf.P, kf.F, kf.Q, kf.R = state.copy(), covariance.copy(), f, factor * q, r
        kf.H = np.eye(3, 6)
        filters.append(kf)
    imm = IMMEstimator(filters, chain.stationary.copy(), chain.transition(dt))
    states, covariances = np.tile(state, (1, 2, 1)), np.tile(covariance, (1, 2, 1, 1))
    probabilities = chain.stationary[None]
    rng = np.random.default_rng(0)
    for k in range(80):
        z = np.array([4 + 0.1 * k + (0.01 * (k - 40) ** 2 if k > 40 else 0), 1, 0]) + rng.normal(0, 0.1, 3)
        imm.predict()
        imm.update(z)
        states, covariances, probabilities = mix(states, covariances, probabilities, chain.transition(dt))
        noise = chain.noise_factor[:, None, None] * q
        flat, spread = kalman.predict(states[0], covariances[0], dt, noise)
        expected = kalman.expect(flat, spread, np.eye(4))
        result = kalman.update(flat, spread, expected, np.tile(z, (2, 1)), np.tile(r, (2, 1, 1)))
        states, covariances = result.state[None], result.covariance[None]
        probabilities = reweighed(probabilities, result.log_likelihood[None])
        mean, combined = combine(states, covariances, probabilities)
        assert probabilities[0] == pytest.approx(imm.mu, rel=1e-5, abs=2e-6)
        assert mean[0] == pytest.approx(imm.x, rel=1e-5, abs=1e-6)
        assert combined[0] == pytest.approx(imm.P, rel=1e-4, abs=1e-6)
    assert probabilities[0, 1] > 3 * chain.stationary[1], "the second half accelerates"


@given(st.floats(0, 20), st.floats(0, 20))
def test_mode_switching_does_not_depend_on_how_time_is_cut(a: float, b: float) -> None:
    chain = ModeChain.from_config(TrackingConfig())
    assert chain.transition(a) @ chain.transition(b) == pytest.approx(chain.transition(a + b))
    assert chain.transition(a).sum(axis=1) == pytest.approx([1, 1])
    assert chain.stationary @ chain.transition(a) == pytest.approx(chain.stationary)


def test_mixture_moments_by_hand() -> None:
    """Half at 0, half at 2, each of variance 1: mean 1, variance 1 + 1."""
    states = np.array([[[0.0], [2.0]]])
    mean, covariance = combine(states, np.ones((1, 2, 1, 1)), np.array([[0.5, 0.5]]))
    assert mean[0, 0] == 1.0
    assert covariance[0, 0, 0] == 2.0


@pytest.mark.parametrize("true_sigma", [0.02, 0.1, 0.3])
def test_noise_scale_finds_the_true_noise(true_sigma: float) -> None:
    """A steady scalar random-walk filter with nominal sigma 0.1, fed with other noise."""
    rng = np.random.default_rng(1)
    nominal, process = 0.01, 0.001
    scale, estimate, variance, place = np.ones((1, 3)), 0.0, 1.0, 0.0
    history = []
    for k in range(1500):
        place += rng.normal(0, np.sqrt(process))
        variance += process
        noise = np.full((1, 1, 1), scale[0, 0] * nominal)
        total = noise + variance
        innovation = np.array([[place + rng.normal(0, true_sigma) - estimate]])
        gain = variance / total[0, 0, 0]
        estimate += gain * innovation[0, 0]
        variance *= 1 - gain
        scale = adapted_noise(scale, np.array([k]), innovation, total, noise)
        history.append(scale[0, 0])
    assert np.sqrt(nominal * np.mean(history[500:])) == pytest.approx(true_sigma, rel=0.25)
    assert scale[0, 1:] == pytest.approx([1, 1]), "what is not measured keeps its noise"


def test_noise_scale_is_bounded() -> None:
    scale = np.ones((1, 3))
    for _ in range(500):
        one = np.full((1, 1, 1), 1.0)
        scale = adapted_noise(scale, np.array([1]), np.array([[1e6]]), 1.1 * one, one)
    assert scale[0, 0] == NOISE_SCALE_BOUNDS[1]


def test_size_grows_sooner_than_it_shrinks() -> None:
    size = np.array([1.0])
    assert smoothed_size(size, np.array([2.0]))[0] == pytest.approx(1.3)
    assert smoothed_size(size, np.array([0.0]))[0] == pytest.approx(0.95)
