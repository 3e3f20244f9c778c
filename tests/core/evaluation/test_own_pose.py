"""Truth that is the robot's own pose, and truth that only keeps it company."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.evaluation.own_pose import rides_along
from adcbf_cli.core.types import FloatArray, Truth

STAMPS = np.arange(50, dtype=np.int64) * 100_000_000


def driven(speed_mps: float) -> FloatArray:
    """A sensor that drives along a bend, (50, 4, 4)."""
    poses = np.tile(np.eye(4), (50, 1, 1))
    angle = 0.02 * np.arange(50)
    poses[:, 0, 0] = poses[:, 1, 1] = np.cos(angle)
    poses[:, 1, 0], poses[:, 0, 1] = np.sin(angle), -np.sin(angle)
    step = speed_mps * 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    poses[:, :2, 3] = np.cumsum(step, axis=0)
    return poses


def labels(poses: FloatArray, local_m: FloatArray, offset_ns: int = 0) -> Truth:
    """Where something is that is at `local_m` (50, 2) in the sensor's frame."""
    position = np.zeros((50, 3))
    position[:, :2] = np.einsum("nij,nj->ni", poses[:, :2, :2], local_m) + poses[:, :2, 3]
    none = np.full(50, np.nan)
    ids = np.full(50, 7, dtype=np.int64)
    return Truth("world", STAMPS + offset_ns, ids, ("object",) * 50, position, none, none, none, none)


@pytest.mark.parametrize("local_m", [(0.0, 0.0), (-1.6, 0.2)])
def test_a_part_of_the_vehicle_rides_along(local_m: tuple[float, float]) -> None:
    poses = driven(1.0)
    assert rides_along(labels(poses, np.tile(local_m, (50, 1)), 8_000_000), STAMPS, poses) == (7,)


def test_who_walks_beside_the_robot_or_stands_does_not() -> None:
    poses = driven(1.0)
    sways = np.column_stack([np.linspace(1.0, 2.5, 50), np.full(50, 1.0)])
    assert rides_along(labels(poses, sways), STAMPS, poses) == ()
    stands = np.einsum("nij,nj->ni", np.linalg.inv(poses)[:, :2, :3], np.tile([3.0, 2.0, 0.0], (50, 1)))
    stands += np.linalg.inv(poses)[:, :2, 3]
    assert rides_along(labels(poses, stands), STAMPS, poses) == ()


def test_beside_a_robot_that_stands_nothing_can_be_told() -> None:
    poses = driven(0.0)
    assert rides_along(labels(poses, np.tile([2.0, 0.0], (50, 1))), STAMPS, poses) == ()
    assert rides_along(labels(poses, np.zeros((50, 2))), STAMPS[:0], poses[:0]) == ()


def test_labels_between_frames_say_nothing() -> None:
    poses = driven(1.0)
    assert rides_along(labels(poses, np.zeros((50, 2)), 50_000_000), STAMPS, poses) == ()
