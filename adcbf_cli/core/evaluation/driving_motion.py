"""Metrics of the vehicle's motion: arriving, keeping clear, driving smoothly, keeping to the path."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.evaluation.driving_evidence import (
    Applies,
    DriveMetric,
    Evidence,
    highest,
    known,
    lowest,
    rms,
    share,
)
from adcbf_cli.core.replay.records import Result
from adcbf_cli.core.types import BoolArray, FloatArray

SMOOTH_S = 0.5
"""Lag of second differences. Differences over single control periods would show the period's length
and the solver's last digits; over 0.5 s they are means over one second, the time over which
ISO 15622 averages jerk."""

_DRIVEN, _CLOSED = Applies.DRIVEN, Applies.CLOSED


def _ended(result: Result) -> DriveMetric:
    """The 0/1 metric of one way to end."""

    def measure(evidence: Evidence) -> float:
        return float(evidence.drive.result is result)

    better, meaning = {
        Result.SUCCESS: ("higher", "1 where the goal was reached, within replay.goal_tolerance_m"),
        Result.COLLISION: ("lower", "1 where the vehicle's circle met a true obstacle"),
        Result.TIMEOUT: ("lower", "1 where replay.timeout_factor times the nominal time passed before the goal"),
    }[result]
    return DriveMetric(
        result.value,
        "1",
        "higher" if better == "higher" else "lower",
        _CLOSED,
        "drive",
        meaning,
        measure,
        is_event=True,
    )


def nav_time_s(evidence: Evidence) -> float | None:
    return float(evidence.elapsed_s[-1]) if evidence.arrived and len(evidence.elapsed_s) else None


def path_length_m(evidence: Evidence) -> float | None:
    """Sum of the chords between ticks."""
    legs = np.diff(evidence.drive.pose[:, :2], axis=0)
    return float(np.hypot(legs[:, 0], legs[:, 1]).sum()) if evidence.arrived and len(legs) else None


def min_dist_m(evidence: Evidence) -> float | None:
    return lowest(evidence.drive.clearance_m)


def min_ttc_s(evidence: Evidence) -> float | None:
    return lowest(evidence.drive.ttc_s)


def time_below_clearance_s(evidence: Evidence) -> float | None:
    drive = evidence.drive
    judged = np.isfinite(drive.clearance_m)
    if not judged.any():
        return None
    with np.errstate(invalid="ignore"):
        return float(evidence.held_s[judged & (drive.clearance_m < evidence.replay.clearance_m)].sum())


def vel_var(evidence: Evidence) -> float | None:
    """Population variance of the applied speed."""
    drive = evidence.drive
    with np.errstate(invalid="ignore"):
        near = drive.clearance_m < evidence.replay.near_m
    speed = known(drive.inputs[near, 0])
    return float(speed.var()) if speed.size >= 2 else None


def second_difference(values: FloatArray, at_s: FloatArray, period_s: float) -> FloatArray:
    """(x(t + w) - 2 x(t) + x(t - w)) / w^2 at all ticks t that have both neighbours, w being
    SMOOTH_S in whole periods: the mean of x'' over 2 w, with triangular weights.

    values, at_s: (T,). Unevenly spaced values are taken as linear between their times. Empty where
    the drive is shorter than 2 w.
    """
    lag = max(1, round(SMOOTH_S / period_s))
    if len(values) < 2:
        return np.zeros(0)
    grid = period_s * np.arange(int(at_s[-1] / period_s + 1e-6) + 1)
    x = np.interp(grid, at_s, values)
    if len(x) <= 2 * lag:
        return np.zeros(0)
    return np.asarray((x[2 * lag :] - 2 * x[lag:-lag] + x[: -2 * lag]) / (lag * period_s) ** 2)


def jerk_mps3(evidence: Evidence) -> FloatArray:
    return second_difference(evidence.drive.inputs[:, 0], evidence.elapsed_s, evidence.drive.period_s)


def yaw_accel_radps2(evidence: Evidence) -> FloatArray:
    """From the yaw itself, which the applied inputs turn exactly, whatever kind of vehicle it is."""
    yaw = np.unwrap(evidence.drive.pose[:, 2])
    return second_difference(yaw, evidence.elapsed_s, evidence.drive.period_s)


def speeding_up(speed_mps: FloatArray) -> BoolArray:
    """(T,) the first ticks, for as long as the speed rises from each to the next."""
    rises = np.append(np.diff(speed_mps) > 0, False)[: len(speed_mps)]
    return np.logical_and.accumulate(rises)


def freezing_s(evidence: Evidence) -> float | None:
    drive, replay = evidence.drive, evidence.replay
    if not drive.goal_reachable.any():
        return None
    speed = np.abs(drive.inputs[:, 0])
    to_goal_m = np.hypot(drive.reference_length_m - drive.along_m, drive.reference_m)
    frozen = (speed < replay.freeze_speed_mps) & (to_goal_m > replay.goal_tolerance_m) & drive.goal_reachable
    return float(evidence.held_s[frozen & ~speeding_up(speed)].sum())


def _far_from_log(evidence: Evidence) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray(evidence.drive.log_m > evidence.replay.divergence_m)


def diverged_from_log_s(evidence: Evidence) -> float | None:
    far = np.flatnonzero(_far_from_log(evidence))
    return float(evidence.elapsed_s[far[0]]) if far.size else None


def diverged_share(evidence: Evidence) -> float | None:
    return share(_far_from_log(evidence)[np.isfinite(evidence.drive.log_m)])


def after_recording_s(evidence: Evidence) -> float | None:
    return float(evidence.held_s[~evidence.drive.recorded].sum())


_KNOWN = "ticks with a known obstacle"
_SMOOTH = "ticks with 0.5 s of driving on both sides"

MOTION: tuple[DriveMetric, ...] = (
    _ended(Result.SUCCESS),
    _ended(Result.COLLISION),
    _ended(Result.TIMEOUT),
    DriveMetric(
        "nav_time_s",
        "s",
        "lower",
        _DRIVEN,
        "drives that arrive",
        "Nav-time: from the first tick to the one at which the goal is reached; null for drives that fail",
        nav_time_s,
    ),
    DriveMetric(
        "min_dist_m",
        "m",
        "higher",
        _DRIVEN,
        _KNOWN,
        "Min-dist: smallest surface distance between the vehicle's circle and a true obstacle; negative: overlap",
        min_dist_m,
    ),
    DriveMetric(
        "vel_var",
        "m2/s2",
        "lower",
        _DRIVEN,
        "ticks with an obstacle nearer than replay.near_m, two at least",
        "Vel-var: population variance of the applied speed",
        vel_var,
    ),
    DriveMetric(
        "path_length_m",
        "m",
        "lower",
        _DRIVEN,
        "drives that arrive",
        "Path-len: length of the way driven, chords between ticks; null for drives that fail",
        path_length_m,
    ),
    DriveMetric(
        "time_below_clearance_s",
        "s",
        "lower",
        _DRIVEN,
        _KNOWN,
        "time with a true obstacle nearer than replay.clearance_m, surface to surface",
        time_below_clearance_s,
    ),
    DriveMetric(
        "min_ttc_s",
        "s",
        "higher",
        _DRIVEN,
        _KNOWN,
        "smallest time to collision at constant velocities; null where nothing was ever on course",
        min_ttc_s,
    ),
    DriveMetric(
        "jerk_rms_mps3",
        "m/s3",
        "lower",
        _DRIVEN,
        _SMOOTH,
        "root mean square of the second difference over 0.5 s of the applied speed",
        lambda evidence: rms(jerk_mps3(evidence)),
    ),
    DriveMetric(
        "jerk_max_mps3",
        "m/s3",
        "lower",
        _DRIVEN,
        _SMOOTH,
        "largest magnitude of the same",
        lambda evidence: highest(np.abs(jerk_mps3(evidence))),
    ),
    DriveMetric(
        "yaw_accel_rms_radps2",
        "rad/s2",
        "lower",
        _DRIVEN,
        _SMOOTH,
        "root mean square of the second difference over 0.5 s of the yaw that the applied inputs give",
        lambda evidence: rms(yaw_accel_radps2(evidence)),
    ),
    DriveMetric(
        "yaw_accel_max_radps2",
        "rad/s2",
        "lower",
        _DRIVEN,
        _SMOOTH,
        "largest magnitude of the same",
        lambda evidence: highest(np.abs(yaw_accel_radps2(evidence))),
    ),
    DriveMetric(
        "reference_rms_m",
        "m",
        "lower",
        _DRIVEN,
        "ticks",
        "root mean square of the distance from the reference path",
        lambda evidence: rms(evidence.drive.reference_m),
    ),
    DriveMetric(
        "reference_max_m",
        "m",
        "lower",
        _DRIVEN,
        "ticks",
        "largest distance from the reference path",
        lambda evidence: highest(evidence.drive.reference_m),
    ),
    DriveMetric(
        "freezing_s",
        "s",
        "lower",
        _DRIVEN,
        "ticks at which no true obstacle covers the goal",
        "time slower than replay.freeze_speed_mps and farther than replay.goal_tolerance_m from the goal; "
        "not while speeding up at the drive's start",
        freezing_s,
    ),
    DriveMetric(
        "diverged_from_log_s",
        "s",
        "neither",
        _CLOSED,
        "ticks at which the log tells its vehicle's place",
        "time of driving until the vehicle was first farther than replay.divergence_m from the log's, so that "
        "the sensor would have seen something else from then on; null: never",
        diverged_from_log_s,
    ),
    DriveMetric(
        "diverged_share",
        "1",
        "neither",
        _CLOSED,
        "ticks at which the log tells its vehicle's place",
        "share farther than replay.divergence_m from it",
        diverged_share,
    ),
    DriveMetric(
        "after_recording_s",
        "s",
        "neither",
        _CLOSED,
        "ticks",
        "time driven after the recording's end, when nothing is known of obstacles that move",
        after_recording_s,
    ),
)
