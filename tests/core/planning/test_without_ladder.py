"""`planning.fallback=none`: the solver's plan is driven whatever it is, and told for what it is."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.planning.planner import Outcome
from adcbf_cli.core.planning.problem import Solution, SolverStatus
from tests.core.planning.hard_cases import check
from tests.core.planning.told import PLANNING, VEHICLE, Discs, constant, planner, situation, told


@pytest.mark.parametrize("hard", [False, True])
def test_a_plan_into_an_obstacle_is_driven_and_told(hard: bool) -> None:
    into: Discs = [(1.5, 0.0, 0.0, 0.0, 0.4)]
    made, _ = told(constant(0.75), fallback="none", hard=hard)
    plan = made.plan(situation(into))
    assert plan.outcome is Outcome.RELAXED
    assert plan.details is not None
    assert plan.details.violation_m2 > 0.1
    assert not plan.details.feasible
    np.testing.assert_array_equal(plan.inputs, np.tile([0.75, 0.0], (30, 1)))
    braked, _ = told(constant(0.75), hard=hard)
    assert braked.plan(situation(into)).outcome is Outcome.BRAKED


def test_the_last_plan_goes_on_where_nothing_is_solved() -> None:
    ramp = Solution(np.column_stack([np.full(30, 0.7), 0.01 * np.arange(30)]), SolverStatus.CONVERGED, 3, 1.0)
    failed = constant(0.1, status="failed")
    made, _ = told(ramp, failed, fallback="none")
    made.plan(situation([], inputs=(0.7, 0.0)))
    disc: Discs = [(1.5, 0.0, 0.0, 0.0, 0.4)]
    for stamp_ns in (50_000_000, 250_000_000):
        turn = stamp_ns * 1e-10
        plan = made.plan(situation(disc, inputs=(0.7, turn), stamp_ns=stamp_ns))
        np.testing.assert_allclose(plan.inputs[:3], [[0.7, turn + 0.01 * k] for k in range(3)], atol=1e-12)
        assert plan.outcome is Outcome.RELAXED
        assert plan.details is not None
        assert (plan.details.status, plan.details.start, plan.details.feasible) == ("failed", "shifted", False)
        assert plan.details.violation_m2 > 0.1, "what it leads to is told"
        assert plan.details.merit > 100


def test_inputs_are_held_where_there_is_no_last_plan() -> None:
    for stamps in ((0,), (0, 3_000_000_000)):
        made, _ = told(*([constant(0.6)] * (len(stamps) - 1)), constant(0.1, status="failed"), fallback="none")
        for stamp_ns in stamps:
            plan = made.plan(situation([], inputs=(0.4, 0.2), stamp_ns=stamp_ns))
        np.testing.assert_array_equal(plan.inputs, np.tile([0.4, 0.2], (30, 1)))
        np.testing.assert_allclose(plan.poses, VEHICLE.roll_out(np.zeros(3), plan.inputs, 0.1))
        assert plan.outcome is Outcome.RELAXED, "it does not brake"
        assert plan.details is not None
        assert (plan.details.start, plan.details.feasible) == ("held", False)


def test_standing_without_a_plan_is_stopped() -> None:
    made, _ = told(constant(np.nan), fallback="none")
    plan = made.plan(situation([], inputs=(0.0, 0.0)))
    assert plan.outcome is Outcome.STOPPED
    assert not plan.inputs.any()


def test_plans_stay_finite_and_within_limits() -> None:
    made, _ = told(constant(7.0), constant(np.inf), constant(0.5, merit=np.nan), fallback="none")
    last = np.array([0.4, -0.5])
    for tick in range(4):
        plan = made.plan(situation([(0.5, 0.1, 0.0, 0.0, 0.4)], inputs=tuple(last), stamp_ns=tick * 33_333_333))
        check(plan.inputs, last, VEHICLE, PLANNING)
        assert plan.outcome is Outcome.RELAXED
        last = plan.inputs[0]


def test_where_every_barrier_holds_the_ladder_changes_nothing() -> None:
    disc: Discs = [(2.0, 0.3, 0.0, 0.0, 0.4)]
    with_ladder, without = planner().plan(situation(disc)), planner(fallback="none").plan(situation(disc))
    assert with_ladder.outcome is without.outcome is Outcome.SOLVED
    np.testing.assert_array_equal(with_ladder.inputs, without.inputs)
