"""Drives built by hand, for the tests of driving metrics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from adcbf_cli.core.replay.records import Drive, PlanStages, PlanSteps, Result
from adcbf_cli.core.types import NO_ID

START_NS = 1_700_000_000_000_000_000
PERIOD_S = 0.1
NAN = float("nan")


def steps_of(ticks: int, **columns: Any) -> PlanSteps:
    """Solved, without obstacles or conflict, in 2 ms each."""
    base = PlanSteps(
        outcome=("solved",) * ticks,
        status=("converged",) * ticks,
        start=("shifted",) * ticks,
        iterations=np.full(ticks, 5),
        merit=np.ones(ticks),
        violation_m2=np.zeros(ticks),
        decay=np.ones(ticks),
        feasible=np.ones(ticks),
        obstacles=np.zeros(ticks, dtype=np.int64),
        dropped=np.zeros(ticks, dtype=np.int64),
        conflict=np.zeros(ticks, dtype=bool),
        deviation_m=np.zeros(ticks),
        solve_ms=np.full(ticks, 2.0),
    )
    return replace(base, **columns)


def stages_of(ticks: int, stages: int, **columns: Any) -> PlanStages:
    base = PlanStages(
        pose=np.zeros((ticks, stages + 1, 3)),
        inputs=np.zeros((ticks, stages + 1, 2)),
        barrier_m2=np.full((ticks, stages + 1), NAN),
        gamma=np.full((ticks, stages + 1), NAN),
        slack_m2=np.full((ticks, stages + 1), NAN),
        track_id=np.full((ticks, stages + 1), NO_ID),
    )
    return replace(base, **columns)


def drive_of(
    speed: Sequence[float] | np.ndarray,
    yaw_rate: Sequence[float] | np.ndarray | None = None,
    period_s: float = PERIOD_S,
    **columns: Any,
) -> Drive:
    """A successful drive with these speeds, one a tick, along the x axis unless it turns; nothing is near."""
    v = np.asarray(speed, dtype=float)
    w = np.zeros_like(v) if yaw_rate is None else np.asarray(yaw_rate, dtype=float)
    ticks = len(v)
    yaw = np.append(0.0, np.cumsum(w * period_s))[:ticks]
    x = np.append(0.0, np.cumsum(v * period_s * np.cos(yaw)))[:ticks]
    y = np.append(0.0, np.cumsum(v * period_s * np.sin(yaw)))[:ticks]
    base = Drive(
        planner="mine",
        seed=0,
        period_s=period_s,
        nominal_s=10.0,
        reference_length_m=100.0,
        reference_speed_mps=1.0,
        stamp_ns=START_NS + np.round(np.arange(ticks) * period_s * 1e9).astype(np.int64),
        pose=np.column_stack([x, y, yaw]),
        inputs=np.column_stack([v, w]),
        clearance_m=np.full(ticks, NAN),
        nearest_id=np.full(ticks, NO_ID),
        ttc_s=np.full(ticks, NAN),
        reference_m=np.abs(y),
        along_m=x,
        log_m=np.full(ticks, NAN),
        recorded=np.ones(ticks, dtype=bool),
        goal_reachable=np.ones(ticks, dtype=bool),
        result=Result.SUCCESS,
        steps=steps_of(ticks),
        stages=stages_of(ticks, 3),
    )
    return replace(base, **columns)


def turned(drive: Drive, angle_rad: float, shift_m: tuple[float, float], later_ns: int) -> Drive:
    """The same drive elsewhere in the world, and later."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    place = drive.pose[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + shift_m
    return replace(
        drive, pose=np.column_stack([place, drive.pose[:, 2] + angle_rad]), stamp_ns=drive.stamp_ns + later_ns
    )
