"""The fast solver: a Gauss-Newton SQP over the stages, compiled by Numba (`sqp_loop`)."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.planning.problem import Instance, Problem, Solution, SolverStatus
from adcbf_cli.core.planning.solvers import sqp_loop
from adcbf_cli.core.planning.solvers.packing import confine, is_finite, pack_model, pack_scene
from adcbf_cli.core.types import FloatArray

STATUS = {
    sqp_loop.CONVERGED: SolverStatus.CONVERGED,
    sqp_loop.LIMIT: SolverStatus.ITERATION_LIMIT,
    sqp_loop.FAILED: SolverStatus.FAILED,
}


class SqpSolver:
    """At least `min_iterations`, at most `max_iterations`; 1 and 1 is a real-time iteration.

    The first solve of a new installation compiles for a while; later ones load the result.
    """

    def __init__(self, problem: Problem, min_iterations: int, max_iterations: int) -> None:
        self._problem = problem
        self._model = pack_model(problem)
        self._min_iterations = min_iterations
        self._max_iterations = max_iterations

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        """The best inputs found from `guess` (N, 2); FAILED, and the guess, where numbers are not finite."""
        scene = pack_scene(self._problem, instance)
        if not (is_finite(scene) and np.isfinite(guess).all()):
            return Solution(guess, SolverStatus.FAILED, 0, float("nan"))
        start = confine(scene, np.asarray(guess, dtype=np.float64))
        inputs, merit, iterations, code, _ = sqp_loop.solve_sqp(
            self._model, scene, start, self._min_iterations, self._max_iterations, 1.0, 0.1, 1e-8, 1e-7
        )
        if code == sqp_loop.FAILED:
            return Solution(guess, SolverStatus.FAILED, iterations, float("nan"))
        return Solution(confine(scene, inputs), STATUS[code], iterations, merit)
