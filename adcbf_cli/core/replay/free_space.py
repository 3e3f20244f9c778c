"""What a scan shows to be free: places that its rays passed through."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.types import BoolArray, FloatArray, Frame

CORE = 0.5
"""Rays count where they pass within this share of the radius: near the rim they may just have missed."""

MIN_RAYS = 5
"""So many rays prove that nothing is there; fewer may have found a gap."""


def seen_through(frame: Frame, centre_m: FloatArray, radius_m: FloatArray) -> BoolArray:
    """(k,) whether rays went through upright things at centres (k, 3), world, of radii (k,), at or below their centre's
    height, and ended behind them. What no ray meets, as a low rock in front of the sensor, is not seen through."""
    if not len(centre_m) or not len(frame.points_m):
        return np.zeros(len(centre_m), dtype=np.bool_)
    points = frame.points_m @ frame.world_from_sensor[:3, :3].T
    reach_m = np.hypot(points[:, 0], points[:, 1])
    offset = centre_m - frame.world_from_sensor[:3, 3]
    place_m = np.hypot(offset[:, 0], offset[:, 1])
    bearing = np.arctan2(offset[:, 1], offset[:, 0])
    aside = np.arctan2(points[:, 1], points[:, 0]) - bearing[:, None]
    aside_m = place_m[:, None] * np.abs(np.sin(aside))
    through = (np.cos(aside) > 0.0) & (aside_m < CORE * radius_m[:, None])
    through &= reach_m > (place_m + radius_m)[:, None]
    through &= points[:, 2] / np.maximum(reach_m, 1e-6) * place_m[:, None] <= offset[:, 2, None]
    return np.asarray(np.count_nonzero(through, axis=1) >= MIN_RAYS)
