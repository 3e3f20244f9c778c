"""What a plan is worth: the one function that scores every solver's inputs.

merit = tracking cost + slack_weight * sum of barrier violations + decay_weight * sum (w - 1)^2, with
poses rolled out from the inputs, so that no solver is scored by poses which the vehicle would not
reach. Limits of the inputs are not in it: solvers keep them exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.planning.barrier import gamma_at
from adcbf_cli.core.planning.problem import Instance, Problem
from adcbf_cli.core.types import FloatArray


@dataclass(frozen=True, slots=True)
class Rows:
    """The barriers along a plan: N stages, n obstacles, M = `barrier_stages(problem)` stages with rows.

    barrier_m2: (N + 1, n) h at every stage. gamma: (N, n), also where there is no row.
    residual_m2: (N, n) h[k + 1] - (1 - gamma) h[k], that is without decay; infinite where there is no
        row (k >= M). decay: (N, n) the cheapest w in [0, 1], 1 without decay or row. slack_m2: (N, n)
        violation that is left with that w, >= 0.
    """

    barrier_m2: FloatArray
    gamma: FloatArray
    residual_m2: FloatArray
    decay: FloatArray
    slack_m2: FloatArray


def barrier_stages(problem: Problem) -> int:
    """How many of the N stages have barrier rows (the paper's M_CBF)."""
    steps = problem.barrier.steps
    return problem.steps if steps is None else min(steps, problem.steps)


def barrier_rows(problem: Problem, instance: Instance, inputs: FloatArray) -> Rows:
    """The barriers along the plan that `inputs` (N, 2) lead to.

    Raises ValueError where the barrier is frozen and the instance has no gamma.
    """
    return rows_along(problem, instance, problem.vehicle.roll_out(instance.pose, inputs, problem.step_s))


def merit(problem: Problem, instance: Instance, inputs: FloatArray) -> float:
    """What `inputs` (N, 2) are worth, less being better; not finite where they are not."""
    poses = problem.vehicle.roll_out(instance.pose, inputs, problem.step_s)
    return float(_worth(problem, instance, inputs, poses))


def merits(problem: Problem, instance: Instance, inputs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Poses (K, N + 1, 3) and `merit` (K,) of K inputs (K, N, 2) at once."""
    poses = problem.vehicle.roll_outs(instance.pose, inputs, problem.step_s)
    return poses, _worth(problem, instance, inputs, poses)


def _worth(problem: Problem, instance: Instance, inputs: FloatArray, poses: FloatArray) -> FloatArray:
    """(...,) merit of inputs (..., N, 2) that lead to poses (..., N + 1, 3)."""
    total = tracking_cost(problem, instance, inputs, poses)
    if len(instance):
        rows = rows_along(problem, instance, poses)
        total = total + problem.slack_weight * rows.slack_m2.sum(axis=(-2, -1))
        if problem.barrier.decay_weight is not None:
            total = total + problem.barrier.decay_weight * ((rows.decay - 1.0) ** 2).sum(axis=(-2, -1))
    return total


def tracking_cost(problem: Problem, instance: Instance, inputs: FloatArray, poses: FloatArray) -> FloatArray:
    """(...,) the cost of `Weights` for inputs (..., N, 2) and the poses (..., N + 1, 3) that they lead to."""
    weights, reference = problem.weights, instance.reference
    stage = np.ones(problem.steps)
    stage[-1] = weights.terminal
    off = poses[..., 1:, :] - reference[1:, :3]
    cost = weights.position * (stage * (off[..., 0] ** 2 + off[..., 1] ** 2)).sum(axis=-1)
    cost = cost + weights.heading * (stage * off[..., 2] ** 2).sum(axis=-1)
    cost = cost + ((inputs - reference[1:, 3:]) ** 2).sum(axis=-2) @ np.array([weights.speed, weights.turn])
    duration_s = np.full(problem.steps, problem.step_s)
    duration_s[0] = problem.first_step_s
    before = np.broadcast_to(instance.last_inputs, (*inputs.shape[:-2], 1, 2))
    change = np.diff(inputs, axis=-2, prepend=before) / duration_s[:, None]
    cost = cost + (change**2).sum(axis=-2) @ np.array([weights.accel, weights.turn_accel])
    return np.asarray(0.5 * cost)


def rows_along(problem: Problem, instance: Instance, poses: FloatArray) -> Rows:
    """`barrier_rows` where the poses (..., N + 1, 3) that the inputs lead to are known already; every array of the
    answer has the same leading dimensions."""
    barrier = problem.barrier
    off = poses[..., :, None, :2] - instance.obstacle_m.transpose(1, 0, 2)
    squared = (off**2).sum(axis=-1)
    height = squared - instance.keep_out_m.T**2
    if barrier.frozen:
        if instance.gamma is None:
            raise ValueError("this barrier is frozen: the instance must bring its gamma")
        gamma = instance.gamma.T
    else:
        gamma = gamma_at(barrier.gamma, np.sqrt(squared[..., :-1, :]), instance.obstacle_radius_m)
    held = height[..., :-1, :]
    floor = held - gamma if barrier.form == "printed" else (1.0 - gamma) * held
    decay = cheapest_decay(height[..., 1:, :], floor, barrier.decay_weight, problem.slack_weight)
    residual = height[..., 1:, :] - floor
    slack = np.maximum(decay * floor - height[..., 1:, :], 0.0)
    rowless = (..., slice(barrier_stages(problem), None), slice(None))
    residual[rowless], decay[rowless], slack[rowless] = np.inf, 1.0, 0.0
    return Rows(height, gamma, residual, decay, slack)


def cheapest_decay(
    reached: FloatArray, floor: FloatArray, decay_weight: float | None, slack_weight: float
) -> FloatArray:
    """The w in [0, 1] that minimises decay_weight (w - 1)^2 + slack_weight max(0, w floor - reached),
    element by element.

    The function is convex with a kink at w = reached / floor, left of which it only falls. So the
    minimum is at the kink or, where the quadratic's own minimum 1 - slack_weight floor / (2 decay_weight)
    lies to the right of it, there. A negative floor rises with falling w: then w = 1.
    """
    decay = np.ones_like(floor)
    short = (floor > 0.0) & (floor > reached)
    if decay_weight is None or not short.any():
        return decay
    kink = reached[short] / floor[short]
    smooth = 1.0 - slack_weight * floor[short] / (2.0 * decay_weight)
    decay[short] = np.clip(np.maximum(kink, smooth), 0.0, 1.0)
    return decay
