"""The fast solver against IPOPT, which is exact: how much worse its plans are, over random steps."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.planning.barrier import Barrier
from adcbf_cli.core.planning.solvers.ipopt import IpoptSolver
from adcbf_cli.core.planning.solvers.sqp import SqpSolver
from adcbf_cli.core.types import FloatArray
from tests.core.planning.instances import BARRIERS, KINDS, cruising, problem_of, random_instance


def gaps(barrier: Barrier, kind: str, count: int, first: int) -> FloatArray:
    """How much the fast solver's merit exceeds what IPOPT makes of its solution, relatively; at least 0.

    IPOPT starts there because from one guess two solvers may end in different minima, either being the better.
    """
    problem = problem_of(barrier, kind=kind)  # type: ignore[arg-type]
    fast, exact = SqpSolver(problem, 5, 10), IpoptSolver(problem)
    found = []
    for seed in range(first, first + count):
        instance = random_instance(problem, seed)
        one = fast.solve(instance, cruising(problem))
        other = exact.solve(instance, one.inputs)
        found.append(max(one.merit - other.merit, 0.0) / max(other.merit, 1e-3))
    return np.array(found)


@pytest.mark.parametrize("kind", KINDS)
def test_solutions_are_minima(kind: str) -> None:
    gap = gaps(BARRIERS["adaptive"], kind, 100, 1000)
    assert np.median(gap) < 1e-4
    assert np.quantile(gap, 0.95) < 1e-2


@pytest.mark.parametrize("name", BARRIERS)
def test_with_every_barrier_they_are(name: str) -> None:
    gap = gaps(BARRIERS[name], "unicycle", 20, 2000)
    assert np.median(gap) < 1e-4
    assert np.quantile(gap, 0.8) < 1e-2


def test_from_the_same_guess_minima_are_as_good_on_average() -> None:
    """Each may find the better minimum; neither does so much more often."""
    problem = problem_of(BARRIERS["adaptive"])
    fast, exact = SqpSolver(problem, 5, 10), IpoptSolver(problem)
    better = []
    for seed in range(3000, 3100):
        instance = random_instance(problem, seed)
        one, other = fast.solve(instance, cruising(problem)), exact.solve(instance, cruising(problem))
        better.append((one.merit - other.merit) / other.merit)
    assert np.median(np.abs(better)) < 1e-4
    assert np.mean(np.array(better) > 0.01) < 0.1
