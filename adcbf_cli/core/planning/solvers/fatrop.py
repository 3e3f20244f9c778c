"""FATROP on the same program: the second oracle, which uses the order of its stages."""

from __future__ import annotations

from typing import Any

import casadi as ca

from adcbf_cli.core.planning.ocp import Ocp, bucket, build
from adcbf_cli.core.planning.problem import Instance, Problem, Solution
from adcbf_cli.core.planning.solvers.program import first_barrier_parameter, solve_program
from adcbf_cli.core.types import FloatArray

CONVERGED = ("0",)
"""FATROP's return status is a number."""

TOLERANCE = 1e-6
"""At 1e-8 a third of the solves end in rounding errors without having met it, at the same plan."""

MAX_ITERATIONS = 500


class FatropSolver:
    """One program for each bucket of obstacle slots, built when first needed."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._built: dict[int, tuple[Ocp, ca.Function]] = {}

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        """See `Solver.solve`."""
        slots = bucket(len(instance))
        if slots not in self._built:
            ocp = build(self._problem, slots)
            self._built[slots] = (ocp, ca.nlpsol("plan", "fatrop", ocp.nlp, self._options(ocp)))
        ocp, solver = self._built[slots]
        return solve_program(ocp, solver, instance, guess, CONVERGED)

    def _options(self, ocp: Ocp) -> dict[str, Any]:
        fatrop = {
            "print_level": 0,
            "tol": TOLERANCE,
            "max_iter": MAX_ITERATIONS,
            "mu_init": first_barrier_parameter(self._problem),
        }
        return {
            "print_time": False,
            "error_on_fail": False,
            "structure_detection": "manual",
            "N": self._problem.steps,
            "nx": ocp.states,
            "nu": ocp.controls,
            "ng": ocp.rows,
            "equality": ocp.equality,
            "fatrop": fatrop,
        }
