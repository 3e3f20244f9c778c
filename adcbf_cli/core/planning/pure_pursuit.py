"""Pure pursuit that stops: follows the path and waits while something blocks it. It never goes around.

The simplest driver that a path needs, and so the floor that an avoiding planner has to beat.
"""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.config import PlanningConfig
from adcbf_cli.core.planning import pursuit
from adcbf_cli.core.planning.fallback import required_m, stands, surface_m
from adcbf_cli.core.planning.planner import Outcome, Plan, Situation
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.types import FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

GENTLE = 0.5
"""Share of the braking limit that stopping before an obstacle is planned with."""


class PurePursuit:
    """Follows at the path's speed, and slows down so as to stand before the first place on its way that is
    blocked: by an obstacle where it is now, or where it will be when the vehicle gets there.

    It stops in front of what stands still as long as the horizon holds the stopping distance.
    """

    def __init__(self, name: str, vehicle: Vehicle, planning: PlanningConfig) -> None:
        self.name = name
        self._vehicle = vehicle
        self._planning = planning
        self._progress = pursuit.Progress()

    def plan(self, situation: Situation) -> Plan:
        vehicle, step_s = self._vehicle, self._planning.step_s
        path, along_m = self._progress.way(situation.path, situation.pose)
        steps = self._planning.steps
        reference = pursuit.horizon(vehicle, path, along_m, situation.pose, steps, step_s)
        inputs = self._follow(situation, path, along_m, reference[1:, 3])
        poses = vehicle.roll_out(situation.pose, inputs, step_s)
        free_m = self._free_m(situation, poses)
        if not np.isfinite(free_m):
            return Plan(Outcome.SOLVED, inputs, poses, None)
        careful = self._follow(situation, path, along_m, np.minimum(reference[1:, 3], self._stopping(free_m)))
        slower = bool(careful[0, 0] < inputs[0, 0])
        poses = vehicle.roll_out(situation.pose, careful, step_s)
        return Plan(self._outcome(situation, slower), careful, poses, None)

    def _follow(self, situation: Situation, path: ReferencePath, along_m: float, speeds_mps: FloatArray) -> FloatArray:
        step_s = self._planning.step_s
        at_m = along_m + np.concatenate([[0.0], np.cumsum(speeds_mps[:-1]) * step_s])
        aims = pursuit.beyond(path, at_m + pursuit.look_ahead_m(path))
        first_s = 1.0 / self._planning.rate_hz
        return pursuit.pursue(self._vehicle, situation.pose, situation.inputs, aims[:, :2], speeds_mps, step_s, first_s)

    def _free_m(self, situation: Situation, poses: FloatArray) -> float:
        """Way along `poses` up to the last one before any that is blocked; infinite where none is."""
        seen, body_m = situation.obstacles, self._vehicle.body_radius_m
        held = np.repeat(seen.position_m[:, :1], len(poses), axis=1)
        near = np.minimum(
            surface_m(poses, held, seen.radius_m, body_m), surface_m(poses, seen.position_m, seen.radius_m, body_m)
        )
        required = required_m(near[:, 0], self._planning.safety_distance_m)
        blocked = (near < required[:, None]).any(axis=0)
        if not blocked.any():
            return np.inf
        way = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        return float(way[: max(int(np.argmax(blocked)) - 1, 0)].sum())

    def _stopping(self, free_m: float) -> FloatArray:
        """(N,) speeds that come to a stand after `free_m`."""
        speeds = np.empty(self._planning.steps)
        left = free_m
        for k in range(len(speeds)):
            speeds[k] = np.sqrt(2 * GENTLE * self._vehicle.rate_max[0] * left)
            left = max(left - speeds[k] * self._planning.step_s, 0.0)
        return speeds

    def _outcome(self, situation: Situation, slower: bool) -> Outcome:
        if not slower:
            return Outcome.SOLVED
        return Outcome.STOPPED if stands(situation.inputs) else Outcome.BRAKED
