"""Compiled: roll-out, merit, and the quadratic model of the planning problem around a roll-out.

The state of stage k is (x, y, yaw, u[k - 1]), its control u[k]. Steps d of them are what the quadratic
programme is about; as the roll-out obeys the dynamics exactly, the programme's dynamics have no offset:

    d pose[k + 1] = A d pose[k] + B d u[k],   A = I except d x' / d yaw = ax, d y' / d yaw = ay.

A barrier row says value + near . d xy[k + 1] + far . d xy[k] >= 0. Falling short costs at most `cap` per
m^2, and only quadratically, short^2 / (2 give), up to there: give = 0 is the L1 penalty; optimal decay
is a row with give. With w the decay in force and a, b the two sides of the constraint,

    min over w in [0, 1] of P (w - 1)^2 + rho max(0, w b - a)

has slope 2 P (b - a) / b^2 for a < b, up to min(rho, 2 P / b), and rho for a < 0: the sum of a row
a - b >= 0 with give b^2 / (2 P) and that cap, and a row a >= 0 with the rest of rho for cap.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from adcbf_cli.core.planning.solvers.packing import Model, Scene
from adcbf_cli.core.types import FloatArray

FAST = {"contract", "reassoc", "nsz", "arcp"}
"""Sums may be reordered, but NaN and infinity keep their meaning: they are how a failure is seen."""

SIDES = 8
"""Limits a stage: of either input low, high, falling, rising."""

NO_ROW = 1.0
"""Value of a row that is not there: satisfied, whatever the step."""


class StageQp(NamedTuple):
    """The quadratic model; N stages, M of them with m barrier rows each.

    ax, ay: (N,). b: (N, 3, 2). pose_grad: (N, 3) gradient and pose_hess: (N, 3) diagonal Hessian at
    pose[k + 1]. input_grad, input_hess: (N, 2) at u[k]. change_grad, change_hess: (N, 2) at
    u[k] - u[k - 1]. room: (N, SIDES) how far u[k] is from its limits: from below and from above, then
    the same of u[k] - u[k - 1] (not used at k = 0); each pair of columns is the two inputs.
    value, cap, give: (M, m). near_x, near_y, far_x, far_y: (M, m).
    """

    ax: FloatArray
    ay: FloatArray
    b: FloatArray
    pose_grad: FloatArray
    pose_hess: FloatArray
    input_grad: FloatArray
    input_hess: FloatArray
    change_grad: FloatArray
    change_hess: FloatArray
    room: FloatArray
    value: FloatArray
    cap: FloatArray
    give: FloatArray
    near_x: FloatArray
    near_y: FloatArray
    far_x: FloatArray
    far_y: FloatArray


@njit(cache=True, error_model="numpy", fastmath=FAST)
def empty_qp(stages: int, row_stages: int, rows: int) -> StageQp:
    """Arrays for a model, not yet filled."""
    return StageQp(
        np.empty(stages),
        np.empty(stages),
        np.zeros((stages, 3, 2)),
        np.empty((stages, 3)),
        np.empty((stages, 3)),
        np.empty((stages, 2)),
        np.empty((stages, 2)),
        np.empty((stages, 2)),
        np.empty((stages, 2)),
        np.empty((stages, SIDES)),
        np.empty((row_stages, rows)),
        np.empty((row_stages, rows)),
        np.empty((row_stages, rows)),
        np.empty((row_stages, rows)),
        np.empty((row_stages, rows)),
        np.empty((row_stages, rows)),
        np.empty((row_stages, rows)),
    )


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _turn(model: Model, u: FloatArray) -> tuple[float, float, float]:
    """Half the yaw that inputs (2,) turn in a stage, and its derivatives with respect to them."""
    half_s = 0.5 * model.step_s
    if not model.ackermann:
        return half_s * u[1], 0.0, half_s
    slope = math.tan(u[1])
    per_speed = half_s * slope / model.wheelbase_m
    return per_speed * u[0], per_speed, half_s * u[0] * (1.0 + slope * slope) / model.wheelbase_m


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _sinc(half: float) -> tuple[float, float]:
    """sin(half) / half and its derivative."""
    if abs(half) > 1e-3:
        value = math.sin(half) / half
        return value, (math.cos(half) - value) / half
    square = half * half
    return 1.0 - square / 6.0 * (1.0 - square / 20.0), -half / 3.0 * (1.0 - square / 10.0)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def roll_out(model: Model, scene: Scene, inputs: FloatArray, poses: FloatArray) -> None:
    """Fill poses (N + 1, 3) with where inputs (N, 2) lead; as `Vehicle.roll_out`."""
    poses[0] = scene.pose
    for k in range(len(inputs)):
        half, _, _ = _turn(model, inputs[k])
        chord = inputs[k, 0] * model.step_s * _sinc(half)[0]
        direction = poses[k, 2] + half
        poses[k + 1, 0] = poses[k, 0] + chord * math.cos(direction)
        poses[k + 1, 1] = poses[k, 1] + chord * math.sin(direction)
        poses[k + 1, 2] = poses[k, 2] + 2.0 * half


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _gamma(model: Model, scene: Scene, k: int, i: int, square: float) -> tuple[float, float]:
    """Gamma of obstacle i at stage k at a squared distance, and its derivative by the distance over it."""
    if not scene.adaptive:
        return scene.gamma[k, i], 0.0
    distance = math.sqrt(square)
    argument = model.gamma_scale * (distance - model.gamma_distance)
    raised = scene.amplitude[i] * model.gamma_height
    gamma = scene.amplitude[i] + raised * math.erf(argument)
    if gamma < model.gamma_floor:
        return model.gamma_floor, 0.0
    if gamma > model.gamma_ceiling:
        return model.gamma_ceiling, 0.0
    slope = raised * 1.1283791670955126 * model.gamma_scale * math.exp(-argument * argument)
    return gamma, slope / max(distance, 1e-9)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _sides(model: Model, scene: Scene, poses: FloatArray, k: int, i: int) -> tuple[float, float, float]:
    """The row h[k + 1] >= floor of obstacle i at stage k: both sides, and how d floor / d xy[k] goes
    with xy[k] - obstacle."""
    x, y = poses[k + 1, 0] - scene.x[k + 1, i], poses[k + 1, 1] - scene.y[k + 1, i]
    reached = x * x + y * y - scene.square[k + 1, i]
    x, y = poses[k, 0] - scene.x[k, i], poses[k, 1] - scene.y[k, i]
    square = x * x + y * y
    height = square - scene.square[k, i]
    gamma, slope = _gamma(model, scene, k, i, square)
    if model.printed:
        return reached, height - gamma, 2.0 - slope
    return reached, (1.0 - gamma) * height, 2.0 * (1.0 - gamma) - slope * height


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _decay(model: Model, reached: float, floor: float) -> float:
    """The cheapest decay of a row; see `merit.cheapest_decay`."""
    if not model.decay or floor <= 0.0 or reached >= floor:
        return 1.0
    smooth = 1.0 - 0.5 * model.slack_weight * floor / model.decay_weight
    return max(reached / floor, smooth, 0.0)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def merit_of(model: Model, scene: Scene, inputs: FloatArray, poses: FloatArray) -> float:
    """`merit.merit` of inputs (N, 2) with the poses (N + 1, 3) that they lead to."""
    stages, reference = len(inputs), scene.reference
    cost = 0.0
    for k in range(stages):
        share = model.terminal if k == stages - 1 else 1.0
        x, y = poses[k + 1, 0] - reference[k + 1, 0], poses[k + 1, 1] - reference[k + 1, 1]
        yaw = poses[k + 1, 2] - reference[k + 1, 2]
        cost += share * (model.position * (x * x + y * y) + model.heading * yaw * yaw)
        cost += model.speed * (inputs[k, 0] - reference[k + 1, 3]) ** 2
        cost += model.turn * (inputs[k, 1] - reference[k + 1, 4]) ** 2
        duration = model.step_s if k else model.first_step_s
        before = inputs[k - 1] if k else scene.last
        cost += model.accel * ((inputs[k, 0] - before[0]) / duration) ** 2
        cost += model.turn_accel * ((inputs[k, 1] - before[1]) / duration) ** 2
    slack, given = 0.0, 0.0
    for k in range(model.row_steps):
        for i in range(len(scene.amplitude)):
            reached, floor, _ = _sides(model, scene, poses, k, i)
            decay = _decay(model, reached, floor)
            slack += max(decay * floor - reached, 0.0)
            given += (decay - 1.0) ** 2
    return 0.5 * cost + model.slack_weight * slack + model.decay_weight * given


@njit(cache=True, error_model="numpy", fastmath=FAST)
def linearise(model: Model, scene: Scene, inputs: FloatArray, poses: FloatArray, qp: StageQp) -> None:
    """Fill `qp` with the model around inputs (N, 2) and their poses (N + 1, 3)."""
    _linearise_motion(model, inputs, poses, qp)
    _linearise_cost(model, scene, inputs, poses, qp)
    for k in range(model.row_steps):
        for i in range(len(scene.amplitude)):
            _linearise_row(model, scene, poses, qp, k, i)


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _linearise_motion(model: Model, inputs: FloatArray, poses: FloatArray, qp: StageQp) -> None:
    for k in range(len(inputs)):
        half, by_first, by_second = _turn(model, inputs[k])
        value, slope = _sinc(half)
        cosine, sine = math.cos(poses[k, 2] + half), math.sin(poses[k, 2] + half)
        way = inputs[k, 0] * model.step_s
        x_by_half, y_by_half = way * (slope * cosine - value * sine), way * (slope * sine + value * cosine)
        qp.ax[k], qp.ay[k] = -way * value * sine, way * value * cosine
        b = qp.b[k]
        b[0, 0], b[0, 1] = model.step_s * value * cosine + x_by_half * by_first, x_by_half * by_second
        b[1, 0], b[1, 1] = model.step_s * value * sine + y_by_half * by_first, y_by_half * by_second
        b[2, 0], b[2, 1] = 2.0 * by_first, 2.0 * by_second


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _linearise_cost(model: Model, scene: Scene, inputs: FloatArray, poses: FloatArray, qp: StageQp) -> None:
    stages = len(inputs)
    for k in range(stages):
        share = model.terminal if k == stages - 1 else 1.0
        for j in range(3):
            weight = share * (model.position if j < 2 else model.heading)
            qp.pose_hess[k, j] = weight
            qp.pose_grad[k, j] = weight * (poses[k + 1, j] - scene.reference[k + 1, j])
        duration = model.step_s if k else model.first_step_s
        for j in range(2):
            weight = model.turn if j else model.speed
            before = inputs[k - 1, j] if k else scene.last[j]
            change = inputs[k, j] - before
            qp.input_hess[k, j] = weight
            qp.input_grad[k, j] = weight * (inputs[k, j] - scene.reference[k + 1, 3 + j])
            qp.change_hess[k, j] = (model.turn_accel if j else model.accel) / (duration * duration)
            qp.change_grad[k, j] = qp.change_hess[k, j] * change
            qp.room[k, j] = inputs[k, j] - scene.low[k, j]
            qp.room[k, 2 + j] = scene.high[k, j] - inputs[k, j]
            qp.room[k, 4 + j] = scene.reach[j] + change
            qp.room[k, 6 + j] = scene.reach[j] - change


@njit(cache=True, error_model="numpy", fastmath=FAST)
def _linearise_row(model: Model, scene: Scene, poses: FloatArray, qp: StageQp, k: int, i: int) -> None:
    reached, floor, by_far = _sides(model, scene, poses, k, i)
    decay = _decay(model, reached, floor)
    near_x, near_y = 2.0 * (poses[k + 1, 0] - scene.x[k + 1, i]), 2.0 * (poses[k + 1, 1] - scene.y[k + 1, i])
    qp.value[k, i] = reached - floor
    qp.cap[k, i] = model.slack_weight
    qp.give[k, i] = 0.0
    qp.near_x[k, i], qp.near_y[k, i] = near_x, near_y
    qp.far_x[k, i] = -decay * by_far * (poses[k, 0] - scene.x[k, i])
    qp.far_y[k, i] = -decay * by_far * (poses[k, 1] - scene.y[k, i])
    if not model.decay:
        return
    rest = i + len(scene.amplitude)
    qp.value[k, rest], qp.cap[k, rest], qp.give[k, rest] = NO_ROW, model.slack_weight, 0.0
    qp.near_x[k, rest], qp.near_y[k, rest] = 0.0, 0.0
    qp.far_x[k, rest], qp.far_y[k, rest] = 0.0, 0.0
    if floor <= 0.0:
        return
    qp.give[k, i] = 0.5 * floor * floor / model.decay_weight
    qp.cap[k, i] = min(model.slack_weight, 2.0 * model.decay_weight / floor)
    if qp.cap[k, i] < model.slack_weight:
        qp.value[k, rest], qp.cap[k, rest] = reached, model.slack_weight - qp.cap[k, i]
        qp.near_x[k, rest], qp.near_y[k, rest] = near_x, near_y
