"""The same SQP as `sqp`, without a compiler: numpy for the model, PIQP for the quadratic programmes."""

from __future__ import annotations

import math

import numpy as np
import piqp
from scipy import sparse

from adcbf_cli.core.planning.merit import merit
from adcbf_cli.core.planning.problem import Instance, Problem, Solution, SolverStatus
from adcbf_cli.core.planning.solvers.packing import (
    CAP,
    FAR_X,
    FAR_Y,
    GIVE,
    LONGEST_STEP,
    NEAR_X,
    NEAR_Y,
    SHORTEST_STEP,
    TOLERANCE,
    VALUE,
    Scene,
    StageQp,
    failed,
    is_finite,
    pack_model,
    pack_scene,
    starting,
)
from adcbf_cli.core.planning.solvers.stage_model import stage_model
from adcbf_cli.core.types import FloatArray

PRECISION = 1e-7
"""PIQP's absolute tolerance; its residuals here are metres and m^2."""


class PiqpSolver:
    """At least `min_iterations`, at most `max_iterations`; see `sqp_loop` for the iterations themselves."""

    def __init__(self, problem: Problem, min_iterations: int, max_iterations: int) -> None:
        self._problem = problem
        self._model = pack_model(problem)
        self._min_iterations = min_iterations
        self._max_iterations = max_iterations

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        """The best inputs found from `guess` (N, 2); FAILED, and the guess, where numbers are not finite."""
        scene = pack_scene(self._problem, instance)
        first = starting(guess)
        if not is_finite(scene, first):
            return failed(guess)
        inputs = self._within_limits(instance, first)
        with np.errstate(over="ignore", invalid="ignore"):
            value = merit(self._problem, instance, inputs)
        if not math.isfinite(value):
            return failed(guess)
        trust = math.inf
        for iteration in range(self._max_iterations):
            step = self._step(instance, scene, inputs, trust)
            length, reached = self._search(instance, inputs, step, value)
            if length == 0.0:
                return Solution(inputs, SolverStatus.CONVERGED, iteration + 1, value)
            trust = 2.0 * length * float(np.abs(step).max()) if length < 1.0 else 2.0 * trust
            inputs = self._within_limits(instance, inputs + length * step)
            fell, value = value - reached, reached
            if fell < TOLERANCE * value and iteration + 1 >= self._min_iterations:
                return Solution(inputs, SolverStatus.CONVERGED, iteration + 1, value)
        return Solution(inputs, SolverStatus.ITERATION_LIMIT, self._max_iterations, value)

    def _step(self, instance: Instance, scene: Scene, inputs: FloatArray, trust: float) -> FloatArray:
        """The quadratic programme's step (N, 2); zero where it cannot be solved."""
        poses = self._problem.vehicle.roll_out(instance.pose, inputs, self._problem.step_s)
        qp = stage_model(self._model, scene, inputs, poses)
        qp.room[:, :4] = np.minimum(qp.room[:, :4], trust)
        return solve_by_piqp(qp)[:, :2]

    def _search(self, instance: Instance, inputs: FloatArray, step: FloatArray, value: float) -> tuple[float, float]:
        """How far to go along the step and the merit there; see `sqp_loop`."""
        best, best_length, length = value, 0.0, 1.0
        while SHORTEST_STEP <= length <= LONGEST_STEP:
            trial = self._within_limits(instance, inputs + length * step)
            reached = merit(self._problem, instance, trial)
            if reached < best:
                best, best_length = reached, length
                if length < 1.0:
                    break
                length *= 2.0
            elif best_length > 0.0:
                break
            else:
                length *= 0.5
        return best_length, best

    def _within_limits(self, instance: Instance, wanted: FloatArray) -> FloatArray:
        problem = self._problem
        last = instance.last_inputs
        return problem.vehicle.within_limits(wanted, last, problem.step_s, problem.first_step_s)


def solve_by_piqp(qp: StageQp) -> FloatArray:
    """The step (N, 5) of inputs and poses that solves `qp`; zero where PIQP cannot.

    Variables: all inputs, all poses, what each row falls short by at its cap's price, and what it gives.
    """
    stages, rows = len(qp.room), qp.rows[:, VALUE].size
    difference = sparse.eye_array(2 * stages) - sparse.eye_array(2 * stages, k=-2)
    changes = difference.T @ sparse.diags_array(qp.inputs[:, 6:].ravel())
    give = qp.rows[:, GIVE].ravel()
    giving = give > 0.0
    stiffness = np.where(giving, 1.0 / np.where(giving, give, 1.0), 1.0)
    hessian = sparse.block_diag(
        [
            sparse.diags_array(qp.inputs[:, 2:4].ravel()) + changes @ difference,
            sparse.diags_array(qp.pose[:, 3:].ravel()),
            sparse.csc_array((rows, rows)),
            sparse.diags_array(stiffness) if rows else sparse.csc_array((0, 0)),
        ],
        format="csc",
    )
    gradient = np.concatenate(
        [
            qp.inputs[:, :2].ravel() + difference.T @ qp.inputs[:, 4:6].ravel(),
            qp.pose[:, :3].ravel(),
            qp.rows[:, CAP].ravel(),
            np.zeros(rows),
        ]
    )
    free = np.full(3 * stages, np.inf)
    solver = piqp.SparseSolver()
    solver.settings.eps_abs, solver.settings.eps_rel, solver.settings.max_iter = PRECISION, PRECISION, 100
    limits, low, high = _limits(qp, difference)
    solver.setup(
        hessian,
        gradient,
        _dynamics(qp, rows),
        np.zeros(3 * stages),
        limits,
        low,
        high,
        np.concatenate([-qp.room[:, :2].ravel(), -free, np.zeros(rows), np.where(giving, -np.inf, 0.0)]),
        np.concatenate([qp.room[:, 2:4].ravel(), free, np.full(rows, np.inf), np.where(giving, np.inf, 0.0)]),
    )
    status = solver.solve()
    solution = solver.result.x
    if status not in (piqp.PIQP_SOLVED, piqp.PIQP_MAX_ITER_REACHED) or not np.isfinite(solution).all():
        return np.zeros((stages, 5))
    return np.hstack([solution[: 2 * stages].reshape(-1, 2), solution[2 * stages : 5 * stages].reshape(-1, 3)])


def _dynamics(qp: StageQp, rows: int) -> sparse.csc_array:
    """d pose[k + 1] - A d pose[k] - B d u[k] = 0, as a matrix of all variables."""
    stages = len(qp.room)
    k = np.arange(stages)
    onto = sparse.eye_array(3 * stages) - sparse.eye_array(3 * stages, k=-3)
    turned = sparse.coo_array(
        (-qp.motion[1:, :2].ravel(), (np.add.outer(3 * k[1:], [0, 1]).ravel(), np.repeat(3 * k[1:] - 1, 2))),
        shape=(3 * stages, 3 * stages),
    )
    driven = sparse.block_diag([-stage.reshape(3, 2) for stage in qp.motion[:, 2:]])
    return sparse.csc_array(sparse.hstack([driven, onto + turned, sparse.csc_array((3 * stages, 2 * rows))]))


def _limits(qp: StageQp, difference: sparse.sparray) -> tuple[sparse.csc_array, FloatArray, FloatArray]:
    """The barrier rows, and limits of the inputs' changes from stage 1 on: a matrix and its bounds."""
    stages, (row_stages, _, count) = len(qp.room), qp.rows.shape
    rows = row_stages * count
    line = np.arange(rows)
    stage = np.repeat(np.arange(row_stages), count)
    later = stage > 0
    place = np.concatenate([3 * stage, 3 * stage + 1, 3 * stage[later] - 3, 3 * stage[later] - 2])
    slope = [qp.rows[:, part].ravel() for part in (NEAR_X, NEAR_Y, FAR_X, FAR_Y)]
    value = np.concatenate([slope[0], slope[1], slope[2][later], slope[3][later]])
    barrier = sparse.coo_array(
        (value, (np.concatenate([line, line, line[later], line[later]]), place)), shape=(rows, 3 * stages)
    )
    changes = sparse.csc_array(difference)[2:]
    unit = sparse.eye_array(rows)
    matrix = sparse.block_array([[None, barrier, unit, unit], [changes, None, None, None]]) if rows else changes
    if not rows:
        matrix = sparse.hstack([changes, sparse.csc_array((changes.shape[0], 3 * stages))])
    low = np.concatenate([-qp.rows[:, VALUE].ravel(), -qp.room[1:, 4:6].ravel()])
    high = np.concatenate([np.full(rows, np.inf), qp.room[1:, 6:].ravel()])
    return sparse.csc_array(matrix), low, high
