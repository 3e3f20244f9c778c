"""The batched filters, track by track, against filterpy's one-at-a-time filters."""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.frames import pose_matrix, wrap_angle
from adcbf_cli.core.tracking.filters import BatchFilter
from adcbf_cli.core.types import Notes

STEPS = 120
TRACKS = 4


def sensor_pose(step: int) -> np.ndarray:
    """A sensor that drives a bend, with some roll and pitch."""
    half = 0.5 * 0.02 * step
    quaternion = np.array([0.02 * np.sin(step / 7), 0.03, np.sin(half), np.cos(half)])
    return pose_matrix(np.array([0.05 * step, 0.01 * step, 1.5]), quaternion)


def scenario(dimension: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Starting states around the sensor (all four quadrants), covariances, and irregular steps."""
    rng = np.random.default_rng(seed)
    states = np.zeros((TRACKS, dimension))
    states[:, :3] = [[8, 3, 0.5], [-6, 5, 1.0], [-7, -0.02, 0.2], [9, -6, 2.0]]
    states[:, 3:5] = rng.normal(0, 1, (TRACKS, 2))
    if dimension == 7:
        states[:, 6] = [0.5, -0.3, 0.0, 1e-6]
    root = rng.normal(0, 0.15, (TRACKS, dimension, dimension))
    covariances = root @ np.swapaxes(root, 1, 2) + 0.05 * np.eye(dimension)
    return states, covariances, rng.choice([0.05, 0.1, 0.22], STEPS)


def measured_points(states: np.ndarray, rng: np.random.Generator, pose: np.ndarray) -> np.ndarray:
    """Noisy centres in the sensor's frame, near where the tracks are, so that updates stay sane."""
    return (states[:, :3] + rng.normal(0, 0.05, (TRACKS, 3)) - pose[:3, 3]) @ pose[:3, :3]


def noise_of(kalman: BatchFilter, points: np.ndarray) -> np.ndarray:
    return kalman.measurement.noise(points, np.tile([0.05**2, 0.07**2, 0.08**2], (TRACKS, 1)), np.zeros((TRACKS, 1, 3)))


def spherical(point: np.ndarray, planar: bool) -> np.ndarray:
    """Range, azimuth, elevation, written out once more, independently."""
    x, y, z = point
    if planar:
        return np.array([np.sqrt(x * x + y * y), np.arctan2(y, x)])
    return np.array([np.linalg.norm(point), np.arctan2(y, x), np.arcsin(z / np.linalg.norm(point))])


def residual(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    difference = a - b
    difference[1] = wrap_angle(difference[1])
    return difference


def wrapped_mean(sigmas: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The azimuth's mean as that of wrapped deviations from the first sigma point.

    The mean of sines and cosines differs from it by a factor 1 / (1 - variance / 2) on the
    deviation, through the centre point's large negative weight: 1e-5 m in these scenes.
    """
    mean = weights @ sigmas
    mean[1] = sigmas[0, 1] + weights @ wrap_angle(sigmas[:, 1] - sigmas[0, 1])
    return mean


def circular_mean(sigmas: np.ndarray, weights: np.ndarray) -> np.ndarray:
    mean = weights @ sigmas
    mean[1] = np.arctan2(weights @ np.sin(sigmas[:, 1]), weights @ np.cos(sigmas[:, 1]))
    return mean


@pytest.mark.parametrize(
    ("model", "planar", "mean", "tolerance"),
    [
        ("cv", False, wrapped_mean, 1e-6),
        ("ca", False, wrapped_mean, 1e-6),
        ("ct", False, wrapped_mean, 1e-6),
        ("cv", True, wrapped_mean, 1e-6),
        ("ct", True, wrapped_mean, 1e-6),
        ("cv", False, circular_mean, 1e-3),
    ],
)
def test_ukf_equals_filterpy_over_many_steps(model: str, planar: bool, mean: object, tolerance: float) -> None:
    config = TrackingConfig(model=model, sigma_range_m=1.0)  # wide spreads, too, go through sigma points
    notes = Notes()
    kalman = BatchFilter(config, planar, notes)
    d, k = kalman.motion.dimension, kalman.measurement.dimension
    states, covariances, steps = scenario(d, seed=1)
    references = []
    for state, covariance in zip(states, covariances, strict=True):
        points = MerweScaledSigmaPoints(d, config.ukf_alpha, config.ukf_beta, config.ukf_kappa)
        ukf = UnscentedKalmanFilter(
            d,
            k,
            0.1,
            hx=lambda x, pose: spherical((x[:3] - pose[:3, 3]) @ pose[:3, :3], planar),
            fx=lambda x, dt: kalman.motion.propagate(x[None], dt)[0],
            points=points,
            z_mean_fn=mean,
            residual_z=residual,
        )
        ukf.x, ukf.P = state.copy(), covariance.copy()
        references.append(ukf)
    rng = np.random.default_rng(2)
    for step, dt in enumerate(steps):
        noise = kalman.motion.process_noise(dt) + 1e-6 * np.eye(d)
        states, covariances = kalman.predict(states, covariances, dt, noise)
        pose = sensor_pose(step)
        points = measured_points(states, rng, pose)
        measured, r = kalman.measurement.observe(points), noise_of(kalman, points)
        result = kalman.update(states, covariances, kalman.expect(states, covariances, pose), measured, r)
        states, covariances = result.state, result.covariance
        for i, ukf in enumerate(references):
            ukf.Q = noise
            ukf.predict(dt=dt)
            ukf.update(measured[i], R=r[i], pose=pose)
            assert states[i] == pytest.approx(ukf.x, rel=tolerance, abs=tolerance)
            assert covariances[i] == pytest.approx(ukf.P, rel=tolerance, abs=tolerance)
            assert np.sqrt(result.nis[i]) == pytest.approx(ukf.mahalanobis, rel=tolerance, abs=10 * tolerance)
    assert notes.counters == {}


@pytest.mark.parametrize("model", ["cv", "ca"])
def test_kf_equals_filterpy(model: str) -> None:
    kalman = BatchFilter(TrackingConfig(filter="kf", model=model), False, Notes())
    d = kalman.motion.dimension
    states, covariances, steps = scenario(d, seed=3)
    references = []
    for state, covariance in zip(states, covariances, strict=True):
        kf = KalmanFilter(d, 3)
        kf.x, kf.P = state.copy(), covariance.copy()
        references.append(kf)
    rng = np.random.default_rng(4)
    for step, dt in enumerate(steps):
        noise = kalman.motion.process_noise(dt)
        states, covariances = kalman.predict(states, covariances, dt, noise)
        pose = sensor_pose(step)
        points = measured_points(states, rng, pose)
        r = noise_of(kalman, points)
        result = kalman.update(states, covariances, kalman.expect(states, covariances, pose), points, r)
        states, covariances = result.state, result.covariance
        for i, kf in enumerate(references):
            kf.predict(F=kalman.motion.jacobian(states, dt), Q=noise)
            # The oracle measures in the world frame, with the noise turned into it.
            observation = np.hstack([np.eye(3), np.zeros((3, d - 3))])
            world = pose[:3, :3] @ points[i] + pose[:3, 3]
            kf.update(world, R=pose[:3, :3] @ r[i] @ pose[:3, :3].T, H=observation)
            assert states[i] == pytest.approx(kf.x, rel=1e-9, abs=1e-9)
            assert covariances[i] == pytest.approx(kf.P, rel=1e-8, abs=1e-9)


def test_ekf_equals_filterpy() -> None:
    kalman = BatchFilter(TrackingConfig(filter="ekf"), False, Notes())
    states, covariances, steps = scenario(6, seed=5)
    references = []
    for state, covariance in zip(states, covariances, strict=True):
        ekf = ExtendedKalmanFilter(6, 3)
        ekf.x, ekf.P = state.copy(), covariance.copy()
        references.append(ekf)
    rng = np.random.default_rng(6)
    for step, dt in enumerate(steps):
        noise = kalman.motion.process_noise(dt)
        states, covariances = kalman.predict(states, covariances, dt, noise)
        pose = sensor_pose(step)
        points = measured_points(states, rng, pose)
        measured, r = kalman.measurement.observe(points), noise_of(kalman, points)
        result = kalman.update(states, covariances, kalman.expect(states, covariances, pose), measured, r)
        states, covariances = result.state, result.covariance

        def expected(x: np.ndarray, pose: np.ndarray = pose) -> np.ndarray:
            return spherical((x[:3] - pose[:3, 3]) @ pose[:3, :3], planar=False)

        def slope(x: np.ndarray) -> np.ndarray:
            return central_difference(expected, x, 1e-6)

        for i, ekf in enumerate(references):
            ekf.F, ekf.Q = kalman.motion.jacobian(states, dt), noise
            ekf.predict()
            ekf.update(measured[i], HJacobian=slope, Hx=expected, R=r[i], residual=residual)
            assert states[i] == pytest.approx(ekf.x, rel=1e-6, abs=1e-7)
            assert covariances[i] == pytest.approx(ekf.P, rel=1e-5, abs=1e-7)


def central_difference(function: object, x: np.ndarray, h: float) -> np.ndarray:
    assert callable(function)
    columns = [(function(x + h * e) - function(x - h * e)) / (2 * h) for e in np.eye(len(x))]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("kind", ["ekf", "kf"])
def test_measurement_jacobian_is_the_derivative(kind: str, planar: bool) -> None:
    measurement = BatchFilter(TrackingConfig(filter=kind), planar, Notes()).measurement
    points = np.random.default_rng(7).uniform(-10, 10, (20, 3))
    jacobian = measurement.jacobian(points)
    for point, analytic in zip(points, jacobian, strict=True):
        numeric = central_difference(measurement.observe, point, 1e-6)
        assert analytic == pytest.approx(numeric, abs=1e-7)


@pytest.mark.parametrize("rate", [0.0, 1e-9, 1e-5, 9e-4, 1.1e-3, 0.3, -2.0])
def test_turn_jacobian_is_the_derivative(rate: float) -> None:
    motion = BatchFilter(TrackingConfig(model="ct"), False, Notes()).motion
    state = np.array([1.0, -2.0, 0.5, 1.3, -0.4, 0.1, rate])
    numeric = central_difference(lambda x: motion.propagate(x[None], 0.1)[0], state, 1e-5)
    assert motion.jacobian(state[None], 0.1)[0] == pytest.approx(numeric, abs=1e-8)


def test_a_coordinated_turn_goes_round_a_circle() -> None:
    """At 1 m/s and pi/2 rad/s, a quarter turn in 1 s ends a radius ahead and a radius to the left."""
    motion = BatchFilter(TrackingConfig(model="ct"), False, Notes()).motion
    end = motion.propagate(np.array([[0.0, 0, 0, 1, 0, 0, np.pi / 2]]), 1.0)[0]
    assert end == pytest.approx([2 / np.pi, 2 / np.pi, 0, 0, 1, 0, np.pi / 2], abs=1e-12)


@pytest.mark.parametrize("model", ["cv", "ca"])
def test_process_noise_does_not_depend_on_how_time_is_cut(model: str) -> None:
    motion = BatchFilter(TrackingConfig(model=model), False, Notes()).motion
    f = motion.jacobian(np.zeros((1, motion.dimension)), 0.13)
    twice = f @ motion.process_noise(0.13) @ f.T + motion.process_noise(0.13)
    assert motion.process_noise(0.26) == pytest.approx(twice, rel=1e-12, abs=1e-15)


def test_noise_in_angles_is_that_in_metres_at_the_distance() -> None:
    """A standard deviation of 0.1 m across, at 5 m, is 0.02 rad; along a spread vector it is rank one."""
    measurement = BatchFilter(TrackingConfig(), False, Notes()).measurement
    points = np.array([[3.0, 4.0, 0.0]])
    noise = measurement.noise(points, np.array([[0.04, 0.01, 0.09]]), np.zeros((1, 1, 3)))[0]
    assert noise == pytest.approx(np.diag([0.04, 0.01 / 25, 0.09 / 25]))
    across = measurement.noise(points, np.full((1, 3), 1e-12), np.array([[[-0.8, 0.6, 0.0]]]))[0]
    assert across == pytest.approx(np.diag([0.0, 1 / 25, 0.0]), abs=1e-9)


@pytest.mark.parametrize("kind", ["ukf", "ekf", "kf"])
@pytest.mark.parametrize("point", [[0.0, 0.0, 0.0], [0.0, 0.0, 3.0], [1e-12, 0.0, -1.0], [-5.0, 0.0, 0.0]])
def test_points_at_or_above_the_sensor_give_no_nan(kind: str, point: list[float]) -> None:
    kalman = BatchFilter(TrackingConfig(filter=kind), False, Notes())
    state = np.zeros((1, 6))
    state[0, :3] = point
    covariance = 0.1 * np.eye(6)[None]
    for _ in range(50):
        state, covariance = kalman.predict(state, covariance, 0.1, kalman.motion.process_noise(0.1))
        at = np.array([point])
        r = kalman.measurement.noise(at, np.full((1, 3), 0.01), np.zeros((1, 1, 3)))
        expected = kalman.expect(state, covariance, np.eye(4))
        result = kalman.update(state, covariance, expected, kalman.measurement.observe(at), r)
        state, covariance = result.state, result.covariance
        assert np.isfinite(state).all()
        assert np.linalg.eigvalsh(covariance).min() > 0
    assert state[0, :3] == pytest.approx(point, abs=0.5)
