"""Following a path without looking at obstacles: progress along it, and pure pursuit's roll-out.

Shared by the pure-pursuit planner, by the MPC planners' second start and by the other baselines.
"""

from __future__ import annotations

import math

import numpy as np

from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.types import FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

LOOK_AHEAD_M = 0.6
LOOK_AHEAD_S = 0.5
"""Pure pursuit aims at this distance plus this time's way ahead."""

GENTLE = 0.5
"""Share of the braking limit with which the reference slows down before its end, so that following it
leaves something in hand."""


FARTHER_ON_M = 0.5
"""A vehicle begins at the beginning of its path, unless another place of it is nearer by this."""

MISSED_M = 0.15
"""Farther off the path than this, and than what is left of it, the vehicle heads for the goal itself."""


FULL_TURN, QUARTER_TURN = 2 * math.pi, math.pi / 2


class Progress:
    """The arc length reached on a path; found near the last one, so that laps and crossings are not
    short-cut. A new path starts anew, at its start unless the vehicle is clearly farther on."""

    def __init__(self) -> None:
        self._path: ReferencePath | None = None
        self._along_m = 0.0

    def way(self, path: ReferencePath, pose: FloatArray) -> tuple[ReferencePath, float]:
        """What to follow from `pose` (3,) on, and the arc length on it.

        That is the path, but for its end: a vehicle that had to pass it by would stand beside the goal,
        where the path asks it to stand. There the straight line to the goal takes the path's place.
        """
        if path is not self._path:
            self._path, self._along_m = path, path.nearest_or_found(pose[:2], 0.0, FARTHER_ON_M)
        self._along_m = path.nearest(pose[:2], self._along_m)
        off = path.at(np.array([self._along_m]))[0, :2] - pose[:2]
        if math.hypot(*off) > max(MISSED_M, path.length_m - self._along_m):
            return ReferencePath(np.stack([pose[:2], path.goal_m]), path.speed_mps), 0.0
        return path, self._along_m


def horizon(
    vehicle: Vehicle, path: ReferencePath, along_m: float, pose: FloatArray, steps: int, step_s: float
) -> FloatArray:
    """`ReferencePath.horizon` with this vehicle's braking."""
    return path.horizon(pose, along_m, steps, step_s, GENTLE * float(vehicle.rate_max[0]))


def look_ahead_m(path: ReferencePath) -> float:
    return LOOK_AHEAD_M + LOOK_AHEAD_S * path.speed_mps


def beyond(path: ReferencePath, along_m: FloatArray) -> FloatArray:
    """(k, 3) as `ReferencePath.at`, going straight on after the path's end: an aim that stopped there
    would make the last metre's curvature arbitrary."""
    places = path.at(along_m)
    over = np.maximum(along_m - path.length_m, 0.0)
    places[:, 0] += over * np.cos(places[:, 2])
    places[:, 1] += over * np.sin(places[:, 2])
    return places


def pursue(
    vehicle: Vehicle,
    pose: FloatArray,
    last: FloatArray,
    aims_m: FloatArray,
    speeds_mps: FloatArray,
    step_s: float,
    first_step_s: float,
) -> FloatArray:
    """Inputs (N, 2) of pure pursuit: at stage k towards aims (N, 2) with at most speeds (N,), within the
    limits from `last` on.

    Poses in between go by the chord of each step's arc; plain floats, since N rounds of numpy calls on
    two numbers would take longer than solving the problem that this is a start for.
    """
    x, y, yaw = pose.tolist()
    speed, turn = last.tolist()
    (slow, left), (fast, right) = vehicle.input_min.tolist(), vehicle.input_max.tolist()
    speed_reach, turn_reach = (vehicle.rate_max * first_step_s).tolist()
    later_speed_reach, later_turn_reach = (vehicle.rate_max * step_s).tolist()
    wheelbase_m = None if vehicle.kind == "unicycle" else vehicle.wheelbase_m
    inputs = []
    for (aim_x, aim_y), allowed in zip(aims_m.tolist(), speeds_mps.tolist(), strict=True):
        to_x, to_y = aim_x - x, aim_y - y
        distance = max(math.hypot(to_x, to_y), 1e-3)
        bearing = math.remainder(math.atan2(to_y, to_x) - yaw, FULL_TURN)
        wanted_speed, wanted_turn = _towards(wheelbase_m, distance, bearing, allowed, right)
        speed = _limit(wanted_speed, speed, speed_reach, slow, fast)
        turn = _limit(wanted_turn, turn, turn_reach, left, right)
        inputs.append((speed, turn))
        rate = turn if wheelbase_m is None else speed * math.tan(turn) / wheelbase_m
        direction = yaw + 0.5 * rate * step_s
        x += speed * step_s * math.cos(direction)
        y += speed * step_s * math.sin(direction)
        yaw += rate * step_s
        speed_reach, turn_reach = later_speed_reach, later_turn_reach
    return np.array(inputs).reshape(-1, 2)


def _limit(wanted: float, last: float, reach: float, low: float, high: float) -> float:
    """`Vehicle.limited` of one input. Comparisons take a third of the time of min and max."""
    if wanted < low:
        wanted = low
    if wanted > high:
        wanted = high
    if wanted < last - reach:
        wanted = last - reach
    return last + reach if wanted > last + reach else wanted


def _towards(
    wheelbase_m: float | None, distance_m: float, bearing_rad: float, speed_mps: float, turn_max: float
) -> tuple[float, float]:
    """The inputs for a point at this distance and bearing: the arc through it has curvature
    2 sin(bearing) / distance. What lies behind is turned towards first. Without a wheelbase it is a unicycle."""
    behind = abs(bearing_rad) > QUARTER_TURN
    curvature = 2 * (math.copysign(1.0, bearing_rad) if behind else math.sin(bearing_rad)) / distance_m
    if wheelbase_m is not None:
        return speed_mps, math.atan(wheelbase_m * curvature)
    if behind:
        return 0.0, math.copysign(turn_max, bearing_rad)
    speed = min(speed_mps, turn_max / max(abs(curvature), 1e-9))
    return speed, speed * curvature
