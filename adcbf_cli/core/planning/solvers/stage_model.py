"""In numpy, what `linearise` does compiled: the quadratic model of the planning problem around a roll-out.

The formulas of optimal decay are explained there.
"""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from adcbf_cli.core.planning.merit import cheapest_decay
from adcbf_cli.core.planning.solvers.packing import (
    CAP,
    FAR_X,
    FAR_Y,
    GIVE,
    NEAR_X,
    NEAR_Y,
    NO_ROW,
    PER_ROW,
    VALUE,
    Model,
    Scene,
    StageQp,
)
from adcbf_cli.core.types import FloatArray


def stage_model(model: Model, scene: Scene, inputs: FloatArray, poses: FloatArray) -> StageQp:
    """The model around inputs (N, 2) and the poses (N + 1, 3) that they lead to."""
    share = np.ones((len(inputs), 1))
    share[-1] = model.terminal
    pose_weight = share * np.array([model.position, model.position, model.heading])
    before = np.vstack([scene.last, inputs[:-1]])
    duration = np.full((len(inputs), 1), model.step_s)
    duration[0] = model.first_step_s
    input_weight = np.broadcast_to([model.speed, model.turn], inputs.shape)
    change_weight = np.array([model.accel, model.turn_accel]) / duration**2
    change = inputs - before
    return StageQp(
        motion=_motion(model, inputs, poses),
        pose=np.hstack([pose_weight * (poses[1:] - scene.reference[1:, :3]), pose_weight]),
        inputs=np.hstack(
            [input_weight * (inputs - scene.reference[1:, 3:]), input_weight, change_weight * change, change_weight]
        ),
        room=np.hstack([inputs - scene.low, scene.high - inputs, scene.reach + change, scene.reach - change]),
        rows=_rows(model, scene, poses),
    )


def _motion(model: Model, inputs: FloatArray, poses: FloatArray) -> FloatArray:
    half_s = 0.5 * model.step_s
    if model.ackermann:
        slope = np.tan(inputs[:, 1])
        by_first = half_s * slope / model.wheelbase_m
        half = by_first * inputs[:, 0]
        by_second = half_s * inputs[:, 0] * (1.0 + slope**2) / model.wheelbase_m
    else:
        by_first, by_second = np.zeros(len(inputs)), np.full(len(inputs), half_s)
        half = half_s * inputs[:, 1]
    value = np.sinc(half / np.pi)
    small = np.abs(half) < 1e-3
    slope = np.where(small, -half / 3.0, (np.cos(half) - value) / np.where(small, 1.0, half))
    cosine, sine = np.cos(poses[:-1, 2] + half), np.sin(poses[:-1, 2] + half)
    way = inputs[:, 0] * model.step_s
    x_by_half, y_by_half = way * (slope * cosine - value * sine), way * (slope * sine + value * cosine)
    columns = [
        *(-way * value * sine, way * value * cosine),
        *(model.step_s * value * cosine + x_by_half * by_first, x_by_half * by_second),
        *(model.step_s * value * sine + y_by_half * by_first, y_by_half * by_second),
        *(2.0 * by_first, 2.0 * by_second),
    ]
    return np.stack(columns, axis=1)


def _rows(model: Model, scene: Scene, poses: FloatArray) -> FloatArray:
    centre = np.stack([scene.x, scene.y], axis=-1)
    off = poses[:, None, :2] - centre
    squared = (off**2).sum(axis=-1)
    height = squared - scene.square
    stages = model.row_steps
    near, far, reached = off[1 : stages + 1], off[:stages], height[1 : stages + 1]
    gamma, slope = _gamma(model, scene, squared[:stages])
    if model.printed:
        floor, by_far = height[:stages] - gamma, 2.0 - slope
    else:
        floor, by_far = (1.0 - gamma) * height[:stages], 2.0 * (1.0 - gamma) - slope * height[:stages]
    decay = cheapest_decay(reached, floor, model.decay_weight if model.decay else None, model.slack_weight)
    rows = np.zeros((stages, PER_ROW, far.shape[1] * (2 if model.decay else 1)))
    first = rows[:, :, : far.shape[1]]
    first[:, VALUE] = reached - floor
    first[:, CAP] = model.slack_weight
    first[:, NEAR_X], first[:, NEAR_Y] = 2.0 * near[..., 0], 2.0 * near[..., 1]
    first[:, FAR_X], first[:, FAR_Y] = -decay * by_far * far[..., 0], -decay * by_far * far[..., 1]
    if model.decay:
        _give(model, rows, reached, floor)
    return rows


def _give(model: Model, rows: FloatArray, reached: FloatArray, floor: FloatArray) -> None:
    """Let the first half of the rows give, and fill the second half."""
    first, rest = rows[:, :, : floor.shape[1]], rows[:, :, floor.shape[1] :]
    decays = floor > 0.0
    cap = np.minimum(model.slack_weight, 2.0 * model.decay_weight / np.where(decays, floor, 1.0))
    first[:, CAP] = np.where(decays, cap, model.slack_weight)
    first[:, GIVE] = np.where(decays, 0.5 * floor**2 / model.decay_weight, 0.0)
    split = decays & (cap < model.slack_weight)
    rest[:, VALUE] = np.where(split, reached, NO_ROW)
    rest[:, CAP] = np.where(split, model.slack_weight - cap, model.slack_weight)
    for axis in (NEAR_X, NEAR_Y):
        rest[:, axis] = np.where(split, first[:, axis], 0.0)


def _gamma(model: Model, scene: Scene, squared: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gamma at squared distances (M, n), and its derivative by the distance over the distance."""
    if not scene.adaptive:
        return scene.gamma[: len(squared)], np.zeros_like(squared)
    distance = np.sqrt(squared)
    argument = model.gamma_scale * (distance - model.gamma_distance)
    raised = scene.amplitude * model.gamma_height
    gamma = scene.amplitude + raised * erf(argument)
    inside = (gamma >= model.gamma_floor) & (gamma <= model.gamma_ceiling)
    slope = raised * (2.0 / np.sqrt(np.pi)) * model.gamma_scale * np.exp(-(argument**2)) / np.maximum(distance, 1e-9)
    return np.clip(gamma, model.gamma_floor, model.gamma_ceiling), np.where(inside, slope, 0.0)
