"""What IPOPT and FATROP share: from an instance to a program's arrays, and from its answer to a solution."""

from __future__ import annotations

import casadi as ca
import numpy as np

from adcbf_cli.core.planning.merit import merit
from adcbf_cli.core.planning.ocp import Ocp
from adcbf_cli.core.planning.problem import Instance, Problem, Solution, SolverStatus
from adcbf_cli.core.types import FloatArray


def solve_program(
    ocp: Ocp, solver: ca.Function, instance: Instance, guess: FloatArray, converged: tuple[str, ...]
) -> Solution:
    """Run `solver` from `guess`; it has converged where its return status is one of `converged`.

    A guess or an instance that is not finite fails. Otherwise there are always inputs to give, since
    the barriers are soft: what was found or, where that is worse and not even converged, the guess.
    """
    problem = ocp.problem

    def in_limits(inputs: FloatArray) -> FloatArray:
        return problem.vehicle.within_limits(inputs, instance.last_inputs, problem.step_s, problem.first_step_s)

    if not np.isfinite(guess).all():
        return Solution(guess, SolverStatus.FAILED, 0, np.inf)
    start = in_limits(guess)
    start_value = merit(problem, instance, start)
    if not np.isfinite(start_value):
        return Solution(guess, SolverStatus.FAILED, 0, np.inf)
    answer = solver(x0=ocp.variables(instance, start), p=ocp.parameters(instance), **ocp.bounds(instance))
    stats = solver.stats()
    iterations = int(stats.get("iter_count", 0))
    found = ocp.inputs_of(np.asarray(answer["x"]).ravel())
    if not np.isfinite(found).all():
        return Solution(start, SolverStatus.ITERATION_LIMIT, iterations, start_value)
    inputs = in_limits(found)
    value = merit(problem, instance, inputs)
    if str(stats["return_status"]) in converged:
        return Solution(inputs, SolverStatus.CONVERGED, iterations, value)
    if value <= start_value:
        return Solution(inputs, SolverStatus.ITERATION_LIMIT, iterations, value)
    return Solution(start, SolverStatus.ITERATION_LIMIT, iterations, start_value)


def first_barrier_parameter(problem: Problem) -> float:
    """The interior-point methods' first mu. The slacks' multipliers reach up to the slack weight; starting
    well below it puts iterates onto the constraints at once, and into poorer minima in clutter."""
    return 0.1 * problem.slack_weight
