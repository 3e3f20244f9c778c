"""Compiled: roll-out, merit, and the quadratic model of the planning problem around a roll-out.

Optimal decay has no variables here. With w the decay, and a, b the two sides of the constraint,

    min over w in [0, 1] of P (w - 1)^2 + rho max(0, w b - a)

has slope 2 P (b - a) / b^2 for a < b, up to min(rho, 2 P / b), and rho for a < 0. That is a row
a - b >= 0 with give b^2 / (2 P) and that cap, and a row a >= 0 with the rest of rho for cap.
"""

from __future__ import annotations

import math

from adcbf_cli.core.planning.solvers.compiling import compiled
from adcbf_cli.core.planning.solvers.packing import (
    CAP,
    FAR_X,
    FAR_Y,
    GIVE,
    NEAR_X,
    NEAR_Y,
    NO_ROW,
    VALUE,
    Model,
    Scene,
    StageQp,
)
from adcbf_cli.core.types import FloatArray


@compiled
def _turn(model: Model, u: FloatArray) -> tuple[float, float, float]:
    """Half the yaw that inputs (2,) turn in a stage, and its derivatives with respect to them."""
    half_s = 0.5 * model.step_s
    if not model.ackermann:
        return half_s * u[1], 0.0, half_s
    slope = math.tan(u[1])
    per_speed = half_s * slope / model.wheelbase_m
    return per_speed * u[0], per_speed, half_s * u[0] * (1.0 + slope * slope) / model.wheelbase_m


@compiled
def _sinc(half: float) -> tuple[float, float]:
    """sin(half) / half and its derivative."""
    if abs(half) > 1e-3:
        value = math.sin(half) / half
        return value, (math.cos(half) - value) / half
    square = half * half
    return 1.0 - square / 6.0 * (1.0 - square / 20.0), -half / 3.0 * (1.0 - square / 10.0)


@compiled
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


@compiled
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


@compiled
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


@compiled
def _decay(model: Model, reached: float, floor: float) -> float:
    """The cheapest decay of a row; see `merit.cheapest_decay`."""
    if not model.decay or floor <= 0.0 or reached >= floor:
        return 1.0
    smooth = 1.0 - 0.5 * model.slack_weight * floor / model.decay_weight
    return max(reached / floor, smooth, 0.0)


@compiled
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


@compiled
def linearise(model: Model, scene: Scene, inputs: FloatArray, poses: FloatArray, qp: StageQp) -> None:
    """Fill `qp` with the model around inputs (N, 2) and their poses (N + 1, 3)."""
    _linearise_motion(model, inputs, poses, qp)
    _linearise_cost(model, scene, inputs, poses, qp)
    for k in range(model.row_steps):
        for i in range(len(scene.amplitude)):
            _linearise_row(model, scene, poses, qp, k, i)


@compiled
def _linearise_motion(model: Model, inputs: FloatArray, poses: FloatArray, qp: StageQp) -> None:
    for k in range(len(inputs)):
        half, by_first, by_second = _turn(model, inputs[k])
        value, slope = _sinc(half)
        cosine, sine = math.cos(poses[k, 2] + half), math.sin(poses[k, 2] + half)
        way = inputs[k, 0] * model.step_s
        x_by_half, y_by_half = way * (slope * cosine - value * sine), way * (slope * sine + value * cosine)
        motion = qp.motion[k]
        motion[0], motion[1] = -way * value * sine, way * value * cosine
        motion[2], motion[3] = model.step_s * value * cosine + x_by_half * by_first, x_by_half * by_second
        motion[4], motion[5] = model.step_s * value * sine + y_by_half * by_first, y_by_half * by_second
        motion[6], motion[7] = 2.0 * by_first, 2.0 * by_second


@compiled
def _linearise_cost(model: Model, scene: Scene, inputs: FloatArray, poses: FloatArray, qp: StageQp) -> None:
    stages = len(inputs)
    for k in range(stages):
        share = model.terminal if k == stages - 1 else 1.0
        for j in range(3):
            weight = share * (model.position if j < 2 else model.heading)
            qp.pose[k, j] = weight * (poses[k + 1, j] - scene.reference[k + 1, j])
            qp.pose[k, 3 + j] = weight
        duration = model.step_s if k else model.first_step_s
        for j in range(2):
            weight = model.turn if j else model.speed
            change = inputs[k, j] - (inputs[k - 1, j] if k else scene.last[j])
            qp.inputs[k, j] = weight * (inputs[k, j] - scene.reference[k + 1, 3 + j])
            qp.inputs[k, 2 + j] = weight
            weight = (model.turn_accel if j else model.accel) / (duration * duration)
            qp.inputs[k, 4 + j] = weight * change
            qp.inputs[k, 6 + j] = weight
            qp.room[k, j] = inputs[k, j] - scene.low[k, j]
            qp.room[k, 2 + j] = scene.high[k, j] - inputs[k, j]
            qp.room[k, 4 + j] = scene.reach[j] + change
            qp.room[k, 6 + j] = scene.reach[j] - change


@compiled
def _linearise_row(model: Model, scene: Scene, poses: FloatArray, qp: StageQp, k: int, i: int) -> None:
    reached, floor, by_far = _sides(model, scene, poses, k, i)
    decay = _decay(model, reached, floor)
    near_x, near_y = 2.0 * (poses[k + 1, 0] - scene.x[k + 1, i]), 2.0 * (poses[k + 1, 1] - scene.y[k + 1, i])
    qp.rows[k, VALUE, i] = reached - floor
    qp.rows[k, CAP, i] = model.slack_weight
    qp.rows[k, GIVE, i] = 0.0
    qp.rows[k, NEAR_X, i], qp.rows[k, NEAR_Y, i] = near_x, near_y
    qp.rows[k, FAR_X, i] = -decay * by_far * (poses[k, 0] - scene.x[k, i])
    qp.rows[k, FAR_Y, i] = -decay * by_far * (poses[k, 1] - scene.y[k, i])
    if not model.decay:
        return
    rest = i + len(scene.amplitude)
    qp.rows[k, :, rest] = 0.0
    qp.rows[k, VALUE, rest], qp.rows[k, CAP, rest] = NO_ROW, model.slack_weight
    if floor <= 0.0:
        return
    cap = min(model.slack_weight, 2.0 * model.decay_weight / floor)
    qp.rows[k, GIVE, i], qp.rows[k, CAP, i] = 0.5 * floor * floor / model.decay_weight, cap
    if cap < model.slack_weight:
        qp.rows[k, VALUE, rest], qp.rows[k, CAP, rest] = reached, model.slack_weight - cap
        qp.rows[k, NEAR_X, rest], qp.rows[k, NEAR_Y, rest] = near_x, near_y
