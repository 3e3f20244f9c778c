"""Rigid transforms as 4 x 4 arrays named `target_from_source`, quaternions as (x, y, z, w), time
as int64 nanoseconds."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.types import FloatArray


def identity() -> FloatArray:
    return np.eye(4)


def rotation_from_quaternion(xyzw: FloatArray) -> FloatArray:
    """(..., 4) quaternions (x, y, z, w), any non-zero norm -> (..., 3, 3) rotation matrices."""
    q = np.asarray(xyzw, dtype=np.float64)
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_rotation(rotation: FloatArray) -> FloatArray:
    """(3, 3) rotation matrix -> (x, y, z, w) with w >= 0."""
    from scipy.spatial.transform import Rotation

    q: FloatArray = Rotation.from_matrix(rotation).as_quat()
    return q if q[3] >= 0 else -q


def pose_matrix(position_m: FloatArray, quaternion_xyzw: FloatArray) -> FloatArray:
    """The transform with this translation and rotation, 4 x 4."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_quaternion(quaternion_xyzw)
    matrix[:3, 3] = position_m
    return matrix


def invert(transform: FloatArray) -> FloatArray:
    """The inverse of a rigid transform, by transposing its rotation."""
    inverse = np.eye(4)
    rotation = transform[:3, :3].T
    inverse[:3, :3] = rotation
    inverse[:3, 3] = -rotation @ transform[:3, 3]
    return inverse


def transform_points(transform: FloatArray, points_m: FloatArray) -> FloatArray:
    """(n, 3) points, mapped by a 4 x 4 rigid transform."""
    return points_m @ transform[:3, :3].T + transform[:3, 3]


def level_rotation(world_from_sensor: FloatArray) -> FloatArray:
    """The 3 x 3 rotation from the sensor's frame to the levelled sensor frame: same origin and
    heading, z along the world's z. It takes out a tilted mount and the vehicle's roll and pitch."""
    rotation = world_from_sensor[:3, :3]
    heading = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ rotation


def wrap_angle(angle_rad: FloatArray) -> FloatArray:
    """Angles folded into [-pi, pi)."""
    return (np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi
