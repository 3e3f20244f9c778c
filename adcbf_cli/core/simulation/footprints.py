"""The outlines of things on the ground, seen from above, and the distances between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.simulation.scenario import Box, Cylinder, Person, Rock, Tree, Vehicle, Wall
from adcbf_cli.core.types import FloatArray

OUTLINE_STEP_M = 0.05


@dataclass(frozen=True, slots=True)
class Footprint:
    """A rectangle about centre_m (2,), turned by yaw_rad, with half sides half_m (2,), grown by round_m:
    a circle where its sides are zero."""

    centre_m: FloatArray
    yaw_rad: float
    half_m: FloatArray
    round_m: float

    def distance_m(self, points_m: FloatArray) -> FloatArray:
        """(n,) distances from points (n, 2) to the surface, 0 inside."""
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        local = (points_m - self.centre_m) @ np.array([[cos, -sin], [sin, cos]])
        beyond = np.maximum(np.abs(local) - self.half_m, 0.0)
        return np.asarray(np.maximum(np.hypot(beyond[:, 0], beyond[:, 1]) - self.round_m, 0.0))

    def leaves(self, room_m: float, other: Footprint) -> bool:
        """Whether there is this much room between two surfaces, within a millimetre."""
        apart = float(np.hypot(*(self.centre_m - other.centre_m)))
        if apart >= self._reach_m() + other._reach_m() + room_m:
            return True
        return all(b.distance_m(a._core()).min() - a.round_m >= room_m for a, b in ((self, other), (other, self)))

    def _reach_m(self) -> float:
        return self.round_m + float(np.hypot(*self.half_m))

    def _core(self) -> FloatArray:
        """(n, 2) points along the rectangle's sides."""
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * self.half_m
        sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
        local = np.concatenate([_spaced(start, end) for start, end in sides])
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.asarray(self.centre_m + local @ np.array([[cos, sin], [-sin, cos]]))


def _spaced(start: FloatArray, end: FloatArray) -> FloatArray:
    count = 1 + int(np.ceil(np.hypot(*(end - start)) / OUTLINE_STEP_M))
    return np.asarray(start + np.linspace(0, 1, count)[:, None] * (end - start))


def footprint(thing: Tree | Rock | Wall | Box) -> Footprint:
    """The outline of what stands on the ground; a tree's is its trunk's."""
    if isinstance(thing, Tree):
        return Footprint(np.array(thing.at_m), 0.0, np.zeros(2), thing.trunk_radius_m)
    if isinstance(thing, Wall):
        ends = np.array([thing.from_m, thing.to_m])
        along = ends[1] - ends[0]
        half = np.array([np.hypot(*along), thing.thickness_m]) / 2
        return Footprint(ends.mean(axis=0), float(np.arctan2(along[1], along[0])), half, 0.0)
    return Footprint(np.array(thing.at_m), float(np.deg2rad(thing.yaw_deg)), np.array(thing.size_m[:2]) / 2, 0.0)


def mover_radius_m(mover: Person | Vehicle | Cylinder) -> float:
    """The circle about a mover that holds it whichever way it faces."""
    if isinstance(mover, Cylinder):
        return mover.radius_m
    if isinstance(mover, Person):
        return float(np.hypot(mover.depth_m, mover.width_m) / 2)
    return float(np.hypot(mover.size_m[0], mover.size_m[1]) / 2)
