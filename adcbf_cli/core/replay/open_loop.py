"""Planners plan along a log: at each scan from where the log's vehicle was, whatever they planned
before. What they plan is compared with what the log's driver then did; nothing of it is driven."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.planning.planner import Planner, Situation
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.replay.closed_loop import PerceptionFeed
from adcbf_cli.core.replay.drive_log import DriveLog, Setting
from adcbf_cli.core.replay.log_path import LogPath, inputs_of
from adcbf_cli.core.replay.records import LOGGED, Drive
from adcbf_cli.core.replay.world import RecordedWorld
from adcbf_cli.core.types import FloatArray, Notes, Predictions
from adcbf_cli.core.vehicles.vehicle import Vehicle

LOST_M = 1.0
"""A vehicle that is nearer to another place of its path by this has jumped there."""

SPEED_TOLERANCE = 0.05
MAX_SHARE_BEYOND = 0.01
"""A log whose vehicle is faster than this vehicle can be, by more than SPEED_TOLERANCE and in more than
MAX_SHARE_BEYOND of the scans, is another vehicle's."""


def plan_along(
    planners: Sequence[Planner],
    predictions: Iterable[Predictions],
    world: RecordedWorld,
    log_path: LogPath,
    path: ReferencePath,
    vehicle: Vehicle,
    config: Config,
    clock: Callable[[], int],
    notes: Notes,
) -> list[Drive]:
    """One drive a planner, in their order, with a tick a scan; poses and inputs are the log's.

    Planners are given the logged inputs as far as the vehicle's bounds allow. UsageError where the log's
    speed is not this vehicle's; AdcbfError where there is no prediction.
    """
    check_speed(log_path, config)
    setting = Setting(world, log_path, vehicle, config)
    feed = PerceptionFeed(predictions, setting, notes)
    logs = [DriveLog(setting, planner.name, 0, path, keep_stages=True) for planner in planners]
    errors: list[list[FloatArray]] = [[] for _ in planners]
    planning = config.planning
    logged = logged_inputs(log_path, vehicle)
    along_m: float | None = None
    for i, stamp_ns in enumerate(log_path.stamp_ns.tolist()):
        pose, inputs = log_path.pose[i], logged[i]
        knowledge = feed.at(stamp_ns)
        along_m = _along(path, pose[:2], along_m)
        applied = np.clip(inputs, vehicle.input_min, vehicle.input_max)
        known = knowledge.obstacles(
            stamp_ns, pose[:2], setting.range_m, planning.steps, planning.step_s, planning.uncertainty
        )
        for planner, log, error in zip(planners, logs, errors, strict=True):
            log.tick(stamp_ns, pose, float(inputs[0]), along_m, None)
            situation = Situation(stamp_ns, pose.copy(), applied.copy(), path, known)
            before = clock()
            plan = planner.plan(situation)
            log.planned(plan, pose, known, (clock() - before) / 1e6)
            log.applied(inputs)
            error.append(plan_error(plan.poses, log_path, stamp_ns, planning.step_s))
    period_s = scan_period_s(log_path)
    return [log.drive(period_s, None, np.stack(error)) for log, error in zip(logs, errors, strict=True)]


def logged_drive(
    log_path: LogPath, world: RecordedWorld, path: ReferencePath, vehicle: Vehicle, config: Config
) -> Drive:
    """The log's own driver, measured as the planners are, with this vehicle's body and inputs."""
    log = DriveLog(Setting(world, log_path, vehicle, config), LOGGED, 0, path, keep_stages=False)
    along_m: float | None = None
    inputs = logged_inputs(log_path, vehicle)
    for i, stamp_ns in enumerate(log_path.stamp_ns.tolist()):
        along_m = _along(path, log_path.pose[i, :2], along_m)
        log.tick(stamp_ns, log_path.pose[i], float(inputs[i, 0]), along_m, None)
        log.applied(inputs[i])
    return log.drive(scan_period_s(log_path), None)


def logged_inputs(log_path: LogPath, vehicle: Vehicle) -> FloatArray:
    """(T, 2) the log's motion in this kind of vehicle's inputs; zero where the log does not say."""
    motion = np.column_stack([log_path.speed_mps, log_path.yaw_rate_radps])
    return inputs_of(np.nan_to_num(motion), vehicle)


def scan_period_s(log_path: LogPath) -> float:
    """The median time between scans; a log of one scan has none, and counts as a second."""
    return float(np.median(np.diff(log_path.stamp_ns))) / 1e9 if len(log_path.stamp_ns) > 1 else 1.0


def plan_error(poses: FloatArray, log_path: LogPath, stamp_ns: int, step_s: float) -> FloatArray:
    """(N + 1,) distance of planned poses (N + 1, 3) from where the log's vehicle then was."""
    then = log_path.at(stamp_ns + np.round(np.arange(len(poses)) * step_s * 1e9).astype(np.int64))
    return np.asarray(np.hypot(poses[:, 0] - then[:, 0], poses[:, 1] - then[:, 1]))


def check_speed(log_path: LogPath, config: Config) -> None:
    """UsageError where the log's vehicle is faster, or reverses more, than the configured one can."""
    speed = log_path.speed_mps[np.isfinite(log_path.speed_mps)]
    low, high = config.vehicle.min_speed_mps, config.vehicle.max_speed_mps
    slack = SPEED_TOLERANCE * high
    if not len(speed):
        return
    if np.mean(speed > high + slack) > MAX_SHARE_BEYOND:
        top = float(speed.max())
        raise UsageError(
            f"the log's vehicle drove up to {top:.1f} m/s, vehicle.max_speed_mps is {high:g}: "
            f"set it with --set vehicle.max_speed_mps={_rounded_up(top):g}"
        )
    if np.mean(speed < low - slack) > MAX_SHARE_BEYOND:
        top = float(-speed.min())
        raise UsageError(
            f"the log's vehicle reversed with up to {top:.1f} m/s, vehicle.min_speed_mps is {low:g}: "
            f"set it with --set vehicle.min_speed_mps={-_rounded_up(top):g}"
        )


def _rounded_up(speed_mps: float) -> float:
    """To the next whole number from 5 m/s on, to the next tenth below."""
    return float(math.ceil(speed_mps)) if speed_mps >= 5.0 else math.ceil(10.0 * speed_mps) / 10.0


def _along(path: ReferencePath, point_m: FloatArray, last_m: float | None) -> float:
    """Progress along the path: near the last one, unless the vehicle is nowhere near there any more, as
    after a gap in the log's poses."""
    return path.nearest(point_m) if last_m is None else path.nearest_or_found(point_m, last_m, LOST_M)
