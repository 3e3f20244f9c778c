"""The path to follow, and the reference that a horizon takes from it."""

from __future__ import annotations

import math

import numpy as np

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.types import FloatArray

MIN_SPACING_M = 0.02
"""Closer points of a recorded path are noise of the pose, and would turn the tangent at random."""

WINDOW_M = 0.5
WINDOW_S = 0.5
"""Progress is looked for this far around the last one: several ticks' way, and less than from one
branch of a path to another that passes near it."""


class ReferencePath:
    """A polyline in the world, by arc length.

    points_m: (m, 2) with m >= 2 after points closer than MIN_SPACING_M to their predecessor are left
    out; UsageError where fewer than two are left, or where they are not finite.
    """

    def __init__(self, points_m: FloatArray, speed_mps: float) -> None:
        points = np.asarray(points_m, dtype=float).reshape(-1, 2)
        if not np.isfinite(points).all():
            raise UsageError("the reference path has points that are not finite")
        self.points_m = _thinned(points)
        if len(self.points_m) < 2:
            raise UsageError(
                "the reference path is a single point: the log's vehicle stood still, or the file has one row; "
                "give --reference with two points or more, or --start and --goal"
            )
        legs = np.diff(self.points_m, axis=0)
        self.at_m = np.concatenate([[0.0], np.cumsum(np.hypot(legs[:, 0], legs[:, 1]))])
        self._legs = legs
        self._x, self._y = np.ascontiguousarray(self.points_m.T)
        self._squared = np.einsum("ij,ij->i", legs, legs)
        self._length = np.diff(self.at_m)
        self._end_m = float(self.at_m[-1])
        self.yaw_rad = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
        self.speed_mps = speed_mps

    @property
    def length_m(self) -> float:
        return self._end_m

    @property
    def goal_m(self) -> FloatArray:
        goal: FloatArray = self.points_m[-1]
        return goal

    def nearest(self, point_m: FloatArray, around_m: float | None = None, window_m: float | None = None) -> float:
        """Arc length (m) of the path's nearest point. `around_m`: look only within `window_m` of it (None:
        WINDOW_M and the way of WINDOW_S), so that a path that crosses itself or comes back is not short-cut."""
        if window_m is None:
            window_m = WINDOW_M + WINDOW_S * self.speed_mps
        first, last, low, high = 0, len(self._legs), np.zeros(1), np.ones(1)
        if around_m is not None:
            first = min(int(np.searchsorted(self.at_m[1:], around_m - window_m)), last - 1)
            last = max(int(np.searchsorted(self.at_m[:-1], around_m + window_m, side="right")), first + 1)
            start_m, length = self.at_m[first:last], self._length[first:last]
            low = _to_share((around_m - window_m - start_m) / length)
            high = _to_share((around_m + window_m - start_m) / length)
        start, legs = self.points_m[first:last], self._legs[first:last]
        along = np.einsum("ij,ij->i", point_m - start, legs) / self._squared[first:last]
        share = np.minimum(np.maximum(along, low), high)
        gap = point_m - (start + share[:, None] * legs)
        best = int(np.argmin(np.hypot(gap[:, 0], gap[:, 1])))
        leg = first + best
        return float(self.at_m[leg] + share[best] * (self.at_m[leg + 1] - self.at_m[leg]))

    def nearest_or_found(self, point_m: FloatArray, around_m: float, farther_m: float) -> float:
        """As `nearest` around `around_m`, unless the path comes nearer elsewhere by more than `farther_m`."""
        near, anywhere = self.nearest(point_m, around_m), self.nearest(point_m)
        gap = self.at(np.array([near, anywhere]))[:, :2] - point_m
        near_m, anywhere_m = np.hypot(gap[:, 0], gap[:, 1])
        return anywhere if near_m > anywhere_m + farther_m else near

    def at(self, along_m: FloatArray) -> FloatArray:
        """(k, 3) x, y, yaw at arc lengths (k,), clamped to the path's ends."""
        along = np.minimum(np.maximum(along_m, 0.0), self._end_m)
        leg = np.minimum(np.searchsorted(self.at_m, along, side="right") - 1, len(self.yaw_rad) - 1)
        places = np.empty((len(along), 3))
        places[:, 0] = np.interp(along, self.at_m, self._x)
        places[:, 1] = np.interp(along, self.at_m, self._y)
        places[:, 2] = self.yaw_rad[leg]
        return places

    def distance(self, points_m: FloatArray) -> FloatArray:
        """(k,) distance of points (k, 2) from the path."""
        to = points_m[:, None] - self.points_m[:-1]
        share = _to_share(np.einsum("kij,ij->ki", to, self._legs) / self._squared)
        gap = to - share[..., None] * self._legs
        return np.asarray(np.hypot(gap[..., 0], gap[..., 1]).min(axis=1))

    def horizon(self, pose: FloatArray, along_m: float, steps: int, step_s: float, brake_mps2: float) -> FloatArray:
        """(steps + 1, 5) x, y, yaw, speed, 0 from arc length `along_m` on, at the path's speed, slowing
        down with `brake_mps2` so as to stand at the path's end; yaw within pi of the pose's at first."""
        end_m, here_m, top_mps = self._end_m, float(along_m), self.speed_mps
        along, speed = [], []
        for _ in range(steps + 1):
            now_mps = min(top_mps, math.sqrt(2 * brake_mps2 * max(end_m - here_m, 0.0)))
            along.append(here_m)
            speed.append(now_mps)
            here_m = min(here_m + now_mps * step_s, end_m)
        places = self.at(np.array(along))
        yaw = places[:, 2]
        if np.abs(yaw[1:] - yaw[:-1]).max(initial=0.0) > np.pi:  # unwrapping is slow, and seldom needed
            yaw = np.unwrap(yaw)
        yaw = yaw + 2 * np.pi * np.round((pose[2] - yaw[0]) / (2 * np.pi))
        reference = np.zeros((steps + 1, 5))
        reference[:, :2], reference[:, 2], reference[:, 3] = places[:, :2], yaw, speed
        return reference


def _to_share(values: FloatArray) -> FloatArray:
    """np.clip to [0, 1], in half the time on few values."""
    return np.asarray(np.minimum(np.maximum(values, 0.0), 1.0))


def _thinned(points: FloatArray) -> FloatArray:
    kept = [0] if len(points) else []
    for i in range(1, len(points)):
        if np.hypot(*(points[i] - points[kept[-1]])) >= MIN_SPACING_M:
            kept.append(i)
    return points[kept]
