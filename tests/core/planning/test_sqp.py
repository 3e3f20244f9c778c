"""The fast solver: limits, progress, failure, special barriers, and its twin without a compiler."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adcbf_cli.core.planning.barrier import AdaptiveGamma, Barrier, FixedGamma
from adcbf_cli.core.planning.merit import barrier_rows, merit
from adcbf_cli.core.planning.problem import Instance, Problem, SolverStatus
from adcbf_cli.core.planning.solvers.piqp_qp import PiqpSolver
from adcbf_cli.core.planning.solvers.sqp import SqpSolver
from adcbf_cli.core.types import FloatArray
from tests.core.planning.instances import (
    BARRIERS,
    KINDS,
    cruising,
    instance_of,
    problem_of,
    random_instance,
)

barriers = pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
kinds = pytest.mark.parametrize("kind", KINDS)
SOLVERS = {"sqp": SqpSolver, "piqp": PiqpSolver}
both = pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS)


def assert_within_limits(problem: Problem, instance: Instance, inputs: FloatArray) -> None:
    allowed = problem.vehicle.within_limits(inputs, instance.last_inputs, problem.step_s, problem.first_step_s)
    np.testing.assert_allclose(inputs, allowed, rtol=0, atol=1e-12)


@kinds
@barriers
def test_limits_are_kept_and_the_merit_falls_whatever_comes(barrier: Barrier, kind: str) -> None:
    """Guesses and last inputs out of bounds, obstacles on top of the vehicle, many, none."""
    problem = problem_of(barrier, kind=kind)  # type: ignore[arg-type]
    solver = SqpSolver(problem, 1, 4)
    rng = np.random.default_rng(11)
    for seed in range(25):
        instance = random_instance(problem, seed, obstacles=int(rng.integers(0, 14)), nearest_m=rng.choice([0.05, 1.3]))
        instance = replace(instance, last_inputs=instance.last_inputs + rng.normal(0.0, 1.0, 2) * (seed % 3 == 0))
        guess = rng.normal(0.0, 1.0, (problem.steps, 2))
        found = solver.solve(instance, guess)
        assert found.status is not SolverStatus.FAILED
        assert_within_limits(problem, instance, found.inputs)
        assert found.merit == pytest.approx(merit(problem, instance, found.inputs), rel=1e-12)
        start = problem.vehicle.within_limits(guess, instance.last_inputs, problem.step_s, problem.first_step_s)
        assert found.merit <= merit(problem, instance, start) * (1 + 1e-3)


def test_a_solution_does_not_depend_on_what_was_solved_before() -> None:
    """What is kept of an instance serves that instance only, and one that is not finite spoils no other."""
    problem = problem_of(BARRIERS["adaptive"])
    solver = SqpSolver(problem, 3, 5)
    instances = [random_instance(problem, seed, obstacles=1 + seed) for seed in range(4)]
    broken = replace(instances[1], pose=np.array([np.nan, 0.0, 0.0]))
    for instance in (instances[0], instances[1], broken, instances[1], instances[2], instances[0], instances[3]):
        for guess in (cruising(problem), np.zeros((problem.steps, 2))):
            found, fresh = solver.solve(instance, guess), SqpSolver(problem, 3, 5).solve(instance, guess)
            np.testing.assert_array_equal(found.inputs, fresh.inputs)
            assert found.status is fresh.status
            assert (found.status is SolverStatus.FAILED) == (instance is broken)


@kinds
@barriers
def test_with_and_without_a_compiler_solutions_are_equal(barrier: Barrier, kind: str) -> None:
    """Programmes are solved to different precision, so that in a tie each may take another side: one in ten."""
    problem = problem_of(barrier, kind=kind)  # type: ignore[arg-type]
    compiled, plain = SqpSolver(problem, 5, 30), PiqpSolver(problem, 5, 30)
    same = []
    for seed in range(10):
        instance = random_instance(problem, 50 + seed, obstacles=4)
        one, other = compiled.solve(instance, cruising(problem)), plain.solve(instance, cruising(problem))
        assert_within_limits(problem, instance, other.inputs)
        same.append(one.merit == pytest.approx(other.merit, rel=1e-4, abs=1e-4))
    assert np.mean(same) >= 0.9


@both
def test_what_is_not_finite_fails_and_leaves_the_guess_alone(solver: type[SqpSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance, guess = random_instance(problem, 0), cruising(problem)
    spoiled = instance.obstacle_m.copy()
    spoiled[2, 7, 1] = np.nan
    for bad in (
        replace(instance, pose=np.array([0.0, np.inf, 0.0])),
        replace(instance, obstacle_m=spoiled),
        replace(instance, pose=np.array([1e200, 0.0, 0.0])),  # its square is not finite
    ):
        found = solver(problem, 5, 10).solve(bad, guess)
        assert found.status is SolverStatus.FAILED
        np.testing.assert_array_equal(found.inputs, guess)
    empty = guess.copy()
    empty[4] = np.nan
    assert solver(problem, 5, 10).solve(instance, empty).status is SolverStatus.FAILED


@both
def test_the_guess_is_not_written_to(solver: type[SqpSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    guess = cruising(problem)
    solver(problem, 5, 10).solve(random_instance(problem, 1), guess)
    np.testing.assert_array_equal(guess, cruising(problem))


def test_the_same_step_gives_the_same_bytes() -> None:
    problem = problem_of(BARRIERS["optimal decay"])
    solver = SqpSolver(problem, 5, 10)
    first, again = (solver.solve(random_instance(problem, 3), cruising(problem)) for _ in range(2))
    assert first.inputs.tobytes() == again.inputs.tobytes()


@both
def test_without_obstacles_on_the_path_nothing_needs_to_change(solver: type[SqpSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance = instance_of(problem, [])
    found = solver(problem, 5, 10).solve(instance, cruising(problem))
    np.testing.assert_allclose(found.inputs, cruising(problem), atol=1e-3)
    assert found.merit < 1e-6


def test_iterations_are_at_least_and_at_most_what_was_asked() -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance = instance_of(problem, [(1.2, 0.1, 0.0, 0.0, 0.3)])
    once = SqpSolver(problem, 1, 1).solve(instance, cruising(problem))
    assert once.iterations == 1
    assert once.status is SolverStatus.ITERATION_LIMIT
    settled = SqpSolver(problem, 6, 60).solve(instance, cruising(problem))
    assert 6 <= settled.iterations < 60
    assert settled.status is SolverStatus.CONVERGED
    assert settled.merit < once.merit < merit(problem, instance, cruising(problem))


@kinds
def test_a_distance_constraint_stops_where_the_distance_is_reached(kind: str) -> None:
    """gamma = 1 is MPC-DC: a wall-like disc ahead, 1.25 m to its keep-out circle, may be approached up to it."""
    problem = problem_of(Barrier(FixedGamma(1.0)), steps=30, kind=kind)  # type: ignore[arg-type]
    instance = instance_of(problem, [(6.75, 0.0, 0.0, 0.0, 5.0)])
    found = SqpSolver(problem, 5, 60).solve(instance, cruising(problem))
    rows = barrier_rows(problem, instance, found.inputs)
    assert rows.slack_m2.max() < 1e-4
    assert 0.0 <= rows.barrier_m2.min() < 0.5  # 0.5 m^2 is 5 cm from a circle of 5 m


def test_a_smaller_gamma_keeps_farther_away() -> None:
    """And the adaptive one is less than 1 near the obstacle."""
    nearest = {}
    for name, gamma in {"1": FixedGamma(1.0), "0.1": FixedGamma(0.1), "adaptive": AdaptiveGamma()}.items():
        problem = problem_of(Barrier(gamma), steps=30)
        instance = instance_of(problem, [(2.2, 0.05, 0.0, 0.0, 0.4)])
        found = SqpSolver(problem, 5, 60).solve(instance, cruising(problem))
        nearest[name] = barrier_rows(problem, instance, found.inputs).barrier_m2.min()
    assert nearest["0.1"] > nearest["1"] + 0.05
    assert nearest["adaptive"] > nearest["1"] + 0.05


@both
def test_a_cheap_decay_is_used_before_slack(solver: type[SqpSolver]) -> None:
    instance = instance_of(problem_of(BARRIERS["fixed"]), [(1.7, 0.0, 0.0, 0.0, 0.4)])
    merits = []
    for decay_weight in (0.1, 10.0, None):
        problem = problem_of(Barrier(FixedGamma(0.02), decay_weight=decay_weight))
        found = solver(problem, 5, 40).solve(instance, cruising(problem))
        rows = barrier_rows(problem, instance, found.inputs)
        if decay_weight == 0.1:
            assert rows.decay.min() < 0.95
            assert rows.slack_m2.max() < 1e-6
        merits.append(found.merit)
    assert merits[0] < merits[1] < merits[2]


@both
def test_within_the_keep_out_circle_it_leaves_instead_of_failing(solver: type[SqpSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance = instance_of(problem, [(0.0, 0.6, 0.0, 0.0, 0.3)])
    found = solver(problem, 5, 20).solve(instance, cruising(problem))
    height = barrier_rows(problem, instance, found.inputs).barrier_m2[:, 0]
    assert found.status is not SolverStatus.FAILED
    assert height[0] < 0 < height[-1]


@both
def test_exactly_in_line_with_an_obstacle_it_takes_a_side(solver: type[SqpSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"], steps=30)
    instance = instance_of(problem, [(1.9, 0.0, 0.0, 0.0, 0.3)])
    found = solver(problem, 5, 40).solve(instance, cruising(problem))
    poses = problem.vehicle.roll_out(instance.pose, found.inputs, problem.step_s)
    assert np.abs(poses[:, 1]).max() > 0.1


def test_where_the_world_lies_does_not_matter() -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance = random_instance(problem, 8)
    turn, shift = 0.7, np.array([12.0, -5.0])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    reference = instance.reference.copy()
    reference[:, :2] = reference[:, :2] @ rotation.T + shift
    reference[:, 2] += turn
    moved = replace(
        instance,
        pose=np.append(rotation @ instance.pose[:2] + shift, instance.pose[2] + turn),
        reference=reference,
        obstacle_m=instance.obstacle_m @ rotation.T + shift,
    )
    solver = SqpSolver(problem, 5, 30)
    here, there = solver.solve(instance, cruising(problem)), solver.solve(moved, cruising(problem))
    assert there.merit == pytest.approx(here.merit, rel=1e-6)
    np.testing.assert_allclose(there.inputs, here.inputs, atol=1e-3)
