"""A problem, an instance and a linearisation of it as the plain arrays that the SQP solvers compute with.

Both SQP solvers, compiled and not, start here, so that they cannot read a problem differently, nor fail
differently.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from adcbf_cli.core.planning.barrier import AdaptiveGamma
from adcbf_cli.core.planning.problem import Instance, Problem, Solution, SolverStatus
from adcbf_cli.core.types import FloatArray

TOLERANCE = 1e-6
"""A decrease of the merit that is relatively smaller ends the iterations."""

LONGEST_STEP, SHORTEST_STEP = 8.0, 1.0 / 4096.0
"""How far the line searches go, as factors of a programme's step."""

HAIR = np.array([0.0, 1e-4])


class Model(NamedTuple):
    """What a problem fixes.

    decay: whether rows have a decay variable, of cost decay_weight (w - 1)^2. printed: rows are
    h[k + 1] >= h[k] - gamma. row_steps: stages with rows.
    gamma_...: adaptive gamma is clip(amplitude (1 + height erf(scale (d - distance))), floor, ceiling),
    with each obstacle's amplitude in the scene.
    """

    ackermann: bool
    wheelbase_m: float
    step_s: float
    first_step_s: float
    position: float
    heading: float
    speed: float
    turn: float
    accel: float
    turn_accel: float
    terminal: float
    slack_weight: float
    decay: bool
    decay_weight: float
    printed: bool
    row_steps: int
    gamma_distance: float
    gamma_scale: float
    gamma_height: float
    gamma_floor: float
    gamma_ceiling: float


class Scene(NamedTuple):
    """One instance; n obstacles, N stages, everything C-contiguous float64.

    pose: (3,). last: (2,). low, high: (N, 2) what each stage's inputs may be (see `input_boxes`).
    reach: (2,) the largest change of the inputs from one stage to the next.
    reference: (N + 1, 5). x, y: (N + 1, n) obstacle centres; square: (N + 1, n) squared keep-out radii.
    amplitude: (n,), used where gamma is adaptive. gamma: (N, n), used where it is not.
    """

    pose: FloatArray
    last: FloatArray
    low: FloatArray
    high: FloatArray
    reach: FloatArray
    reference: FloatArray
    x: FloatArray
    y: FloatArray
    square: FloatArray
    adaptive: bool
    amplitude: FloatArray
    gamma: FloatArray


SIDES = 8
"""Limits of a stage's inputs: either one low, high, falling, rising."""

PER_ROW = 7
VALUE, CAP, GIVE, NEAR_X, NEAR_Y, FAR_X, FAR_Y = range(PER_ROW)
"""Where a `StageQp` keeps what of its rows."""

NO_ROW = 1.0
"""Value of a row that is not there: satisfied, whatever the step."""


class StageQp(NamedTuple):
    """The quadratic model of a problem around a roll-out: N stages, M of them with m barrier rows each.

    Variables are the steps d u[k] and d pose[k + 1] from it, where d pose[0] = 0 and
    d pose[k + 1] = A d pose[k] + B d u[k], A being the identity but for ax, ay in its yaw column.
    motion: (N, 8) ax, ay and B (3, 2) row by row.
    pose: (N, 6) cost at pose[k + 1]: gradient, and diagonal of the Hessian.
    inputs: (N, 8) cost at u[k]: gradient (2,), Hessian (2,), and the same at u[k] - u[k - 1].
    room: (N, SIDES) how far u[k] is from its limits: from below (2,) and from above (2,), then the same
    of u[k] - u[k - 1], which does not count at k = 0.
    rows: (M, PER_ROW, m). A row is value + near d xy[k + 1] + far d xy[k] >= 0; falling short by e + s
    costs e^2 / (2 give) + cap s (give = 0: cap s alone).
    """

    motion: FloatArray
    pose: FloatArray
    inputs: FloatArray
    room: FloatArray
    rows: FloatArray


def empty_qp(model: Model, scene: Scene) -> StageQp:
    """Arrays for a model, to be filled."""
    stages, count = len(scene.low), len(scene.amplitude)
    return StageQp(
        np.empty((stages, 8)),
        np.empty((stages, 6)),
        np.empty((stages, 8)),
        np.empty((stages, SIDES)),
        np.empty((model.row_steps, PER_ROW, 2 * count if model.decay else count)),
    )


def pack_model(problem: Problem) -> Model:
    barrier, weights, vehicle = problem.barrier, problem.weights, problem.vehicle
    gamma = barrier.gamma if isinstance(barrier.gamma, AdaptiveGamma) else AdaptiveGamma()
    spread = math.sqrt(2.0) * gamma.distance_sigma_m
    scale, height = (1.0 / spread, 1.0) if gamma.form == "cdf" else (1.0, 1.0 / spread)
    return Model(
        ackermann=vehicle.kind == "ackermann",
        wheelbase_m=float(vehicle.wheelbase_m),
        step_s=float(problem.step_s),
        first_step_s=float(problem.first_step_s),
        position=float(weights.position),
        heading=float(weights.heading),
        speed=float(weights.speed),
        turn=float(weights.turn),
        accel=float(weights.accel),
        turn_accel=float(weights.turn_accel),
        terminal=float(weights.terminal),
        slack_weight=float(problem.slack_weight),
        decay=barrier.decay_weight is not None,
        decay_weight=float(barrier.decay_weight or 0.0),
        printed=barrier.form == "printed",
        row_steps=problem.steps if barrier.steps is None else min(barrier.steps, problem.steps),
        gamma_distance=float(gamma.distance_m),
        gamma_scale=scale,
        gamma_height=height,
        gamma_floor=-math.inf if gamma.floor is None else float(gamma.floor),
        gamma_ceiling=math.inf if gamma.ceiling is None else float(gamma.ceiling),
    )


def pack_scene(problem: Problem, instance: Instance) -> Scene:
    low, high = input_boxes(problem, instance.last_inputs)
    centres = instance.obstacle_m
    return Scene(
        pose=_plain(instance.pose),
        last=_plain(instance.last_inputs),
        low=low,
        high=high,
        reach=_plain(problem.vehicle.rate_max * problem.step_s),
        reference=_plain(instance.reference),
        x=_plain(centres[:, :, 0].T),
        y=_plain(centres[:, :, 1].T),
        square=_plain(np.square(instance.keep_out_m).T),
        adaptive=isinstance(problem.barrier.gamma, AdaptiveGamma) and not _is_given(problem, instance),
        amplitude=_amplitude(problem, instance),
        gamma=_fixed_gamma(problem, instance),
    )


def starting(guess: FloatArray) -> FloatArray:
    """The guess (N, 2), turning by a hair more.

    Exactly in line with an obstacle the way around it is equally good on either side, and a step that
    follows gradients would take neither.
    """
    return np.ascontiguousarray(guess + HAIR, dtype=np.float64)


def is_finite(scene: Scene, inputs: FloatArray) -> bool:
    return all(bool(np.isfinite(part).all()) for part in (*scene, inputs))


def failed(guess: FloatArray) -> Solution:
    return Solution(guess, SolverStatus.FAILED, 0, math.nan)


def input_boxes(problem: Problem, last_inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, 2) lowest and highest inputs of each stage, the first step's rate limit included.

    From last inputs out of bounds the box is where the rate limits let the inputs return to, as in
    `Vehicle.limited`, so that it is never empty.
    """
    vehicle = problem.vehicle
    at_s = problem.first_step_s + problem.step_s * np.arange(problem.steps)
    reach = vehicle.rate_max * at_s[:, None]
    low = np.minimum(vehicle.input_min, last_inputs + reach)
    high = np.maximum(vehicle.input_max, last_inputs - reach)
    low[0] = np.maximum(low[0], last_inputs - reach[0])
    high[0] = np.minimum(high[0], last_inputs + reach[0])
    return low, high


def _amplitude(problem: Problem, instance: Instance) -> FloatArray:
    """(n,) A (1 - E(r - r_E, sigma_r)) of eq. 14: what the obstacle's radius makes of gamma."""
    gamma = problem.barrier.gamma
    if not isinstance(gamma, AdaptiveGamma):
        return np.zeros(len(instance))
    spread = math.sqrt(2.0) * gamma.radius_sigma_m
    offset = np.asarray(instance.obstacle_radius_m, dtype=float) - gamma.radius_m
    if gamma.form == "cdf":
        share = [math.erfc(value / spread) for value in offset]
    else:
        share = [1.0 - math.erf(value) / spread for value in offset]
    return gamma.amplitude * np.array(share, dtype=float)


def _is_given(problem: Problem, instance: Instance) -> bool:
    return problem.barrier.frozen and instance.gamma is not None


def _fixed_gamma(problem: Problem, instance: Instance) -> FloatArray:
    gamma, shape = problem.barrier.gamma, (problem.steps, len(instance))
    if instance.gamma is not None and _is_given(problem, instance):
        return _plain(instance.gamma.T)
    if isinstance(gamma, AdaptiveGamma):
        return np.zeros(shape)
    return np.full(shape, float(gamma.value))


def _plain(array: FloatArray) -> FloatArray:
    return np.ascontiguousarray(array, dtype=np.float64)
