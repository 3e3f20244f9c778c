"""The logged vehicle's poses, speed and turn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from adcbf_cli.core.config import VehicleConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.replay.log_path import LogPath, inputs_of
from adcbf_cli.core.vehicles.vehicle import Vehicle

SECOND = 1_000_000_000


@dataclass
class Frame:
    stamp_ns: int
    world_from_sensor: np.ndarray
    pose_known: bool


def frame(stamp_ns: int, x: float, y: float, yaw: float, known: bool = True, roll: float = 0.0) -> Frame:
    c, s = np.cos(yaw), np.sin(yaw)
    cr, sr = np.cos(roll), np.sin(roll)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    matrix[:3, 3] = x, y, 1.7
    return Frame(stamp_ns, matrix, known)


def circle(radius_m: float, speed_mps: float, offset_rad: float = 0.0, noise_m: float = 0.0) -> LogPath:
    time_s = np.arange(201) / 10
    angle = speed_mps / radius_m * time_s
    pose = np.column_stack([radius_m * np.sin(angle), radius_m * (1 - np.cos(angle)), angle + offset_rad])
    pose[:, :2] += np.random.default_rng(100).normal(0.0, noise_m, (201, 2))
    return LogPath(np.round(time_s * 1e9).astype(np.int64), pose)


def test_frames_without_a_known_pose_are_left_out() -> None:
    path = LogPath.from_frames(
        [frame(0, 0, 0, 0), frame(SECOND // 2, 99, 99, 0, known=False), frame(SECOND, 1, 0.2, 0)]
    )
    assert path.stamp_ns.tolist() == [0, SECOND]
    np.testing.assert_allclose(path.at(np.array([SECOND // 4])), [[0.25, 0.05, 0.0]])


def test_no_scan_is_an_error() -> None:
    with pytest.raises(AdcbfError, match="no scan"):
        LogPath.from_frames([])


def test_yaw_is_the_x_axis_in_the_plane_whatever_the_roll() -> None:
    path = LogPath.from_frames([frame(0, 1, 2, 0.7, roll=0.3)])
    np.testing.assert_allclose(path.pose, [[1, 2, 0.7]])


def test_nothing_outside_or_across_a_gap() -> None:
    path = LogPath(np.array([0, SECOND, 3 * SECOND]), np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0.0]]))
    at = path.at(np.array([-1, 0, SECOND // 2, SECOND, 2 * SECOND, 3 * SECOND, 3 * SECOND + 1]))
    np.testing.assert_allclose(at[:, 0], [np.nan, 0, 0.5, 1, np.nan, 3, np.nan])


def test_yaw_takes_the_short_way_around() -> None:
    path = LogPath(np.array([0, SECOND]), np.array([[0, 0, np.pi - 0.1], [0, 0, -np.pi + 0.1]]))
    assert path.at(np.array([SECOND // 2]))[0, 2] == pytest.approx(np.pi)


def test_speed_and_turn_on_a_circle() -> None:
    path = circle(5.0, 2.0)
    inner = slice(5, -5)
    np.testing.assert_allclose(path.speed_mps[inner], 2.0, rtol=0.01)
    np.testing.assert_allclose(path.yaw_rate_radps[inner], 0.4, rtol=1e-6)


def test_noise_of_poses_is_smoothed() -> None:
    """Plain differences of 1 cm noise over 0.1 s would be 0.14 m/s off."""
    path = circle(1000.0, 1.0, noise_m=0.01)
    assert np.std(path.speed_mps - 1.0) < 0.04


def test_reverse_is_negative() -> None:
    path = LogPath(np.array([0, SECOND]), np.array([[0, 0, 0], [-0.2, 0, 0.0]]))
    np.testing.assert_allclose(path.speed_mps, -0.2)


def test_a_single_pose_has_no_speed() -> None:
    path = LogPath(np.array([5]), np.array([[1, 2, 3.0]]))
    assert np.isnan(path.speed_mps).all()
    vehicle = Vehicle.from_config(VehicleConfig())
    np.testing.assert_allclose(path.inputs_at(5, vehicle), [0, 0])


@pytest.mark.parametrize("offset", [np.pi / 2, -2.0, np.pi])
def test_a_sensor_mounted_turned_is_noticed(offset: float) -> None:
    path = circle(5.0, 1.0, offset_rad=offset)
    straight = circle(5.0, 1.0)
    assert abs(np.angle(np.exp(1j * (path.mount_yaw_rad - offset)))) < 0.02
    np.testing.assert_allclose(np.exp(1j * path.pose[:, 2]), np.exp(1j * straight.pose[:, 2]), atol=0.02)
    np.testing.assert_allclose(path.speed_mps[5:-5], 1.0, rtol=0.01)
    assert f"turned by {np.degrees(path.mount_yaw_rad):.0f} degrees" in str(path.mount_note)


@pytest.mark.parametrize("offset", [0.0, 0.2, -0.3])
def test_a_small_offset_is_left_alone(offset: float) -> None:
    assert circle(5.0, 1.0, offset_rad=offset).mount_note is None


def test_inputs_in_the_vehicles_own_terms() -> None:
    ackermann = Vehicle.from_config(VehicleConfig(kind="ackermann", wheelbase_m=2.0))
    np.testing.assert_allclose(inputs_of(np.array([4.0, 0.5]), ackermann), [4.0, np.arctan(2.0 * 0.5 / 4.0)])
    motion = np.array([[4.0, 0.5], [-3.0, 0.2]])
    np.testing.assert_allclose(ackermann.yaw_rate(inputs_of(motion, ackermann)), motion[:, 1])
    assert np.isfinite(inputs_of(np.array([0.0, 0.5]), ackermann)).all()
    unicycle = Vehicle.from_config(VehicleConfig())
    np.testing.assert_allclose(inputs_of(np.array([4.0, 0.5]), unicycle), [4.0, 0.5])


def test_stamps_that_go_back_are_left_out() -> None:
    path = LogPath(np.array([0, 10, 5, 10, 20]), np.array([[0, 0, 0], [1, 0, 0], [9, 9, 9], [9, 9, 9], [2, 0, 0.0]]))
    assert path.stamp_ns.tolist() == [0, 10, 20]


def test_nowhere_has_times_and_no_poses() -> None:
    path = LogPath.from_frames([frame(0, 0, 0, 0, known=False), frame(SECOND, 0, 0, 0, known=False)])
    assert not path.known
    assert (path.start_ns, path.end_ns) == (0, SECOND)
    assert np.isnan(path.at(np.array([0, SECOND // 2]))).all()
