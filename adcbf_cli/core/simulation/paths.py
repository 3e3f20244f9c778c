"""Scripted paths: where something on a path is at a time, which way it faces, how fast it goes.

All paths but the circle are polylines with a schedule: arc length as a piecewise linear function
of time. A smooth path is a dense polyline along a Catmull-Rom curve.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from adcbf_cli.core.simulation.scenario import (
    CirclePath,
    CrossingPath,
    LinePath,
    Route,
    Scenario,
    StandPath,
    WaypointPath,
)
from adcbf_cli.core.types import FloatArray

CURVE_STEPS = 256
"""Polyline segments that stand for one leg of a smooth path: a few centimetres each."""

ROUTE_SPEED_MPS = 0.75
"""Speed of a scripted ego along its scenario's route: the paper's path of 36 m takes 47 to 50 s."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Planar motion at n times: x_m, y_m, yaw_rad (facing), vx_mps, vy_mps (world), travelled_m."""

    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray
    vx_mps: FloatArray
    vy_mps: FloatArray
    travelled_m: FloatArray


AnyPath = StandPath | LinePath | WaypointPath | CirclePath


def motion_along(path: AnyPath, time_s: FloatArray) -> Motion:
    """The motion along a path at (n,) times from the scenario's start; before a path begins and after
    it ends, its mover stands, facing the way it is about to go or last went."""
    if isinstance(path, CirclePath):
        return _circle(path, time_s)
    if isinstance(path, StandPath):
        return _stand(path, time_s)
    return _schedule(path).at(time_s)


def route_points(route: Route) -> FloatArray:
    """(k, 2) the route as a polyline: its points, or a dense curve through them, scaled to its length."""
    corners = np.array(route.points_m)
    points = _catmull_rom(corners) if route.smooth else corners
    if route.length_m is None:
        return points
    steps = np.diff(points, axis=0)
    return np.asarray(points[0] + (points - points[0]) * (route.length_m / np.hypot(steps[:, 0], steps[:, 1]).sum()))


def beside(way_m: FloatArray, along_m: float, aside_m: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """The (2,) point at an arc length along a polyline (k, 2), shifted to its left by aside_m, and the
    polyline's (2,) unit direction there. Beyond its ends the polyline goes on straight."""
    kept = way_m[np.concatenate([[True], np.any(np.diff(way_m, axis=0) != 0, axis=1)])]
    steps = np.diff(kept, axis=0)
    length = np.hypot(steps[:, 0], steps[:, 1])
    start = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    segment = int(np.clip(np.searchsorted(start, along_m, side="right") - 1, 0, len(steps) - 1))
    ahead = steps[segment] / length[segment]
    left = np.array([-ahead[1], ahead[0]])
    return kept[segment] + (along_m - start[segment]) * ahead + aside_m * left, ahead


def crossing_line(path: CrossingPath, way_m: FloatArray) -> LinePath | StandPath:
    """The line that crosses a route (k, 2) as asked. Where its walk would begin before the scenario does,
    it begins at where it would be by then; where it would be over by then, the mover stands at its end."""
    point, ahead = beside(way_m, path.along_m)
    angle = np.deg2rad(path.angle_deg)
    cos, sin = np.cos(angle), np.sin(angle)
    direction = np.array([cos * ahead[0] - sin * ahead[1], sin * ahead[0] + cos * ahead[1]])
    meets_s = path.along_m / ROUTE_SPEED_MPS - path.early_s if path.meets_s is None else path.meets_s
    before_m = min(path.before_m, meets_s * path.speed_mps)
    end = _pair(point + path.after_m * direction)
    if before_m <= -path.after_m:
        return StandPath(kind="stand", at_m=end, yaw_deg=float(np.rad2deg(np.arctan2(direction[1], direction[0]))))
    start_s = max(0.0, meets_s - before_m / path.speed_mps)
    return LinePath(
        kind="line", from_m=_pair(point - before_m * direction), to_m=end, speed_mps=path.speed_mps, start_s=start_s
    )


def _pair(point: FloatArray) -> tuple[float, float]:
    """A point to the micrometre."""
    return round(float(point[0]), 6), round(float(point[1]), 6)


def ego_path(scenario: Scenario) -> AnyPath:
    """The ego's scripted path: its own, or the scenario's route at the paper's speed."""
    if scenario.ego.path is not None:
        return scenario.ego.path
    assert scenario.route is not None
    points = route_points(scenario.route)
    kept = points[np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 0])]
    places = tuple((float(x), float(y)) for x, y in kept)
    return WaypointPath.model_construct(
        kind="waypoints", points_m=places, times_s=None, speed_mps=ROUTE_SPEED_MPS, pauses_s=None, start_s=0.0,
        smooth=False,
    )  # fmt: skip


def _stand(path: StandPath, time_s: FloatArray) -> Motion:
    zero = np.zeros_like(time_s)
    return Motion(zero + path.at_m[0], zero + path.at_m[1], zero + np.deg2rad(path.yaw_deg), zero, zero, zero)


def _circle(path: CirclePath, time_s: FloatArray) -> Motion:
    """Equation 11; its speed is a constant 2 pi |w| A."""
    rate = 2 * np.pi * path.frequency_hz
    angle = rate * time_s + np.deg2rad(path.start_angle_deg)
    sin, cos = np.sin(angle), np.cos(angle)
    vx, vy = -path.radius_m * rate * cos, path.radius_m * rate * sin
    return Motion(
        x_m=path.centre_m[0] - path.radius_m * sin,
        y_m=path.centre_m[1] - path.radius_m * cos,
        yaw_rad=np.arctan2(vy, vx),
        vx_mps=vx,
        vy_mps=vy,
        travelled_m=abs(rate) * path.radius_m * time_s,
    )


@dataclass(frozen=True, slots=True)
class _Schedule:
    """A polyline with arc length `length_m` at its k vertices `points_m` (k, 2) and headings there,
    and a schedule: arc length `reached_m` at times `time_s`.

    turns: headings turn between vertices (smooth), or hold along each segment (sharp corners).
    """

    points_m: FloatArray
    length_m: FloatArray
    heading_rad: FloatArray
    time_s: FloatArray
    reached_m: FloatArray
    turns: bool

    def at(self, time_s: FloatArray) -> Motion:
        travelled = np.interp(time_s, self.time_s, self.reached_m)
        leg = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self.time_s) - 2)
        rate = np.diff(self.reached_m) / np.diff(self.time_s)
        moving = (time_s >= self.time_s[0]) & (time_s < self.time_s[-1])
        speed = np.where(moving, rate[leg], 0.0)
        segment = np.clip(np.searchsorted(self.length_m, travelled, side="right") - 1, 0, len(self.length_m) - 2)
        between = np.interp(travelled, self.length_m, self.heading_rad) if self.turns else None
        heading = self.heading_rad[segment] if between is None else between
        return Motion(
            x_m=np.interp(travelled, self.length_m, self.points_m[:, 0]),
            y_m=np.interp(travelled, self.length_m, self.points_m[:, 1]),
            yaw_rad=heading,
            vx_mps=speed * np.cos(heading),
            vy_mps=speed * np.sin(heading),
            travelled_m=travelled,
        )


@lru_cache(maxsize=1024)
def _schedule(path: LinePath | WaypointPath) -> _Schedule:
    if isinstance(path, LinePath):
        corners = np.array([path.from_m, path.to_m])
        smooth = False
    else:
        corners = np.array(path.points_m)
        smooth = path.smooth
    points = _catmull_rom(corners) if smooth else corners
    steps = np.diff(points, axis=0)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    at_corner = length[::CURVE_STEPS] if smooth else length
    segment_heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    if smooth:
        middle = (segment_heading[:-1] + segment_heading[1:]) / 2
        heading = np.concatenate([segment_heading[:1], middle, segment_heading[-1:]])
    else:
        heading = segment_heading
    times, reached = _timing(path, at_corner)
    return _Schedule(points, length, heading, times, reached, smooth)


def _timing(path: LinePath | WaypointPath, at_corner_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """When each corner is reached, and left again where there is a pause."""
    if isinstance(path, WaypointPath) and path.times_s is not None:
        return np.array(path.times_s), at_corner_m
    assert path.speed_mps is not None
    pauses = path.pauses_s if isinstance(path, WaypointPath) and path.pauses_s else (0.0,) * len(at_corner_m)
    times: list[float] = []
    reached: list[float] = []
    clock = path.start_s
    for index, (length, pause) in enumerate(zip(at_corner_m, pauses, strict=True)):
        if index:
            clock += (length - at_corner_m[index - 1]) / path.speed_mps
        times.append(clock)
        reached.append(float(length))
        if pause:
            clock += pause
            times.append(clock)
            reached.append(float(length))
    return np.array(times), np.array(reached)


def _catmull_rom(corners: FloatArray) -> FloatArray:
    """(k, 2) corners -> a dense polyline through them: a uniform Catmull-Rom spline, whose end
    tangents come from mirrored end points. Every CURVE_STEPS-th vertex is a corner."""
    before = 2 * corners[:1] - corners[1:2]
    after = 2 * corners[-1:] - corners[-2:-1]
    p = np.concatenate([before, corners, after])
    s = (np.arange(CURVE_STEPS) / CURVE_STEPS)[:, None]
    legs = []
    for p0, p1, p2, p3 in zip(p[:-3], p[1:-2], p[2:-1], p[3:], strict=True):
        quadratic = 2 * p0 - 5 * p1 + 4 * p2 - p3
        cubic = -p0 + 3 * p1 - 3 * p2 + p3
        legs.append(0.5 * (2 * p1 + (p2 - p0) * s + quadratic * s**2 + cubic * s**3))
    return np.concatenate([*legs, corners[-1:]])
