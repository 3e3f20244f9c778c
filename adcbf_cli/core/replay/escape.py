"""Could a collision have been avoided? A search for a drive that touches nothing, with everything's future known.

The search goes forward in time, a layer of states at a time: each state is driven on with a set of wanted
inputs, held for a period and followed as fast as the vehicle's rates allow; of what touched nothing, the most
promising states and some spread over the plane are kept. What is found is driven again with the vehicle's own
step and checked against the world itself before it is returned, so a found way is a proof. None found is not:
the search keeps a limited number of states, and its inputs change once a period only.

docs/replay.md says what "could have been avoided" means.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.replay.escape_world import CHECK_SPACING_M, KeptWorld, LocalWorld, Stretch, WayToGoal, way_to_goal
from adcbf_cli.core.replay.records import Drive, Result
from adcbf_cli.core.replay.world import TrueWorld, WorldObjects
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

WIDTH = 2048
"""States kept a layer, at most."""

SEARCHES = ((32, 0.1, 1 / 3), (4, 0.05, 1 / 3), (1, 0.05, 1 / 3), (1, 0.025, 1 / 6))
"""One after the other: the share of the width, the cells (m) of which the best state is kept, how long (s) wanted
inputs are held. The first finds most ways; the last, which can do things in between, is better at close quarters
than over many seconds. Longer periods with fewer states left out found more than shorter ones of the same cost."""

AFTERWARDS_S = 3.0
"""A collision counts as avoided only where the way goes on for this long after the time of the hit."""

SPEED_LEVELS = np.array([0.0, 1 / 3, 2 / 3, 1.0])
TURN_LEVELS = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
"""Inputs that are tried, as shares of the bounds."""

MARGIN_M = 1e-3
"""The search keeps this clear, since it takes things to move on straight lines between ticks."""

LOOK_AHEAD_M = 0.3
"""A state is as near to the goal as the mean of its place and the one this far ahead of it."""

INPUT_TOLERANCE = 1e-9
POSE_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True)
class Escape:
    """What a search found.

    inputs: (T, 2) applied from tick to tick, poses: (T + 1, 3), the first being the start; T = 0 where none was
    found. expanded: how many periods were driven in the search, over all of its states.
    """

    found: bool
    inputs: FloatArray
    poses: FloatArray
    expanded: int


@dataclass(frozen=True, slots=True)
class Judgement:
    """Whether a drive's collision could have been avoided; terms as in docs/replay.md.

    object_id: what was hit. known_since_ns: when it first was known, None where it was not before the hit.
    reacted_from_ns: the first tick that could react to it; the drive's first where it was never known.
    avoidable: True with a way as proof, False where none was found, None where the thing was never known.
    avoidable_until_ns: the last tick of the drive from which a way was found; None without any.
    way: the search's answer from `reacted_from_ns` on.
    """

    object_id: int
    known_since_ns: int | None
    reacted_from_ns: int
    avoidable: bool | None
    avoidable_until_ns: int | None
    way: Escape


def judge_collision(
    world: TrueWorld,
    vehicle: Vehicle,
    drive: Drive,
    known_since_ns: Mapping[int, int],
    start_inputs: FloatArray | None = None,
    width: int = WIDTH,
) -> Judgement:
    """Whether a way existed from the moment when the thing that was hit became known.

    drive: one that ended in a collision, else ValueError. known_since_ns: by the world's ids. start_inputs: (2,)
    applied before the drive's first tick; None: it stood.
    """
    if drive.result is not Result.COLLISION:
        raise ValueError("a drive without a collision has none to judge")
    hit_ns, hit_id = int(drive.stamp_ns[-1]), int(drive.nearest_id[-1])
    known = known_since_ns.get(hit_id)
    if known is not None and known >= hit_ns:
        known = None
    before = np.zeros(2) if start_inputs is None else start_inputs

    def way_from(tick: int) -> Escape:
        return find_escape(
            world,
            vehicle,
            drive.pose[tick],
            drive.inputs[tick - 1] if tick else before,
            int(drive.stamp_ns[tick]),
            hit_ns + round(AFTERWARDS_S * 1e9),
            tick_s=drive.period_s,
            width=width,
        )

    tick = 0 if known is None else int(np.searchsorted(drive.stamp_ns, known))
    way = way_from(tick)
    until_ns = int(drive.stamp_ns[_last_with_way(way_from, tick, len(drive.stamp_ns) - 1)]) if way.found else None
    return Judgement(hit_id, known, int(drive.stamp_ns[tick]), None if known is None else way.found, until_ns, way)


def _last_with_way(way_from: Callable[[int], Escape], found: int, none: int) -> int:
    """The last tick with a way, by halving: who drives on to a tick with a way had one before it too."""
    while none - found > 1:
        middle = (found + none) // 2
        found, none = (middle, none) if way_from(middle).found else (found, middle)
    return found


def find_escape(
    world: TrueWorld,
    vehicle: Vehicle,
    pose: FloatArray,
    inputs: FloatArray,
    start_ns: int,
    until_ns: int,
    goal_m: FloatArray | None = None,
    goal_tolerance_m: float = 0.3,
    tick_s: float = 1 / 30,
    width: int = WIDTH,
) -> Escape:
    """A drive from a pose (3,) with inputs (2,) applied that touches nothing: until `until_ns`, or, with a goal
    (2,), until it is within `goal_tolerance_m` of it, by `until_ns` at the latest.

    tick_s: the control period. width: states kept a layer by the widest search; SEARCHES are made one after the
    other until one finds a way.
    """
    kept = KeptWorld(world)
    task = _Task(kept, vehicle, np.asarray(pose, dtype=float), np.asarray(inputs, dtype=float), start_ns, tick_s)
    ticks = math.ceil((until_ns - start_ns) / 1e9 / tick_s - 1e-6)
    none = Escape(False, np.zeros((0, 2)), task.pose[None], 0)
    if (kept.at(start_ns).clearance(task.pose[None, :2], vehicle.body_radius_m) <= 0.0).any():
        return none
    local = LocalWorld(kept, task.pose, start_ns, tick_s)
    goal = None
    if goal_m is not None:
        goal = way_to_goal(local, np.asarray(goal_m, dtype=float), goal_tolerance_m, vehicle.body_radius_m, ticks)
    expanded = 0
    seen_whole: set[tuple[float, float]] = set()
    for share, cell_m, held_s in SEARCHES:
        if (cell_m, held_s) in seen_whole:
            continue
        search = _Search(local, vehicle, goal, max(width // share, 1), cell_m, max(round(held_s / tick_s), 1))
        wanted = search.run(task.inputs, ticks)
        expanded += search.expanded
        if wanted is None:
            if not search.crowded:
                seen_whole.add((cell_m, held_s))
            continue
        driven = vehicle.within_limits(wanted, task.inputs, tick_s, tick_s)
        way = Escape(True, driven, _driven(task, driven), expanded)
        if verified(way, kept, vehicle, task.pose, task.inputs, start_ns, until_ns, goal_m, goal_tolerance_m, tick_s):
            return way
    return Escape(False, none.inputs, none.poses, expanded)


def verified(
    way: Escape,
    world: TrueWorld,
    vehicle: Vehicle,
    pose: FloatArray,
    inputs: FloatArray,
    start_ns: int,
    until_ns: int,
    goal_m: FloatArray | None = None,
    goal_tolerance_m: float = 0.3,
    tick_s: float = 1 / 30,
) -> bool:
    """Whether a way is what `find_escape` promises, by driving it: inputs within the vehicle's bounds and rates,
    poses where they lead, clearance above zero at every tick and at each CHECK_SPACING_M that vehicle and things
    may have come closer in between, and its end at the goal or not before `until_ns`."""
    task = _Task(world, vehicle, np.asarray(pose, dtype=float), np.asarray(inputs, dtype=float), start_ns, tick_s)
    if not way.found or len(way.poses) != len(way.inputs) + 1 or not np.isfinite(way.inputs).all():
        return False
    allowed = vehicle.within_limits(way.inputs, task.inputs, tick_s, tick_s) if len(way.inputs) else way.inputs
    if np.abs(allowed - way.inputs).max(initial=0.0) > INPUT_TOLERANCE:
        return False
    poses = _driven(task, way.inputs)
    if np.abs(poses - way.poses).max() > POSE_TOLERANCE:
        return False
    end_ns = task.stamp_ns(len(way.inputs))
    if goal_m is None and end_ns < until_ns - round(1e3):
        return False
    if goal_m is not None and (end_ns > until_ns + 1e9 * tick_s or math.dist(poses[-1, :2], goal_m) > goal_tolerance_m):
        return False
    return all(_is_clear(task, poses[k], way.inputs[k], k) for k in range(len(way.inputs)))


@dataclass(frozen=True, slots=True)
class _Task:
    world: TrueWorld
    vehicle: Vehicle
    pose: FloatArray
    inputs: FloatArray
    start_ns: int
    tick_s: float

    def stamp_ns(self, tick: float) -> int:
        return self.start_ns + round(tick * 1e9 * self.tick_s)


def _driven(task: _Task, inputs: FloatArray) -> FloatArray:
    """(T + 1, 3) poses, tick by tick as the replay drives."""
    poses = [task.pose]
    for row in inputs:
        poses.append(task.vehicle.step(poses[-1], row, task.tick_s))
    return np.array(poses)


def _is_clear(task: _Task, pose: FloatArray, inputs: FloatArray, tick: int) -> bool:
    """Whether nothing is touched from this tick to the next, both included."""
    body = task.vehicle.body_radius_m
    start, end = task.world.at(task.stamp_ns(tick)), task.world.at(task.stamp_ns(tick + 1))
    arrived = task.vehicle.step(pose, inputs, task.tick_s)
    clear = [objects.clearance(at[None, :2], body)[0] for objects, at in ((start, pose), (end, arrived))]
    if min(clear[0].min(initial=np.inf), clear[1].min(initial=np.inf)) <= 0.0:
        return False
    way_m = abs(float(inputs[0])) * task.tick_s + _moved(start, end, task.tick_s)
    if clear[0].min(initial=np.inf) + clear[1].min(initial=np.inf) > way_m:
        return True
    parts = math.ceil(way_m / CHECK_SPACING_M)
    for share in np.arange(1, parts) / parts:
        here = task.vehicle.step(pose, inputs, share * task.tick_s)
        objects = task.world.at(task.stamp_ns(tick + share))
        if (objects.clearance(here[None, :2], body) <= 0.0).any():
            return False
    return True


def _moved(start: WorldObjects, end: WorldObjects, tick_s: float) -> float:
    """The longest way that any thing's surface may go between two ticks, in m."""
    fastest = max(float(np.hypot(*o.velocity_mps.T).max(initial=0.0)) for o in (start, end))
    if len(start) != len(end) or (start.id != end.id).any():
        return fastest * tick_s
    turned = np.abs(np.remainder(end.yaw_rad - start.yaw_rad + np.pi, 2 * np.pi) - np.pi)
    swept = np.hypot(*(end.centre_m - start.centre_m).T) + np.nan_to_num(turned) * start.radius_m
    return max(fastest * tick_s, float(swept.max(initial=0.0)))


@dataclass(frozen=True, slots=True)
class _Layer:
    """n states at one tick: poses (n, 3) in the start's frame, inputs (n, 2) applied up to now. How they came
    about: parent (n,) in the layer before, wanted inputs (n, 2) since then, for this many ticks."""

    pose: FloatArray
    inputs: FloatArray
    parent: IntArray
    wanted: FloatArray
    ticks: int


class _Search:
    """One search. width: states kept a layer. cell_m: within cells of this size, and of headings and inputs in
    proportion, the best state is kept. held: ticks that wanted inputs are held for. After `run`, expanded: the periods
    driven; crowded: whether the width ever left states out, without which a wider search would find no more."""

    def __init__(
        self, local: LocalWorld, vehicle: Vehicle, goal: WayToGoal | None, width: int, cell_m: float, held: int
    ) -> None:
        self._local = local
        self._vehicle = vehicle
        self._goal = goal
        self._width = width
        self._held = held
        spread = 0.5 * (vehicle.input_max - vehicle.input_min)
        step = np.minimum(vehicle.rate_max * held * local.tick_s, spread)
        self._cells = np.array([1.0, 1.0, np.pi / 2.4, *np.maximum(2.5 * step, 1e-6)]) * cell_m
        levels = [np.unique(np.append(SPEED_LEVELS * vehicle.input_max[0], vehicle.input_min[0]))]
        levels.append(np.where(TURN_LEVELS < 0, -vehicle.input_min[1], vehicle.input_max[1]) * TURN_LEVELS)
        self._levels = levels
        self.expanded = 0
        self.crowded = False

    def run(self, inputs: FloatArray, ticks: int) -> FloatArray | None:
        """The (T, 2) inputs of a way of at most this many ticks, None where none was found."""
        none = np.zeros(1, dtype=np.int64)
        layers = [_Layer(np.zeros((1, 3)), inputs[None], none, inputs[None], 0)]
        tick = 0
        while tick < ticks:
            count = min(self._held, ticks - tick)
            layer, arrived = self._next(layers[-1], self._local.stretch(tick, count), ticks - tick - count)
            layers.append(layer)
            if arrived is not None:
                return self._inputs(layers, *arrived)
            if not len(layer.pose):
                return None
            tick += count
        return self._inputs(layers, 0, layers[-1].ticks) if self._goal is None else None

    def _next(self, layer: _Layer, stretch: Stretch, left: int) -> tuple[_Layer, tuple[int, int] | None]:
        """The layer after this one, with so many ticks left after it; and the state of it that has arrived and after
        how many ticks, if any."""
        parent, wanted = self._choices(layer.inputs)
        self.expanded += len(parent)
        applied = self._ramped(layer.inputs[parent], wanted, stretch.ticks)
        poses = [layer.pose[parent]]
        for k in range(stretch.ticks):
            poses.append(self._vehicle.step(poses[-1], applied[:, k], self._local.tick_s))
        path = np.stack(poses, axis=1)
        reach_m = self._fastest(layer) * stretch.ticks * self._local.tick_s
        near = stretch.near(layer.pose, reach_m, self._vehicle.body_radius_m)
        touched, clear_m = stretch.first_touch(self._vehicle, path, applied, near[parent], MARGIN_M)
        if self._goal is not None:
            inside = (self._goal.gap_m(path[:, 1:]) <= 0.0) & (np.arange(stretch.ticks) < touched[:, None])
            done = np.flatnonzero(inside.any(axis=1))
            if len(done):
                ticks = np.argmax(inside[done], axis=1)
                best = int(np.argmin(ticks))
                row = done[[best]]
                last = _Layer(path[row, -1], applied[row, -1], parent[row], wanted[row], stretch.ticks)
                return last, (0, int(ticks[best]) + 1)
        alive = np.flatnonzero(touched == stretch.ticks)
        if self._goal is not None:
            alive = alive[self._goal.gap_m(path[alive, -1]) <= self._fastest(layer) * left * self._local.tick_s]
        end = np.column_stack([path[alive, -1], applied[alive, -1]])
        chosen = alive[self._chosen(end, clear_m[alive])]
        return _Layer(path[chosen, -1], applied[chosen, -1], parent[chosen], wanted[chosen], stretch.ticks), None

    def _choices(self, inputs: FloatArray) -> tuple[IntArray, FloatArray]:
        """What is tried from states with inputs (n, 2): the state (c,) and the wanted inputs (c, 2), without
        those that come to the same within the period."""
        reach = self._vehicle.rate_max * self._held * self._local.tick_s
        axes, fresh = [], []
        for i, levels in enumerate(self._levels):
            near = np.clip(levels, inputs[:, i, None] - reach[i], inputs[:, i, None] + reach[i])
            axes.append(near)
            fresh.append(np.diff(near, axis=1, prepend=-np.inf) > 1e-9)
        state, speed, turn = np.nonzero(fresh[0][:, :, None] & fresh[1][:, None, :])
        return state, np.column_stack([axes[0][state, speed], axes[1][state, turn]])

    def _ramped(self, inputs: FloatArray, wanted: FloatArray, ticks: int) -> FloatArray:
        """(c, ticks, 2) inputs on the way from (c, 2) to (c, 2), as `Vehicle.within_limits` gives them."""
        reach = self._vehicle.rate_max * self._local.tick_s * np.arange(1, ticks + 1)[:, None]
        return np.asarray(inputs[:, None] + np.clip((wanted - inputs)[:, None], -reach, reach))

    def _fastest(self, layer: _Layer) -> float:
        """No state that comes after these is faster, m/s."""
        return float(max(np.abs(layer.inputs[:, 0]).max(), np.abs(self._levels[0]).max()))

    def _chosen(self, state: FloatArray, clear_m: FloatArray) -> IntArray:
        """Which of the states (c, 5) x, y, yaw, inputs, with their clearances (c,), to go on from: the best of
        each cell; of these, where they are too many, half the best and half spread over the plane."""
        if self._goal is None:
            score = -np.minimum(clear_m, 2.0)
        else:
            ahead = state[:, :2] + LOOK_AHEAD_M * np.column_stack([np.cos(state[:, 2]), np.sin(state[:, 2])])
            score = 0.5 * (self._goal.distance(state[:, :2]) + self._goal.distance(ahead))
        order = np.argsort(score, kind="stable")
        turned = np.column_stack([state[:, :2], np.remainder(state[:, 2], 2 * np.pi), state[:, 3:]])
        order = order[_firsts(np.round(turned[order] / self._cells))[0]]
        if len(order) <= self._width:
            return order
        self.crowded = True
        best, rest = order[: self._width // 2], order[self._width // 2 :]
        rank = _firsts(np.floor(np.column_stack([state[rest, :2] / 0.5, state[rest, 2] / (0.25 * np.pi)])))[1]
        spread = rest[np.argsort(rank, kind="stable")[: self._width - len(best)]]
        return np.concatenate([best, spread])

    def _inputs(self, layers: list[_Layer], state: int, ticks: int) -> FloatArray:
        """(T, 2) inputs that lead to a state of the last layer, `ticks` after the layer before."""
        parts = []
        for before, layer in zip(layers[-2::-1], layers[:0:-1], strict=True):
            parent = int(layer.parent[state])
            ramped = self._ramped(before.inputs[[parent]], layer.wanted[[state]], layer.ticks)[0]
            parts.append(ramped[: ticks if layer is layers[-1] else layer.ticks])
            state = parent
        return np.concatenate(parts[::-1]) if parts else np.zeros((0, 2))


def _firsts(cell: FloatArray) -> tuple[BoolArray, IntArray]:
    """Of rows in cells (c, d): which is its cell's first (c,), and each row's rank within its cell (c,)."""
    if not len(cell):
        return np.zeros(0, dtype=np.bool_), np.zeros(0, dtype=np.int64)
    number = (cell - cell.min(axis=0)).astype(np.int64)
    # One number a cell: sorting those is many times as fast as sorting rows.
    _, group = np.unique(np.ravel_multi_index(tuple(number.T), tuple(number.max(axis=0) + 1)), return_inverse=True)
    order = np.argsort(group, kind="stable")
    sizes = np.bincount(group)
    rank = np.empty(len(group), dtype=np.int64)
    rank[order] = np.arange(len(group)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return rank == 0, rank
