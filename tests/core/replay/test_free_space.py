"""What scans show to be free: rays through a place, below the height of what was there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from adcbf_cli.core.replay.free_space import MIN_RAYS, seen_through
from adcbf_cli.core.types import FloatArray, Frame

SENSOR_HEIGHT_M = 0.5


def sensor_at(x: float = 0.0, y: float = 0.0, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    pose[:3, 3] = x, y, SENSOR_HEIGHT_M
    return pose


def ground_scan(world_from_sensor: FloatArray, without: float | None = None) -> Frame:
    """Rays every 2 degrees at three elevations that end on flat ground, but none towards the azimuth `without`."""
    around, up = np.meshgrid(np.deg2rad(np.arange(0.0, 360.0, 2.0)), np.deg2rad([-15.0, -11.0, -7.0]))
    reach = SENSOR_HEIGHT_M / np.tan(-up)
    points = np.stack([reach * np.cos(around), reach * np.sin(around), np.full_like(reach, -SENSOR_HEIGHT_M)], axis=-1)
    if without is not None:
        points = points[np.cos(around - without) < np.cos(0.3)]
    in_sensor = points.reshape(-1, 3) @ world_from_sensor[:3, :3]
    return Frame(0, 0, in_sensor, world_from_sensor, planar=False, pose_known=True)


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0, 0.0, 0.0), (7.0, -3.0, 0.2, -0.1, 2.0)])
def test_a_person_who_left_is_seen_through_and_a_low_rock_near_by_is_not(place: tuple[float, ...]) -> None:
    frame = ground_scan(sensor_at(*place))
    x, y = place[:2]
    person, rock, far = [x + 1.2, y + 0.3, 0.8], [x - 0.5, y, 0.15], [x, y + 6.0, 0.8]
    found = seen_through(frame, np.array([person, rock, far]), np.array([0.25, 0.2, 0.3]))
    assert found.tolist() == [True, False, False], "over the rock the lowest ray is too high, and none goes beyond 6 m"


def test_where_no_ray_goes_nothing_is_proved() -> None:
    frame = ground_scan(sensor_at(), without=0.0)
    either = np.array([[1.2, 0.0, 0.8], [-1.2, 0.0, 0.8]])
    assert seen_through(frame, either, np.full(2, 0.25)).tolist() == [False, True]


def test_a_gap_is_no_proof() -> None:
    thin_m = 1.2 * np.deg2rad(2.0)  # one column of three rays
    assert MIN_RAYS > 3
    assert not seen_through(ground_scan(sensor_at()), np.array([[1.2, 0.0, 0.8]]), np.array([thin_m])).any()


def test_without_things_or_points_nothing_is_seen_through() -> None:
    assert seen_through(ground_scan(sensor_at()), np.empty((0, 3)), np.empty(0)).shape == (0,)
    empty = Frame(0, 0, np.empty((0, 3)), np.eye(4), planar=False, pose_known=True)
    assert seen_through(empty, np.array([[1.0, 0.0, 0.5]]), np.array([0.3])).tolist() == [False]
