"""Where an optimising planner begins to search: its previous plan, shifted, and the path, followed.

Local minima decide more than solvers do: which side of an obstacle a plan passes is settled here.
"""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.planning import pursuit
from adcbf_cli.core.planning.columns import Columns
from adcbf_cli.core.planning.problem import Problem
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.types import FloatArray

ROOM = 1.15
"""The second start goes around an obstacle at this many times the distance to keep."""


def shifted(inputs: FloatArray, elapsed_s: float, step_s: float) -> FloatArray | None:
    """The plan `inputs` (N, 2) as it goes on `elapsed_s` later, its last inputs held; interpolated, since
    the planner runs more often than a stage is long. None where it has run out, or time ran backwards."""
    at_s = step_s * np.arange(len(inputs))
    if not 0.0 <= elapsed_s < step_s * len(inputs):
        return None
    later, goes_on_s = np.empty_like(inputs), at_s + elapsed_s
    for i in range(inputs.shape[1]):
        later[:, i] = np.interp(goes_on_s, at_s, inputs[:, i])
    return later


def follow(
    problem: Problem, path: ReferencePath, reference: FloatArray, along_m: float, pose: FloatArray, last: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Inputs (N, 2) that pursue the path at the reference's speeds, as if there were no obstacles, and
    the points (N, 2) that they aim at."""
    legs = reference[1:-1, :2] - reference[:-2, :2]
    at_m = np.full(len(reference) - 1, along_m, dtype=float)
    at_m[1:] += np.cumsum(np.hypot(legs[:, 0], legs[:, 1]))
    aims = pursuit.beyond(path, at_m + pursuit.look_ahead_m(path))[:, :2]
    return _pursue(problem, reference, aims, pose, last), aims


def around(
    problem: Problem,
    reference: FloatArray,
    aims_m: FloatArray,
    followed: FloatArray,
    poses: FloatArray,
    columns: Columns,
    last: FloatArray,
) -> FloatArray:
    """Inputs (N, 2) of `follow` turned aside from the first obstacle that its way, `poses` (N + 1, 3), conflicts with.

    Aims within the obstacle's reach move out of it sideways, on the side of the path where the
    obstacle's centre is not. Straight ahead both sides are alike, and every descent from the middle
    ends in front of the obstacle: then it is the left.
    """
    gap = poses[:, :2] - columns.centre_m
    inside = np.hypot(gap[..., 0], gap[..., 1]) < columns.keep_out_m
    if not inside.any():
        return followed
    stage = int(np.argmax(inside.any(axis=0)))
    column = int(np.argmax(inside[:, stage]))
    centre = columns.centre_m[column, stage]
    reach = ROOM * float(columns.keep_out_m[column, stage])
    yaw = float(reference[min(stage, len(reference) - 1), 2])
    across = np.array([-np.sin(yaw), np.cos(yaw)])
    side = -1.0 if float((centre - reference[stage, :2]) @ across) > 0.0 else 1.0
    to = aims_m - centre
    sideways, forward = to @ across, to @ np.array([np.cos(yaw), np.sin(yaw)])
    edge = side * np.sqrt(np.maximum(reach**2 - forward**2, 0.0))
    blocked = (np.abs(forward) < reach) & (side * sideways < side * edge)
    moved = aims_m + np.where(blocked, edge - sideways, 0.0)[:, None] * across
    return _pursue(problem, reference, moved, poses[0], last)


def _pursue(
    problem: Problem, reference: FloatArray, aims_m: FloatArray, pose: FloatArray, last: FloatArray
) -> FloatArray:
    return pursuit.pursue(problem.vehicle, pose, last, aims_m, reference[1:, 3], problem.step_s, problem.first_step_s)
