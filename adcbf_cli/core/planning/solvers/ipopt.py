"""IPOPT on the exact problem: the oracle. Multiple shooting, exact Hessian, converged to 1e-8."""

from __future__ import annotations

from typing import Any

from adcbf_cli.core.planning.ocp import Ocp
from adcbf_cli.core.planning.solvers.program import ProgramSolver, first_barrier_parameter

TOLERANCE = 1e-8
MAX_ITERATIONS = 500


class IpoptSolver(ProgramSolver):
    """See `Solver`."""

    plugin = "ipopt"
    converged = ("Solve_Succeeded", "Solved_To_Acceptable_Level")

    def options(self, ocp: Ocp) -> dict[str, Any]:
        """Silent, and from far outside the constraints."""
        ipopt = {
            "print_level": 0,
            "sb": "yes",
            "tol": TOLERANCE,
            "max_iter": MAX_ITERATIONS,
            "mu_init": first_barrier_parameter(self.problem),
        }
        return {"ipopt": ipopt}
