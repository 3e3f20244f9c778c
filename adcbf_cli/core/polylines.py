"""Polylines in the plane with fewer points."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.types import FloatArray


def simplified(points_m: FloatArray, tolerance_m: float) -> FloatArray:
    """The polyline (m, 2) with the points left out from which it then differs by no more than the tolerance
    (Ramer, Douglas, Peucker)."""
    keep = np.zeros(len(points_m), dtype=bool)
    keep[[0, -1]] = True
    spans = [(0, len(points_m) - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        off = _distance_from_leg(points_m[first + 1 : last], points_m[first], points_m[last])
        farthest = int(np.argmax(off))
        if off[farthest] > tolerance_m:
            middle = first + 1 + farthest
            keep[middle] = True
            spans += [(first, middle), (middle, last)]
    return points_m[keep]


def _distance_from_leg(points_m: FloatArray, start_m: FloatArray, end_m: FloatArray) -> FloatArray:
    leg = end_m - start_m
    length2 = float(leg @ leg)
    share = np.clip((points_m - start_m) @ leg / length2, 0.0, 1.0) if length2 > 0 else np.zeros(len(points_m))
    gap = points_m - start_m - share[:, None] * leg
    distance: FloatArray = np.hypot(gap[:, 0], gap[:, 1])
    return distance
