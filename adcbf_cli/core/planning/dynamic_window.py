"""Dynamic window: of the inputs that can be reached soon, the best arc from which stopping is still possible.

After Fox, Burgard and Thrun (1997), with the obstacles moving as predicted along each arc.
"""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.config import PlanningConfig
from adcbf_cli.core.planning import fallback, pursuit
from adcbf_cli.core.planning.fallback import TOUCH_M, required_m, surface_m
from adcbf_cli.core.planning.planner import Outcome, Plan, Situation
from adcbf_cli.core.planning.problem import Obstacles
from adcbf_cli.core.types import FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

WINDOW_S = 0.5
"""The window: inputs that can be reached within this time."""

SPEEDS, TURNS = 7, 15
"""Grid points of the window."""

NEAR_M = 0.6
"""Surface distance, beyond the safety distance, below which clearance costs."""

CLEARANCE_WEIGHT = 1.0
"""Metres of distance from the reference that being within the safety distance is worth."""

CONFLICT_WEIGHT = 2.0
"""Metres of distance from the reference that an arc is worth which is within the safety distance at once;
the later, the less: there is time yet to choose another."""

SWITCH_WEIGHT = 0.1
"""Metres of distance from the reference that each rad/s (rad) between this arc's turn and the last one's is
worth: otherwise left and right of something dead ahead win in turn, until it is too late for either."""

SPEED_WEIGHT = 0.3
"""Metres of distance from the reference that each m/s below its speed is worth."""


class DynamicWindow:
    """Admissible is an arc that keeps the safety distance for the whole horizon, or from which, after one
    stage, braking ends before anything comes closer. So what stands still is never hit, as long as it is
    known and the horizon holds the stopping distance."""

    def __init__(self, name: str, vehicle: Vehicle, planning: PlanningConfig) -> None:
        self.name = name
        self._vehicle = vehicle
        self._planning = planning
        self._progress = pursuit.Progress()
        self._turn = 0.0

    def plan(self, situation: Situation) -> Plan:
        vehicle, planning = self._vehicle, self._planning
        first_s = 1.0 / planning.rate_hz
        path, along_m = self._progress.way(situation.path, situation.pose)
        steps, step_s = planning.steps, planning.step_s
        reference = pursuit.horizon(vehicle, path, along_m, situation.pose, steps, step_s)
        arcs = self._arcs(situation.inputs)
        poses = vehicle.roll_outs(situation.pose, arcs, step_s)
        spare = self._spare_m(situation, poses)
        clear = np.asarray((spare >= -TOUCH_M).all(axis=1))
        for i in np.argsort(self._costs(reference, arcs, poses, spare), kind="stable"):
            if clear[i] or self._can_stop(situation, arcs[i, 0]):
                self._turn = float(arcs[i, -1, 1])
                return Plan(Outcome.SOLVED, arcs[i], poses[i], None)
        return fallback.braking(vehicle, situation, steps, step_s, first_s)

    def _arcs(self, last: FloatArray) -> FloatArray:
        """(arcs, N, 2) inputs that go to a point of the window as fast as they may, and stay there."""
        vehicle, planning = self._vehicle, self._planning
        inside = np.clip(last, vehicle.input_min, vehicle.input_max)
        low = np.maximum(inside - vehicle.rate_max * WINDOW_S, vehicle.input_min)
        high = np.minimum(inside + vehicle.rate_max * WINDOW_S, vehicle.input_max)
        speeds = np.linspace(low[0], high[0], SPEEDS)
        turns = np.append(np.linspace(low[1], high[1], TURNS), np.clip(0.0, low[1], high[1]))
        target = np.stack(np.meshgrid(speeds, turns, indexing="ij"), axis=-1).reshape(-1, 1, 2)
        at_s = 1.0 / planning.rate_hz + planning.step_s * np.arange(planning.steps)
        reach = at_s[:, None] * vehicle.rate_max
        return np.asarray(last + np.clip(target - last, -reach, reach))

    def _spare_m(self, situation: Situation, poses: FloatArray) -> FloatArray:
        """(arcs, N) what is left at each stage of the distance to keep from the nearest obstacle: negative
        is too close, infinite without obstacles."""
        seen = situation.obstacles
        if not len(seen):
            return np.full((len(poses), poses.shape[1] - 1), np.inf)
        gap = poses[:, None, :, :2] - seen.position_m
        surface = np.hypot(gap[..., 0], gap[..., 1]) - seen.radius_m[:, None] - self._vehicle.body_radius_m
        required = required_m(surface[0, :, 0], self._planning.safety_distance_m)
        return np.asarray((surface[:, :, 1:] - required[:, None]).min(axis=1))

    def _costs(self, reference: FloatArray, arcs: FloatArray, poses: FloatArray, spare_m: FloatArray) -> FloatArray:
        """(arcs,) mean distance from the reference, missing speed, change of mind, nearness to obstacles."""
        off = poses[:, 1:, :2] - reference[1:, :2]
        cost = np.hypot(off[..., 0], off[..., 1]).mean(axis=1)
        cost += SPEED_WEIGHT * np.abs(reference[1:, 3] - arcs[..., 0]).mean(axis=1)
        cost += SWITCH_WEIGHT * np.abs(arcs[:, -1, 1] - self._turn)
        near = np.clip(1.0 - spare_m / NEAR_M, 0.0, 1.0)
        conflict = np.maximum.accumulate(spare_m < -TOUCH_M, axis=1)
        cost += CLEARANCE_WEIGHT * (near**2).mean(axis=1) + CONFLICT_WEIGHT * conflict.mean(axis=1)
        return np.asarray(cost)

    def _can_stop(self, situation: Situation, inputs: FloatArray) -> bool:
        """Whether one stage with `inputs` (2,) and then braking keeps clear until the vehicle stands; what
        comes at it then is not its doing."""
        seen = situation.obstacles
        if not len(seen):
            return True
        vehicle, step_s = self._vehicle, self._planning.step_s
        stop = int(np.ceil(abs(inputs[0]) / (vehicle.rate_max[0] * step_s))) + 1
        stop = min(stop, 4 * self._planning.steps)
        stages = np.concatenate([inputs[None], vehicle.braking(inputs, stop, step_s)])
        poses = vehicle.roll_out(situation.pose, stages, step_s)
        surface = surface_m(poses, _extended(seen, len(poses), step_s), seen.radius_m, vehicle.body_radius_m)
        required = required_m(surface[:, 0], self._planning.safety_distance_m)
        return bool((surface >= required[:, None]).all())


def _extended(seen: Obstacles, stages: int, step_s: float) -> FloatArray:
    """(n, stages, 2) predicted positions, beyond the horizon at constant velocity."""
    known = seen.position_m.shape[1]
    if stages <= known:
        return seen.position_m[:, :stages]
    later_s = step_s * np.arange(1, stages - known + 1)
    more = seen.position_m[:, -1:] + seen.velocity_mps[:, None] * later_s[:, None]
    return np.concatenate([seen.position_m, more], axis=1)
