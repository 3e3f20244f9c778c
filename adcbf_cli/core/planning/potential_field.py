"""Artificial potential field: drawn towards a point ahead on the path, pushed away by obstacles.

The classical reactive planner (Khatib, 1986). It uses the obstacles' current places only, promises
nothing, and stands still in the field's local minima: that is what it is here to show.
"""

from __future__ import annotations

import math

import numpy as np

from adcbf_cli.core.config import PlanningConfig
from adcbf_cli.core.planning import fallback, pursuit
from adcbf_cli.core.planning.planner import Outcome, Plan, Situation
from adcbf_cli.core.types import FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

INFLUENCE_M = 1.0
"""Surface distance, beyond the safety distance, from which an obstacle pushes."""

PUSH = 0.3
"""Strength of the push against a pull of 1: at the distance where they are equal the way ends."""

TURN_PER_S = 2.5
"""Yaw rate for each radian of heading error (unicycle); how sharply the force is followed."""

MIN_FORCE = 0.05
"""A weaker force has no direction: a local minimum."""


class PotentialField:
    """One force a tick, followed for the whole horizon with the obstacles held where they are."""

    def __init__(self, name: str, vehicle: Vehicle, planning: PlanningConfig) -> None:
        self.name = name
        self._vehicle = vehicle
        self._planning = planning
        self._progress = pursuit.Progress()

    def plan(self, situation: Situation) -> Plan:
        planning, vehicle = self._planning, self._vehicle
        first_s = 1.0 / planning.rate_hz
        path, along_m = self._progress.way(situation.path, situation.pose)
        reference = pursuit.horizon(vehicle, path, along_m, situation.pose, 1, planning.step_s)
        ahead = along_m + pursuit.look_ahead_m(path)
        aim = pursuit.beyond(path, np.array([ahead]))[0, :2]
        force = self._force(situation, aim)
        if math.hypot(*force) < MIN_FORCE:
            return fallback.braking(vehicle, situation, planning.steps, planning.step_s, first_s)
        wanted = self._inputs(situation.pose, force, float(reference[1, 3]))
        held = np.tile(wanted, (planning.steps, 1))
        inputs = vehicle.within_limits(held, situation.inputs, planning.step_s, first_s)
        return Plan(Outcome.SOLVED, inputs, vehicle.roll_out(situation.pose, inputs, planning.step_s), None)

    def _force(self, situation: Situation, aim_m: FloatArray) -> FloatArray:
        """(2,) pull of size 1 towards the aim, and the negative gradient of 0.5 PUSH (1 / s - 1 / s0)^2 for
        each obstacle at distance s < s0 beyond the safety distance."""
        pull = aim_m - situation.pose[:2]
        force = pull / max(float(np.hypot(*pull)), 1e-9)
        seen = situation.obstacles
        away = situation.pose[:2] - seen.position_m[:, 0]
        centre_m = np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-9)
        keep_out = seen.radius_m + self._vehicle.body_radius_m + self._planning.safety_distance_m
        gap = np.maximum(centre_m - keep_out, 0.05)
        size = np.where(gap < INFLUENCE_M, PUSH * (1 / gap - 1 / INFLUENCE_M) / gap**2, 0.0)
        return np.asarray(force + (size / centre_m) @ away)

    def _inputs(self, pose: FloatArray, force: FloatArray, speed_mps: float) -> FloatArray:
        """(2,) inputs that turn into the force's direction; the more it points aside, the slower, and
        standing when it points back."""
        error = math.remainder(math.atan2(float(force[1]), float(force[0])) - float(pose[2]), 2 * math.pi)
        speed = speed_mps * max(math.cos(error), 0.0) * min(math.hypot(*force), 1.0)
        if self._vehicle.kind == "unicycle":
            return np.array([speed, TURN_PER_S * error])
        creep = 0.2 * speed_mps
        return np.array([max(speed, creep), TURN_PER_S * error * self._vehicle.wheelbase_m / pursuit.LOOK_AHEAD_M])
