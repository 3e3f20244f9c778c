"""The true world of a simulated scene at any time, exactly: what a closed loop is measured against.

Cylinders and trunks are circles. A rock is the ellipse in its rectangle, as a row of discs: in the corners
of the rectangle there is nothing to hit. Everything else is the rectangle of its ground truth.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from adcbf_cli.core.replay.world import KEPT_MOMENTS, WorldObjects, joined, nearest_of
from adcbf_cli.core.simulation.objects import TruthBox
from adcbf_cli.core.simulation.world import World
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

ROUND = ("cylinder", "tree")
"""Kinds whose outline in the plane is a circle; the others' is a rectangle."""


ROCK_DISCS = 7
"""They leave less than 3 cm of a rock's ellipse out, down to one two and a half times as long as wide."""


class SimulatedWorld:
    """A `TrueWorld`; ids are those of the scene's ground truth: movers first, then what stands.

    A rock's further discs count on from the last thing's id; `thing_of` says whose they are.
    """

    def __init__(self, world: World, moments_ns: IntArray | None = None) -> None:
        """moments_ns: (k,) ascending; at these the movers' places are computed together, which is quicker."""
        self._world = world
        self._moments_ns = np.zeros(0, dtype=np.int64) if moments_ns is None else moments_ns
        self._at_moments = world.movers_truth(world.seconds(self._moments_ns))
        movers = len(world.movers)
        boxes = world.statics_truth(np.zeros(1))
        self._boxes = _snapshot(boxes, movers)
        rocks = np.array([box.category == "rock" for box in boxes], dtype=np.bool_)
        self._static, self._owner = _rocks_as_discs(self._boxes, rocks)
        self._latest: dict[int, WorldObjects] = {}

    def at(self, stamp_ns: int) -> WorldObjects:
        """The things at this time; movers that have not begun, or have arrived, stand."""
        if stamp_ns not in self._latest:
            if len(self._latest) >= KEPT_MOMENTS:
                self._latest.pop(next(iter(self._latest)))
            self._latest[stamp_ns] = self._joined(stamp_ns, self._static)
        return self._latest[stamp_ns]

    def as_boxes(self, stamp_ns: int) -> WorldObjects:
        """The same with one row a thing: a rock is its rectangle."""
        return self._joined(stamp_ns, self._boxes)

    def along(self, stamp_ns: IntArray) -> tuple[FloatArray, FloatArray]:
        """Where every thing will be: centres (m, k, 2) and velocities (m, k, 2) at times (k,), by id."""
        boxes = self._world.truth(np.asarray(stamp_ns, dtype=np.int64))
        shape = (len(boxes), len(stamp_ns), 2)
        centre = np.array([np.column_stack([box.x_m, box.y_m]) for box in boxes]).reshape(shape)
        velocity = np.array([np.column_stack([box.vx_mps, box.vy_mps]) for box in boxes]).reshape(shape)
        return centre, velocity

    def _joined(self, stamp_ns: int, static: WorldObjects) -> WorldObjects:
        row = int(np.searchsorted(self._moments_ns, stamp_ns))
        if row < len(self._moments_ns) and self._moments_ns[row] == stamp_ns:
            return joined([_snapshot(self._at_moments, 0, row), static])
        time_s = self._world.seconds(np.array([stamp_ns]))
        return joined([_snapshot(self._world.movers_truth(time_s), 0), static])

    def thing_of(self, object_id: int) -> int:
        """The id in ground truth that an object of `at` belongs to."""
        return self._owner.get(object_id, object_id)

    def nearest(self, point_m: FloatArray, body_radius_m: float, stamp_ns: int) -> tuple[float, int]:
        """As `TrueWorld.nearest`, by ground truth's ids."""
        clearance, nearest = nearest_of(self.at(stamp_ns), point_m, body_radius_m)
        return clearance, self.thing_of(nearest)


def _snapshot(boxes: list[TruthBox], first_id: int, row: int = 0) -> WorldObjects:
    """Boxes at one of their times as objects."""

    def column(values: list[Any]) -> FloatArray:
        return np.array(values, dtype=float)

    round_ = np.array([box.category in ROUND for box in boxes], dtype=np.bool_)
    length, width = column([box.length_m for box in boxes]), column([box.width_m for box in boxes])
    yaw = column([float(box.yaw_rad[row]) for box in boxes])
    return WorldObjects(
        id=first_id + np.arange(len(boxes), dtype=np.int64),
        centre_m=column([(box.x_m[row], box.y_m[row]) for box in boxes]).reshape(-1, 2),
        velocity_mps=column([(box.vx_mps[row], box.vy_mps[row]) for box in boxes]).reshape(-1, 2),
        radius_m=np.where(round_, 0.5 * length, 0.5 * np.hypot(length, width)),
        length_m=np.where(round_, np.nan, length),
        width_m=np.where(round_, np.nan, width),
        yaw_rad=np.where(round_, np.nan, yaw),
    )


def _rocks_as_discs(things: WorldObjects, rocks: BoolArray) -> tuple[WorldObjects, dict[int, int]]:
    """Each rock's row as ROCK_DISCS, and whose the further discs' ids are.

    The discs are the largest that fit into the ellipse with their centres on its long axis: about x on it,
    r^2 = b^2 (1 - x^2 / (a^2 - b^2)), for |x| <= (a^2 - b^2) / a.
    """
    rows = np.flatnonzero(rocks)
    a = 0.5 * np.maximum(things.length_m, things.width_m)[rows]
    b = 0.5 * np.minimum(things.length_m, things.width_m)[rows]
    focal = np.maximum(a**2 - b**2, 1e-12)
    x = (focal / a)[:, None] * np.linspace(-1.0, 1.0, ROCK_DISCS)
    radius = b[:, None] * np.sqrt(1.0 - x**2 / focal[:, None])
    yaw = things.yaw_rad[rows] + np.where(things.length_m[rows] < things.width_m[rows], 0.5 * np.pi, 0.0)
    centre = things.centre_m[rows, None] + x[..., None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)[:, None]
    further = (
        np.arange(len(rows) * (ROCK_DISCS - 1)).reshape(len(rows), ROCK_DISCS - 1) + int(things.id.max(initial=-1)) + 1
    )
    ids = np.column_stack([things.id[rows], further]).astype(np.int64)
    n = ids.size
    discs = WorldObjects(ids.ravel(), centre.reshape(-1, 2), np.zeros((n, 2)), radius.ravel(), *np.full((3, n), np.nan))
    others = WorldObjects(*(getattr(things, name)[~rocks] for name in WorldObjects.__dataclass_fields__))
    owner = {int(part): int(row[0]) for row in ids for part in row[1:]}
    return joined([others, discs]), owner
