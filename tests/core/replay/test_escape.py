"""Ways out, and none: worlds made by hand in which the answer is known."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.config import VehicleConfig
from adcbf_cli.core.replay.escape import Escape, find_escape, judge_collision, verified
from adcbf_cli.core.replay.records import Drive, Result
from adcbf_cli.core.replay.simulated_world import SimulatedWorld
from adcbf_cli.core.replay.world import RecordedWorld, Samples
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.world import World
from adcbf_cli.core.types import NO_ID, FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

SECOND = 1_000_000_000
START = 100 * SECOND
VEHICLE = Vehicle.from_config(VehicleConfig())
BODY_M = VEHICLE.body_radius_m
STANDING = np.zeros(2)
CRUISING = np.array([1.0, 0.0])
PERIOD_S = 1 / 30

Thing = dict[str, Any]


def world(*things: Thing, shift_m: tuple[float, float] = (0.0, 0.0), turn_deg: float = 0.0) -> SimulatedWorld:
    """Walls and boxes stand, the rest moves; all of it turned about the origin, then shifted."""
    moved = [_moved(thing, shift_m, turn_deg) for thing in things]
    scenario = Scenario.model_validate(
        {
            "duration_s": 60,
            "start_time_s": START // SECOND,
            "terrain": {"size_m": 400},
            "ego": {"path": {"kind": "stand", "at_m": [0, 0]}},
            "lidar": {"kind": "spinning"},
            "objects": [thing for thing in moved if "path" not in thing],
            "movers": [thing for thing in moved if "path" in thing],
        }
    )
    return SimulatedWorld(World(scenario, 0))


def placed(point: FloatArray, shift_m: tuple[float, float], turn_deg: float) -> FloatArray:
    cos, sin = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    return np.asarray(point) @ np.array([[cos, sin], [-sin, cos]]) + shift_m


def _moved(thing: Thing, shift_m: tuple[float, float], turn_deg: float) -> Thing:
    copy: Thing = {}
    for key, value in thing.items():
        if key == "path":
            copy[key] = _moved(value, shift_m, turn_deg)
        elif key in ("at_m", "from_m", "to_m", "points_m"):
            copy[key] = placed(np.array(value, dtype=float), shift_m, turn_deg).tolist()
        else:
            copy[key] = value
    return copy


def wall(*ends: list[float]) -> Thing:
    return {"kind": "wall", "from_m": ends[0], "to_m": ends[1]}


def walker(start: list[float], end: list[float], speed_mps: float, radius_m: float = 0.3) -> Thing:
    path = {"kind": "line", "from_m": start, "to_m": end, "speed_mps": speed_mps}
    return {"kind": "cylinder", "radius_m": radius_m, "path": path}


def escape(
    scene: Any,
    until_s: float,
    goal_m: list[float] | None = None,
    pose: tuple[float, ...] = (0.0, 0.0, 0.0),
    inputs: FloatArray = STANDING,
    vehicle: Vehicle = VEHICLE,
    **options: Any,
) -> Escape:
    """The search's answer, whose claim is checked again from outside."""
    goal = None if goal_m is None else np.array(goal_m)
    until_ns = START + round(until_s * SECOND)
    way = find_escape(scene, vehicle, np.array(pose), inputs, START, until_ns, goal, **options)
    assert len(way.poses) == len(way.inputs) + 1
    np.testing.assert_array_equal(way.poses[0], pose)
    if way.found:
        assert verified(way, scene, vehicle, np.array(pose), inputs, START, until_ns, goal)
        assert least_clearance(scene, way, vehicle) > 0.0
    else:
        assert len(way.inputs) == 0
    return way


def least_clearance(scene: Any, way: Escape, vehicle: Vehicle = VEHICLE, parts: int = 3) -> float:
    """By driving the way in small steps, apart from how the search looks."""
    least = math.inf
    for k, (pose, inputs) in enumerate(zip(way.poses[:-1], way.inputs, strict=True)):
        for part in range(parts):
            here = vehicle.step(pose, inputs, part / parts * PERIOD_S)
            stamp = START + round((k + part / parts) * PERIOD_S * SECOND)
            clearance = scene.nearest(here[:2], vehicle.body_radius_m, stamp)[0]
            least = min(least, math.inf if math.isnan(clearance) else clearance)
    return least


# What stands across a corridor a little wider than the vehicle, and walls to both sides and behind.
CORRIDOR = (wall([-3.0, 0.45], [30.0, 0.45]), wall([-3.0, -0.45], [30.0, -0.45]), wall([-3.0, -0.45], [-3.0, 0.45]))


def test_nothing_in_the_way_is_driven_straight_to_the_goal():
    """Full speed is reached after a second and half a metre; 9.7 m to the goal's edge take 10.2 s."""
    way = escape(world(), 39.0, [10.0, 0.0])
    assert way.found
    assert len(way.inputs) == pytest.approx(10.2 * 30, abs=8)
    assert math.dist(way.poses[-1, :2], (10.0, 0.0)) <= 0.3
    assert np.abs(way.poses[:, 1]).max() < 1.0


def test_no_way_reaches_a_goal_too_far_for_the_time():
    assert not escape(world(), 9.0, [10.0, 0.0]).found


def test_a_person_walks_through_where_the_vehicle_stands():
    """Standing still ends in a touch; there is room to go."""
    scene = world(walker([4.0, 0.0], [-6.0, 0.0], 1.0))
    standing = [scene.nearest(np.zeros(2), BODY_M, START + k * SECOND // 10)[0] for k in range(100)]
    assert min(standing) < 0.0
    assert escape(scene, 10.0).found


def test_no_way_out_of_a_closed_corridor_with_a_car_coming():
    car = {"kind": "vehicle", "path": {"kind": "line", "from_m": [14, 0], "to_m": [-2.5, 0], "speed_mps": 2.0}}
    cross = wall([-3.0, 1.2], [30.0, 1.2]), wall([-3.0, -1.2], [30.0, -1.2]), wall([-3.0, -1.2], [-3.0, 1.2])
    scene = world(*cross, car)
    assert escape(scene, 5.0).found, "the car is not there yet"
    assert not escape(scene, 12.0, width=256).found
    assert escape(world(*cross[1:], car), 12.0).found, "with one side open"


def test_a_gate_that_opens_for_a_moment():
    """A door steps aside from 8 s to 13 s; the yard before it has no other way out."""
    yard = [wall([3.0, 0.5], [3.0, 4.0]), wall([3.0, -4.0], [3.0, -0.5]), wall([-2.0, 4.0], [3.0, 4.0])]
    yard += [wall([-2.0, -4.0], [3.0, -4.0]), wall([-2.0, -4.0], [-2.0, 4.0])]

    def door(*times_s: float) -> Thing:
        points = [[3.0, 0.0], [3.0, 0.01], [5.0, 1.5], [5.0, 1.51], [3.0, 0.01], [3.0, 0.0]]
        path = {"kind": "waypoints", "points_m": points, "times_s": times_s}
        return {"kind": "cylinder", "radius_m": 0.4, "path": path}

    goal = [6.0, -1.0]
    way = escape(world(*yard, door(0.0, 8.0, 9.0, 12.0, 13.0, 50.0)), 30.0, goal)
    assert way.found
    through = np.flatnonzero(way.poses[:, 0] > 3.0)[0] / 30
    assert 8.0 < through < 13.0
    shut = world(*yard, door(0.0, 18.0, 19.0, 22.0, 23.0, 50.0))
    assert not escape(shut, 16.0, goal, width=128).found


def test_a_hit_a_fifth_of_a_second_away():
    """At 2.5 m/s towards each other, 0.42 m apart: not even half of it can be braked away or turned aside."""
    ahead = walker([1.2, 0.0], [-8.0, 0.0], 1.5, radius_m=0.48)
    way = escape(world(ahead), 3.0, inputs=CRUISING)
    assert not way.found
    assert way.expanded > 0
    assert escape(world(walker([5.2, 0.0], [-8.0, 0.0], 1.5, radius_m=0.48)), 8.0, inputs=CRUISING).found


@pytest.mark.parametrize(("spare_m", "found"), [(0.005, True), (-0.02, False)])
def test_braking_to_the_last_centimetre(spare_m: float, found: bool):
    """From 1 m/s with 1 m/s^2 and ticks of 1/30 s the vehicle goes on for (29 + 28 + ... + 0) / 30 / 30 m. Some
    millimetres less are possible, for the corridor leaves 5 cm to either side to curve in."""
    way_m = sum(range(30)) / 30 / 30
    end = wall([way_m + BODY_M + 0.1 + spare_m, -2.0], [way_m + BODY_M + 0.1 + spare_m, 2.0])
    assert escape(world(*CORRIDOR, end), 4.0, inputs=CRUISING).found is found


def test_a_touch_between_two_ticks_counts():
    """A thin thing so fast that it is on one side at a tick and on the other at the next."""
    time_ns = START + np.arange(0, 5 * SECOND, SECOND // 100)
    x = 40.0 * (time_ns - START - 2 * SECOND - SECOND // 60) / SECOND
    place = np.column_stack([x, np.zeros_like(x)])
    bullet = Samples.of(np.full(len(x), 1), time_ns, place, np.full(len(x), 0.01))
    scene = RecordedWorld(bullet, 0.5)
    still = Escape(True, np.zeros((90, 2)), np.zeros((91, 3)), 0)
    ticks = START + np.round(np.arange(91) * SECOND / 30).astype(np.int64)
    assert min(scene.nearest(np.zeros(2), BODY_M, int(t))[0] for t in ticks) > 0.0
    assert not verified(still, scene, VEHICLE, np.zeros(3), STANDING, START, START + 3 * SECOND)
    assert escape(scene, 4.0).found, "there are two seconds to step aside"
    walls = wall([-3.0, 0.45], [30.0, 0.45]), wall([-3.0, -0.45], [30.0, -0.45])
    assert not escape(_Both(scene, world(*walls)), 4.0, width=256).found


class _Both:
    """Two worlds in one."""

    def __init__(self, first: Any, second: Any) -> None:
        self._worlds = first, second

    def at(self, stamp_ns: int) -> Any:
        parts = [part.at(stamp_ns) for part in self._worlds]
        names = [field.name for field in dataclasses.fields(parts[0])]
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        joined["id"] = np.concatenate([parts[0].id, 1000 + parts[1].id])
        return dataclasses.replace(parts[0], **joined)

    def nearest(self, point_m: FloatArray, body_radius_m: float, stamp_ns: int) -> tuple[float, int]:
        return min(part.nearest(point_m, body_radius_m, stamp_ns) for part in self._worlds)


def test_things_that_come_and_go():
    """A recorded blockade that vanishes with its last sample lets the vehicle out."""
    time_ns = START + np.arange(0, 5 * SECOND, SECOND // 10)
    spots = [(x, y) for x in (-0.9, 0.0, 0.9) for y in (-0.9, 0.0, 0.9) if (x, y) != (0.0, 0.0)]
    ids = np.repeat(np.arange(len(spots)), len(time_ns))
    stamps, places = np.tile(time_ns, len(spots)), np.repeat(np.array(spots), len(time_ns), axis=0)
    scene = RecordedWorld(Samples.of(ids, stamps, places, np.full(len(ids), 0.3)), 0.5)
    way = escape(scene, 12.0, [4.0, 0.0])
    assert way.found
    assert np.hypot(*way.poses[: 30 * 4, :2].T).max() < 0.6
    assert not escape(scene, 4.5, [2.0, 0.0], width=256).found


def test_a_start_in_contact_has_no_way():
    way = escape(world(walker([0.5, 0.0], [0.6, 0.0], 0.1)), 3.0)
    assert not way.found
    assert way.expanded == 0


@pytest.mark.parametrize("kind", ["ackermann", "unicycle"])
def test_a_vehicle_that_may_reverse_backs_out(kind: str):
    """A dead end with a person coming up to its end wall: the only way is back."""
    config = VehicleConfig(kind=kind, min_speed_mps=-1.0)
    sides = wall([-30.0, 0.45], [1.5, 0.45]), wall([-30.0, -0.45], [1.5, -0.45])
    scene = world(*sides, walker([3.0, 0.0], [-4.0, 0.0], 0.8))
    assert escape(scene, 8.0, vehicle=Vehicle.from_config(config)).found
    assert not escape(scene, 8.0, vehicle=Vehicle.from_config(VehicleConfig(kind=kind)), width=256).found


@pytest.fixture
def found() -> tuple[SimulatedWorld, Escape]:
    scene = world(walker([4.0, 0.0], [-6.0, 0.0], 1.0))
    return scene, escape(scene, 8.0)


def test_a_tampered_way_is_no_proof(found: tuple[SimulatedWorld, Escape]):
    scene, way = found

    def holds(way: Escape, pose: FloatArray | None = None, last: FloatArray = STANDING, until_s: float = 8.0) -> bool:
        start = np.zeros(3) if pose is None else pose
        return verified(way, scene, VEHICLE, start, last, START, START + round(until_s * SECOND))

    assert holds(way)
    still = dataclasses.replace(way, inputs=np.zeros((240, 2)), poses=np.zeros((241, 3)))
    assert not holds(still), "it is run over"
    jump = way.inputs.copy()
    jump[10, 0] += 0.1
    assert not holds(dataclasses.replace(way, inputs=jump)), "faster than the rate allows"
    shifted = way.poses.copy()
    shifted[20:, 1] += 0.01
    assert not holds(dataclasses.replace(way, poses=shifted)), "poses that the inputs do not lead to"
    assert not holds(dataclasses.replace(way, inputs=way.inputs[:-30], poses=way.poses[:-30])), "too short"
    assert not holds(way, until_s=9.0)
    assert not holds(way, pose=np.array([0.1, 0.0, 0.0])), "from elsewhere"
    assert not holds(way, last=np.array([0.5, 0.0])), "from another speed"
    assert not holds(dataclasses.replace(way, found=False))
    broken = way.inputs.copy()
    broken[3] = np.nan
    assert not holds(dataclasses.replace(way, inputs=broken))
    goal = np.array([50.0, 0.0])
    assert not verified(way, scene, VEHICLE, np.zeros(3), STANDING, START, START + 8 * SECOND, goal), "not there"


OPEN = (
    walker([3.0, -3.0], [3.0, 6.0], 0.9),
    walker([7.0, 0.2], [-6.0, 0.2], 1.2),
    wall([2.0, 1.5], [6.0, 1.5]),
    {"kind": "person", "path": {"kind": "line", "from_m": [5, -4], "to_m": [1, 5], "speed_mps": 1.0}},
)
SHUT = (*CORRIDOR, walker([6.0, 0.0], [-2.0, 0.0], 1.0))


def test_shifting_and_turning_the_scene_changes_nothing():
    """Past a wall and three people: the way takes as long. In a dead end there is none."""
    goal = np.array([5.0, 0.0])
    here = escape(world(*OPEN), 15.0, goal.tolist(), width=64)
    none = escape(world(*SHUT), 10.0, width=64)
    assert here.found
    assert not none.found
    for shift_m, turn_deg in (((31.3, -17.9), 0.0), ((-12.2, 40.7), 143.0)):
        pose = (*placed(np.zeros(2), shift_m, turn_deg), math.radians(turn_deg))
        moved = {"shift_m": shift_m, "turn_deg": turn_deg}
        there = escape(world(*OPEN, **moved), 15.0, placed(goal, shift_m, turn_deg).tolist(), pose=pose, width=64)
        assert there.found
        assert len(there.inputs) == pytest.approx(len(here.inputs), abs=15)
        assert not escape(world(*SHUT, **moved), 10.0, pose=pose, width=64).found


def drive(scene: SimulatedWorld, speed_mps: float, ticks: int = 400) -> Drive:
    """Straight on along x at a constant speed until something is touched, as a replay records it."""
    poses, stamps, clearances, nearest = [], [], [], []
    for k in range(ticks):
        poses.append([k * PERIOD_S * speed_mps, 0.0, 0.0])
        stamps.append(START + round(k * PERIOD_S * SECOND))
        clearance, thing = scene.nearest(np.array(poses[-1][:2]), BODY_M, stamps[-1])
        clearances.append(clearance)
        nearest.append(thing)
        if clearance < 0.0:
            break
    n = len(poses)
    result = Result.COLLISION if clearances[-1] < 0.0 else Result.TIMEOUT
    rest = {
        name: np.full(n, np.nan) for name in ("ttc_s", "reference_m", "along_m", "log_m", "recorded", "goal_reachable")
    }
    return Drive(
        planner="straight",
        seed=0,
        period_s=PERIOD_S,
        nominal_s=10.0,
        reference_length_m=10.0,
        reference_speed_mps=1.0,
        stamp_ns=np.array(stamps),
        pose=np.array(poses),
        inputs=np.tile([speed_mps, 0.0], (n, 1)),
        clearance_m=np.array(clearances),
        nearest_id=np.array(nearest),
        result=result,
        steps=None,
        stages=None,
        **rest,  # type: ignore[arg-type]
    )


HEAD_ON = walker([10.0, 0.0], [-10.0, 0.0], 1.5, radius_m=0.48)
"""With an ego of 1 m/s: 9.22 m apart, they touch after 3.688 s."""


def test_a_collision_with_what_was_known_in_time_was_avoidable():
    scene = world(HEAD_ON)
    driven = drive(scene, 1.0)
    assert (driven.stamp_ns[-1] - START) / SECOND == pytest.approx(3.7, abs=0.02)
    judged = judge_collision(scene, VEHICLE, driven, {0: START + round(1.01 * SECOND)}, CRUISING)
    assert judged.object_id == 0
    assert judged.known_since_ns == START + round(1.01 * SECOND)
    assert judged.reacted_from_ns == driven.stamp_ns[31], "the first tick not before"
    assert judged.avoidable is True
    np.testing.assert_array_equal(judged.way.poses[0], driven.pose[31])
    assert len(judged.way.inputs) * PERIOD_S >= 3.69 - 1.04 + 3.0 - 1e-6, "until three seconds after the hit"
    assert judged.avoidable_until_ns is not None
    last = int(np.searchsorted(driven.stamp_ns, judged.avoidable_until_ns))
    assert 31 < last < len(driven.stamp_ns) - 1
    until_ns = int(driven.stamp_ns[-1]) + 3 * SECOND
    found = [
        find_escape(scene, VEHICLE, driven.pose[k], CRUISING, int(driven.stamp_ns[k]), until_ns).found
        for k in (last, last + 1)
    ]
    assert found == [True, False]


def test_a_collision_with_what_became_known_too_late_was_not():
    scene = world(HEAD_ON)
    driven = drive(scene, 1.0)
    judged = judge_collision(scene, VEHICLE, driven, {0: int(driven.stamp_ns[-6]), 7: START}, CRUISING)
    assert judged.avoidable is False
    assert judged.reacted_from_ns == driven.stamp_ns[-6]
    assert judged.avoidable_until_ns is None
    assert not judged.way.found


@pytest.mark.parametrize("since_s", [None, 0.0, 2.0])
def test_a_collision_with_what_was_never_known(since_s: float | None):
    """Known at the hit or later is not known before it; then the way from the start stands beside it."""
    scene = world(HEAD_ON)
    driven = drive(scene, 1.0)
    known = {} if since_s is None else {0: int(driven.stamp_ns[-1]) + round(since_s * SECOND)}
    judged = judge_collision(scene, VEHICLE, driven, known, CRUISING)
    assert judged.avoidable is None
    assert judged.known_since_ns is None
    assert judged.reacted_from_ns == START
    assert judged.way.found


def test_the_inputs_before_the_tick_are_where_it_starts_from():
    """At the first tick the drive does not say what was applied before: standing, unless given."""
    scene = world(HEAD_ON)
    driven = drive(scene, 1.0)
    standing = judge_collision(scene, VEHICLE, driven, {0: START})
    cruising = judge_collision(scene, VEHICLE, driven, {0: START}, CRUISING)
    assert standing.way.inputs[0, 0] <= 1 / 30 + 1e-9
    assert cruising.way.inputs[0, 0] >= 1.0 - 1 / 30 - 1e-9


def test_a_drive_without_a_collision_is_refused():
    with pytest.raises(ValueError, match="collision"):
        judge_collision(world(), VEHICLE, drive(world(), 1.0, ticks=3), {NO_ID: START})
