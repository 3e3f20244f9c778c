"""Metrics of the planning steps: the fallback ladder, the barrier, time, and error in open loop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adcbf_cli.core.evaluation.driving_evidence import (
    Applies,
    DriveMetric,
    Evidence,
    highest,
    known,
    lowest,
    mean,
    quantile,
    share,
)
from adcbf_cli.core.planning.planner import Outcome
from adcbf_cli.core.replay.records import PlanStages, PlanSteps, Result
from adcbf_cli.core.types import BoolArray, FloatArray

AFTER_FALLBACK_S = 3.0
"""A collision this soon after a step of the fallback ladder follows from it."""

PLAN_ERROR_S = (1, 2, 3)
"""Horizons of the open loop's error."""

_STEPS = "planning steps"


def of_outcome(steps: PlanSteps, *wanted: Outcome) -> BoolArray:
    """(T,) whether the step ended as one of `wanted`."""
    return np.isin(np.array(steps.outcome, dtype=object), [outcome.value for outcome in wanted])


def planned(steps: PlanSteps) -> BoolArray:
    """(T,) whether there was a planning step at all: none may follow the drive's end."""
    return np.array([outcome != "" for outcome in steps.outcome], dtype=bool)


def _outcome_rate(outcome: Outcome, meaning: str) -> DriveMetric:
    def measure(evidence: Evidence) -> float | None:
        steps = evidence.drive.steps
        return None if steps is None else share(of_outcome(steps, outcome)[planned(steps)])

    return DriveMetric(f"{outcome}_rate", "1", "lower", Applies.PLANNED, _STEPS, meaning, measure)


def fell_back(evidence: Evidence, steps: PlanSteps) -> BoolArray:
    """(T,) whether the step's plan came from the fallback ladder. A collision's own tick is none: whatever
    is planned there comes too late."""
    fallback = of_outcome(steps, Outcome.RELAXED, Outcome.BRAKED, Outcome.STOPPED)
    if evidence.drive.result is Result.COLLISION:
        fallback[-1:] = False
    return fallback


def infeasible_rate(evidence: Evidence) -> float | None:
    steps = evidence.drive.steps
    return None if steps is None else share(known(steps.feasible) == 0.0)


def dropped_rate(evidence: Evidence) -> float | None:
    steps = evidence.drive.steps
    return None if steps is None else share(steps.dropped[planned(steps)] > 0)


def collision_after_fallback(evidence: Evidence) -> float | None:
    drive = evidence.drive
    if drive.steps is None:
        return None
    if drive.result is not Result.COLLISION:
        return 0.0
    before_s = evidence.elapsed_s[-1] - evidence.elapsed_s
    return float((fell_back(evidence, drive.steps) & (before_s <= AFTER_FALLBACK_S)).any())


def deadline_missed_rate(evidence: Evidence) -> float | None:
    steps = evidence.drive.steps
    return None if steps is None else share(known(steps.solve_ms) > 1e3 / evidence.planning.rate_hz)


def _of_steps(
    column: Callable[[PlanSteps], FloatArray], reduce: Callable[[FloatArray], float | None]
) -> Callable[[Evidence], float | None]:
    def measure(evidence: Evidence) -> float | None:
        steps = evidence.drive.steps
        return None if steps is None else reduce(column(steps))

    return measure


def _of_stages(
    column: Callable[[PlanStages], FloatArray], reduce: Callable[[FloatArray], float | None]
) -> Callable[[Evidence], float | None]:
    def measure(evidence: Evidence) -> float | None:
        stages = evidence.drive.stages
        return None if stages is None else reduce(column(stages))

    return measure


def _solve_time(name: str, what: str, reduce: Callable[[FloatArray], float | None]) -> DriveMetric:
    definition = f"{what} of the wall time of a planning step, as the machine at hand takes it"
    measure = _of_steps(lambda steps: steps.solve_ms, reduce)
    return DriveMetric(f"solve_{name}_ms", "ms", "lower", Applies.PLANNED, _STEPS, definition, measure)


def plan_error_m(evidence: Evidence, ahead_s: float) -> float | None:
    """Mean over plans of their error `ahead_s` on, linear between stages; None beyond the horizon."""
    errors = evidence.drive.plan_error_m
    if errors is None:
        return None
    stage = ahead_s / evidence.planning.step_s
    before = int(stage + 1e-9)
    after, part = before + 1, stage - before
    if part < 1e-9:
        after, part = before, 0.0
    if after >= errors.shape[1]:
        return None
    return mean((1 - part) * errors[:, before] + part * errors[:, after])


def _plan_error(ahead_s: int) -> DriveMetric:
    return DriveMetric(
        f"plan_error_{ahead_s}s_m",
        "m",
        "lower",
        Applies.OPEN,
        "plans for whose time the log tells its vehicle's place",
        f"mean distance between the place planned for {ahead_s} s on and where the logged vehicle then was; "
        "null where the horizon is shorter",
        lambda evidence: plan_error_m(evidence, ahead_s),
    )


PLANNING: tuple[DriveMetric, ...] = (
    DriveMetric(
        "infeasible_rate",
        "1",
        "lower",
        Applies.PLANNED,
        "planning steps of an optimising planner",
        "share whose barriers do not hold without slack, to 1e-6 m2",
        infeasible_rate,
    ),
    _outcome_rate(Outcome.RELAXED, "share that ended in a plan with slack or decay"),
    _outcome_rate(Outcome.BRAKED, "share that had no usable plan and braked"),
    _outcome_rate(Outcome.STOPPED, "share that had no usable plan while the vehicle stood"),
    DriveMetric(
        "collision_after_fallback",
        "1",
        "lower",
        Applies.CLOSED,
        "drive",
        "1 where the drive ended in a collision within 3 s after a relaxed, braked or stopped step; the step at "
        "the collision itself does not count",
        collision_after_fallback,
        is_event=True,
    ),
    DriveMetric(
        "violation_max_m2",
        "m2",
        "lower",
        Applies.PLANNED,
        _STEPS,
        "largest barrier violation in a plan",
        _of_steps(lambda steps: steps.violation_m2, highest),
    ),
    DriveMetric(
        "decay_min",
        "1",
        "higher",
        Applies.PLANNED,
        _STEPS,
        "smallest decay in a plan; 1 is none",
        _of_steps(lambda steps: steps.decay, lowest),
    ),
    DriveMetric(
        "barrier_min_m2",
        "m2",
        "higher",
        Applies.PLANNED,
        "stages of all plans",
        "smallest barrier h that a plan leads to, with the obstacles as they were known",
        _of_stages(lambda stages: stages.barrier_m2, lowest),
    ),
    DriveMetric(
        "gamma_min",
        "1",
        "neither",
        Applies.PLANNED,
        "stages of all plans",
        "smallest gamma of the obstacle with the smallest barrier",
        _of_stages(lambda stages: stages.gamma, lowest),
    ),
    DriveMetric(
        "gamma_max",
        "1",
        "neither",
        Applies.PLANNED,
        "stages of all plans",
        "largest gamma of the obstacle with the smallest barrier",
        _of_stages(lambda stages: stages.gamma, highest),
    ),
    DriveMetric(
        "dropped_rate",
        "1",
        "lower",
        Applies.PLANNED,
        _STEPS,
        "share that knew of more obstacles than planning.max_obstacles, and left some out",
        dropped_rate,
    ),
    _solve_time("p50", "median", lambda times: quantile(times, 0.5)),
    _solve_time("p95", "95 % quantile", lambda times: quantile(times, 0.95)),
    _solve_time("p99", "99 % quantile", lambda times: quantile(times, 0.99)),
    _solve_time("max", "largest", highest),
    DriveMetric(
        "deadline_missed_rate",
        "1",
        "lower",
        Applies.PLANNED,
        _STEPS,
        "share that took longer than 1 / planning.rate_hz",
        deadline_missed_rate,
    ),
    *(_plan_error(ahead_s) for ahead_s in PLAN_ERROR_S),
)
