"""The LiDAR's rays and times, its noise, and the odometry's drift."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.simulation.lidar import (
    COORDINATE_STEP_M,
    base_from_sensor,
    firing_pattern,
    measured_ranges,
    quantise,
)
from adcbf_cli.core.simulation.odometry import simulate_drift
from adcbf_cli.core.simulation.poses import poses
from adcbf_cli.core.simulation.scenario import Mount, Odometry, PlanarLaser, SpinningLidar
from adcbf_cli.core.types import FloatArray


def test_a_revolution_of_a_spinning_lidar():
    lidar = SpinningLidar(
        kind="spinning", elevations_deg=(-10.0, 0.0, 5.0), azimuth_step_deg=30, rate_hz=10, start_azimuth_deg=-180
    )
    pattern = firing_pattern(lidar)
    assert pattern.period_ns == 100_000_000
    np.testing.assert_array_equal(pattern.offset_ns[::3], [0, 25_000_000, 50_000_000, 75_000_000])
    np.testing.assert_allclose(pattern.directions[::3, 1], [[-1, 0, 0], [0, -1, 0], [1, 0, 0], [0, 1, 0]], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(pattern.directions, axis=-1), 1.0)
    np.testing.assert_allclose(pattern.directions[:, 0, 2], np.sin(np.deg2rad(-10)))


def test_channels_spread_evenly():
    lidar = SpinningLidar(kind="spinning", channels=4, lowest_elevation_deg=-15, highest_elevation_deg=15)
    elevation = np.rad2deg(np.arcsin(firing_pattern(lidar).directions[0, :, 2]))
    np.testing.assert_allclose(elevation, [-15, -5, 5, 15])


def test_an_instantaneous_lidar_has_no_offsets():
    lidar = SpinningLidar(kind="spinning", instantaneous=True)
    assert (firing_pattern(lidar).offset_ns == 0).all()


def test_a_planar_laser_steps_through_its_view():
    laser = PlanarLaser(kind="planar", first_azimuth_deg=-90, last_azimuth_deg=90, azimuth_step_deg=0.5, rate_hz=20)
    pattern = firing_pattern(laser)
    assert pattern.directions.shape == (361, 1, 3)
    np.testing.assert_allclose(pattern.azimuth_rad[[0, 180, 360]], [-np.pi / 2, 0, np.pi / 2], atol=1e-12)
    assert pattern.offset_ns[-1] == 25_000_000
    assert (pattern.directions[..., 2] == 0).all()


def test_the_mount_pitches_the_nose_down_for_positive_pitch():
    pose = base_from_sensor(Mount(x_m=0.2, height_m=1.1, pitch_deg=10))
    np.testing.assert_allclose(pose[:3, 3], [0.2, 0, 1.1])
    assert pose[2, 0] == pytest.approx(-np.sin(np.deg2rad(10)))


def ranging(**changes: float) -> SpinningLidar:
    values = {"range_sigma_m": 0.0, "dropout_probability": 0.0, "min_range_m": 0.5, "max_range_m": 20.0}
    return SpinningLidar(kind="spinning", **(values | changes))


def test_range_noise_has_the_asked_spread_and_no_bias():
    true = np.full((400, 250), 10.0)
    error = measured_ranges(true, ranging(range_sigma_m=0.03), np.random.default_rng(0)) - 10.0
    assert error.mean() == pytest.approx(0.0, abs=4 * 0.03 / np.sqrt(true.size))
    assert error.std() == pytest.approx(0.03, rel=0.01)


def test_dropouts_come_at_the_asked_rate():
    lost = np.isinf(
        measured_ranges(np.full((400, 250), 10.0), ranging(dropout_probability=0.2), np.random.default_rng(0))
    )
    assert lost.mean() == pytest.approx(0.2, abs=4 * np.sqrt(0.16 / lost.size))


def test_what_is_too_near_too_far_or_nothing_is_not_returned():
    measured = measured_ranges(np.array([[0.4, 0.6, 19.0, 21.0, np.inf]]), ranging(), np.random.default_rng(0))
    np.testing.assert_array_equal(measured, [[np.inf, 0.6, 19.0, np.inf, np.inf]])


def test_noise_of_one_ray_does_not_depend_on_what_the_others_hit():
    lidar = ranging(range_sigma_m=0.02, dropout_probability=0.1)
    full = np.full((50, 16), 8.0)
    holes = full.copy()
    holes[::2] = np.inf
    first = measured_ranges(full, lidar, np.random.default_rng(7))
    second = measured_ranges(holes, lidar, np.random.default_rng(7))
    np.testing.assert_array_equal(first[1::2], second[1::2])


def test_quantised_coordinates_are_exact_in_single_precision():
    value = quantise(np.random.default_rng(0).uniform(-60, 60, size=1000))
    np.testing.assert_array_equal(value.astype(np.float32).astype(np.float64), value)
    np.testing.assert_array_equal(value % COORDINATE_STEP_M, 0)


def straight_drive(length_m: float, samples: int) -> tuple[FloatArray, FloatArray]:
    x = np.linspace(0, length_m, samples)
    zero = np.zeros_like(x)
    return np.linspace(0, 10, samples), poses(x, zero, zero, zero, zero, zero)


def test_exact_odometry_does_not_drift():
    time_s, pose = straight_drive(10, 100)
    drift = simulate_drift(Odometry(), time_s, pose, np.random.default_rng(0)).at(time_s)
    np.testing.assert_allclose(drift, np.tile(np.eye(4), (100, 1, 1)), atol=1e-12)


@pytest.mark.parametrize("samples", [50, 500])
def test_drift_grows_with_distance_whatever_the_rate(samples: int):
    """After 25 m: heading error 0.01 * 5 = 0.05 rad; along the drive 0.02 * 5 = 0.1 m."""
    odometry = Odometry(translation_sigma_m_per_sqrt_m=0.02, heading_sigma_rad_per_sqrt_m=0.01)
    time_s, pose = straight_drive(25, samples)
    ends = []
    for seed in range(600):
        drift = simulate_drift(odometry, time_s, pose, np.random.default_rng(seed))
        reported = drift.at(time_s[-1:])[0] @ pose[-1]
        ends.append((reported[0, 3] - 25, np.arctan2(reported[1, 0], reported[0, 0])))
    along, heading = np.array(ends).T
    assert heading.std() == pytest.approx(0.05, rel=0.1)
    assert along.std() == pytest.approx(0.1, rel=0.15)


def test_turning_on_the_spot_drifts_in_heading_alone():
    yaw = np.linspace(0, 4.0, 200)
    zero = np.zeros_like(yaw)
    pose = poses(zero + 3, zero - 2, zero, yaw, zero, zero)
    odometry = Odometry(heading_sigma_rad_per_sqrt_rad=0.05, translation_sigma_m_per_sqrt_m=1.0)
    turns = []
    for seed in range(400):
        reported = simulate_drift(odometry, yaw, pose, np.random.default_rng(seed)).at(yaw[-1:])[0] @ pose[-1]
        np.testing.assert_allclose(reported[:2, 3], [3, -2], atol=1e-9)
        turns.append(np.arctan2(reported[1, 0], reported[0, 0]) - np.arctan2(np.sin(4), np.cos(4)))
    assert np.std(turns) == pytest.approx(0.05 * 2, rel=0.1)


def test_drifted_steps_are_the_true_steps_seen_from_the_wrong_heading():
    """With heading errors alone, odometry drives the true lengths: only directions are wrong."""
    rng = np.random.default_rng(2)
    yaw = np.cumsum(rng.normal(scale=0.1, size=100))
    x, y = np.cumsum(np.cos(yaw)) * 0.1, np.cumsum(np.sin(yaw)) * 0.1
    zero = np.zeros_like(x)
    pose = poses(x, y, zero, yaw, zero, zero)
    odometry = Odometry(heading_sigma_rad_per_sqrt_m=0.1)
    time_s = np.arange(100.0)
    reported = simulate_drift(odometry, time_s, pose, rng).at(time_s) @ pose
    true_step = np.linalg.norm(np.diff(pose[:, :2, 3], axis=0), axis=1)
    np.testing.assert_allclose(np.linalg.norm(np.diff(reported[:, :2, 3], axis=0), axis=1), true_step, atol=1e-12)
    assert np.linalg.norm(reported[-1, :2, 3] - pose[-1, :2, 3]) > 0.01
