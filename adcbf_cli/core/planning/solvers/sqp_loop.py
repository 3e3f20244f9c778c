"""Compiled: the whole of a Gauss-Newton SQP solve, from a guess to inputs, in one call.

Each iteration linearises around the roll-out of its inputs, solves the stage-wise quadratic programme
and goes along its step as far as lowers the merit (an exact L1 penalty, so the step is one of descent).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from adcbf_cli.core.planning.solvers.linearise import FAST, StageQp, empty_qp, linearise, merit_of, roll_out
from adcbf_cli.core.planning.solvers.packing import Model, Scene
from adcbf_cli.core.planning.solvers.stage_qp import Iterate, empty_iterate, empty_newton, solve_qp
from adcbf_cli.core.types import FloatArray

CONVERGED, LIMIT, FAILED = 0, 1, 2


@njit(cache=True, error_model="numpy", fastmath=FAST)
def solve_sqp(
    model: Model,
    scene: Scene,
    guess: FloatArray,
    min_iterations: int,
    max_iterations: int,
    mu_start: float,
    mu_next: float,
    mu_end: float,
    tolerance: float,
) -> tuple[FloatArray, float, int, int, int]:
    """Inputs (N, 2), their merit, iterations and one of CONVERGED, LIMIT, FAILED.

    guess: (N, 2), within the scene's limits. Inputs are within them up to rounding.
    """
    stages, count = len(guess), len(scene.amplitude)
    rows = 2 * count if model.decay else count
    qp = empty_qp(stages, model.row_steps, rows)
    at = empty_iterate(stages, model.row_steps, rows)
    newton = empty_newton(stages, model.row_steps, rows)
    inputs, poses = guess.copy(), np.empty((stages + 1, 3))
    trial, trial_poses = guess.copy(), np.empty((stages + 1, 3))
    roll_out(model, scene, inputs, poses)
    merit = merit_of(model, scene, inputs, poses)
    total = 0
    if not math.isfinite(merit):
        return inputs, merit, 0, FAILED, total
    mu = mu_start
    for iteration in range(max_iterations):
        linearise(model, scene, inputs, poses, qp)
        total += solve_qp(qp, at, newton, mu, mu_end, 40)
        mu = mu_next
        length, best = 1.0, merit
        for _ in range(12):
            trial[:] = inputs + length * at.du
            roll_out(model, scene, trial, trial_poses)
            best = merit_of(model, scene, trial, trial_poses)
            if best < merit:
                break
            length *= 0.5
        if not best < merit:
            return inputs, merit, iteration + 1, CONVERGED, total
        done = merit - best < tolerance * abs(merit)
        inputs[:] = trial
        poses[:] = trial_poses
        merit = best
        if done and iteration + 1 >= min_iterations:
            return inputs, merit, iteration + 1, CONVERGED, total
    return inputs, merit, max_iterations, LIMIT, total
