"""The fast solver: a Gauss-Newton SQP over the stages, compiled by Numba (`sqp_loop`)."""

from __future__ import annotations

from adcbf_cli.core.planning.problem import Instance, Problem, Solution, SolverStatus
from adcbf_cli.core.planning.solvers import sqp_loop
from adcbf_cli.core.planning.solvers.packing import empty_qp, failed, is_finite, pack_model, pack_scene, starting
from adcbf_cli.core.types import FloatArray


class SqpSolver:
    """At least `min_iterations`, at most `max_iterations`; 1 and 1 is a real-time iteration.

    The first solve of a new installation compiles for a while; later ones load the result.
    """

    def __init__(self, problem: Problem, min_iterations: int, max_iterations: int) -> None:
        self._problem = problem
        self._model = pack_model(problem)
        self._solve = sqp_loop.entry()
        self._min_iterations = min_iterations
        self._max_iterations = max_iterations

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        """The best inputs found from `guess` (N, 2); FAILED, and the guess, where numbers are not finite."""
        scene = pack_scene(self._problem, instance)
        first = starting(guess)
        if not is_finite(scene, first):
            return failed(guess)
        inputs, merit, iterations, code = self._solve(
            self._model, scene, empty_qp(self._model, scene), first, self._min_iterations, self._max_iterations
        )
        if code == sqp_loop.FAILED:
            return failed(guess)
        status = SolverStatus.CONVERGED if code == sqp_loop.CONVERGED else SolverStatus.ITERATION_LIMIT
        return Solution(inputs, status, iterations, merit)
