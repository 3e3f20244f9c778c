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
    """Run `solver` from `guess`. Its return status is one of `converged`, or the solve did not converge."""
    problem = ocp.problem
    start = within_limits(problem, instance, guess)
    if not np.isfinite(merit(problem, instance, start)):
        return Solution(guess, SolverStatus.FAILED, 0, np.inf)
    answer = solver(x0=ocp.variables(instance, start), p=ocp.parameters(instance), **ocp.bounds(instance))
    stats = solver.stats()
    iterations = int(stats.get("iter_count", 0))
    inputs = within_limits(problem, instance, ocp.inputs_of(np.asarray(answer["x"]).ravel()))
    value = merit(problem, instance, inputs)
    if str(stats["return_status"]) in converged and np.isfinite(value):
        return Solution(inputs, SolverStatus.CONVERGED, iterations, value)
    start_value = merit(problem, instance, start)
    if np.isfinite(value) and value <= start_value:
        return Solution(inputs, SolverStatus.ITERATION_LIMIT, iterations, value)
    return Solution(start, SolverStatus.ITERATION_LIMIT, iterations, start_value)


def within_limits(problem: Problem, instance: Instance, inputs: FloatArray) -> FloatArray:
    """The inputs (N, 2) brought into bounds and rate limits, one after the other."""
    limited = np.empty((problem.steps, 2))
    last, period_s = instance.last_inputs, problem.first_step_s
    for k in range(problem.steps):
        limited[k] = last = problem.vehicle.limited(inputs[k], last, period_s)
        period_s = problem.step_s
    return limited


def first_barrier_parameter(problem: Problem) -> float:
    """The interior-point methods' first mu. The slacks' multipliers reach up to the slack weight; starting
    well below it puts iterates onto the constraints at once, and into poorer minima in clutter."""
    return 0.1 * problem.slack_weight
