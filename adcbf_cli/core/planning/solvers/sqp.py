"""The fast solver: a Gauss-Newton SQP over the stages, compiled by Numba (`sqp_loop`)."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.planning.problem import Instance, Problem, Solution, SolverStatus
from adcbf_cli.core.planning.solvers import sqp_loop
from adcbf_cli.core.planning.solvers.packing import Scene, empty_qp, failed, is_finite, pack_model, pack_scene, starting
from adcbf_cli.core.types import FloatArray


class SqpSolver:
    """At least `min_iterations`, at most `max_iterations`; 1 and 1 is a real-time iteration.

    Building the first one of a new installation compiles for a while; later ones load the result.
    """

    def __init__(self, problem: Problem, min_iterations: int, max_iterations: int) -> None:
        self._problem = problem
        self._model = pack_model(problem)
        self._solve = sqp_loop.entry()
        self._packed: tuple[Instance, Scene, bool] | None = None
        self._min_iterations = min_iterations
        self._max_iterations = max_iterations
        self.solve(_anything(problem), np.zeros((problem.steps, 2)))  # compiled here, not within a deadline

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        """The best inputs found from `guess` (N, 2); FAILED, and the guess, where numbers are not finite."""
        scene, finite = self._scene(instance)
        first = starting(guess)
        if not finite or not np.isfinite(first).all():
            return failed(guess)
        inputs, merit, iterations, code = self._solve(
            self._model, scene, empty_qp(self._model, scene), first, self._min_iterations, self._max_iterations
        )
        if code == sqp_loop.FAILED:
            return failed(guess)
        status = SolverStatus.CONVERGED if code == sqp_loop.CONVERGED else SolverStatus.ITERATION_LIMIT
        return Solution(inputs, status, iterations, merit)

    def _scene(self, instance: Instance) -> tuple[Scene, bool]:
        """The instance as arrays, and whether all of it is finite; kept, since one instance is solved from
        several guesses."""
        if self._packed is None or self._packed[0] is not instance:
            scene = pack_scene(self._problem, instance)
            self._packed = (instance, scene, is_finite(scene, scene.last))
        return self._packed[1:]


def _anything(problem: Problem) -> Instance:
    """An instance of no difficulty: at rest, nothing near."""
    steps = problem.steps
    return Instance(
        pose=np.zeros(3),
        last_inputs=np.zeros(2),
        reference=np.zeros((steps + 1, 5)),
        obstacle_m=np.full((1, steps + 1, 2), 1e3),
        obstacle_radius_m=np.ones(1),
        keep_out_m=np.ones((1, steps + 1)),
        gamma=np.ones((1, steps)),
    )
