"""Evasion: of what the vehicle can do, the way that keeps the most room; only where something moving comes too near."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.planning.barrier import AdaptiveGamma, Barrier
from adcbf_cli.core.planning.columns import Columns, columns_of
from adcbf_cli.core.planning.evasion import WIDTH, room_m, roomy_ways
from adcbf_cli.core.planning.fallback import surface_m
from adcbf_cli.core.planning.mpc import problem_of
from adcbf_cli.core.planning.planner import Outcome
from adcbf_cli.core.types import FloatArray
from tests.core.planning.told import PLANNING, VEHICLE, Discs, constant, seen, situation, told

PROBLEM = problem_of(VEHICLE, PLANNING, Barrier(AdaptiveGamma()))
REFERENCE = np.column_stack([0.075 * np.arange(31), *np.zeros((2, 31)), np.full(31, 0.75), np.zeros(31)])


def columns(discs: Discs) -> Columns:
    return columns_of(seen(discs), "predicted", 0.5, 0.0)


def found(discs: Discs, last: tuple[float, float]) -> FloatArray:
    return roomy_ways(PROBLEM, np.zeros(3), np.array(last), columns(discs), REFERENCE)


def rooms(discs: Discs, inputs: FloatArray) -> FloatArray:
    return room_m(VEHICLE.roll_outs(np.zeros(3), inputs, 0.1), columns(discs))


def test_ways_are_within_the_limits_and_the_roomiest_first() -> None:
    coming: Discs = [(2.5, 0.2, -1.3, 0.0, 0.4), (0.8, -1.8, 0.0, 0.8, 0.3)]
    ways = found(coming, (0.6, -0.3))
    assert 1 < len(ways) <= WIDTH
    for way in ways:
        np.testing.assert_allclose(VEHICLE.within_limits(way, np.array([0.6, -0.3]), 0.1, 1 / 30), way, atol=1e-12)
    room = rooms(coming, ways)
    assert (room <= room[0] + 0.02).all()


def test_none_of_many_other_ways_keeps_more_room() -> None:
    rng = np.random.default_rng(7)
    worse = 0
    for _ in range(15):
        side, speed = rng.uniform(-np.pi, np.pi, 3), rng.uniform(0.3, 1.5, 3)
        place = rng.uniform(1.0, 2.5, 3)[:, None] * np.column_stack([np.cos(side), np.sin(side)])
        aim = rng.normal(0.0, 0.4, (3, 2)) - place
        velocity = speed[:, None] * aim / np.hypot(*aim.T)[:, None]
        discs = [(*p, *v, 0.3) for p, v in zip(place.tolist(), velocity.tolist(), strict=True)]
        last = (float(rng.uniform(0.0, 1.0)), float(rng.uniform(-1.0, 1.0)))
        knots = rng.uniform([0.0, -1.0], [1.0, 1.0], (300, 6, 2)).repeat(5, axis=1)
        others = np.array([VEHICLE.within_limits(way, np.array(last), 0.1, 1 / 30) for way in knots])
        best, other = rooms(discs, found(discs, last)).max(), rooms(discs, others).max()
        assert best > other - 0.05
        worse += bool(other < best - 0.02)
    assert worse >= 5, "and often they keep less"


def test_without_obstacles_there_is_room_everywhere_and_the_reference_is_kept() -> None:
    ways = found([], (0.75, 0.0))
    np.testing.assert_array_equal(rooms([], ways), 0.0)
    assert np.hypot(*(VEHICLE.roll_out(np.zeros(3), ways[0], 0.1)[-1, :2] - REFERENCE[-1, :2])) < 0.15


def test_what_can_reverse_backs_out() -> None:
    niche: Discs = [(0.9, 0.0, -0.4, 0.0, 0.3), (0.0, 0.95, 0.0, 0.0, 0.4), (0.0, -0.95, 0.0, 0.0, 0.4)]
    stays = float(rooms(niche, np.zeros((1, 30, 2)))[0])
    assert rooms(niche, found(niche, (0.0, 0.0))).max() < stays + 0.3
    backs = VEHICLE.__class__(
        VEHICLE.kind, np.array([-1.0, -1.0]), VEHICLE.input_max, VEHICLE.rate_max, VEHICLE.body_radius_m, 0.6
    )
    problem = problem_of(backs, PLANNING, Barrier(AdaptiveGamma()))
    ways = roomy_ways(problem, np.zeros(3), np.zeros(2), columns(niche), REFERENCE)
    assert rooms(niche, ways).max() > stays + 0.5


COMING: Discs = [(3.0, 0.1, -1.0, 0.0, 0.3)]


def test_a_plan_that_is_run_over_gives_way_to_the_roomiest_one() -> None:
    made, _ = told(constant(0.1))
    evading = made.plan(situation(COMING, inputs=(0.7, 0.0)))
    assert evading.details is not None
    assert (evading.outcome, evading.details.start) == (Outcome.RELAXED, "evading")
    known = seen(COMING)
    crawling = VEHICLE.roll_out(np.zeros(3), constant(0.1).inputs, 0.1)
    rooms = [surface_m(p, known.position_m, known.radius_m, 0.3).min() for p in (crawling, evading.poses)]
    assert rooms[0] < 0.0 < rooms[1]
    np.testing.assert_array_equal(
        evading.inputs, VEHICLE.within_limits(evading.inputs, np.array([0.7, 0.0]), 0.1, 1 / 30)
    )


def test_nothing_is_evaded_that_stands_or_is_passed_with_room() -> None:
    standing: Discs = [(0.75, 0.0, 0.0, 0.0, 0.3)]
    made, _ = told(constant(0.7))
    plan = made.plan(situation(standing, inputs=(0.7, 0.0)))
    assert plan.details is not None
    assert plan.details.start != "evading"
    aside: Discs = [(2.2, 1.2, -1.3, 0.0, 0.3)]
    made, _ = told(constant(0.7))
    plan = made.plan(situation(aside, inputs=(0.7, 0.0)))
    assert plan.details is not None
    assert plan.details.start != "evading"


def test_a_planner_that_holds_what_moves_has_nothing_to_evade() -> None:
    made, _ = told(constant(0.1), name="mpc-cbf")
    plan = made.plan(situation(COMING, inputs=(0.7, 0.0)))
    assert plan.details is not None
    assert plan.details.start != "evading"


def test_room_is_what_is_missing_at_the_worst() -> None:
    poses = np.zeros((2, 3, 3))
    poses[1, :, 1] = -1.0
    centre = np.array([[[1.0, 0.0], [0.9, 0.0], [0.8, 0.0]]])
    one = Columns(np.zeros(1, dtype=np.int64), centre, np.zeros(1), np.array([[0.7, 0.8, 0.9]]))
    np.testing.assert_allclose(room_m(poses, one), [-0.1, 0.0])
    assert room_m(poses, one.taken(np.zeros(1, dtype=bool))).tolist() == [0.0, 0.0]
