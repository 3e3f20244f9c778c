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
        self.yaw_rad = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
        self.speed_mps = speed_mps

    @property
    def length_m(self) -> float:
        return float(self.at_m[-1])

    @property
    def goal_m(self) -> FloatArray:
        goal: FloatArray = self.points_m[-1]
        return goal

    def nearest(self, point_m: FloatArray, around_m: float | None = None, window_m: float | None = None) -> float:
        """Arc length (m) of the path's nearest point. `around_m`: look only within `window_m` of it (None:
        WINDOW_M and the way of WINDOW_S), so that a path that crosses itself or comes back is not short-cut."""
        if window_m is None:
            window_m = WINDOW_M + WINDOW_S * self.speed_mps
        start, legs = self.points_m[:-1], np.diff(self.points_m, axis=0)
        along = np.einsum("ij,ij->i", point_m - start, legs) / np.einsum("ij,ij->i", legs, legs)
        low, high = np.zeros(len(legs)), np.ones(len(legs))
        if around_m is not None:
            length = np.diff(self.at_m)
            low = np.clip((around_m - window_m - self.at_m[:-1]) / length, 0.0, 1.0)
            high = np.clip((around_m + window_m - self.at_m[:-1]) / length, 0.0, 1.0)
        share = np.clip(along, low, high)
        gap = point_m - (start + share[:, None] * legs)
        distance = np.hypot(gap[:, 0], gap[:, 1])
        if around_m is not None:
            inside = (self.at_m[1:] >= around_m - window_m) & (self.at_m[:-1] <= around_m + window_m)
            distance = np.where(inside, distance, np.inf)
        leg = int(np.argmin(distance))
        return float(self.at_m[leg] + share[leg] * (self.at_m[leg + 1] - self.at_m[leg]))

    def nearest_or_found(self, point_m: FloatArray, around_m: float, farther_m: float) -> float:
        """As `nearest` around `around_m`, unless the path comes nearer elsewhere by more than `farther_m`."""
        near, anywhere = self.nearest(point_m, around_m), self.nearest(point_m)
        gap = self.at(np.array([near, anywhere]))[:, :2] - point_m
        near_m, anywhere_m = np.hypot(gap[:, 0], gap[:, 1])
        return anywhere if near_m > anywhere_m + farther_m else near

    def at(self, along_m: FloatArray) -> FloatArray:
        """(k, 3) x, y, yaw at arc lengths (k,), clamped to the path's ends."""
        along = np.clip(along_m, 0.0, self.length_m)
        leg = np.clip(np.searchsorted(self.at_m, along, side="right") - 1, 0, len(self.yaw_rad) - 1)
        x = np.interp(along, self.at_m, self.points_m[:, 0])
        y = np.interp(along, self.at_m, self.points_m[:, 1])
        return np.stack([x, y, self.yaw_rad[leg]], axis=-1)

    def distance(self, points_m: FloatArray) -> FloatArray:
        """(k,) distance of points (k, 2) from the path."""
        start, legs = self.points_m[:-1], np.diff(self.points_m, axis=0)
        to = points_m[:, None] - start
        share = np.clip(np.einsum("kij,ij->ki", to, legs) / np.einsum("ij,ij->i", legs, legs), 0.0, 1.0)
        gap = to - share[..., None] * legs
        return np.asarray(np.hypot(gap[..., 0], gap[..., 1]).min(axis=1))

    def horizon(self, pose: FloatArray, along_m: float, steps: int, step_s: float, brake_mps2: float) -> FloatArray:
        """(steps + 1, 5) x, y, yaw, speed, 0 from arc length `along_m` on, at the path's speed, slowing
        down with `brake_mps2` so as to stand at the path's end; yaw within pi of the pose's at first."""
        length_m, here_m = self.length_m, float(along_m)
        along, speed = [], []
        for _ in range(steps + 1):
            along.append(here_m)
            speed.append(min(self.speed_mps, math.sqrt(2 * brake_mps2 * max(length_m - here_m, 0.0))))
            here_m = min(here_m + speed[-1] * step_s, length_m)
        places = self.at(np.array(along))
        yaw = places[:, 2]
        if np.abs(np.diff(yaw)).max(initial=0.0) > np.pi:  # unwrapping is slow, and seldom needed
            yaw = np.unwrap(yaw)
        yaw = yaw + 2 * np.pi * np.round((pose[2] - yaw[0]) / (2 * np.pi))
        return np.column_stack([places[:, :2], yaw, speed, np.zeros(steps + 1)])


def _thinned(points: FloatArray) -> FloatArray:
    kept = [0] if len(points) else []
    for i in range(1, len(points)):
        if np.hypot(*(points[i] - points[kept[-1]])) >= MIN_SPACING_M:
            kept.append(i)
    return points[kept]
