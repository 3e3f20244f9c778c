"""Where to drive, and from where: the path of a replay, and the starts of its seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.planning.planner import Planner
from adcbf_cli.core.planning.reference import MIN_SPACING_M, ReferencePath
from adcbf_cli.core.replay.log_path import LogPath
from adcbf_cli.core.replay.world import RecordedWorld
from adcbf_cli.core.types import FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

PAPER_SPEED_MPS = 0.75
"""The paper's path of 36 m takes 47 to 50 s."""

MOVING_MPS = 0.05
"""Slower is standing still."""

ROUTE_SPACING_M = 0.1
"""Points of a logged path closer than this say more about the pose's noise than about the path."""

MAX_DRAWS = 100

MOST_STEPS = 1_000_000
"""Planning steps of one drive, at most: some hours of computing, and over nine hours of driving at 30 Hz."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One drive to be made: a planner of its own, from a pose (3,) with inputs (2,) applied, along a path.

    keep_stages: whether the drive's record holds every plan's stages, not only what was driven.
    """

    planner: Planner
    seed: int
    start_ns: int
    start_pose: FloatArray
    start_inputs: FloatArray
    path: ReferencePath
    keep_stages: bool = True


@dataclass(frozen=True, slots=True)
class Start:
    """When and where a seed's drives begin, and with which inputs applied."""

    stamp_ns: int
    pose: FloatArray
    inputs: FloatArray


def reference_speed(config: Config) -> float:
    """Speed along the reference, m/s. UsageError where the vehicle cannot drive that fast."""
    wanted, fastest = config.planning.reference_speed_mps, config.vehicle.max_speed_mps
    if wanted is None:
        return min(PAPER_SPEED_MPS, fastest)
    if wanted > fastest:
        raise UsageError(
            f"planning.reference_speed_mps is {wanted:g}, but the vehicle reaches {fastest:g} m/s: "
            f"lower it, or set vehicle.max_speed_mps"
        )
    return wanted


def check_duration(path: ReferencePath, config: Config) -> None:
    """UsageError where a drive that never arrives would go on for more than MOST_STEPS."""
    factor = config.replay.timeout_factor
    limit_s = factor * path.length_m / path.speed_mps
    if limit_s * config.planning.rate_hz > MOST_STEPS:
        raise UsageError(
            f"{path.length_m:.1f} m at {path.speed_mps:g} m/s, given {factor:g} times as long "
            f"(replay.timeout_factor), are {limit_s:.3g} s: over {MOST_STEPS:,} planning steps a drive; "
            "take a higher --speed, or a lower planning.rate_hz"
        )


def logged_speed(log_path: LogPath) -> float:
    """The mean speed, m/s, at which the log's vehicle moved, where it did; the paper's where it never did."""
    moving = log_path.speed_mps[np.abs(np.nan_to_num(log_path.speed_mps)) > MOVING_MPS]
    return float(np.abs(moving).mean()) if len(moving) else PAPER_SPEED_MPS


def route_from_log(log_path: LogPath, speed_mps: float) -> ReferencePath:
    """The path that the log's vehicle took. UsageError where it stood still."""
    points = log_path.smooth_m
    kept = [0]
    for i in range(1, len(points)):
        if np.hypot(*(points[i] - points[kept[-1]])) >= ROUTE_SPACING_M:
            kept.append(i)
    return ReferencePath(points[kept], speed_mps)


def route_between(start_m: FloatArray, goal_m: FloatArray, speed_mps: float, box: MapBox) -> ReferencePath:
    """The straight line between two points (2,). UsageError where one lies outside the map, or both are one."""
    box.check("start", start_m)
    box.check("goal", goal_m)
    if float(np.hypot(*(goal_m - start_m))) < MIN_SPACING_M:
        raise UsageError(f"the goal ({goal_m[0]:g}, {goal_m[1]:g}) is where the way starts: there is nothing to drive")
    return ReferencePath(np.stack([start_m, goal_m]), speed_mps)


@dataclass(frozen=True, slots=True)
class MapBox:
    """The part of the world that the log knows: lowest and highest x, y (2,), in m."""

    low_m: FloatArray
    high_m: FloatArray

    def check(self, what: str, point_m: FloatArray) -> None:
        """UsageError where a point (2,) is outside."""
        point = np.asarray(point_m, dtype=float)
        if not np.isfinite(point).all() or (point < self.low_m).any() or (point > self.high_m).any():
            low, high = self.low_m, self.high_m
            raise UsageError(
                f"the {what} ({point[0]:g}, {point[1]:g}) is outside the map that the log knows: "
                f"x from {low[0]:.1f} to {high[0]:.1f} m, y from {low[1]:.1f} to {high[1]:.1f} m"
            )


def map_box(log_path: LogPath, world: RecordedWorld, range_m: float) -> MapBox:
    """The box around the logged path, if any, and everything seen, grown by the sensor's range."""
    corners: list[FloatArray] = list(world.bounds() or ())
    if log_path.known:
        corners += [log_path.pose[:, :2].min(axis=0), log_path.pose[:, :2].max(axis=0)]
    if not corners:
        raise AdcbfError("the log knows neither a vehicle's path nor a single obstacle: there is no map to drive on")
    return MapBox(np.min(corners, axis=0) - range_m, np.max(corners, axis=0) + range_m)


def log_start(log_path: LogPath, path: ReferencePath, vehicle: Vehicle, from_log: bool = True) -> Start:
    """Where seed 0 starts: with the log, at its vehicle's own pose and inputs, these limited to what the
    vehicle can and to the reference's speed; or, on a path of its own, standing at that path's start."""
    if not from_log:
        return Start(log_path.start_ns, path.at(np.zeros(1))[0], np.zeros(2))
    highest = np.array([min(path.speed_mps, vehicle.input_max[0]), vehicle.input_max[1]])
    inputs = np.clip(log_path.inputs_at(log_path.start_ns, vehicle), vehicle.input_min, highest)
    return Start(log_path.start_ns, log_path.pose[0].copy(), inputs)


def start_of(seed: int, first: Start, world: RecordedWorld, vehicle: Vehicle, config: Config) -> Start:
    """The start of one seed: 0 is `first`; others are displaced to the side and start later.

    The draw depends on the seed only, so that all planners start alike. A start in a collision is drawn
    again; AdcbfError after MAX_DRAWS of them.
    """
    if seed == 0:
        return first
    rng = np.random.default_rng([seed])
    side = np.array([-np.sin(first.pose[2]), np.cos(first.pose[2])])
    tick_ns = 1e9 / config.planning.rate_hz
    for _ in range(MAX_DRAWS):
        offset_m = rng.normal(0.0, config.replay.start_offset_m)
        delay_ns = rng.uniform(0.0, config.replay.start_delay_s) * 1e9
        stamp_ns = first.stamp_ns + round(round(delay_ns / tick_ns) * tick_ns)
        pose = first.pose + np.append(offset_m * side, 0.0)
        clearance, _ = world.nearest(pose[:2], vehicle.body_radius_m, stamp_ns)
        if not clearance < 0.0:
            return Start(stamp_ns, pose, first.inputs)
    raise AdcbfError(
        f"seed {seed}: none of {MAX_DRAWS} starts around ({first.pose[0]:.1f}, {first.pose[1]:.1f}) is free of "
        "obstacles: set replay.start_offset_m larger, or give another --start"
    )


def entries_for(
    names: Sequence[str],
    seeds: Sequence[int],
    make: Callable[[str], Planner],
    path: ReferencePath,
    first: Start,
    world: RecordedWorld,
    vehicle: Vehicle,
    config: Config,
) -> list[Entry]:
    """One entry a planner and seed, planners by name in the order given; `make` builds a fresh planner.
    Stages are kept of the first seed only: they are thirty times what the rest of a drive takes."""
    starts = {seed: start_of(seed, first, world, vehicle, config) for seed in seeds}
    return [
        Entry(
            planner=make(name),
            seed=seed,
            start_ns=starts[seed].stamp_ns,
            start_pose=starts[seed].pose,
            start_inputs=starts[seed].inputs,
            path=path,
            keep_stages=seed == seeds[0],
        )
        for name in names
        for seed in seeds
    ]
