"""Tell ground from obstacles in a 3-D scan, on slopes and rough ground.

All heights are in the levelled sensor frame (origin at the sensor, z against gravity, heading kept).

1. A *coarse plane* through the lowest points of 1 m cells, by deterministic RANSAC, gives the slope
   that the robot stands on and the sensor's height above it. Each point's height is then measured
   from that plane (a shear: upright things stay upright), so that a 20 degree slope looks flat.
2. Patchwork++ (Lee et al., IROS 2022) fits planes to small patches of what is left and so follows
   the ground's shape. Its patches are sized as in the publication for a car's 80 m, and kept about
   1.5 m long for the smaller surroundings of a small robot. Below the lowest beam there is no ground
   to be seen, and what rises into the beams there, as a rock beside the wheels, would be the lowest
   thing in its patch: so the patches around the robot are also given the coarse plane where no beam
   reaches it.
3. A *height map* of the ground that it found says for each remaining point how high above the local
   ground it is. That drops overhangs, the remains in patches with too few points for a fit, and
   roofs that were taken for ground.

The alternatives 'plane' and 'band' stop after step 1: points within a clearance of the coarse plane,
or of the horizontal plane one sensor height below, are ground.

What lies below the ground (reflections in wet floors and windows, ditches) is no obstacle.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from adcbf_cli.core.config import PerceptionConfig
from adcbf_cli.core.perception.grid import cell_numbers
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray, Notes

if TYPE_CHECKING:
    from pypatchworkpp import patchworkpp

FIT_RADIUS_M = 20.0
"""Ground is fitted to at least these surroundings, however small the crop."""

CAR_RINGS = (2, 4, 4, 4)
CAR_SECTORS = (16, 32, 54, 32)
PATCH_M = 1.5
"""Patchwork++'s published zones for a car, and the size that its patches keep in smaller ones."""

MAX_SLOPE = 0.7
"""Steepest coarse plane: 35 degrees."""

DROP_M = 0.5
"""Points this far below the coarse plane, in a hole of the lowest points' surface ..."""

HOLE_CELLS = 5
"""... narrower than this many metres, are reflections or in a ditch."""

PLANE_TOLERANCE_M = 0.15
MAX_SENSOR_HEIGHT_M = 5.0
MIN_PLANE_CELLS = 12

PLANE_POINTS = 20_000
"""Of denser scans every second, third ... point is enough for the coarse plane."""

HYPOTHESES = 200

BLIND_M = 5.0
BLIND_STEP_M = 0.1
"""Where no beam reaches the ground, so far away at most, the coarse plane is sampled in such steps."""

MAP_CELL_M = 0.5
ROOF_WINDOW_CELLS = 7
"""A raised patch of ground that a 3.5 m square does not fit into is no ground but a roof."""

ROOF_M = 0.5
"""... if it stands out by more than this."""


@dataclass(frozen=True, slots=True)
class Plane:
    """z = slope_x * x + slope_y * y + offset_m."""

    slope_x: float
    slope_y: float
    offset_m: float

    def height(self, points_m: FloatArray) -> FloatArray:
        """Vertical distance (n,) of points (n, 3) above the plane."""
        above: FloatArray = (
            points_m[:, 2] - self.slope_x * points_m[:, 0] - self.slope_y * points_m[:, 1] - self.offset_m
        )
        return above


def coarse_plane(points_m: FloatArray, sensor_height_m: float | None) -> Plane | None:
    """The plane below the sensor that most 1 m cells' lowest points lie on, or None without one.

    points_m: (n, 3), levelled sensor frame. sensor_height_m fixes the plane's height below the sensor
    to within half a metre. Deterministic: the hypotheses are drawn with a fixed seed.
    """
    lows = _lowest_of_cells(points_m[:: max(1, len(points_m) // PLANE_POINTS)])
    if len(lows) < MIN_PLANE_CELLS:
        return None
    planes = _planes_through(lows[_drawn_triples(len(lows))])
    planes = planes[_plausible(planes, sensor_height_m)]
    if len(planes) == 0:
        return None
    best = planes[np.argmax(_support(planes, lows))]
    fitted_to = np.zeros(len(lows), dtype=bool)
    for _ in range(3):
        near = np.abs(lows[:, 2] - lows[:, :2] @ best[:2] - best[2]) < PLANE_TOLERANCE_M
        if (near == fitted_to).all():  # the same cells give the same plane
            break
        fitted_to = near
        design = np.column_stack([lows[near, :2], np.ones(int(near.sum()))])
        fitted, _, rank, _ = np.linalg.lstsq(design, lows[near, 2], rcond=None)
        if rank < 3 or not _plausible(fitted[None], sensor_height_m)[0]:
            break
        best = fitted
    return Plane(*(float(value) for value in best))


def _lowest_of_cells(points_m: FloatArray) -> FloatArray:
    """The lowest point of each occupied 1 m cell, (k, 3). Points far below the horizontal are left
    out, so that no reflection is the lowest one."""
    distance = np.hypot(points_m[:, 0], points_m[:, 1])
    plausible = points_m[:, 2] > -MAX_SENSOR_HEIGHT_M - MAX_SLOPE * distance
    points_m = points_m[plausible & (distance < FIT_RADIUS_M)]
    if len(points_m) == 0:
        return points_m
    side = 2 * int(FIT_RADIUS_M)
    column = np.floor(points_m[:, 0] + FIT_RADIUS_M).astype(np.int64)
    row = np.floor(points_m[:, 1] + FIT_RADIUS_M).astype(np.int64)
    cell = column * side + row
    lowest = np.full(side * side, np.inf)
    np.minimum.at(lowest, cell, points_m[:, 2])
    candidates = np.flatnonzero(points_m[:, 2] == lowest[cell])
    _, first = np.unique(cell[candidates], return_index=True)
    return points_m[candidates[first]]


@lru_cache(maxsize=256)
def _drawn_triples(count: int) -> IntArray:
    """(k, 3) triples of different numbers below count, the same ones for each count."""
    draw: IntArray = np.random.default_rng(0).integers(0, count, size=(HYPOTHESES, 3))
    draw = draw[(draw[:, 0] != draw[:, 1]) & (draw[:, 1] != draw[:, 2]) & (draw[:, 0] != draw[:, 2])]
    draw.flags.writeable = False
    return draw


def _planes_through(triples_m: FloatArray) -> FloatArray:
    """Planes (k, 3) as (slope_x, slope_y, offset) through three points each, (k, 3, 3); vertical and
    undefined ones are left out."""
    one = triples_m[:, 1] - triples_m[:, 0]
    other = triples_m[:, 2] - triples_m[:, 0]
    normal = np.cross(one, other)
    upright = np.abs(normal[:, 2]) > 1e-3
    normal, anchor = normal[upright], triples_m[upright, 0]
    slope = -normal[:, :2] / normal[:, 2:]
    return np.column_stack([slope, anchor[:, 2] - (slope * anchor[:, :2]).sum(axis=1)])


def _plausible(planes: FloatArray, sensor_height_m: float | None) -> BoolArray:
    """Not too steep, and at a possible height below the sensor."""
    gentle = np.hypot(planes[:, 0], planes[:, 1]) < MAX_SLOPE
    if sensor_height_m is None:
        below: BoolArray = (planes[:, 2] < -0.05) & (planes[:, 2] > -MAX_SENSOR_HEIGHT_M)
    else:
        below = np.abs(planes[:, 2] + sensor_height_m) < 0.5
    result: BoolArray = gentle & below
    return result


def _support(planes: FloatArray, lows_m: FloatArray) -> FloatArray:
    """Cells on each plane minus cells below it: the ground is the lowest surface, not a car's roof."""
    residual = planes[:, :2] @ lows_m[:, :2].T
    np.subtract(lows_m[:, 2], residual, out=residual)
    residual -= planes[:, 2:]
    below = np.count_nonzero(residual < -2 * PLANE_TOLERANCE_M, axis=1)
    residual /= PLANE_TOLERANCE_M
    np.multiply(residual, residual, out=residual)
    np.subtract(1.0, residual, out=residual)
    support: FloatArray = np.maximum(residual, 0.0, out=residual).sum(axis=1) - below
    return support


class GroundRemoval:
    """Splits scan after scan; Patchwork++'s adaptive thresholds and the sensor's height are kept in
    between, so that the result depends on the sequence of scans, and on nothing else."""

    def __init__(self, config: PerceptionConfig, notes: Notes) -> None:
        self._config = config
        self._notes = notes
        self._height_m = config.sensor_height_m
        self._plane: Plane | None = None
        self._patchwork: patchworkpp | None = None
        self._method = config.ground
        if self._method == "patchwork" and find_spec("pypatchworkpp") is None:
            notes.warn(
                "pypatchworkpp has no package for this Python: ground is taken for a plane, which holds less "
                "well on rough ground (perception.ground=plane)"
            )
            self._method = "plane"

    @property
    def fit_radius_m(self) -> float:
        """The surroundings to hand in: the crop's corners, and at least FIT_RADIUS_M."""
        return float(max(FIT_RADIUS_M, np.sqrt(2.0) * self._config.range_m))

    def heights(self, points_m: FloatArray) -> FloatArray:
        """Each point's height (n,) above the local ground; -inf for ground and for what lies below.

        points_m: (n, 3), levelled sensor frame, the surroundings up to `fit_radius_m`.
        """
        if self._method == "none" or len(points_m) == 0:
            return points_m[:, 2].copy()
        plane = self._coarse_plane(points_m)
        if plane is None:
            self._notes.warn(
                "no ground plane was found in the first scans, and perception.sensor_height_m is not set: "
                "nothing was taken for ground there"
            )
            return points_m[:, 2].copy()
        above = plane.height(points_m)
        if self._method == "patchwork":
            above = self._above_patches(points_m, above, -plane.offset_m)
        return np.where(above > self._config.ground_clearance_m, above, -np.inf)

    def _coarse_plane(self, points_m: FloatArray) -> Plane | None:
        """This scan's plane; where it shows none, the last one; where there is none, a level one."""
        found = coarse_plane(points_m, self._height_m)
        if found is not None:
            self._plane = found
            if self._height_m is None:
                self._height_m = -found.offset_m
        elif self._plane is None and self._height_m is not None:
            self._plane = Plane(0.0, 0.0, -self._height_m)
        if self._method == "band" and self._height_m is not None:
            return Plane(0.0, 0.0, -self._height_m)
        return self._plane

    def _above_patches(self, points_m: FloatArray, above_plane_m: FloatArray, sensor_height_m: float) -> FloatArray:
        """Heights above Patchwork++'s ground; -inf for its ground points that are no roofs."""
        if self._patchwork is None:
            self._patchwork = _new_patchwork(sensor_height_m, self._config.min_range_m, self.fit_radius_m)
        fitted = np.flatnonzero(~_in_holes(points_m[:, :2], above_plane_m))
        flattened = np.column_stack([points_m[fitted, :2], above_plane_m[fitted] - sensor_height_m])
        blind = _disc(_blind_m(points_m[fitted, :2], above_plane_m[fitted], sensor_height_m), BLIND_STEP_M)
        unseen = np.column_stack([blind, np.full(len(blind), -sensor_height_m)])
        self._patchwork.estimateGround(np.concatenate([flattened, unseen]).astype(np.float32))
        found = self._patchwork.getGroundIndices()
        ground = fitted[found[found < len(fitted)]]
        if len(ground) == 0:
            return above_plane_m
        return _above_ground_map(points_m[:, :2], above_plane_m, ground)


def _blind_m(xy_m: FloatArray, above_plane_m: FloatArray, sensor_height_m: float) -> float:
    """How far around the sensor no ground is seen: to where the steepest ray of these points meets the plane."""
    down_m = sensor_height_m - above_plane_m
    down = down_m > 0.0
    meets_m = np.hypot(xy_m[down, 0], xy_m[down, 1]) * sensor_height_m / down_m[down]
    return float(meets_m.min(initial=BLIND_M))


def _disc(radius_m: float, step_m: float) -> FloatArray:
    """(k, 2) the points of a square grid around the origin that are within a radius of it."""
    line = step_m * np.arange(-int(radius_m / step_m), int(radius_m / step_m) + 1)
    x, y = np.meshgrid(line, line)
    within = np.hypot(x, y) <= radius_m
    return np.column_stack([x[within], y[within]])


def _in_holes(xy_m: FloatArray, above_plane_m: FloatArray) -> BoolArray:
    """Points (n,) in narrow holes below the coarse plane: reflections. They would pull a patch's plane
    down, and leave its ground as an obstacle."""
    from scipy.ndimage import grey_closing

    low = above_plane_m < -DROP_M
    if not low.any():
        return low
    cell, shape = cell_numbers(xy_m[:, 0], xy_m[:, 1], 1.0)
    floor = np.zeros(shape[0] * shape[1])
    np.minimum.at(floor, cell, above_plane_m)
    closed = grey_closing(floor.reshape(shape), size=(HOLE_CELLS, HOLE_CELLS)).ravel()
    holes: BoolArray = low & (above_plane_m < closed[cell] - DROP_M)
    return holes


def _above_ground_map(xy_m: FloatArray, height_m: FloatArray, ground: np.ndarray) -> FloatArray:
    """Height (n,) above the nearest ground: the mean of the ground points in a 0.5 m cell, or in the
    nearest cell that has some. Ground points get -inf, unless they stand out of the map as a roof."""
    from scipy.ndimage import distance_transform_edt, grey_opening

    flat, shape = cell_numbers(xy_m[:, 0], xy_m[:, 1], MAP_CELL_M)
    count = np.bincount(flat[ground], minlength=shape[0] * shape[1])
    total = np.bincount(flat[ground], height_m[ground], minlength=shape[0] * shape[1])
    level = (total / np.maximum(count, 1)).reshape(shape)
    empty = (count == 0).reshape(shape)
    nearest = distance_transform_edt(empty, return_distances=False, return_indices=True)
    level = level[tuple(nearest)]
    opened = grey_opening(level, size=(ROOF_WINDOW_CELLS, ROOF_WINDOW_CELLS))
    level = np.where(level - opened > ROOF_M, opened, level)
    above = height_m - level.ravel()[flat]
    is_ground = np.zeros(len(xy_m), dtype=bool)
    is_ground[ground] = True
    return np.where(is_ground & (above < ROOF_M), -np.inf, above)


def _new_patchwork(sensor_height_m: float, min_range_m: float, max_range_m: float) -> patchworkpp:
    """Patchwork++ with its publication's parameters, but zones for these surroundings, and without the
    reflected noise removal, which would want intensities in one maker's scale."""
    import pypatchworkpp

    parameters = pypatchworkpp.Parameters()
    parameters.verbose = False
    parameters.enable_RNR = False
    parameters.sensor_height = sensor_height_m
    parameters.min_range = min_range_m
    parameters.max_range = max(max_range_m, 2 * min_range_m)
    bounds = min_range_m + (parameters.max_range - min_range_m) * np.array([0.0, 1 / 8, 1 / 4, 1 / 2, 1.0])
    width = np.diff(bounds)
    around = np.pi * (bounds[:-1] + bounds[1:])
    parameters.num_rings_each_zone = [
        int(np.clip(round(w / PATCH_M), 1, car)) for w, car in zip(width, CAR_RINGS, strict=True)
    ]
    parameters.num_sectors_each_zone = [
        int(np.clip(round(a / PATCH_M), 4, car)) for a, car in zip(around, CAR_SECTORS, strict=True)
    ]
    with _quiet_stdout():
        return pypatchworkpp.patchworkpp(parameters)


@contextmanager
def _quiet_stdout() -> Iterator[None]:
    """Patchwork++ greets on the process's stdout, which is for results: send that to nowhere."""
    try:
        kept = os.dup(1)
    except OSError:  # stdout is closed: nothing can be printed on it
        yield
        return
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
