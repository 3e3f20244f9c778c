"""Planners drive through a recorded world: each plan's first inputs move the vehicle, whose place
decides what it plans next. The world does not answer: it moves as it was recorded.

All drives advance together in one pass over the predictions. docs/replay.md says what that can show.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.planning.planner import Plan, Situation
from adcbf_cli.core.planning.problem import Obstacles
from adcbf_cli.core.replay.drive_log import DriveLog, Setting
from adcbf_cli.core.replay.knowledge import Knowledge, Uncertainty
from adcbf_cli.core.replay.log_path import LogPath
from adcbf_cli.core.replay.records import Drive, Result
from adcbf_cli.core.replay.routes import Entry
from adcbf_cli.core.replay.world import RecordedWorld
from adcbf_cli.core.types import FloatArray, Notes, Predictions
from adcbf_cli.core.vehicles.vehicle import Vehicle

CHECK_SPACING_M = 0.02
"""Between ticks, a collision is looked for each time that ego and obstacles may have come this much closer."""

LEFT_TOLERANCES = 2.0
"""The goal counts as reached with no more than this many goal tolerances of path left: a path may start
where it ends, and pass its goal more than once."""

INPUT_TOLERANCE = 1e-9


def replay(
    entries: Sequence[Entry],
    predictions: Iterable[Predictions],
    world: RecordedWorld,
    log_path: LogPath,
    vehicle: Vehicle,
    config: Config,
    clock: Callable[[], int],
    notes: Notes,
) -> list[Drive]:
    """One drive an entry, in their order.

    predictions: ascending in time, read once. clock: nanoseconds, read around each planning step only.
    AdcbfError where there is no prediction at all.
    """
    setting = Setting(world, log_path, vehicle, config)
    feed = PerceptionFeed(predictions, setting, notes)
    drives = [Driver(entry, setting, clock, notes) for entry in entries]
    under_way = list(drives)
    while under_way:
        driver = min(under_way, key=lambda d: d.stamp_ns)
        driver.step(feed.at(driver.stamp_ns))
        if driver.result is not None:
            under_way.remove(driver)
    return [driver.drive() for driver in drives]


class PerceptionFeed:
    """Predictions in order of time, taken in as time goes on."""

    def __init__(self, predictions: Iterable[Predictions], setting: Setting, notes: Notes) -> None:
        """AdcbfError where there is none."""
        self._records: Iterator[Predictions] = iter(predictions)
        self._next: Predictions | None = next(self._records, None)
        if self._next is None:
            raise AdcbfError("there are no predictions to plan with: no obstacle was ever tracked long enough")
        self._log_path = setting.log_path
        if self._log_path.mount_note is not None:
            notes.warn(self._log_path.mount_note)
        self._knowledge = Knowledge(notes, setting.vehicle.body_radius_m)

    def at(self, stamp_ns: int) -> Knowledge:
        """What is known at this time; times must not go back."""
        while self._next is not None and self._next.stamp_ns <= stamp_ns:
            vehicle_m = self._log_path.at(np.array([self._next.stamp_ns]))[0, :2]
            self._knowledge.update(self._next, vehicle_m)
            self._next = next(self._records, None)
        if self._next is None and stamp_ns > self._log_path.end_ns:
            self._knowledge.end()
        return self._knowledge


class Known(Protocol):
    """What a planner may know of obstacles at a time; see `Knowledge.obstacles`."""

    def obstacles(
        self, stamp_ns: int, ego_m: FloatArray, range_m: float, steps: int, step_s: float, uncertainty: Uncertainty
    ) -> Obstacles: ...


class Driver:
    """One drive under way. stamp_ns: its next tick; pose (3,) there, and the inputs (2,) that led to it.
    result: None while it drives."""

    def __init__(self, entry: Entry, setting: Setting, clock: Callable[[], int], notes: Notes) -> None:
        self._entry = entry
        self._setting = setting
        self._clock = clock
        self._notes = notes
        self._period_s = 1.0 / setting.config.planning.rate_hz
        self._log = DriveLog(setting, entry.planner.name, entry.seed, entry.path, entry.keep_stages)
        self._tick = 0
        self.pose = np.array(entry.start_pose, dtype=float)
        self.inputs = np.array(entry.start_inputs, dtype=float)
        self._along_m = 0.0
        self._touched: tuple[float, int] | None = None
        nominal_s = entry.path.length_m / entry.path.speed_mps
        self._limit_s = setting.config.replay.timeout_factor * nominal_s
        self.stamp_ns = entry.start_ns
        self.result: Result | None = None

    def step(self, knowledge: Known, believed: FloatArray | None = None) -> None:
        """One tick: measure, plan, and drive on to the next. The drive's last tick is planned too, but
        what it plans is not driven. believed: the pose (3,) that the planner takes for its own; None: the true one.
        """
        setting, path = self._setting, self._entry.path
        self._along_m = path.nearest(self.pose[:2], self._along_m)
        self._log.tick(self.stamp_ns, self.pose, float(self.inputs[0]), self._along_m, self._touched)
        self.result = self._end()
        if self.result is Result.COLLISION and self._tick == 0:
            self._notes.warn(
                f"seed {self._entry.seed} starts in a collision: its drives end where they begin "
                "(vehicle.body_radius_m too large? else give another --start)"
            )
        planning = setting.config.planning
        pose = (self.pose if believed is None else believed).copy()
        known = knowledge.obstacles(
            self.stamp_ns, pose[:2], setting.range_m, planning.steps, planning.step_s, planning.uncertainty
        )
        situation = Situation(self.stamp_ns, pose, self.inputs.copy(), path, known)
        before = self._clock()
        plan = self._entry.planner.plan(situation)
        self._log.planned(plan, pose, known, (self._clock() - before) / 1e6)
        inputs = self._allowed(plan)
        self._log.applied(inputs)
        if self.result is None:
            self._drive_on(inputs)

    def drive(self) -> Drive:
        return self._log.drive(self._period_s, self.result)

    def _end(self) -> Result | None:
        if self._log.clearance_m < 0.0:
            return Result.COLLISION
        path, replay_config = self._entry.path, self._setting.config.replay
        to_goal_m = float(np.hypot(*(self.pose[:2] - path.goal_m)))
        left_m = path.length_m - self._along_m
        if to_goal_m <= replay_config.goal_tolerance_m and left_m <= LEFT_TOLERANCES * replay_config.goal_tolerance_m:
            return Result.SUCCESS
        if (self.stamp_ns - self._entry.start_ns) / 1e9 >= self._limit_s:
            return Result.TIMEOUT
        return None

    def _allowed(self, plan: Plan) -> FloatArray:
        """The plan's first inputs, as far as the vehicle can follow them."""
        vehicle, wanted = self._setting.vehicle, np.asarray(plan.inputs[0], dtype=float)
        if not np.isfinite(wanted).all():
            self._notes.count("plans_without_finite_inputs")
            wanted = vehicle.braking(self.inputs, 1, self._period_s)[0]
        inputs = vehicle.limited(wanted, self.inputs, self._period_s)
        if np.abs(inputs - wanted).max() > INPUT_TOLERANCE:
            self._notes.count("plans_beyond_the_vehicles_limits")
        return inputs

    def _drive_on(self, inputs: FloatArray) -> None:
        """To the next tick, looking for collisions in between."""
        start_ns = self.stamp_ns
        self._tick += 1
        self.stamp_ns = self._entry.start_ns + round(self._tick * 1e9 * self._period_s)
        moved = self._setting.vehicle.step(self.pose, inputs, self._period_s)
        self._touched = first_touch(self._setting, self.pose, inputs, start_ns, self.stamp_ns)
        self.pose, self.inputs = moved, inputs


def first_touch(
    setting: Setting, pose: FloatArray, inputs: FloatArray, start_ns: int, end_ns: int
) -> tuple[float, int] | None:
    """The first collision between two ticks, both excluded: clearance (negative) and whose; None without.

    Only where it may happen: the clearances at both ends must be overcome by what ego and obstacles
    move in between.
    """
    body = setting.vehicle.body_radius_m
    start, end = setting.world.at(start_ns), setting.world.at(end_ns)
    if not len(start) and not len(end):
        return None
    period_s = (end_ns - start_ns) / 1e9
    arrived = setting.vehicle.step(pose, inputs, period_s)
    fastest = max(float(np.hypot(*o.velocity_mps.T).max(initial=0.0)) for o in (start, end))
    way_m = (abs(float(inputs[0])) + fastest) * period_s
    clear_m = start.clearance(pose[None, :2], body).min(initial=np.inf)
    clear_m += end.clearance(arrived[None, :2], body).min(initial=np.inf)
    if way_m <= CHECK_SPACING_M or clear_m > way_m:
        return None
    parts = math.ceil(way_m / CHECK_SPACING_M)
    for k in range(1, parts):
        share = k / parts
        here = setting.vehicle.step(pose, inputs, share * period_s)
        clearance, touched = setting.world.nearest(here[:2], body, start_ns + round(share * (end_ns - start_ns)))
        if clearance < 0.0:
            return clearance, touched
    return None
