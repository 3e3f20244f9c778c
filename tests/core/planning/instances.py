"""Planning problems and random steps of them, for the tests of merit, oracles and solvers."""

from __future__ import annotations

from typing import Literal

import numpy as np

from adcbf_cli.core.config import VehicleConfig
from adcbf_cli.core.planning.barrier import AdaptiveGamma, Barrier, FixedGamma
from adcbf_cli.core.planning.problem import Instance, Problem, Weights
from adcbf_cli.core.types import FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

KINDS: tuple[Literal["unicycle", "ackermann"], ...] = ("unicycle", "ackermann")
WEIGHTS = Weights(position=1.0, heading=0.1, speed=0.5, turn=0.1, accel=0.05, turn_accel=0.05, terminal=5.0)
SPEED_MPS = 0.75
BODY_AND_SAFETY_M = 0.5

BARRIERS = {
    "distance": Barrier(FixedGamma(1.0)),
    "fixed": Barrier(FixedGamma(0.1)),
    "adaptive": Barrier(AdaptiveGamma()),
    "optimal decay": Barrier(AdaptiveGamma(), decay_weight=10.0),
    "frozen": Barrier(AdaptiveGamma(), frozen=True),
    "first stages": Barrier(AdaptiveGamma(), steps=5),
    "printed form": Barrier(AdaptiveGamma(), form="printed"),
    "printed gamma": Barrier(AdaptiveGamma(form="printed", floor=None, ceiling=None)),
}


def problem_of(
    barrier: Barrier, steps: int = 15, kind: Literal["unicycle", "ackermann"] = "unicycle", **vehicle: float
) -> Problem:
    model = Vehicle.from_config(VehicleConfig.model_validate({"kind": kind, **vehicle}))
    return Problem(model, steps, 0.1, 1 / 30, WEIGHTS, barrier, slack_weight=1000.0)


def straight(pose: FloatArray, steps: int, step_s: float = 0.1, speed_mps: float = SPEED_MPS) -> FloatArray:
    """A reference (steps + 1, 5) straight ahead of a pose."""
    along = speed_mps * step_s * np.arange(steps + 1)
    still = np.zeros(steps + 1)
    return np.column_stack(
        [
            pose[0] + along * np.cos(pose[2]),
            pose[1] + along * np.sin(pose[2]),
            still + pose[2],
            still + speed_mps,
            still,
        ]
    )


def instance_of(
    problem: Problem,
    discs: list[tuple[float, float, float, float, float]],
    last: tuple[float, float] = (SPEED_MPS, 0.0),
) -> Instance:
    """At the origin, going along x. discs: rows of x, y, vx, vy, own radius."""
    table = np.array(discs, dtype=float).reshape(-1, 5)
    at_s = problem.step_s * np.arange(problem.steps + 1)
    centre = table[:, None, :2] + at_s[None, :, None] * table[:, None, 2:4]
    radius = table[:, 4]
    return Instance(
        pose=np.zeros(3),
        last_inputs=np.array(last),
        reference=straight(np.zeros(3), problem.steps, problem.step_s),
        obstacle_m=centre,
        obstacle_radius_m=radius,
        keep_out_m=np.repeat(radius[:, None] + BODY_AND_SAFETY_M, problem.steps + 1, axis=1),
        gamma=np.full((len(table), problem.steps), 0.3) if problem.barrier.frozen else None,
    )


def random_instance(problem: Problem, seed: int, obstacles: int = 6, nearest_m: float = 1.3) -> Instance:
    """Discs within 4 m, half of them moving, their centres at least `nearest_m` away; a pose that is off
    the reference by some centimetres and degrees."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-4, 4, (obstacles, 2))
    place *= np.maximum(1.0, nearest_m / np.hypot(place[:, 0], place[:, 1]))[:, None]
    velocity = rng.normal(0.0, 0.5, (obstacles, 2)) * (rng.random((obstacles, 1)) < 0.5)
    start = np.append(rng.normal(0.0, 3.0, 2), rng.uniform(-np.pi, np.pi))
    at_s = problem.step_s * np.arange(problem.steps + 1)
    radius = rng.uniform(0.1, 0.7, obstacles)
    return Instance(
        pose=start + rng.normal(0.0, [0.1, 0.1, 0.1]),
        last_inputs=rng.uniform([0.2, -0.3], [1.0, 0.3]),
        reference=straight(start, problem.steps, problem.step_s),
        obstacle_m=start[:2] + place[:, None] + at_s[None, :, None] * velocity[:, None],
        obstacle_radius_m=radius,
        keep_out_m=np.repeat(radius[:, None] + BODY_AND_SAFETY_M, problem.steps + 1, axis=1),
        gamma=rng.uniform(0.05, 1.0, (obstacles, problem.steps)) if problem.barrier.frozen else None,
    )


def random_inputs(problem: Problem, instance: Instance, seed: int) -> FloatArray:
    """(N, 2) within the limits."""
    rng = np.random.default_rng(seed)
    wanted = instance.last_inputs + np.cumsum(rng.normal(0.0, [0.05, 0.1], (problem.steps, 2)), axis=0)
    return problem.vehicle.within_limits(wanted, instance.last_inputs, problem.step_s, problem.first_step_s)


def cruising(problem: Problem) -> FloatArray:
    """Straight ahead at the reference's speed, obstacles or not."""
    return np.tile([SPEED_MPS, 0.0], (problem.steps, 1))
