"""What a drive leaves behind: one record a planner and seed (closed loop) or a planner (open loop)."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

LOGGED = "logged"
"""The planner name of the log's own driver."""


class Result(enum.StrEnum):
    """How a drive ended. Open-loop drives have none."""

    SUCCESS = "success"
    COLLISION = "collision"
    TIMEOUT = "timeout"


@dataclass(frozen=True, slots=True)
class PlanSteps:
    """One planning step a row, T of them: what the planner did there.

    outcome, status, start: T strings ("" where a planner has none). NaN (decay, merit, violation) and
    -1 (iterations) where a planner has none; feasible: (T,) 1.0, 0.0 or NaN.
    obstacles, dropped: (T,) how many it knew, and how many of them did not fit into the problem.
    conflict: (T,) whether following the reference would, by what was known, come closer to an
        obstacle than the safety distance within the horizon.
    deviation_m: (T,) largest distance of the plan's positions from the reference's at the same stages.
    solve_ms: (T,) wall time of the planner's step.
    """

    outcome: tuple[str, ...]
    status: tuple[str, ...]
    start: tuple[str, ...]
    iterations: IntArray
    merit: FloatArray
    violation_m2: FloatArray
    decay: FloatArray
    feasible: FloatArray
    obstacles: IntArray
    dropped: IntArray
    conflict: BoolArray
    deviation_m: FloatArray
    solve_ms: FloatArray


@dataclass(frozen=True, slots=True)
class PlanStages:
    """The plans themselves: (T, N + 1) over planning steps and stages.

    pose: (T, N + 1, 3). inputs: (T, N + 1, 2), NaN at the last stage. barrier_m2: the smallest h over
    the known obstacles at that stage, NaN without obstacles (or without a barrier); gamma, slack_m2:
    that obstacle's; track_id: its id or NO_ID.
    """

    pose: FloatArray
    inputs: FloatArray
    barrier_m2: FloatArray
    gamma: FloatArray
    slack_m2: FloatArray
    track_id: IntArray


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive of T control ticks, `period_s` apart (open loop: one a scan, `period_s` their median).

    planner: "logged" for the log's own driver, whose `steps` and `stages` are None. seed: 0 in open loop.
    stages: None too where they were not kept (`Entry.keep_stages`). The last tick of a drive in closed loop
        is planned, but what it plans is not driven.
    pose: (T, 3) and inputs: (T, 2): where it is at the tick, and what it applies from then on.
    clearance_m: (T,) surface distance to the nearest true obstacle (negative: overlap), NaN where the
        recording knows of none then; nearest_id: (T,) that object, or NO_ID. A collision between two
        ticks counts for the later one.
    ttc_s: (T,) time to collision at constant velocities with any obstacle, NaN where none is in course.
    reference_m: (T,) distance from the reference path. along_m: (T,) progress along it.
    log_m: (T,) distance from where the log's vehicle was then, NaN where the log does not say.
    recorded: (T,) whether the recording covers this tick; after it only what stands is still there.
    result: None in open loop. goal_reachable: (T,) False where the goal lies within a true obstacle.
    plan_error_m: open loop only: (T, N + 1) distance of each plan's stage from where the logged vehicle
        then was, NaN where the log does not say; else None.
    nominal_s: the reference's length over its speed.
    """

    planner: str
    seed: int
    period_s: float
    nominal_s: float
    reference_length_m: float
    reference_speed_mps: float
    stamp_ns: IntArray
    pose: FloatArray
    inputs: FloatArray
    clearance_m: FloatArray
    nearest_id: IntArray
    ttc_s: FloatArray
    reference_m: FloatArray
    along_m: FloatArray
    log_m: FloatArray
    recorded: BoolArray
    goal_reachable: BoolArray
    result: Result | None
    steps: PlanSteps | None
    stages: PlanStages | None
    plan_error_m: FloatArray | None = None
