"""Starts of last resort: of a set of sampled ways, the most promising ones.

Where the previous plan and the path both lead into a barrier, or to standing still, a solver that
descends from them stays there. Ways that turn, swerve, hurry or brake are tried by their merit alone,
which costs little, and the solver goes on from the best.
"""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.planning.merit import merits
from adcbf_cli.core.planning.problem import Instance, Problem
from adcbf_cli.core.types import FloatArray

SPEEDS = (0.0, 1 / 3, 2 / 3, 1.0)
TURNS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Inputs that are held, as shares of the bounds."""

SWERVE_S = 1.0
"""A swerve turns away for so long, back for as long, and goes straight on."""

APART_M = 0.5
"""Two starts end at least this far from each other."""


def sampled_starts(problem: Problem, instance: Instance, count: int) -> list[FloatArray]:
    """Up to `count` inputs (N, 2) within the vehicle's limits, the best by merit first."""
    ways = _ways(problem, instance.last_inputs)
    poses, worth = merits(problem, instance, ways)
    chosen: list[int] = []
    for i in np.argsort(worth, kind="stable").tolist():
        apart = [float(np.hypot(*(poses[i, -1, :2] - poses[k, -1, :2]))) for k in chosen]
        if np.isfinite(worth[i]) and min(apart, default=np.inf) > APART_M:
            chosen.append(i)
        if len(chosen) == count:
            break
    return [ways[i] for i in chosen]


def _ways(problem: Problem, last: FloatArray) -> FloatArray:
    """(K, N, 2) inputs that go to what is wanted as fast as the limits allow, from `last` (2,)."""
    vehicle, steps = problem.vehicle, problem.steps
    speeds = [share * float(vehicle.input_max[0]) for share in SPEEDS]
    if vehicle.input_min[0] < 0.0:
        speeds.append(float(vehicle.input_min[0]))
    turn_max = float(vehicle.input_max[1])
    at_s = problem.step_s * np.arange(steps)
    swerve = np.where(at_s < SWERVE_S, 1.0, np.where(at_s < 2 * SWERVE_S, -1.0, 0.0))
    turns = [np.full(steps, share * turn_max) for share in TURNS]
    turns += [share * turn_max * swerve for share in (-1.0, -0.5, 0.5, 1.0)]
    wanted = np.array([np.column_stack([np.full(steps, speed), turn]) for speed in speeds for turn in turns])
    inputs = np.empty_like(wanted)
    value, reach = np.tile(last, (len(wanted), 1)), vehicle.rate_max * problem.first_step_s
    for k in range(steps):
        inside = np.clip(wanted[:, k], vehicle.input_min, vehicle.input_max)
        value = np.clip(inside, value - reach, value + reach)
        inputs[:, k] = value
        reach = vehicle.rate_max * problem.step_s
    return inputs
