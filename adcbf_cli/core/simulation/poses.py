"""Stacks of rigid transforms, (n, 4, 4)."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.types import FloatArray


def poses(
    x_m: FloatArray, y_m: FloatArray, z_m: FloatArray, yaw_rad: FloatArray, pitch_rad: FloatArray, roll_rad: FloatArray
) -> FloatArray:
    """(n, 4, 4) transforms Rz(yaw) Ry(pitch) Rx(roll) with these translations; (n,) each."""
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    matrix = np.zeros((len(x_m), 4, 4))
    matrix[:, 0] = np.column_stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, x_m])
    matrix[:, 1] = np.column_stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, y_m])
    matrix[:, 2] = np.column_stack([-sp, cp * sr, cp * cr, z_m])
    matrix[:, 3, 3] = 1.0
    return matrix


def compose(first: FloatArray, second: FloatArray) -> FloatArray:
    """(n, 4, 4) products of two stacks (n, 4, 4), or of a stack and one (4, 4)."""
    right = np.broadcast_to(second, first.shape)
    product: FloatArray = np.einsum("nij,njk->nik", first, right)
    return product
