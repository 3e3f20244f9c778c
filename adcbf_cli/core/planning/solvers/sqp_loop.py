"""Compiled: the whole of a Gauss-Newton SQP solve, from a guess to inputs, in one call.

Each iteration linearises around the roll-out of its inputs, solves the stage-wise quadratic programme
and goes along its step as far as lowers the merit (an exact L1 penalty, so the step is one of descent).
Barriers are convex in position, so that deep within an obstacle their linearisation promises too little:
then the step is doubled for as long as that helps. Where it had to be shortened, turning has made the
linearisation promise too much, and the next step is bounded (a trust region).

Curvature of the barriers in the Hessian (convexified) was tried, and gains nothing here.
"""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable

import numpy as np

from adcbf_cli.core.planning.solvers import compiling, packing, stage_qp
from adcbf_cli.core.planning.solvers import linearise as linearising
from adcbf_cli.core.planning.solvers.compiling import ENDLESS, compiled, kept, source_key
from adcbf_cli.core.planning.solvers.linearise import linearise, merit_of, roll_out
from adcbf_cli.core.planning.solvers.packing import LONGEST_STEP, SHORTEST_STEP, TOLERANCE, Model, Scene, StageQp
from adcbf_cli.core.planning.solvers.stage_qp import solve_qp
from adcbf_cli.core.types import FloatArray

CONVERGED, LIMIT, FAILED = 0, 1, 2

MU_START, MU_LEAST = 10.0, 0.01
"""Complementarity that programmes start from: far from a solution, and next to it."""

MU_END, MU_END_MOST = 1e-6, 1e-4
"""Complementarity that programmes are solved to, next to a solution and far from it, where the merit is 1
or less; in proportion to a larger one."""

NEWTON_STEPS = 25
"""At most, for one programme; four or five are usual, a dozen far from a solution."""

Entry = Callable[[Model, Scene, StageQp, FloatArray, int, int], tuple[FloatArray, float, int, int]]


@functools.cache
def entry() -> Entry:
    """`solve_sqp`, kept on disk once it is compiled."""
    key = source_key(sys.modules[__name__], compiling, packing, linearising, stage_qp)

    def solve(
        model: Model, scene: Scene, qp: StageQp, guess: FloatArray, min_iterations: int, max_iterations: int
    ) -> tuple[FloatArray, float, int, int]:
        _ = key  # what is kept is found again by the function's closure
        return solve_sqp(model, scene, qp, guess, min_iterations, max_iterations)

    return kept(solve)


@compiled
def solve_sqp(
    model: Model, scene: Scene, qp: StageQp, guess: FloatArray, min_iterations: int, max_iterations: int
) -> tuple[FloatArray, float, int, int]:
    """Inputs (N, 2), their merit, iterations and one of CONVERGED, LIMIT, FAILED.

    qp: room for the linearisations. guess: (N, 2); the result is within limits.
    """
    inputs, poses = np.empty((len(guess), 2)), np.empty((len(guess) + 1, 3))
    trial, trial_poses = np.empty((len(guess), 2)), np.empty((len(guess) + 1, 3))
    take(scene, guess, guess, 0.0, inputs)
    roll_out(model, scene, inputs, poses)
    merit = merit_of(model, scene, inputs, poses)
    if not merit < ENDLESS:
        return inputs, merit, 0, FAILED
    fell, trust = math.inf, math.inf
    for iteration in range(max_iterations):
        linearise(model, scene, inputs, poses, qp)
        _bound_steps(qp, trust)
        scale = max(merit, 1.0)
        mu = min(max(fell, MU_LEAST * scale), MU_START)
        mu_end = min(max(1e-4 * fell, MU_END * scale), MU_END_MOST * scale)
        step, taken = solve_qp(qp, mu, mu_end, NEWTON_STEPS)
        length, best = _search(model, scene, inputs, step, merit, trial, trial_poses)
        if length == 0.0:
            if mu_end == MU_END * scale:
                return inputs, merit, iteration + 1, CONVERGED if taken < NEWTON_STEPS else LIMIT
            fell = 0.0  # the programme was solved roughly: once more, and precisely
            continue
        trust = 2.0 * length * np.max(np.abs(step[:, :2])) if length < 1.0 else 2.0 * trust
        take(scene, inputs, step, length, inputs)
        roll_out(model, scene, inputs, poses)
        fell, merit = merit - best, best
        if fell < TOLERANCE * merit and iteration + 1 >= min_iterations:
            return inputs, merit, iteration + 1, CONVERGED
    return inputs, merit, max_iterations, LIMIT


@compiled
def _bound_steps(qp: StageQp, trust: float) -> None:
    for k in range(len(qp.room)):
        for side in range(4):
            qp.room[k, side] = min(qp.room[k, side], trust)


@compiled
def take(scene: Scene, inputs: FloatArray, step: FloatArray, length: float, result: FloatArray) -> None:
    """Fill `result` with inputs + length * step, kept within limits as by `Vehicle.within_limits`."""
    for k in range(len(inputs)):
        for j in range(2):
            value = min(max(inputs[k, j] + length * step[k, j], scene.low[k, j]), scene.high[k, j])
            if k > 0:
                before = result[k - 1, j]
                value = min(max(value, before - scene.reach[j]), before + scene.reach[j])
            result[k, j] = value


@compiled
def _search(
    model: Model,
    scene: Scene,
    inputs: FloatArray,
    step: FloatArray,
    merit: float,
    trial: FloatArray,
    trial_poses: FloatArray,
) -> tuple[float, float]:
    """How far to go along the step, and the merit there: 1, doubled while that is better still, or halved
    until it is better than `merit` at all; 0 where it never is."""
    best, best_length, length = merit, 0.0, 1.0
    while SHORTEST_STEP <= length <= LONGEST_STEP:
        take(scene, inputs, step, length, trial)
        roll_out(model, scene, trial, trial_poses)
        reached = merit_of(model, scene, trial, trial_poses)
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
