"""The world as the search for an escape sees it: arrays over a few ticks, in the frame of the search's start.

Circles and rectangles are one shape here, a rectangle with rounded corners: a circle has no extent besides its
corners' radius, a rectangle no radius.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.replay.world import TrueWorld, WorldObjects
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

CHECK_SPACING_M = 0.02
"""Between ticks, a touch is looked for each time that vehicle and thing may have come this much closer."""

MOST_PARTS = 32
"""And at most so often: a thing that turns on the spot may sweep half a metre in a tick."""

FAR_M = 1e6
"""Where things are put at ticks at which they are not there."""

STILL_MOMENTS = 9
"""What is at the same place at so many moments is taken to stand, when the way to the goal is measured."""

CELL_M = 0.15
AROUND_M = 4.0
"""The grid on which that way is measured: its cells, and how far it goes beyond start and goal."""

BLOCKED_M = 50.0
"""Added where the grid shows no way to the goal."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """m things over `ticks` + 1 ticks: place (m, ticks + 1, 2), yaw (m, ticks + 1); half length, half width and
    corner radius (m,) at the first of them."""

    place_m: FloatArray
    yaw_rad: FloatArray
    half_m: FloatArray
    round_m: FloatArray
    tick_s: float

    @property
    def ticks(self) -> int:
        return int(self.yaw_rad.shape[1]) - 1

    def near(self, pose: FloatArray, reach_m: float, body_radius_m: float) -> BoolArray:
        """(n, m) whether states (n, 3) that go `reach_m` at most may meet the things in this stretch."""
        offset = pose[:, None, :2] - self.place_m[:, 0]
        roaming = np.hypot(*np.moveaxis(self.place_m - self.place_m[:, :1], -1, 0)).max(axis=1, initial=0.0)
        size = np.hypot(self.half_m[:, 0], self.half_m[:, 1]) + self.round_m
        # Twice: what comes within reach of the states that they lead to has a say in these' clearance.
        return np.asarray(np.hypot(offset[..., 0], offset[..., 1]) <= size + roaming + body_radius_m + 2 * reach_m)

    def first_touch(
        self, vehicle: Vehicle, path: FloatArray, applied: FloatArray, near: BoolArray, margin_m: float
    ) -> tuple[IntArray, FloatArray]:
        """For c drives with poses (c, ticks + 1, 3) under inputs (c, ticks, 2), each with the things that it may
        meet (c, m): the tick from which on the first comes nearer than the margin before the next tick has passed
        (c,), `ticks` for none; and the clearance at the end from what was near (c,), inf without: it is right where it
        is less than the reach that `near` was asked for."""
        drive, thing = np.nonzero(near)
        clear = self._clearance(path[drive, :, :2], thing, None) - vehicle.body_radius_m
        touched = np.full(len(path), self.ticks, dtype=np.int64)
        end_m = np.full(len(path), np.inf)
        np.minimum.at(end_m, drive, clear[:, -1])
        near_pair, tick = np.nonzero(clear[:, 1:] <= margin_m)
        np.minimum.at(touched, drive[near_pair], tick)
        way = np.abs(applied[drive, :, 0]) * self.tick_s + self._moved[thing]
        unsure = (clear[:, :-1] + clear[:, 1:] <= way + 2 * margin_m) & (np.arange(self.ticks) < touched[drive, None])
        pair, tick = np.nonzero(unsure)
        if len(pair):
            parts = min(math.ceil(float(way[pair, tick].max()) / CHECK_SPACING_M), MOST_PARTS)
            row = drive[pair]
            for share in np.arange(1, parts) / parts:
                here = vehicle.step(path[row, tick], applied[row, tick], share * self.tick_s)
                between = self._clearance(here[:, None, :2], thing[pair], tick + share)[:, 0] - vehicle.body_radius_m
                hit = between <= margin_m
                np.minimum.at(touched, row[hit], tick[hit])
        return touched, end_m

    @property
    def _moved(self) -> FloatArray:
        """(m, ticks) the way that a thing's surface may go from tick to tick."""
        step, turn = np.diff(self.place_m, axis=1), np.diff(self.yaw_rad, axis=1)
        size = np.hypot(self.half_m[:, 0], self.half_m[:, 1])
        return np.asarray(np.hypot(step[..., 0], step[..., 1]) + np.abs(turn) * size[:, None])

    def _clearance(self, point_m: FloatArray, thing: IntArray, at: FloatArray | None) -> FloatArray:
        """(q, k) signed distance of points (q, k, 2) from things (q,): at every tick, or all k at one time (q,)
        in ticks between two of them."""
        if at is None:
            place, yaw = self.place_m[thing], self.yaw_rad[thing]
        else:
            tick = np.floor(at).astype(np.int64)
            share = (at - tick)[:, None]
            place = (1 - share) * self.place_m[thing, tick] + share * self.place_m[thing, tick + 1]
            yaw = ((1 - share[:, 0]) * self.yaw_rad[thing, tick] + share[:, 0] * self.yaw_rad[thing, tick + 1])[:, None]
            place = place[:, None]
        offset = point_m - place
        return rounded_distance(offset, yaw, self.half_m[thing, None], self.round_m[thing, None])


def rounded_distance(offset_m: FloatArray, yaw_rad: FloatArray, half_m: FloatArray, round_m: FloatArray) -> FloatArray:
    """Signed distance of points, given from the centres (..., 2), from rectangles turned by yaw (...) with half
    length and width (..., 2) and corners rounded outwards by a radius (...)."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    along = np.abs(cos * offset_m[..., 0] + sin * offset_m[..., 1]) - half_m[..., 0]
    across = np.abs(cos * offset_m[..., 1] - sin * offset_m[..., 0]) - half_m[..., 1]
    outside = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
    return np.asarray(outside + np.minimum(np.maximum(along, across), 0.0) - round_m)


class KeptWorld:
    """A world that keeps every moment it was asked for: searches one after the other ask for the same ones."""

    def __init__(self, world: TrueWorld) -> None:
        self._world = world
        self._kept: dict[int, WorldObjects] = {}

    def at(self, stamp_ns: int) -> WorldObjects:
        if stamp_ns not in self._kept:
            self._kept[stamp_ns] = self._world.at(stamp_ns)
        return self._kept[stamp_ns]

    def nearest(self, point_m: FloatArray, body_radius_m: float, stamp_ns: int) -> tuple[float, int]:
        return self._world.nearest(point_m, body_radius_m, stamp_ns)


class LocalWorld:
    """A world in the frame of a pose (3,), by ticks from a stamp on."""

    def __init__(self, world: TrueWorld, pose: FloatArray, start_ns: int, tick_s: float) -> None:
        self._world = world
        self._pose = pose
        self._start_ns = start_ns
        self.tick_s = tick_s
        self._stretches: dict[tuple[int, int], Stretch] = {}

    def point(self, point_m: FloatArray) -> FloatArray:
        """World points (..., 2) in the local frame."""
        cos, sin = math.cos(self._pose[2]), math.sin(self._pose[2])
        offset = np.asarray(point_m) - self._pose[:2]
        return np.stack(
            [cos * offset[..., 0] + sin * offset[..., 1], cos * offset[..., 1] - sin * offset[..., 0]], axis=-1
        )

    def stretch(self, tick: int, ticks: int) -> Stretch:
        """From this tick over so many; kept, since one search after the other asks for it."""
        if (tick, ticks) not in self._stretches:
            self._stretches[tick, ticks] = self.moments(np.arange(tick, tick + ticks + 1))
        return self._stretches[tick, ticks]

    def moments(self, tick: IntArray) -> Stretch:
        """The things at ticks (k,), as a stretch of k - 1."""
        moments = [self._world.at(self._start_ns + round(int(t) * 1e9 * self.tick_s)) for t in tick]
        ids = np.unique(np.concatenate([objects.id for objects in moments]))
        rows = np.zeros((len(tick), len(ids), 6))
        rows[:, :, :2] = FAR_M
        for row, objects in zip(rows, moments, strict=True):
            row[np.searchsorted(ids, objects.id)] = self._columns(objects)
        shape = rows[:, :, 3:].max(axis=0, initial=0.0)
        # Yaws of a rectangle that is there now and then do not turn on while it is away.
        yaw = np.unwrap(rows[:, :, 2], axis=0).T
        return Stretch(np.swapaxes(rows[:, :, :2], 0, 1), yaw, shape[:, :2], shape[:, 2], self.tick_s)

    def _columns(self, objects: WorldObjects) -> FloatArray:
        """(m, 6) x, y, yaw, half length, half width, corner radius."""
        box = objects.is_box
        return np.column_stack(
            [
                self.point(objects.centre_m),
                np.where(box, objects.yaw_rad - self._pose[2], 0.0),
                np.where(box, 0.5 * objects.length_m, 0.0),
                np.where(box, 0.5 * objects.width_m, 0.0),
                np.where(box, 0.0, objects.radius_m),
            ]
        )


class WayToGoal:
    """How far it is to the goal around what stands: on a grid from `low_m` (2,), metres a cell (nx, ny)."""

    def __init__(self, goal_m: FloatArray, tolerance_m: float, low_m: FloatArray, metres: FloatArray) -> None:
        self._goal_m = goal_m
        self._tolerance_m = tolerance_m
        self._low_m = low_m
        self._metres = metres

    def gap_m(self, pose: FloatArray) -> FloatArray:
        """(...) metres in a straight line that poses (..., 3) are too far from the goal; not above 0 once there."""
        offset = pose[..., :2] - self._goal_m
        return np.asarray(np.hypot(offset[..., 0], offset[..., 1]) - self._tolerance_m)

    def distance(self, point_m: FloatArray) -> FloatArray:
        """(n,) metres to go from points (n, 2)."""
        highest = np.array(self._metres.shape) - 1
        cell = np.clip(np.round((point_m - self._low_m) / CELL_M), 0, highest).astype(np.int64)
        off = point_m - (self._low_m + CELL_M * cell)
        metres: FloatArray = self._metres[cell[:, 0], cell[:, 1]]
        outside = np.maximum(np.hypot(off[:, 0], off[:, 1]) - CELL_M, 0.0)
        return np.asarray(metres + outside)


def way_to_goal(
    local: LocalWorld, goal_m: FloatArray, tolerance_m: float, body_radius_m: float, ticks: int
) -> WayToGoal:
    """Distances to a goal (2,) in the world around what stands the whole time: it guides a search, no more."""
    goal = local.point(goal_m)
    low = np.minimum(goal, 0.0) - AROUND_M
    count = np.ceil((np.maximum(goal, 0.0) + AROUND_M - low) / CELL_M).astype(np.int64) + 1
    places = low + CELL_M * np.stack(np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), axis=-1)
    free = np.ones(tuple(count), dtype=np.bool_)
    things = local.moments(np.linspace(0, ticks, STILL_MOMENTS).astype(np.int64))
    still = np.ptp(things.place_m, axis=1).max(axis=1) + np.ptp(things.yaw_rad, axis=1) < 1e-6
    for i in np.flatnonzero(still):
        offset = places - things.place_m[i, 0]
        distance = rounded_distance(offset, things.yaw_rad[i, 0], things.half_m[i], things.round_m[i])
        # Half a cell may be missing: a gap that the vehicle only just fits through must not look closed.
        free &= distance > body_radius_m - 0.5 * CELL_M
    straight = np.hypot(*np.moveaxis(places - goal, -1, 0))
    metres = _around(free, np.round((goal - low) / CELL_M).astype(np.int64))
    metres = np.where(np.isfinite(metres), metres, straight + BLOCKED_M)
    return WayToGoal(goal, tolerance_m, low, metres)


def _around(free: BoolArray, goal: IntArray) -> FloatArray:
    """(nx, ny) metres from each free cell to the goal's, over free cells and their eight neighbours; inf for none."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    number = np.arange(free.size).reshape(free.shape)
    passable = free.copy()
    passable[tuple(goal)] = True
    tails, heads, lengths = [], [], []
    nx, ny = free.shape
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        one = (slice(0, nx - dx), slice(max(-dy, 0), ny - max(dy, 0)))
        other = (slice(dx, nx), slice(max(dy, 0), ny - max(-dy, 0)))
        joined = passable[one] & passable[other]
        tails.append(number[one][joined])
        heads.append(number[other][joined])
        lengths.append(np.full(int(joined.sum()), CELL_M * math.hypot(dx, dy)))
    links = (np.concatenate(tails), np.concatenate(heads))
    graph = coo_matrix((np.concatenate(lengths), links), shape=(free.size, free.size)).tocsr()
    metres = dijkstra(graph, directed=False, indices=int(number[tuple(goal)]))
    return np.asarray(metres, dtype=float).reshape(free.shape)
