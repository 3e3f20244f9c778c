"""The MPC planners around their solver: columns, starts, outcomes, the ladder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.planning import fallback, pursuit, starts
from adcbf_cli.core.planning.barrier import AdaptiveGamma, Barrier, FixedGamma, gamma_at
from adcbf_cli.core.planning.columns import can_bind, columns_of, nearest
from adcbf_cli.core.planning.merit import barrier_rows
from adcbf_cli.core.planning.mpc import MpcPlanner, problem_of
from adcbf_cli.core.planning.planner import Outcome, Situation
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.planning.problem import Instance, Problem
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.types import Notes
from tests.core.planning.hard_cases import check
from tests.core.planning.told import PLANNING, STRAIGHT, VEHICLE, Discs, Says, constant, planner, seen, situation, told

# Columns


def test_held_obstacles_stay_and_predicted_ones_move() -> None:
    obstacles = seen([(1.0, 2.0, 0.5, 0.0, 0.4), (3.0, 0.0, 0.0, 0.0, 0.2)])
    held = columns_of(obstacles, "held", 0.5, 0.0)
    np.testing.assert_array_equal(held.centre_m[0], np.tile([1.0, 2.0], (31, 1)))
    np.testing.assert_allclose(held.keep_out_m[:, 7], [0.9, 0.7])
    predicted = columns_of(obstacles, "predicted", 0.5, 0.0)
    np.testing.assert_allclose(predicted.centre_m[0, 30], [2.5, 2.0])
    paper = columns_of(obstacles, "paper", 0.5, 0.0)
    assert paper.track_id.tolist() == [0, 1, 0], "what moves twice, what stands once"
    np.testing.assert_array_equal(paper.centre_m[2], held.centre_m[0])


def test_uncertainty_widens_predicted_columns_only() -> None:
    obstacles = replace(seen([(1.0, 2.0, 0.5, 0.0, 0.4)]), margin_m=np.linspace(0.1, 0.4, 31)[None])
    wide = columns_of(obstacles, "paper", 0.5, 1.0)
    np.testing.assert_allclose(wide.keep_out_m[0, [0, -1]], [1.0, 1.3])
    np.testing.assert_allclose(wide.keep_out_m[1], 0.9)
    np.testing.assert_allclose(columns_of(obstacles, "predicted", 0.5, 0.0).keep_out_m, 0.9)
    np.testing.assert_allclose(columns_of(obstacles, "held", 0.5, 1.0).keep_out_m, 0.9)


@settings(max_examples=150, deadline=None)
@given(
    place=st.tuples(st.floats(-12, 12), st.floats(-12, 12)),
    velocity=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    radius=st.floats(0.05, 1.5),
    gamma=st.sampled_from([FixedGamma(1.0), FixedGamma(0.1), AdaptiveGamma()]),
    seed=st.integers(0, 99),
)
def test_what_cannot_bind_never_does(
    place: tuple[float, float],
    velocity: tuple[float, float],
    radius: float,
    gamma: FixedGamma | AdaptiveGamma,
    seed: int,
) -> None:
    problem = problem_of(VEHICLE, PLANNING, Barrier(gamma))
    columns = columns_of(seen([(*place, *velocity, radius)]), "predicted", 0.5, 0.0)
    if can_bind(problem, np.zeros(3), np.zeros(2), columns)[0]:
        return
    rng = np.random.default_rng(seed)
    towards = np.array([*np.zeros(2), np.arctan2(place[1], place[0])])
    inputs = np.column_stack([np.ones(30), rng.uniform(-0.2, 0.2, 30)])
    instance = Instance(towards, np.zeros(2), np.zeros((31, 5)), columns.centre_m, columns.radius_m, columns.keep_out_m)
    assert (barrier_rows(problem, instance, inputs).residual_m2 > 0).all()


def test_only_what_is_far_is_left_out() -> None:
    problem = problem_of(VEHICLE, PLANNING, Barrier(FixedGamma(1.0)))
    # Top speed is 1 m/s over 3 s, keep-out 0.9 m: 3.95 m is out of reach, 3.85 m is not, nor is what comes.
    columns = columns_of(
        seen([(3.85, 0, 0, 0, 0.4), (3.95, 0, 0, 0, 0.4), (5.0, 0, -1, 0, 0.4)]), "predicted", 0.5, 0.0
    )
    assert can_bind(problem, np.zeros(3), np.zeros(2), columns).tolist() == [True, False, True]
    printed = problem_of(VEHICLE, PLANNING, Barrier(FixedGamma(0.1), form="printed"))
    assert can_bind(printed, np.zeros(3), np.zeros(2), columns).all()


def test_whether_an_obstacle_can_bind_is_its_own_affair() -> None:
    """A stage that is looked at first decides where it can; the others must then say the same."""
    problem = problem_of(VEHICLE, PLANNING, Barrier(AdaptiveGamma()))
    rng = np.random.default_rng(2)
    discs = np.column_stack([rng.uniform(-9, 9, (40, 2)), rng.normal(0, 1, (40, 2)), rng.uniform(0.1, 1, 40)])
    pose, last = np.array([0.5, -0.3, 1.0]), np.array([0.6, 0.1])
    columns = columns_of(seen([tuple(disc) for disc in discs.tolist()]), "predicted", 0.5, 0.0)
    together = can_bind(problem, pose, last, columns)
    alone = [bool(can_bind(problem, pose, last, columns.taken(np.array([i])))[0]) for i in range(40)]
    assert together.tolist() == alone
    assert 5 < together.sum() < 35
    assert can_bind(problem, pose, last, columns.taken(together)).all()


def test_the_nearest_over_the_horizon_are_kept_with_all_their_columns() -> None:
    # The third is far now and near later; the second is near now and leaves.
    obstacles = seen([(1.0, 0.8, 0, 0, 0.3), (-1.5, 0, -1.5, 0, 0.3), (5.0, 1.0, -1.5, 0, 0.3)])
    columns = columns_of(obstacles, "paper", 0.5, 0.0)
    poses = VEHICLE.roll_out(np.zeros(3), np.tile([0.75, 0.0], (30, 1)), 0.1)
    kept, dropped = nearest(columns, poses, 2)
    assert sorted(kept.track_id.tolist()) == [0, 2, 2]
    assert dropped == 1
    assert nearest(columns, poses, 3)[1] == 0


def test_obstacles_beyond_the_limit_are_counted_and_far_ones_are_not() -> None:
    ring: Discs = [(1.5 + 0.1 * i, 1.5, 0, 0, 0.2) for i in range(5)]
    plan = planner(max_obstacles=3).plan(situation([*ring, (50.0, 0.0, 0, 0, 0.2)]))
    assert plan.details is not None
    assert plan.details.dropped == 2
    assert len(plan.details.track_id) == 3
    assert plan.details.barrier_m2.shape == (31, 3)


# Starts


def test_a_plan_is_shifted_in_time_not_by_stages() -> None:
    inputs = np.column_stack([np.arange(4.0), np.zeros(4)])
    later = starts.shifted(inputs, 0.025, 0.1)
    assert later is not None
    np.testing.assert_allclose(later[:, 0], [0.25, 1.25, 2.25, 3.0])
    assert starts.shifted(inputs, 0.4, 0.1) is None, "it has run out"
    assert starts.shifted(inputs, -0.1, 0.1) is None, "time ran backwards"


def test_the_second_start_goes_around_on_the_free_side() -> None:
    for y, side in ((0.2, -1), (-0.2, 1), (0.0, 1)):
        made, solver = told(constant(0.5))
        made.plan(situation([(2.1, y, 0.0, 0.0, 0.4)]))
        poses = VEHICLE.roll_out(np.zeros(3), solver.guesses[0], 0.1)
        assert np.sign(poses[26, 1]) == side
        gap = np.hypot(poses[:, 0] - 2.1, poses[:, 1] - y).min()
        assert gap > 0.65, "a start need not keep the distance, but it goes around"


def test_without_conflict_the_second_start_is_the_path() -> None:
    made, solver = told(constant(0.5))
    made.plan(situation([(1.6, 1.5, 0.0, 0.0, 0.4)]))
    assert np.abs(VEHICLE.roll_out(np.zeros(3), solver.guesses[0], 0.1)[:, 1]).max() < 1e-9


def test_starts_are_the_shifted_plan_and_the_path() -> None:
    made, solver = told(constant(0.7, 0.05))
    made.plan(situation([]))
    made.plan(situation([], stamp_ns=33_333_333, inputs=(0.7, 0.05)))
    assert len(solver.guesses) == 3, "one at first, then two"
    np.testing.assert_allclose(solver.guesses[1], np.tile([0.7, 0.05], (30, 1)))
    single, alone = told(constant(0.7), starts=1)
    single.plan(situation([]))
    single.plan(situation([], stamp_ns=33_333_333))
    assert len(alone.guesses) == 2


def test_a_shifted_start_is_within_reach_of_the_inputs() -> None:
    made, solver = told(constant(0.9, 0.5))
    made.plan(situation([], inputs=(0.9, 0.5)))
    made.plan(situation([], inputs=(0.1, 0.0), stamp_ns=33_333_333))
    check(solver.guesses[1], np.array([0.1, 0.0]), VEHICLE, PLANNING)
    assert solver.guesses[1][-1].tolist() == [0.9, 0.5]


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 9999), wild=st.floats(0.0, 2.0))
def test_limits_are_kept_as_the_vehicle_keeps_them(seed: int, wild: float) -> None:
    rng = np.random.default_rng(seed)
    last = rng.uniform([-0.2, -1.2], [1.2, 1.2])
    wanted = last + np.cumsum(rng.normal(0.0, wild * np.array([0.04, 0.1]), (30, 2)), axis=0)
    expected = VEHICLE.within_limits(wanted, last, 0.1, 1 / 30)
    for inputs in (wanted, expected):
        got = fallback.within_limits(VEHICLE, inputs, last, 0.1, 1 / 30)
        np.testing.assert_array_equal(got, expected)
        assert not np.shares_memory(got, inputs)


def test_the_lower_merit_wins_and_failures_do_not() -> None:
    first = constant(0.7)
    made, _ = told(first, constant(0.71, merit=5.0), constant(0.72, merit=2.0))
    made.plan(situation([]))
    plan = made.plan(situation([], stamp_ns=33_333_333, inputs=(0.7, 0.0)))
    assert plan.details is not None
    assert plan.details.start == "reference"
    assert plan.inputs[5, 0] == pytest.approx(0.72)
    made, _ = told(first, constant(0.71, merit=5.0), constant(0.72, merit=2.0, status="failed"))
    made.plan(situation([]))
    plan = made.plan(situation([], stamp_ns=33_333_333, inputs=(0.7, 0.0)))
    assert plan.details is not None
    assert plan.details.start == "shifted"


def test_frozen_gamma_comes_from_the_previous_plan() -> None:
    disc: Discs = [(2.0, 0.9, 0.0, 0.0, 0.5)]
    made, solver = told(constant(0.7), gamma_at="previous", starts=2)
    made.plan(situation(disc))
    made.plan(situation(disc, stamp_ns=33_333_333, inputs=(0.7, 0.0)))
    poses = VEHICLE.roll_out(np.zeros(3), solver.guesses[1], 0.1)
    distance = np.hypot(poses[:-1, 0] - 2.0, poses[:-1, 1] - 0.9)
    gamma = solver.instances[1].gamma
    assert gamma is not None
    np.testing.assert_allclose(gamma[0], gamma_at(AdaptiveGamma(), distance, np.array(0.5)))
    inside, plain = told(constant(0.7))
    inside.plan(situation(disc))
    assert plain.instances[0].gamma is None


# The ladder


def test_solved_where_no_barrier_is_touched() -> None:
    plan = planner().plan(situation([]))
    assert plan.outcome is Outcome.SOLVED
    assert plan.details is not None
    assert plan.details.feasible
    assert plan.details.decay == 1.0
    assert plan.details.violation_m2 == 0.0
    np.testing.assert_allclose(plan.poses, VEHICLE.roll_out(np.zeros(3), plan.inputs, 0.1))


def test_a_violation_that_keeps_the_distance_is_relaxed_with_its_size() -> None:
    # Past a disc with 0.3 m to spare, in one step's gamma faster than allowed.
    made, _ = told(constant(0.75), name="d-cbf-mpc")
    plan = made.plan(situation([(1.0, 1.0, 0.0, 0.0, 0.4)]))
    assert plan.outcome is Outcome.RELAXED
    assert plan.details is not None
    assert not plan.details.feasible
    x = 0.075 * np.arange(31)
    height = (x - 1.0) ** 2 + 1.0 - 0.81
    assert plan.details.violation_m2 == pytest.approx((0.9 * height[:-1] - height[1:]).max())


def test_hard_brakes_instead_of_relaxing_and_says_why() -> None:
    made, _ = told(constant(0.75), name="d-cbf-mpc", hard=True)
    plan = made.plan(situation([(1.0, 1.0, 0.0, 0.0, 0.4)]))
    assert plan.outcome is Outcome.BRAKED
    assert plan.details is not None
    assert plan.details.violation_m2 > 0.01
    np.testing.assert_allclose(plan.inputs[:2, 0], [0.75 - 1 / 30, 0.75 - 1 / 30 - 0.1])


def test_a_plan_into_an_obstacle_is_never_preferred_to_braking() -> None:
    made, _ = told(constant(0.75))
    plan = made.plan(situation([(1.5, 0.0, 0.0, 0.0, 0.4)]))
    assert plan.outcome is Outcome.BRAKED
    assert plan.details is not None
    assert plan.details.violation_m2 > 0.1, "what the plan would have done is still told"


def test_standing_without_a_plan_is_stopped() -> None:
    made, _ = told(constant(0.5, status="failed"))
    plan = made.plan(situation([], inputs=(0.0, 0.0)))
    assert plan.outcome is Outcome.STOPPED
    assert plan.details is not None
    assert plan.details.status == "failed"
    assert not plan.details.feasible
    assert (plan.inputs[:, 0] == 0).all()


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_inputs_that_are_not_finite_never_come_out(broken: float) -> None:
    for answer in (constant(broken), constant(0.5, merit=broken)):
        made, _ = told(answer)
        plan = made.plan(situation([], inputs=(0.4, 0.2)))
        assert plan.outcome is Outcome.BRAKED
        check(plan.inputs, np.array([0.4, 0.2]), VEHICLE, PLANNING)


def test_a_failed_step_leaves_no_stale_plan() -> None:
    made, solver = told(constant(0.7), constant(0.5, status="failed"))
    made.plan(situation([]))
    made.plan(situation([], stamp_ns=33_333_333))
    solver.guesses.clear()
    made.plan(situation([], stamp_ns=66_666_666))
    assert len(solver.guesses) == 1, "it starts from the path again"


def test_a_solver_beyond_the_limits_is_caught_and_counted() -> None:
    notes = Notes()
    made = make_planner("ad-cbf-mpc", VEHICLE, PLANNING, notes)
    assert isinstance(made, MpcPlanner)
    made._solver = Says(constant(7.0))
    plan = made.plan(situation([], inputs=(0.4, 0.0)))
    check(plan.inputs, np.array([0.4, 0.0]), VEHICLE, PLANNING)
    assert notes.counters == {"plans out of the vehicle's limits": 1}


def test_decay_is_a_relaxation_with_its_size() -> None:
    disc: Discs = [(1.2, 0.75, 0.0, 0.0, 0.4)]
    plan = planner("od-ad-cbf-mpc", decay_weight=1e-3).plan(situation(disc))
    assert plan.details is not None
    assert plan.details.decay < 1 - 1e-6
    assert plan.outcome is Outcome.RELAXED


def test_held_planners_do_not_see_what_comes() -> None:
    crossing: Discs = [(1.5, -1.9, 0.0, 1.0, 0.3)]
    blind = planner("a-cbf-mpc").plan(situation(crossing))
    seeing = planner("ad-cbf-mpc").plan(situation(crossing))
    free = planner("ad-cbf-mpc").plan(situation([]))
    np.testing.assert_allclose(blind.inputs, free.inputs, atol=1e-3)
    assert np.abs(seeing.inputs - free.inputs).max() > 0.05


def test_a_plan_depends_on_nothing_but_what_the_planner_was_told() -> None:
    disc: Discs = [(2.0, 0.1, 0.0, 0.0, 0.4)]
    plans = []
    for _ in range(2):
        made = planner()
        made.plan(situation(disc))
        plans.append(made.plan(situation(disc, stamp_ns=33_333_333)))
    np.testing.assert_array_equal(plans[0].inputs, plans[1].inputs)


def test_a_new_path_is_followed_from_its_own_nearest_point() -> None:
    made = planner()
    far = ReferencePath(np.array([[0.0, 0.0], [30.0, 0.0]]), 0.75)
    made.plan(Situation(0, np.array([25.0, 0.0, 0.0]), np.zeros(2), far, seen([])))
    plan = made.plan(situation([], stamp_ns=33_333_333, inputs=(0.0, 0.0)))
    assert plan.poses[-1, 0] > 1.0
    assert abs(plan.poses[-1, 1]) < 0.01


def test_of_several_laps_the_first_is_driven_first() -> None:
    """Two laps of a circle: where they lie on each other, the nearest point may be the second lap's."""
    turn = np.linspace(0.0, 4 * np.pi, 161)
    laps = ReferencePath(np.column_stack([2 * np.sin(turn), 2 - 2 * np.cos(turn)]), 0.75)
    _, along_m = pursuit.Progress().way(laps, np.array([0.0, 0.001, 0.0]))
    assert along_m < 0.1
    _, along_m = pursuit.Progress().way(laps, np.array([0.0, 4.0, np.pi]))
    assert along_m % (4 * np.pi) == pytest.approx(2 * np.pi, abs=0.1), "half a lap on: there it begins"


def test_the_problem_is_built_from_the_situation() -> None:
    made, solver = told(constant(0.5))
    made.plan(Situation(0, np.array([1.0, 0.3, 0.1]), np.array([0.5, 0.0]), STRAIGHT, seen([(3.0, 1.0, 0, 0, 0.4)])))
    instance = solver.instances[0]
    np.testing.assert_allclose(instance.reference[0, :4], [1.0, 0.0, 0.0, 0.75], atol=1e-9)
    np.testing.assert_allclose(instance.reference[10, 0], 1.75)
    np.testing.assert_allclose(instance.keep_out_m, 0.3 + 0.4 + 0.2)
    np.testing.assert_array_equal(instance.obstacle_radius_m, [0.4])
    problem: Problem = made._problem
    assert problem.first_step_s == pytest.approx(1 / 30)
