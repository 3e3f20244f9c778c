"""IPOPT and FATROP: they agree, keep the limits, and never lose their heads."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.planning.barrier import AdaptiveGamma, Barrier, FixedGamma
from adcbf_cli.core.planning.merit import barrier_rows, merit
from adcbf_cli.core.planning.problem import Instance, Problem, SolverStatus
from adcbf_cli.core.planning.solvers.base import make_solver
from adcbf_cli.core.planning.solvers.fatrop import FatropSolver
from adcbf_cli.core.planning.solvers.ipopt import IpoptSolver
from adcbf_cli.core.types import FloatArray
from tests.core.planning.instances import (
    BARRIERS,
    KINDS,
    cruising,
    instance_of,
    problem_of,
    random_instance,
)

ORACLES = {"ipopt": IpoptSolver, "fatrop": FatropSolver}
both = pytest.mark.parametrize("oracle", ORACLES.values(), ids=ORACLES)


def assert_within_limits(problem: Problem, instance: Instance, inputs: FloatArray) -> None:
    allowed = problem.vehicle.within_limits(inputs, instance.last_inputs, problem.step_s, problem.first_step_s)
    np.testing.assert_allclose(inputs, allowed, atol=1e-12)


@pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_oracles_agree(barrier: Barrier, kind: str) -> None:
    """Two methods, one program: nine in ten times the same minimum to 1e-5. In a cluttered place either
    may, from the same guess, find another one."""
    problem = problem_of(barrier, kind=kind)  # type: ignore[arg-type]
    ipopt, fatrop = IpoptSolver(problem), FatropSolver(problem)
    same = []
    for seed in range(12):
        instance = random_instance(problem, 300 + seed)
        first, second = ipopt.solve(instance, cruising(problem)), fatrop.solve(instance, cruising(problem))
        for found in (first, second):
            assert found.status is SolverStatus.CONVERGED
            assert found.merit == merit(problem, instance, found.inputs)
            assert_within_limits(problem, instance, found.inputs)
        same.append(second.merit == pytest.approx(first.merit, rel=1e-5, abs=1e-5))
    assert np.mean(same) >= 0.9


@both
def test_a_minimum_cannot_be_improved_nearby(oracle: type[IpoptSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance = random_instance(problem, 320)
    found = oracle(problem).solve(instance, cruising(problem))
    rng = np.random.default_rng(0)
    for size in (1e-4, 1e-3, 1e-2):
        for _ in range(100):
            wanted = found.inputs + rng.normal(0.0, size, found.inputs.shape)
            near = problem.vehicle.within_limits(wanted, instance.last_inputs, problem.step_s, problem.first_step_s)
            assert merit(problem, instance, near) >= found.merit - 1e-6


@both
def test_without_obstacles_it_drives_along_the_reference(oracle: type[IpoptSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    found = oracle(problem).solve(instance_of(problem, []), np.zeros((problem.steps, 2)))
    assert found.status is SolverStatus.CONVERGED
    np.testing.assert_allclose(found.inputs, cruising(problem), atol=1e-3)


@both
def test_a_big_obstacle_far_enough_ahead_is_kept_clear_of(oracle: type[IpoptSolver]) -> None:
    """r = 1.0 m, slightly aside: the plan holds every barrier without slack."""
    problem = problem_of(Barrier(AdaptiveGamma()), steps=30)
    instance = instance_of(problem, [(3.5, 0.2, 0, 0, 1.0)])
    found = oracle(problem).solve(instance, cruising(problem))
    rows = barrier_rows(problem, instance, found.inputs)
    assert found.status is SolverStatus.CONVERGED
    assert rows.slack_m2.max() < 1e-6
    assert rows.barrier_m2.min() > 0
    assert barrier_rows(problem, instance, cruising(problem)).slack_m2.max() > 0.1


@both
def test_gamma_one_only_keeps_the_distance(oracle: type[IpoptSolver]) -> None:
    """MPC-DC comes as close as R allows, where a small gamma keeps farther away."""
    smallest = {}
    for gamma in (1.0, 0.05):
        problem = problem_of(Barrier(FixedGamma(gamma)), steps=30)
        instance = instance_of(problem, [(1.8, 0.15, 0, 0, 0.3)])
        found = oracle(problem).solve(instance, cruising(problem))
        smallest[gamma] = barrier_rows(problem, instance, found.inputs).barrier_m2.min()
    assert smallest[1.0] == pytest.approx(0.0, abs=1e-5)
    assert smallest[0.05] > 0.1


@both
def test_a_start_within_the_margin_costs_slack_and_succeeds(oracle: type[IpoptSolver]) -> None:
    """The disc is 0.2 m too close and comes nearer: no input can hold the barrier, and the least violation
    is found."""
    problem = problem_of(BARRIERS["adaptive"])
    instance = instance_of(problem, [(0.6, 0.0, -0.8, 0.0, 0.3)])
    found = oracle(problem).solve(instance, cruising(problem))
    assert found.status is SolverStatus.CONVERGED
    rows = barrier_rows(problem, instance, found.inputs)
    assert rows.slack_m2.max() > 1e-3
    assert found.merit < merit(problem, instance, cruising(problem))


@both
def test_decay_is_used_before_slack(oracle: type[IpoptSolver]) -> None:
    """The disc comes too fast for gamma = 0.05, but stays away: decay bends the barrier, nothing breaks it."""
    plain = problem_of(Barrier(FixedGamma(0.05)))
    bent = problem_of(Barrier(FixedGamma(0.05), decay_weight=10.0))
    instance = instance_of(plain, [(3.0, 0.0, -0.9, 0.0, 0.2)])
    strict = barrier_rows(plain, instance, oracle(plain).solve(instance, cruising(plain)).inputs)
    relaxed = barrier_rows(bent, instance, oracle(bent).solve(instance, cruising(bent)).inputs)
    assert strict.slack_m2.max() > 1e-3
    assert relaxed.decay.min() < 1 - 1e-3
    assert relaxed.slack_m2.max() < 1e-6


OUT_OF_BOUNDS = {"too fast": (1.4, 0.0), "backwards": (-0.3, 0.2), "turning too fast": (0.5, 1.6)}


@both
@pytest.mark.parametrize("last", OUT_OF_BOUNDS.values(), ids=OUT_OF_BOUNDS)
def test_from_out_of_bounds_the_way_back_is_the_fastest(oracle: type[IpoptSolver], last: tuple[float, float]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance = instance_of(problem, [(2.0, 0.3, 0, 0, 0.3)], last=last)
    found = oracle(problem).solve(instance, cruising(problem))
    assert found.status is SolverStatus.CONVERGED
    assert_within_limits(problem, instance, found.inputs)
    first = problem.vehicle.limited(problem.vehicle.input_max, np.array(last), problem.first_step_s)
    lowest = problem.vehicle.limited(problem.vehicle.input_min, np.array(last), problem.first_step_s)
    assert (found.inputs[0] >= lowest - 1e-9).all()
    assert (found.inputs[0] <= first + 1e-9).all()


@both
def test_a_guess_out_of_limits_is_brought_in(oracle: type[IpoptSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance = random_instance(problem, 330)
    wild = np.random.default_rng(1).normal(0.0, 30.0, (problem.steps, 2))
    assert_within_limits(problem, instance, oracle(problem).solve(instance, wild).inputs)


@both
def test_what_is_not_finite_fails_and_nothing_is_raised(oracle: type[IpoptSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance, guess = random_instance(problem, 331), cruising(problem)
    solver = oracle(problem)
    broken = instance.obstacle_m.copy()
    broken[2, 3] = np.nan
    assert solver.solve(dataclasses.replace(instance, obstacle_m=broken), guess).status is SolverStatus.FAILED
    holed = guess.copy()
    holed[4, 1] = np.inf
    failed = solver.solve(instance, holed)
    assert failed.status is SolverStatus.FAILED
    np.testing.assert_array_equal(failed.inputs, holed)
    assert solver.solve(instance, guess).status is SolverStatus.CONVERGED


@both
def test_nothing_is_remembered_between_solves(oracle: type[IpoptSolver]) -> None:
    """Numbers of obstacles within one bucket, and last inputs in and out of bounds, in turn: each plan is
    that of a new solver."""
    problem = problem_of(BARRIERS["optimal decay"])
    used, guess = oracle(problem), cruising(problem)
    for seed, (obstacles, speed) in enumerate([(1, 0.5), (4, 1.3), (2, 0.9), (3, 1.03), (4, 0.2), (1, -0.01)]):
        instance = random_instance(problem, 340 + seed, obstacles)
        instance = dataclasses.replace(instance, last_inputs=np.array([speed, 0.1]))
        again, fresh = used.solve(instance, guess), oracle(problem).solve(instance, guess)
        assert again.status is fresh.status is SolverStatus.CONVERGED
        np.testing.assert_array_equal(again.inputs, fresh.inputs)


@both
def test_on_an_obstacles_centre_it_still_answers(oracle: type[IpoptSolver]) -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance = instance_of(problem, [(0.0, 0.0, 0.0, 0.0, 0.4)], last=(0.0, 0.0))
    found = oracle(problem).solve(instance, np.zeros((problem.steps, 2)))
    assert found.status is not SolverStatus.FAILED
    assert np.isfinite(found.merit)


@both
def test_one_solver_takes_any_number_of_obstacles_in_silence(
    oracle: type[IpoptSolver], capfd: pytest.CaptureFixture[str]
) -> None:
    """A program for each bucket; with one obstacle more, far behind, the plan stays the same."""
    problem = problem_of(BARRIERS["optimal decay"], steps=10)
    solver, guess = oracle(problem), cruising(problem)
    near = [(1.8, 0.3, 0, 0, 0.3), (2.5, -0.8, 0, 0.1, 0.2), (3.0, 1.0, 0, 0, 0.3), (1.5, -1.6, 0, 0, 0.3)]
    merits = []
    for behind in range(6):
        far = [(-30.0 - i, 0.0, 0.0, 0.0, 0.2) for i in range(behind)]
        found = solver.solve(instance_of(problem, near + far), guess)
        assert found.status is SolverStatus.CONVERGED
        merits.append(found.merit)
    np.testing.assert_allclose(merits, merits[0], rtol=1e-6)
    printed = capfd.readouterr()
    assert printed.out == ""
    assert printed.err == ""


@both
@pytest.mark.parametrize("steps", [2, 3, 40])
def test_any_horizon(oracle: type[IpoptSolver], steps: int) -> None:
    """Also with more barrier stages asked for than there are stages."""
    problem = problem_of(Barrier(FixedGamma(0.2), steps=30), steps=steps)
    instance = instance_of(problem, [(1.2, 0.1, 0, 0, 0.3)])
    found = oracle(problem).solve(instance, cruising(problem))
    assert found.status is SolverStatus.CONVERGED
    assert found.inputs.shape == (steps, 2)
    assert found.merit < merit(problem, instance, cruising(problem))


def test_solvers_are_found_by_name() -> None:
    problem = problem_of(BARRIERS["adaptive"])
    for name, kind in ORACLES.items():
        solver, note = make_solver(name, problem, 5, 10)
        assert isinstance(solver, kind)
        assert note is None
    with pytest.raises(UsageError, match=r"no solver is called 'snopt'.*sqp, piqp, ipopt, fatrop"):
        make_solver("snopt", problem, 5, 10)


def test_sqp_without_numba_is_piqp_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    solver, note = make_solver("sqp", problem_of(BARRIERS["adaptive"]), 5, 10)
    assert type(solver).__name__ == "PiqpSolver"
    assert note is not None
    assert "Numba cannot be imported" in note
