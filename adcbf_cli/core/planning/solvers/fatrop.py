"""FATROP on the same program: the second oracle, which uses the order of its stages."""

from __future__ import annotations

from typing import Any

from adcbf_cli.core.planning.ocp import Ocp
from adcbf_cli.core.planning.solvers.program import ProgramSolver, first_barrier_parameter

TOLERANCE = 1e-6
"""Not scaled by the slack weight, as IPOPT's is. At 1e-8 a third of the solves end in rounding errors without
having met it, at 1e-6 one in thirty, with the same merit to 1e-7; at 1e-5 merits are wrong in the sixth digit."""

MAX_ITERATIONS = 300


class FatropSolver(ProgramSolver):
    """See `Solver`."""

    plugin = "fatrop"
    converged = ("0",)

    def options(self, ocp: Ocp) -> dict[str, Any]:
        """Silent, from far outside the constraints, with the stages' sizes."""
        fatrop = {
            "print_level": 0,
            "tol": TOLERANCE,
            "max_iter": MAX_ITERATIONS,
            "mu_init": first_barrier_parameter(self.problem),
        }
        return {
            "structure_detection": "manual",
            "N": self.problem.steps,
            "nx": ocp.states,
            "nu": ocp.controls,
            "ng": ocp.rows,
            "equality": ocp.equality,
            "fatrop": fatrop,
        }
