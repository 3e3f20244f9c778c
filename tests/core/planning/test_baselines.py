"""Dynamic window, potential field, pure pursuit, and what they share."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.config import PlanningConfig, VehicleConfig
from adcbf_cli.core.planning import dynamic_window, fallback, pursuit
from adcbf_cli.core.planning.planner import Outcome, Plan, Situation
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.types import FloatArray, Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle
from tests.core.planning.hard_cases import CASES, Case, check, drive, known

PLANNING = PlanningConfig()
UNICYCLE = Vehicle.from_config(VehicleConfig())
ACKERMANN = Vehicle.from_config(VehicleConfig(kind="ackermann"))
STRAIGHT = ReferencePath(np.array([[0.0, 0.0], [9.0, 0.0]]), 0.75)
BASELINES = ["dwa", "apf", "pure-pursuit"]


def situation(
    discs: list[tuple[float, float, float, float, float]],
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    inputs: tuple[float, float] = (0.75, 0.0),
) -> Situation:
    seen = known(np.asarray(discs, dtype=float).reshape(-1, 5), 0.0, PLANNING.steps, PLANNING.step_s)
    return Situation(0, np.array(pose), np.array(inputs), STRAIGHT, seen)


def planned(name: str, at: Situation, vehicle: Vehicle = UNICYCLE) -> Plan:
    return make_planner(name, vehicle, PLANNING, Notes()).plan(at)


def case(name: str) -> Case:
    return next(found for found in CASES if found.name == name)


def test_surface_distance_by_hand() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    centre = np.array([[[3.0, 4.0], [1.0, 0.5]]])
    got = fallback.surface_m(poses, centre, np.array([0.4]), 0.3)
    np.testing.assert_allclose(got, [[4.3, -0.2]])


def test_a_relaxed_plan_against_braking() -> None:
    better = fallback.relaxed_is_better
    assert better(0.25, 0.9, 1.0, 0.2), "it keeps the safety distance"
    assert better(0.15, 0.1, 1.0, 0.2), "braking comes closer"
    assert not better(0.15, 0.9, 1.0, 0.2)
    assert not better(-0.01, 0.01, 1.0, 0.2), "it drives into something and braking does not"
    assert better(-0.1, -0.2, 1.0, 0.2), "braking is hit harder"
    assert better(0.08, 0.1, 0.1, 0.2), "a way out of the margin may lose a little"
    assert not better(0.08, 0.1, 0.3, 0.2), "but not on the way into it"
    assert not better(0.0, 0.1, 0.1, 0.2)


def test_pursuit_runs_onto_the_path_with_the_dynamics_of_the_vehicle() -> None:
    for vehicle in (UNICYCLE, ACKERMANN):
        pose, last = np.array([0.0, 0.4, 0.0]), np.array([0.0, 0.0])
        aims = pursuit.beyond(STRAIGHT, 0.05 * np.arange(120) + pursuit.look_ahead_m(STRAIGHT))
        inputs = pursuit.pursue(vehicle, pose, last, aims[:, :2], np.full(120, 0.5), 0.1, 1 / 30)
        check(inputs, last, vehicle, PLANNING.model_copy(update={"steps": 120}))
        end = vehicle.roll_out(pose, inputs, 0.1)[-1]
        assert abs(end[1]) < 0.03
        assert abs(end[2]) < 0.05


def test_pursuit_of_a_point_drives_the_arc_through_it() -> None:
    # From the origin heading east, the arc through (1, 1) has radius 1: v = omega.
    slow = pursuit.pursue(
        UNICYCLE, np.zeros(3), np.array([0.5, 0.5]), np.array([[1.0, 1.0]]), np.array([0.5]), 0.1, 0.1
    )
    np.testing.assert_allclose(slow, [[0.5, 0.5]])
    steer = np.arctan(0.6)
    turned = pursuit.pursue(
        ACKERMANN, np.zeros(3), np.array([0.5, steer]), np.array([[1.0, 1.0]]), np.array([0.5]), 0.1, 0.1
    )
    np.testing.assert_allclose(turned, [[0.5, steer]])


def test_the_aim_goes_straight_on_after_the_end() -> None:
    np.testing.assert_allclose(pursuit.beyond(STRAIGHT, np.array([9.5]))[0, :2], [9.5, 0.0])


@pytest.mark.parametrize("name", BASELINES)
@pytest.mark.parametrize("vehicle", [UNICYCLE, ACKERMANN], ids=["unicycle", "ackermann"])
def test_the_way_is_driven_where_it_is_free(name: str, vehicle: Vehicle) -> None:
    course = drive(case("free"), make_planner(name, vehicle, PLANNING, Notes()), vehicle, PLANNING)
    assert course.arrived
    assert set(course.outcomes) == {Outcome.SOLVED}
    assert np.abs(course.pose[:, 1]).max() < 1e-6


def test_pure_pursuit_does_not_mind_what_is_beside_the_way() -> None:
    free = planned("pure-pursuit", situation([]))
    beside = planned("pure-pursuit", situation([(0.7, 0.81, 0.0, 0.0, 0.3)]))
    blocked = planned("pure-pursuit", situation([(0.7, 0.79, 0.0, 0.0, 0.3)]))
    np.testing.assert_array_equal(free.inputs, beside.inputs)
    assert beside.outcome is Outcome.SOLVED
    assert blocked.outcome is Outcome.BRAKED
    assert blocked.inputs[-1, 0] < 0.1


def test_pure_pursuit_stops_for_what_crosses_and_goes_on() -> None:
    course = drive(case("crossing"), make_planner("pure-pursuit", UNICYCLE, PLANNING, Notes()), UNICYCLE, PLANNING)
    assert course.arrived
    assert Outcome.BRAKED in course.outcomes
    assert course.outcomes[-1] is Outcome.SOLVED


def test_pure_pursuit_stands_before_what_stays() -> None:
    course = drive(case("dead ahead"), make_planner("pure-pursuit", UNICYCLE, PLANNING, Notes()), UNICYCLE, PLANNING)
    assert not course.arrived
    assert course.outcomes[-1] is Outcome.STOPPED
    assert PLANNING.safety_distance_m <= course.clearance_m.min() < PLANNING.safety_distance_m + 0.1


def test_the_window_holds_what_can_be_reached() -> None:
    last = np.array([0.4, 0.2])
    arcs = dynamic_window.DynamicWindow("dwa", UNICYCLE, PLANNING)._arcs(last)
    assert arcs[:, -1, 0].min() == pytest.approx(0.0)
    assert arcs[:, -1, 0].max() == pytest.approx(0.9)
    assert arcs[:, -1, 1].max() == pytest.approx(1.0)
    for arc in arcs:
        check(arc, last, UNICYCLE, PLANNING)


def test_the_window_s_roll_outs_are_the_vehicle_s() -> None:
    inputs = np.random.default_rng(4).uniform(-1, 1, (5, 30, 2))
    pose = np.array([1.0, -2.0, 0.7])
    for vehicle in (UNICYCLE, ACKERMANN):
        got = vehicle.roll_outs(pose, inputs, 0.1)
        for arc, poses in zip(inputs, got, strict=True):
            np.testing.assert_allclose(poses, vehicle.roll_out(pose, arc, 0.1), atol=1e-12)


def test_a_dynamic_window_without_a_way_brakes() -> None:
    # Too fast to stop in front of the wall of discs: nothing is admissible.
    wall = [(0.9, y, 0.0, 0.0, 0.3) for y in np.linspace(-3, 3, 21)]
    plan = planned("dwa", situation(wall, inputs=(1.0, 0.0)))
    assert plan.outcome is Outcome.BRAKED
    np.testing.assert_allclose(plan.inputs[:3, 0], [1 - 1 / 30, 1 - 1 / 30 - 0.1, 1 - 1 / 30 - 0.2])
    stopped = planned("dwa", situation([(0.0, 0.0, 0.0, 0.0, 0.3)], inputs=(0.0, 0.0)))
    assert stopped.outcome in (Outcome.SOLVED, Outcome.STOPPED)


def test_a_dynamic_window_passes_big_obstacles() -> None:
    course = drive(case("big ahead"), make_planner("dwa", UNICYCLE, PLANNING, Notes()), UNICYCLE, PLANNING)
    assert course.arrived
    assert course.clearance_m.min() > 0.19


def test_a_field_pushes_away_and_only_within_its_influence() -> None:
    far = planned("apf", situation([(0.5, 1.9, 0.0, 0.0, 0.3)]))
    np.testing.assert_array_equal(far.inputs, planned("apf", situation([])).inputs)
    left = planned("apf", situation([(0.6, 0.7, 0.0, 0.0, 0.3)]))
    right = planned("apf", situation([(0.6, -0.7, 0.0, 0.0, 0.3)]))
    assert left.inputs[5, 1] < 0 < right.inputs[5, 1]
    np.testing.assert_allclose(left.inputs * [1, -1], right.inputs, atol=1e-12)


def test_a_field_s_local_minimum_is_a_stop() -> None:
    course = drive(case("dead ahead"), make_planner("apf", UNICYCLE, PLANNING, Notes()), UNICYCLE, PLANNING)
    assert not course.arrived
    assert not course.collided
    assert course.outcomes[-1] is Outcome.STOPPED


@pytest.mark.parametrize("name", BASELINES)
def test_a_shifted_and_turned_world_gives_the_same_inputs(name: str) -> None:
    angle, offset = 2.1, np.array([40.0, -7.0])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def moved(point: tuple[float, float]) -> FloatArray:
        return turn @ np.array(point) + offset

    disc = (1.6, 0.3, -0.2, 0.1, 0.4)
    velocity = turn @ np.array(disc[2:4])
    there = (*moved(disc[:2]), *velocity, disc[4])
    here = planned(name, situation([disc]))
    at = situation([there])
    path = ReferencePath(np.array([moved((0.0, 0.0)), moved((9.0, 0.0))]), 0.75)
    pose = np.array([*moved((0.0, 0.0)), angle])
    other = make_planner(name, UNICYCLE, PLANNING, Notes()).plan(Situation(0, pose, at.inputs, path, at.obstacles))
    np.testing.assert_allclose(here.inputs, other.inputs, atol=1e-9)
