"""Ways of last resort: of a set of sampled ones, the most promising.

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

SIDES = (-1.0, -0.5, 0.5, 1.0)

SWERVE_S = 1.0
"""A swerve turns away for so long, back for as long, and goes straight on. Another way is to turn on the spot
for so long, as far as the vehicle can, and only then to go."""

APART_M = 0.5
"""Two starts end at least this far from each other."""


def sampled_starts(problem: Problem, instance: Instance, count: int) -> list[FloatArray]:
    """Up to `count` inputs (N, 2) within the vehicle's limits, the best by merit first."""
    ways = _sampled_ways(problem, instance.last_inputs)
    poses, worth = merits(problem, instance, ways)
    chosen: list[int] = []
    for i in np.argsort(worth, kind="stable").tolist():
        apart = [float(np.hypot(*(poses[i, -1, :2] - poses[k, -1, :2]))) for k in chosen]
        if np.isfinite(worth[i]) and min(apart, default=np.inf) > APART_M:
            chosen.append(i)
        if len(chosen) == count:
            break
    return [ways[i] for i in chosen]


def _sampled_ways(problem: Problem, last: FloatArray) -> FloatArray:
    """(K, N, 2) inputs that go to what is wanted as fast as the limits allow, from `last` (2,)."""
    vehicle, steps = problem.vehicle, problem.steps
    fastest, sharpest = float(vehicle.input_max[0]), float(vehicle.input_max[1])
    at_s = problem.step_s * np.arange(steps)
    early, late = at_s < SWERVE_S, at_s >= SWERVE_S
    swerve = np.where(early, 1.0, np.where(at_s < 2 * SWERVE_S, -1.0, 0.0))
    speeds = [np.full(steps, share * fastest) for share in SPEEDS]
    if vehicle.input_min[0] < 0.0:
        speeds.append(np.full(steps, float(vehicle.input_min[0])))
    turns = [np.full(steps, share * sharpest) for share in TURNS]
    turns += [share * sharpest * swerve for share in SIDES]
    pairs = [(speed, turn) for speed in speeds for turn in turns]
    pairs += [(share * fastest * late, side * sharpest * early) for share in (0.5, 1.0) for side in SIDES]
    pairs += [(speed, side * sharpest * early) for speed in speeds[1:] for side in SIDES]
    wanted = np.array([np.column_stack(pair) for pair in pairs])
    inputs = np.empty_like(wanted)
    value, reach = np.tile(last, (len(wanted), 1)), vehicle.rate_max * problem.first_step_s
    for k in range(steps):
        inside = np.clip(wanted[:, k], vehicle.input_min, vehicle.input_max)
        value = np.clip(inside, value - reach, value + reach)
        inputs[:, k] = value
        reach = vehicle.rate_max * problem.step_s
    return inputs
