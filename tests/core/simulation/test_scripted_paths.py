"""Scripted paths against hand-computed places and speeds."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.simulation.paths import motion_along
from adcbf_cli.core.simulation.scenario import CirclePath, LinePath, StandPath, WaypointPath


def test_equation_11_has_a_constant_speed_of_0_236_mps():
    path = CirclePath(kind="circle", centre_m=(8.5, 2.0), radius_m=2.5, frequency_hz=0.015)
    time_s = np.linspace(0, 70, 701)
    motion = motion_along(path, time_s)
    angle = 2 * np.pi * 0.015 * time_s
    np.testing.assert_allclose(motion.x_m, 8.5 - 2.5 * np.sin(angle), atol=1e-12)
    np.testing.assert_allclose(motion.y_m, 2.0 - 2.5 * np.cos(angle), atol=1e-12)
    np.testing.assert_allclose(np.hypot(motion.vx_mps, motion.vy_mps), 2 * np.pi * 0.015 * 2.5, atol=1e-12)
    assert np.hypot(motion.vx_mps[0], motion.vy_mps[0]) == pytest.approx(0.236, abs=5e-4)


def test_a_line_waits_goes_and_stays():
    path = LinePath(kind="line", from_m=(1, 2), to_m=(4, 6), speed_mps=2.5, start_s=1)
    motion = motion_along(path, np.array([0.0, 1.0, 2.0, 3.0, 9.0]))
    np.testing.assert_allclose(motion.x_m, [1, 1, 2.5, 4, 4])
    np.testing.assert_allclose(motion.y_m, [2, 2, 4, 6, 6])
    np.testing.assert_allclose(motion.vx_mps, [0, 1.5, 1.5, 0, 0])
    np.testing.assert_allclose(motion.vy_mps, [0, 2.0, 2.0, 0, 0])
    np.testing.assert_allclose(motion.yaw_rad, np.arctan2(4, 3))


def test_waypoints_pause_and_turn_corners():
    path = WaypointPath(
        kind="waypoints", points_m=((0, 0), (2, 0), (2, 3)), speed_mps=1.0, pauses_s=(0.0, 4.0, 0.0), start_s=1
    )
    motion = motion_along(path, np.array([2.0, 4.0, 6.9, 8.0, 10.0, 11.0]))
    np.testing.assert_allclose(motion.x_m, [1, 2, 2, 2, 2, 2])
    np.testing.assert_allclose(motion.y_m, [0, 0, 0, 1, 3, 3], atol=1e-12)
    np.testing.assert_allclose(np.hypot(motion.vx_mps, motion.vy_mps), [1, 0, 0, 1, 0, 0], atol=1e-12)
    assert motion.yaw_rad[0] == pytest.approx(0)
    assert motion.yaw_rad[3] == pytest.approx(np.pi / 2)


def test_waypoint_times_are_kept():
    path = WaypointPath(kind="waypoints", points_m=((0, 0), (2, 0), (2, 6)), times_s=(1.0, 2.0, 5.0))
    motion = motion_along(path, np.array([1.0, 1.5, 2.0, 4.0]))
    np.testing.assert_allclose(motion.x_m, [0, 1, 2, 2])
    np.testing.assert_allclose(motion.y_m, [0, 0, 0, 4])
    np.testing.assert_allclose(motion.vx_mps, [2, 2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(motion.vy_mps, [0, 0, 2, 2], atol=1e-12)


def test_a_smooth_path_meets_its_waypoints_and_turns_without_jumps():
    corners = ((0, 0), (5, 0.8), (10, -0.5), (15, 0.5))
    path = WaypointPath(kind="waypoints", points_m=corners, times_s=(0.0, 7.0, 14.0, 21.0), smooth=True)
    at_corners = motion_along(path, np.array([0.0, 7.0, 14.0, 21.0]))
    np.testing.assert_allclose(np.column_stack([at_corners.x_m, at_corners.y_m]), corners, atol=1e-9)
    fine = motion_along(path, np.linspace(0, 21, 2101))
    assert np.abs(np.diff(fine.yaw_rad)).max() < 0.01
    moved = np.column_stack([np.diff(fine.x_m), np.diff(fine.y_m)]) / 0.01
    reported = np.column_stack([fine.vx_mps, fine.vy_mps])[:-1]
    np.testing.assert_allclose(moved, reported, atol=0.01)


@pytest.mark.parametrize(
    "path",
    [
        CirclePath(kind="circle", centre_m=(1, 2), radius_m=3, frequency_hz=-0.1, start_angle_deg=30),
        LinePath(kind="line", from_m=(0, 0), to_m=(-30, 12), speed_mps=0.7),
        WaypointPath(kind="waypoints", points_m=((0, 0), (9, 9), (20, 0)), speed_mps=1.3, smooth=True),
    ],
)
def test_velocity_is_the_derivative_of_position_and_yaw_its_direction(path: CirclePath | LinePath | WaypointPath):
    time_s = np.linspace(0.5, 9.5, 50)
    before, now, after = (motion_along(path, time_s + step) for step in (-1e-4, 0.0, 1e-4))
    np.testing.assert_allclose((after.x_m - before.x_m) / 2e-4, now.vx_mps, atol=0.02)
    np.testing.assert_allclose((after.y_m - before.y_m) / 2e-4, now.vy_mps, atol=0.02)
    np.testing.assert_allclose(np.cos(now.yaw_rad - np.arctan2(now.vy_mps, now.vx_mps)), 1.0, atol=1e-9)
    step = np.hypot(after.x_m - before.x_m, after.y_m - before.y_m)
    np.testing.assert_allclose(after.travelled_m - before.travelled_m, step, rtol=1e-3)


def test_standing_keeps_place_and_yaw():
    motion = motion_along(StandPath(kind="stand", at_m=(3, 4), yaw_deg=90), np.array([0.0, 50.0]))
    np.testing.assert_allclose(motion.x_m, 3)
    np.testing.assert_allclose(motion.yaw_rad, np.pi / 2)
    np.testing.assert_allclose(motion.vx_mps, 0)
