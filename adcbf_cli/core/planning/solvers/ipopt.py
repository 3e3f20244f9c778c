"""IPOPT on the exact problem: the oracle. Multiple shooting, exact Hessian, converged to 1e-8."""

from __future__ import annotations

from typing import Any

import casadi as ca

from adcbf_cli.core.planning.ocp import Ocp, bucket, build
from adcbf_cli.core.planning.problem import Instance, Problem, Solution
from adcbf_cli.core.planning.solvers.program import first_barrier_parameter, solve_program
from adcbf_cli.core.types import FloatArray

CONVERGED = ("Solve_Succeeded", "Solved_To_Acceptable_Level")
MAX_ITERATIONS = 500


class IpoptSolver:
    """One program for each bucket of obstacle slots, built when first needed."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._built: dict[int, tuple[Ocp, ca.Function]] = {}

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        """See `Solver.solve`."""
        slots = bucket(len(instance))
        if slots not in self._built:
            ocp = build(self._problem, slots)
            self._built[slots] = (ocp, ca.nlpsol("plan", "ipopt", ocp.nlp, self._options()))
        ocp, solver = self._built[slots]
        return solve_program(ocp, solver, instance, guess, CONVERGED)

    def _options(self) -> dict[str, Any]:
        ipopt = {
            "print_level": 0,
            "sb": "yes",
            "tol": 1e-8,
            "max_iter": MAX_ITERATIONS,
            "mu_init": first_barrier_parameter(self._problem),
        }
        return {"print_time": False, "error_on_fail": False, "ipopt": ipopt}
