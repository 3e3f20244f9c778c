"""Where an ego is at any time: as its scenario scripts it, or as a vehicle really drove."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from adcbf_cli.core.simulation.paths import ego_path, motion_along
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.world import NS_PER_S
from adcbf_cli.core.types import FloatArray, IntArray
from adcbf_cli.core.vehicles.vehicle import Vehicle


class EgoMotion(Protocol):
    """An ego's planar motion."""

    @property
    def end_ns(self) -> int:
        """Up to when it is known."""
        ...

    def at(self, time_ns: IntArray) -> FloatArray:
        """(n, 3) x, y (m), yaw (rad) at (n,) times."""
        ...


class ScriptedMotion:
    """The scenario's own ego, for as long as the scenario lasts; it is known beyond, too."""

    def __init__(self, scenario: Scenario) -> None:
        self._path = ego_path(scenario)
        self._start_ns = scenario.start_time_s * NS_PER_S
        scans = int(np.floor(scenario.duration_s * scenario.lidar.rate_hz + 1e-9))
        self.end_ns = self._start_ns + scans * round(NS_PER_S / scenario.lidar.rate_hz)

    def at(self, time_ns: IntArray) -> FloatArray:
        motion = motion_along(self._path, (np.asarray(time_ns) - self._start_ns) / NS_PER_S)
        return np.column_stack([motion.x_m, motion.y_m, motion.yaw_rad])


class DrivenMotion:
    """A vehicle's way, growing as it drives: inputs held from each tick to the next, arcs in between."""

    def __init__(self, vehicle: Vehicle, start_ns: int, pose: FloatArray) -> None:
        self._vehicle = vehicle
        self._stamp_ns: list[int] = [start_ns]
        self._pose: list[FloatArray] = [np.array(pose, dtype=float)]
        self._inputs: list[FloatArray] = []

    @property
    def end_ns(self) -> int:
        return self._stamp_ns[-1]

    def drive(self, inputs: FloatArray, until_ns: int, pose: FloatArray) -> None:
        """Inputs (2,) held from the last tick until the next one, and the pose (3,) where they led."""
        self._inputs.append(np.array(inputs, dtype=float))
        self._stamp_ns.append(until_ns)
        self._pose.append(np.array(pose, dtype=float))

    def at(self, time_ns: IntArray) -> FloatArray:
        """Before the first tick it stands there; ValueError beyond the last one."""
        wanted = np.asarray(time_ns, dtype=np.int64)
        if len(wanted) and int(wanted.max()) > self.end_ns:
            raise ValueError("the ego has not driven that far yet")
        if not self._inputs or not len(wanted):
            return np.tile(self._pose[0], (len(wanted), 1))
        # A time at a tick belongs to the way that led there, whether or not the drive has gone on since.
        first = max(int(np.searchsorted(self._stamp_ns, wanted.min(), side="left")) - 1, 0)
        stamps = np.array(self._stamp_ns[first:])
        tick = np.clip(np.searchsorted(stamps, wanted, side="left") - 1, 0, None)
        since_s = np.maximum(wanted - stamps[tick], 0) / NS_PER_S
        start, held = np.array(self._pose[first:])[tick], np.array(self._inputs[first:])[tick]
        return self._vehicle.step(start, held, since_s)
