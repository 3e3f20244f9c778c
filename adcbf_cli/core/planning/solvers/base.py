"""What every solver is, and finding one by name."""

from __future__ import annotations

import importlib
from typing import Protocol

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.planning.problem import Instance, Problem, Solution
from adcbf_cli.core.types import FloatArray

SOLVERS = ("sqp", "piqp", "ipopt", "fatrop")


class Solver(Protocol):
    """Built for one `Problem`. The same instance and guess give the same solution: nothing is remembered."""

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        """Improve the inputs `guess` (N, 2), which need not be within limits. Never raises because a
        solve failed: that is the solution's status."""
        ...


def has_numba() -> bool:
    """Whether Numba is installed and fits the Python and numpy that run."""
    try:
        importlib.import_module("numba")
    except ImportError:
        return False
    return True


def make_solver(name: str, problem: Problem, min_iterations: int, max_iterations: int) -> tuple[Solver, str | None]:
    """The solver called `name` and, where another one had to take its place, a note that says so.

    min_iterations, max_iterations: of sqp and piqp; ipopt and fatrop run until they have converged.
    Raises UsageError for an unknown name.
    """
    if name == "sqp" and not has_numba():
        solver, _ = make_solver("piqp", problem, min_iterations, max_iterations)
        return solver, "Numba cannot be imported: piqp takes the place of the solver sqp, and is slower"
    if name == "sqp":
        from adcbf_cli.core.planning.solvers.sqp import SqpSolver

        return SqpSolver(problem, min_iterations, max_iterations), None
    if name == "piqp":
        from adcbf_cli.core.planning.solvers.piqp_qp import PiqpSolver

        return PiqpSolver(problem, min_iterations, max_iterations), None
    if name == "ipopt":
        from adcbf_cli.core.planning.solvers.ipopt import IpoptSolver

        return IpoptSolver(problem), None
    if name == "fatrop":
        from adcbf_cli.core.planning.solvers.fatrop import FatropSolver

        return FatropSolver(problem), None
    raise UsageError(f"no solver is called {name!r}; there are {', '.join(SOLVERS)}")
