"""Motion within a scan: bring points that were measured at different times into the sensor's frame at one time."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.frames import transform_points
from adcbf_cli.core.types import FloatArray, IntArray

KNOT_NS = 10_000_000
"""Poses are taken this far apart; points in between blend their two neighbours. At 1 rad/s and 50 m the blend is
off by 0.6 mm."""

_MAX_KNOTS = 64
_STILL = 1e-6


def knot_offsets_ns(offset_ns: IntArray) -> IntArray:
    """Times (from the scan's stamp) at which poses are wanted: evenly over the offsets, at least two."""
    low, high = int(offset_ns.min()), int(offset_ns.max())
    knots = min(_MAX_KNOTS, max(2, -(-(high - low) // KNOT_NS) + 1))
    return np.unique(np.linspace(low, high, knots).round().astype(np.int64))


def move_points(
    points_m: FloatArray, offset_ns: IntArray, knots_ns: IntArray, target_from_knot: FloatArray
) -> FloatArray:
    """Points (n, 3), each in the sensor's frame at its own time, -> all in the target frame.

    offset_ns: (n,); knots_ns: (k,) increasing, enclosing the offsets; target_from_knot: (k, 4, 4).
    """
    if len(points_m) == 0:
        return points_m
    if np.abs(target_from_knot - target_from_knot[0]).max() < _STILL:
        return place_points(target_from_knot[0], points_m)
    moved = np.empty_like(points_m)
    segment = np.clip(np.searchsorted(knots_ns, offset_ns, side="right") - 1, 0, len(knots_ns) - 2)
    for k in range(len(knots_ns) - 1):
        inside = np.flatnonzero(segment == k)
        if len(inside) == 0:
            continue
        local = points_m[inside]
        share = ((offset_ns[inside] - knots_ns[k]) / (knots_ns[k + 1] - knots_ns[k]))[:, None]
        early = transform_points(target_from_knot[k], local)
        late = transform_points(target_from_knot[k + 1], local)
        moved[inside] = early + share * (late - early)
    return moved


def place_points(target_from_source: FloatArray, points_m: FloatArray) -> FloatArray:
    """transform_points that leaves points untouched (and uncopied) under the identity."""
    if np.abs(target_from_source - np.eye(4)).max() < _STILL * 1e-3:
        return points_m
    return transform_points(target_from_source, points_m)
