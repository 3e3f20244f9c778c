"""The true world of a simulated scene at any time, exactly: what a closed loop is measured against.

Cylinders and trunks are circles, everything else the rectangle of its ground truth.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from adcbf_cli.core.replay.world import KEPT_MOMENTS, WorldObjects, nearest_of
from adcbf_cli.core.simulation.objects import TruthBox
from adcbf_cli.core.simulation.world import World
from adcbf_cli.core.types import FloatArray, IntArray

ROUND = ("cylinder", "tree")
"""Kinds whose outline in the plane is a circle; the others' is a rectangle."""


class SimulatedWorld:
    """A `TrueWorld`; ids are those of the scene's ground truth: movers first, then what stands."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._movers = len(world.movers)
        self._static = _snapshot(world.statics_truth(np.zeros(1)), self._movers)
        self._latest: dict[int, WorldObjects] = {}

    def at(self, stamp_ns: int) -> WorldObjects:
        """The things at this time; movers that have not begun, or have arrived, stand."""
        if stamp_ns not in self._latest:
            if len(self._latest) >= KEPT_MOMENTS:
                self._latest.pop(next(iter(self._latest)))
            time_s = self._world.seconds(np.array([stamp_ns]))
            moving = _snapshot(self._world.movers_truth(time_s), 0)
            names = WorldObjects.__dataclass_fields__
            self._latest[stamp_ns] = WorldObjects(
                *(np.concatenate([getattr(moving, name), getattr(self._static, name)]) for name in names)
            )
        return self._latest[stamp_ns]

    def nearest(self, point_m: FloatArray, body_radius_m: float, stamp_ns: int) -> tuple[float, int]:
        """As `TrueWorld.nearest`."""
        return nearest_of(self.at(stamp_ns), point_m, body_radius_m)

    def along(self, stamp_ns: IntArray) -> tuple[FloatArray, FloatArray]:
        """Where everything will be: centres (m, k, 2) and velocities (m, k, 2) at times (k,), by id."""
        boxes = self._world.truth(np.asarray(stamp_ns, dtype=np.int64))
        centre = np.array([np.column_stack([box.x_m, box.y_m]) for box in boxes]).reshape(len(boxes), -1, 2)
        velocity = np.array([np.column_stack([box.vx_mps, box.vy_mps]) for box in boxes]).reshape(len(boxes), -1, 2)
        return centre, velocity


def _snapshot(boxes: list[TruthBox], first_id: int) -> WorldObjects:
    """Boxes at one time as objects."""

    def column(values: list[Any]) -> FloatArray:
        return np.array(values, dtype=float)

    round_ = np.array([box.category in ROUND for box in boxes], dtype=np.bool_)
    length, width = column([box.length_m for box in boxes]), column([box.width_m for box in boxes])
    yaw = column([float(box.yaw_rad[0]) for box in boxes])
    return WorldObjects(
        id=first_id + np.arange(len(boxes), dtype=np.int64),
        centre_m=column([(box.x_m[0], box.y_m[0]) for box in boxes]).reshape(-1, 2),
        velocity_mps=column([(box.vx_mps[0], box.vy_mps[0]) for box in boxes]).reshape(-1, 2),
        radius_m=np.where(round_, 0.5 * length, 0.5 * np.hypot(length, width)),
        length_m=np.where(round_, np.nan, length),
        width_m=np.where(round_, np.nan, width),
        yaw_rad=np.where(round_, np.nan, yaw),
    )
