"""What a planner would know if nothing stood between it and the truth: the oracle beside `Knowledge`.

For comparing a planner with perception to the same planner with perfect knowledge. Things are known
through walls, from the first tick on, and with their whole future, stops and turns included.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from adcbf_cli.core.planning.problem import Obstacles
from adcbf_cli.core.replay.simulated_world import SimulatedWorld
from adcbf_cli.core.replay.world import WorldObjects
from adcbf_cli.core.types import FloatArray, IntArray

COMPACT = 2.0
"""A rectangle that is less than this many times as long as wide is one circle, as it is to perception:
gamma depends on an obstacle's radius, so that a person in two narrow discs would be passed otherwise
than a person. Longer ones are rows of discs."""

STANDING_MPS = 1e-6


class PerfectKnowledge:
    """Answers like `Knowledge`, from a simulated world.

    A disc is an obstacle. The first of a thing has the thing's id; further ones, as walls and cars
    have, count on from the last thing's.
    """

    def __init__(self, world: SimulatedWorld) -> None:
        self._world = world
        self._moments: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._track_id: IntArray = np.zeros(0, dtype=np.int64)
        self._radius_m: FloatArray = np.zeros(0)

    def obstacles(
        self,
        stamp_ns: int,
        ego_m: FloatArray,
        range_m: float,
        steps: int,
        step_s: float,
        uncertainty: Literal["none", "sigma", "conformal"],
    ) -> Obstacles:
        """Discs whose surface, now, is within `range_m` of the ego's place (2,), over `steps` steps.

        Nothing is uncertain: margins are zero, whatever `uncertainty` asks for. What does not move until
        the horizon's end is static. Asked for in order of time, it is fast.
        """
        _ = uncertainty
        centre, velocity = self._along(stamp_ns, steps, step_s)
        offset = centre[0] - ego_m
        near = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) - self._radius_m <= range_m)
        position, moving = centre[:, near].transpose(1, 0, 2), velocity[:, near].transpose(1, 0, 2)
        return Obstacles(
            track_id=self._track_id[near],
            position_m=np.ascontiguousarray(position),
            radius_m=self._radius_m[near],
            margin_m=np.zeros((len(near), steps + 1)),
            velocity_mps=moving[:, 0].copy(),
            is_static=np.all(np.hypot(moving[..., 0], moving[..., 1]) <= STANDING_MPS, axis=1),
        )

    def _along(self, stamp_ns: int, steps: int, step_s: float) -> tuple[FloatArray, FloatArray]:
        """Centres and velocities (steps + 1, d, 2) of all discs, at now and after each step.

        Moments are kept until they have passed: where a step is a whole number of ticks, as 0.1 s is at
        30 Hz, each tick's horizon shares all but its last moment with those before.
        """
        stamps = [stamp_ns + round(1e9 * step_s * k) for k in range(steps + 1)]
        self._moments = {at: moment for at, moment in self._moments.items() if at >= stamp_ns}
        for at in stamps:
            if at not in self._moments:
                self._moments[at] = self._moment(at)
        kept = [self._moments[at] for at in stamps]
        return np.array([moment[0] for moment in kept]), np.array([moment[1] for moment in kept])

    def _moment(self, stamp_ns: int) -> tuple[FloatArray, FloatArray]:
        """All discs' centres and velocities (d, 2)."""
        objects = _with_circles(self._world.as_boxes(stamp_ns))
        centre, velocity, radius = objects.discs
        if len(radius) != len(self._radius_m):  # the same at all times
            self._track_id, self._radius_m = _ids(objects), radius
        return centre, velocity


def _with_circles(objects: WorldObjects) -> WorldObjects:
    """Compact rectangles replaced by the circles around them."""
    long, short = np.maximum(objects.length_m, objects.width_m), np.minimum(objects.length_m, objects.width_m)
    row = objects.is_box & (long >= COMPACT * short)
    names = ("length_m", "width_m", "yaw_rad")
    return replace(objects, **{name: np.where(row, getattr(objects, name), np.nan) for name in names})


def _ids(objects: WorldObjects) -> IntArray:
    """(d,) one id a disc, in the order of `WorldObjects.discs`."""
    names = WorldObjects.__dataclass_fields__
    alone = [WorldObjects(*(getattr(objects, name)[[row]] for name in names)) for row in range(len(objects))]
    count = np.array([len(one.discs[2]) for one in alone], dtype=np.int64)
    first = np.cumsum(count) - count
    ids = objects.id.max(initial=-1) + 1 + np.arange(count.sum()) - np.repeat(np.arange(len(count)) + 1, count)
    ids[first] = objects.id
    return np.asarray(ids, dtype=np.int64)
