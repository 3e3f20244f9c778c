"""`halt-near`: follows the path, and halts while anything is near and ahead."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.config import PlanningConfig
from adcbf_cli.core.planning import fallback, pursuit
from adcbf_cli.core.planning.planner import Outcome, Plan, Situation
from adcbf_cli.core.types import Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle


class HaltNear:
    """Called with what every planner is made with; one is made for each drive, and may remember what it likes."""

    def __init__(self, name: str, vehicle: Vehicle, planning: PlanningConfig, notes: Notes) -> None:
        self.name = name
        self._vehicle = vehicle
        self._planning = planning
        self._notes = notes
        self._progress = pursuit.Progress()

    def plan(self, situation: Situation) -> Plan:
        planning, vehicle = self._planning, self._vehicle
        first_s = 1.0 / planning.rate_hz  # inputs are held for one tick, then planned anew
        if self._blocked(situation):
            self._notes.count("halts_for_what_is_near")  # counters reach the report
            return fallback.braking(vehicle, situation, planning.steps, planning.step_s, first_s)
        path, along_m = self._progress.way(situation.path, situation.pose)
        ahead = pursuit.horizon(vehicle, path, along_m, situation.pose, planning.steps, planning.step_s)
        at_m = along_m + np.concatenate([[0.0], np.cumsum(ahead[1:-1, 3]) * planning.step_s])
        aims = pursuit.beyond(path, at_m + pursuit.look_ahead_m(path))
        inputs = pursuit.pursue(
            vehicle, situation.pose, situation.inputs, aims[:, :2], ahead[1:, 3], planning.step_s, first_s
        )
        return Plan(Outcome.SOLVED, inputs, vehicle.roll_out(situation.pose, inputs, planning.step_s), None)

    def _blocked(self, situation: Situation) -> bool:
        """Whether an obstacle ahead is nearer than the vehicle needs to stop, and the safety distance."""
        seen = situation.obstacles
        to = seen.position_m[:, 0] - situation.pose[:2]
        direction = np.array([np.cos(situation.pose[2]), np.sin(situation.pose[2])])
        surface_m = np.hypot(to[:, 0], to[:, 1]) - seen.radius_m - self._vehicle.body_radius_m
        stopping_m = self._vehicle.input_max[0] ** 2 / (2 * self._vehicle.rate_max[0])
        near = surface_m < stopping_m + self._planning.safety_distance_m
        return bool((near & (to @ direction > 0)).any())
