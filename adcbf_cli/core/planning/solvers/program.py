"""What IPOPT and FATROP share: from an instance to a program's arrays, and from its answer to a solution."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from adcbf_cli.core.planning.merit import barrier_rows, barrier_stages, merit
from adcbf_cli.core.planning.ocp import INPUTS, STATE, Ocp, build
from adcbf_cli.core.planning.problem import Instance, Problem, Solution, SolverStatus
from adcbf_cli.core.types import FloatArray

DUMMY_OFFSET_M = 20.0
"""Unused slots hold a point this far from the pose, whose rows are bound too loosely to matter."""

NARROWEST = 1e-6
"""Where only one input can be reached, the program has this much room: interior points need some."""


class ProgramSolver(ABC):
    """A `Solver` by one of CasADi's plugins; a program for each bucket of slots, built when first needed."""

    plugin: ClassVar[str]
    converged: ClassVar[tuple[str, ...]]
    """The plugin's return statuses when it has converged."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._built: dict[int, tuple[Ocp, ca.Function]] = {}

    @abstractmethod
    def options(self, ocp: Ocp) -> dict[str, Any]:
        """The plugin's options for this program."""

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        """See `Solver.solve`.

        A guess or an instance that is not finite fails. Otherwise there are always inputs to give, since
        the barriers are soft: what was found or, where that is worse and not even converged, the guess.
        """
        if not np.isfinite(guess).all():
            return Solution(guess, SolverStatus.FAILED, 0, np.inf)
        start = self._in_limits(instance, guess)
        start_merit = merit(self.problem, instance, start)
        if not np.isfinite(start_merit):
            return Solution(guess, SolverStatus.FAILED, 0, np.inf)
        found, has_converged, iterations = self._run(instance, start)
        if not np.isfinite(found).all():
            return Solution(start, SolverStatus.ITERATION_LIMIT, iterations, start_merit)
        inputs = self._in_limits(instance, found)
        value = merit(self.problem, instance, inputs)
        if has_converged:
            return Solution(inputs, SolverStatus.CONVERGED, iterations, value)
        if value <= start_merit:
            return Solution(inputs, SolverStatus.ITERATION_LIMIT, iterations, value)
        return Solution(start, SolverStatus.ITERATION_LIMIT, iterations, start_merit)

    def _run(self, instance: Instance, start: FloatArray) -> tuple[FloatArray, bool, int]:
        """Inputs (N, 2), whether they have converged, and after how many iterations."""
        slots = bucket(len(instance))
        if slots not in self._built:
            ocp = build(self.problem, slots)
            options = {"print_time": False, "error_on_fail": False, **self.options(ocp)}
            self._built[slots] = (ocp, ca.nlpsol("plan", self.plugin, ocp.nlp, options))
        ocp, solver = self._built[slots]
        answer = solver(x0=variables(ocp, instance, start), p=parameters(ocp, instance), **bounds(ocp, instance))
        stats = solver.stats()
        found = inputs_of(ocp, np.asarray(answer["x"]).ravel())
        return found, str(stats["return_status"]) in self.converged, int(stats["iter_count"])

    def _in_limits(self, instance: Instance, inputs: FloatArray) -> FloatArray:
        problem = self.problem
        return problem.vehicle.within_limits(inputs, instance.last_inputs, problem.step_s, problem.first_step_s)


def first_barrier_parameter(problem: Problem) -> float:
    """The interior-point methods' first mu. The slacks' multipliers reach up to the slack weight; starting
    well below it puts iterates onto the constraints at once, and into poorer minima in clutter."""
    return 0.1 * problem.slack_weight


def bucket(obstacles: int) -> int:
    """The number of slots for so many obstacles: 0, 4, 8, 16, 32 and so on."""
    return 0 if obstacles == 0 else max(4, 1 << (obstacles - 1).bit_length())


def parameters(ocp: Ocp, instance: Instance) -> FloatArray:
    """p: the instance, padded with dummies up to the program's slots."""
    unused, stages = ocp.slots - len(instance), ocp.problem.steps + 1
    dummy = np.tile(instance.pose[:2] + np.array([DUMMY_OFFSET_M, 0.0]), (unused, stages, 1))
    obstacle = np.concatenate([instance.obstacle_m, dummy])
    radius = np.concatenate([instance.obstacle_radius_m, np.zeros(unused)])
    keep_out = np.concatenate([instance.keep_out_m, np.zeros((unused, stages))])
    parts = [instance.pose, instance.last_inputs, instance.reference.T, obstacle[..., 0], obstacle[..., 1]]
    parts += [keep_out, radius]
    if ocp.problem.barrier.frozen and instance.gamma is not None:
        parts.append(np.concatenate([instance.gamma, np.ones((unused, stages - 1))]))
    return np.concatenate([np.asarray(part).ravel(order="F") for part in parts])


def bounds(ocp: Ocp, instance: Instance) -> dict[str, FloatArray]:
    """lbx, ubx, lbg, ubg. Inputs out of bounds may stay there for as long as their rate needs to return.

    Which bounds exist and which coincide never changes, as FATROP keeps that from its first solve.
    """
    problem = ocp.problem
    lowest, highest = problem.vehicle.envelope(
        instance.last_inputs, problem.steps, problem.step_s, problem.first_step_s
    )
    highest = np.maximum(highest, lowest + NARROWEST)
    lower, upper = [], []
    for k, count in enumerate(ocp.controls):
        lower.append(np.full(STATE, -np.inf))
        upper.append(np.full(STATE, np.inf))
        if k < problem.steps:
            slacks = min(ocp.slots, count - INPUTS)
            lower += [lowest[k], np.zeros(count - INPUTS)]
            upper += [highest[k], np.full(slacks, np.inf), np.ones(count - INPUTS - slacks)]
    return {
        "lbx": np.concatenate(lower),
        "ubx": np.concatenate(upper),
        "lbg": _loosened(ocp, instance),
        "ubg": ocp.upper,
    }


def _loosened(ocp: Ocp, instance: Instance) -> FloatArray:
    """g's lower bounds; those of unused slots, the last rows of each stage, lower than any plan can come."""
    problem = ocp.problem
    stage_m = float(np.abs([problem.vehicle.input_min[0], problem.vehicle.input_max[0], instance.last_inputs[0]]).max())
    stage_m *= problem.step_s
    fall_m2 = 2 * (DUMMY_OFFSET_M + problem.steps * stage_m) * stage_m + stage_m**2
    loosened = ocp.lower.copy()
    end = 0
    for k in range(barrier_stages(problem)):
        end += STATE + ocp.rows[k]
        loosened[end - (ocp.slots - len(instance)) : end] = -1.0 - fall_m2
    return loosened


def variables(ocp: Ocp, instance: Instance, inputs: FloatArray) -> FloatArray:
    """x at `inputs` (N, 2): rolled out, with the cheapest decay and slack, so that it is feasible if they are."""
    problem = ocp.problem
    poses = problem.vehicle.roll_out(instance.pose, inputs, problem.step_s)
    before = np.concatenate([instance.last_inputs[None], inputs])
    rows = barrier_rows(problem, instance, inputs)
    unused = ocp.slots - len(instance)
    parts = []
    for k in range(problem.steps):
        parts += [poses[k], before[k], inputs[k]]
        if ocp.controls[k] > INPUTS:
            parts += [rows.slack_m2[k], np.zeros(unused)]
        if ocp.controls[k] > INPUTS + ocp.slots:
            parts += [rows.decay[k], np.ones(unused)]
    return np.concatenate([*parts, poses[-1], before[-1]])


def inputs_of(ocp: Ocp, variables: FloatArray) -> FloatArray:
    """(N, 2) the inputs in x."""
    ends = np.cumsum(np.add(ocp.states, ocp.controls))
    starts = np.concatenate([[0], ends[:-2]]) + STATE
    return np.asarray(variables[starts[:, None] + np.arange(INPUTS)])
