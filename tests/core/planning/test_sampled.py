"""Sampled starts: within the limits, ranked by merit, tried only where the usual ones are stuck."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.planning.barrier import AdaptiveGamma, Barrier, FixedGamma
from adcbf_cli.core.planning.columns import columns_of
from adcbf_cli.core.planning.merit import merit, merits
from adcbf_cli.core.planning.mpc import problem_of
from adcbf_cli.core.planning.problem import Instance, Problem
from adcbf_cli.core.planning.sampled import APART_M, sampled_starts
from tests.core.planning.told import PLANNING, VEHICLE, Discs, constant, seen, situation, told


def scene(discs: Discs, barrier: Barrier | None = None) -> tuple[Problem, Instance]:
    """Driving along x at 0.75 m/s, with these discs."""
    problem = problem_of(VEHICLE, PLANNING, barrier or Barrier(AdaptiveGamma()))
    columns = columns_of(seen(discs), "predicted", 0.5, 0.0)
    along = 0.75 * problem.step_s * np.arange(problem.steps + 1)
    reference = np.column_stack([along, *np.zeros((2, 31)), np.full(31, 0.75), np.zeros(31)])
    last = np.array([0.75, 0.1])
    return problem, Instance(np.zeros(3), last, reference, columns.centre_m, columns.radius_m, columns.keep_out_m)


@pytest.mark.parametrize("barrier", [Barrier(AdaptiveGamma()), Barrier(FixedGamma(0.1), decay_weight=10.0)])
def test_many_merits_at_once_are_each_ones_own(barrier: Barrier) -> None:
    problem, instance = scene([(2.0, 0.1, -0.5, 0.0, 0.4), (1.0, 1.2, 0.0, 0.0, 0.2)], barrier)
    inputs = np.random.default_rng(0).uniform([0.0, -1.0], [1.0, 1.0], (7, 30, 2))
    poses, worth = merits(problem, instance, inputs)
    np.testing.assert_allclose(worth, [merit(problem, instance, way) for way in inputs], rtol=1e-12)
    np.testing.assert_allclose(poses[3], VEHICLE.roll_out(np.zeros(3), inputs[3], 0.1), atol=1e-12)


def test_starts_are_within_the_limits_apart_and_the_best_first() -> None:
    problem, instance = scene([(2.0, 0.0, -1.0, 0.0, 0.4)])
    found = sampled_starts(problem, instance, 4)
    assert len(found) == 4
    for way in found:
        np.testing.assert_array_equal(VEHICLE.within_limits(way, instance.last_inputs, 0.1, problem.first_step_s), way)
    worth = [merit(problem, instance, way) for way in found]
    assert worth == sorted(worth)
    ends = np.array([VEHICLE.roll_out(np.zeros(3), way, 0.1)[-1, :2] for way in found])
    gaps = np.hypot(*(ends[:, None] - ends).transpose(2, 0, 1))
    assert gaps[np.triu_indices(4, 1)].min() > APART_M


def test_the_best_way_goes_round_what_stands_on_the_path() -> None:
    problem, instance = scene([(3.0, 0.2, 0.0, 0.0, 0.4)])
    straight = np.tile([0.75, 0.0], (30, 1))
    best = sampled_starts(problem, instance, 1)[0]
    assert merit(problem, instance, best) < 0.2 * merit(problem, instance, straight)
    assert abs(VEHICLE.roll_out(np.zeros(3), best, 0.1)[-1, 1]) > 0.7


def test_they_are_tried_where_a_plan_violates_or_stands_and_not_else() -> None:
    free, solver = told(constant(0.7))
    free.plan(situation([]))
    assert len(solver.guesses) == 1
    ahead: Discs = [(1.2, 0.0, 0.0, 0.0, 0.4)]
    into, solver = told(constant(0.7))
    into.plan(situation(ahead))
    assert len(solver.guesses) == 3, "the path, and two sampled ways"
    standing, solver = told(constant(0.1))
    standing.plan(situation([]))
    assert len(solver.guesses) == 3
    never, solver = told(constant(0.7), starts=2)
    never.plan(situation(ahead))
    assert len(solver.guesses) == 1


def test_the_plan_says_where_it_came_from() -> None:
    made, _ = told(constant(0.1, merit=9.0), constant(0.6, merit=2.0), constant(0.2, merit=3.0))
    plan = made.plan(situation([]))
    assert plan.details is not None
    assert plan.details.start == "sampled"
    assert plan.inputs[10, 0] == pytest.approx(0.6)
