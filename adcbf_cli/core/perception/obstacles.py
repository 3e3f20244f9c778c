"""From clustered points to obstacles: a circle with a height, an oriented rectangle, and over-long
clusters split into several circles.

Centre ('auto'). Where the points fit an arc of a circle well - residual near the range noise and no
larger than from a rectangle, an arc wide enough to fix the centre, convex towards the sensor - it is
the least-squares circle's centre
(posts, trunks, barrels, round robots). Otherwise it is the centre of the rectangle fitted to the
points (vehicles, boxes, walls, people). Between the two, the centre is blended continuously by the
quality of the fit, so that it does not jump from frame to frame as it would with a switch.

Radius. The circle around the centre always encloses all the points of the obstacle, and is never
smaller than a fitted circle. What the sensor did not see of a box (its far side) may stand out.

Splitting. A circle around a wall would swallow free space that the robot needs. A cluster is split
when its circle is larger than `max_radius_m` and it is longer than `max_length_m` (longer than a car
or a group of people), or thin (a wall): a rectangle that covers less than THIN of its circle, or hollow
(the corner of a room): its circle holds the sensor, or its centre lies in front of it, where the beams
that reached it have passed. It is cut
across its length into equal parts, and those parts again where they are bent, until no circle is
larger than `max_radius_m`. Pieces name their common origin in `split_from`. Cars, groups of people
and bushes thus stay one object for the tracker.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import PerceptionConfig
from adcbf_cli.core.perception.shapes import (
    Circles,
    Rectangles,
    algebraic_circles,
    farthest,
    fit_circles,
    fit_yaw,
    group_index,
    rectangles_at,
    scatter_circles,
)
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, IntArray

THIN = 0.1
"""A rectangle that fills less of its circle is a wall: its width is below 0.08 of its length."""

HOLLOW = 0.25
"""A centre is in front of its obstacle if the beams towards it went on by this share of the radius."""

NARROW_ARC_RAD = np.radians(60.0)
WIDE_ARC_RAD = np.radians(100.0)
"""Below the first an arc does not fix a circle's centre, from the second on it does."""

ROUNDNESS = 0.03
"""Real trunks and posts are out of round by about this share of their radius."""

BOXY = 0.5
"""A rectangle that explains the points with half the circle's variance rules the circle out; where
both do equally well (small posts, whose shape drowns in the noise) the circle is taken."""

MIN_CIRCLE_POINTS = 8

ALGEBRAIC_SLACK = 3.0
"""The algebraic fit's residual is allowed this much more when it selects groups for the geometric one."""

MAX_PARTS = 64


@dataclass(frozen=True, slots=True)
class Grouped:
    """Points (n, 3) of one frame, sorted by group and then by cell: `start` (g,), each group's first.
    cells_m (k, 2) and cell_start (g,): its grid cells, in the same order."""

    points_m: FloatArray
    start: IntArray
    cells_m: FloatArray
    cell_start: IntArray


@dataclass(frozen=True, slots=True)
class Shapes:
    """One row a group: what `Clusters` says of it, still in the frame of the points."""

    centre_m: FloatArray
    radius_m: FloatArray
    height_m: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    yaw_rad: FloatArray


def group_points(points_m: FloatArray, point_cell: IntArray, cells_m: FloatArray, cell_group: IntArray) -> Grouped:
    """Sort points (n, 3) and cells (k, 2) by the cells' groups (k,), numbered from 0 without gaps.
    Cells, and the points of cells, with group NO_ID are left out."""
    cells = np.flatnonzero(cell_group != NO_ID)
    cells = cells[np.argsort(cell_group[cells], kind="stable")]
    groups = np.arange(int(cell_group.max(initial=NO_ID)) + 1)
    point_group = cell_group[point_cell]
    points = np.flatnonzero(point_group != NO_ID)
    points = points[np.argsort(point_group[points], kind="stable")]
    return Grouped(
        points_m[points],
        np.searchsorted(point_group[points], groups),
        cells_m[cells],
        np.searchsorted(cell_group[cells], groups),
    )


def measure(grouped: Grouped, config: PerceptionConfig, centre: str) -> Shapes:
    """Each group's obstacle parameters; `centre` as in `PerceptionConfig`. The sensor is the origin."""
    if len(grouped.start) == 0:
        none = np.zeros(0)
        return Shapes(np.zeros((0, 3)), none, none, none, none, none)
    xy, start = grouped.points_m[:, :2], grouped.start
    yaw = fit_yaw(grouped.cells_m, grouped.cell_start, max(config.range_noise_m, config.cell_m / 2))
    box = rectangles_at(xy, start, yaw)
    middle, length, width, least_radius = box.centre_m, box.length_m, box.width_m, np.zeros(len(start))
    if centre == "mean":
        middle = np.add.reduceat(xy, start, axis=0) / np.diff(np.append(start, len(xy)))[:, None]
    elif centre != "box":
        weight, circle = _trusted_circles(xy, start, box, config.range_noise_m, always=centre == "circle")
        middle = middle + weight[:, None] * (np.where(weight[:, None] > 0, circle.centre_m, middle) - middle)
        least_radius = weight * np.where(weight > 0, circle.radius_m, 0.0)
        # A circle's far side is known, so the rectangle is then the one around it, not around its near side.
        length = np.maximum(length, length + weight * (2 * least_radius - length))
        width = np.maximum(width, width + weight * (2 * least_radius - width))
    radius = np.maximum(farthest(xy, start, middle), least_radius)
    low = np.minimum.reduceat(grouped.points_m[:, 2], start)
    high = np.maximum.reduceat(grouped.points_m[:, 2], start)
    return Shapes(np.column_stack([middle, (low + high) / 2]), radius, high - low, length, width, box.yaw_rad)


def circle_weight(circle: Circles, box: Rectangles, size: IntArray, range_noise_m: float) -> FloatArray:
    """How far to trust each circle, (g,) in [0, 1], continuous in the points; the sensor is the origin."""
    defined = np.isfinite(circle.radius_m)
    radius = np.where(defined, circle.radius_m, 1.0)
    rms = np.where(defined, circle.rms_m, np.inf)
    fits = np.clip(2.0 - rms / (range_noise_m + ROUNDNESS * radius), 0.0, 1.0)
    arc = np.where(defined, circle.arc_rad, 0.0)
    spans = np.clip((arc - NARROW_ARC_RAD) / (WIDE_ARC_RAD - NARROW_ARC_RAD), 0.0, 1.0)
    centre = np.where(defined[:, None], circle.centre_m, 0.0)
    behind = np.hypot(*centre.T) - np.hypot(*box.centre_m.T)
    convex = np.clip(1.0 + behind / (0.25 * radius), 0.0, 1.0)
    ratio = (box.rms_m / np.maximum(rms, 1e-9)) ** 2
    rounder = np.clip((ratio - BOXY) / (1.0 - BOXY), 0.0, 1.0)
    weight: FloatArray = np.where(size >= MIN_CIRCLE_POINTS, fits * spans * convex * rounder, 0.0)
    return weight


def _trusted_circles(
    xy: FloatArray, start: IntArray, box: Rectangles, range_noise_m: float, always: bool
) -> tuple[FloatArray, Circles]:
    """Each group's circle and its weight. With `always`, every circle that is no larger than its
    rectangle counts fully. The costly fit is made only where the algebraic one does not rule it out."""
    size = np.diff(np.append(start, len(xy)))
    rough = algebraic_circles(xy, start)
    if always:
        possible = np.isfinite(rough.radius_m)
    else:
        possible = circle_weight(rough, box, size, ALGEBRAIC_SLACK * range_noise_m) > 0
    fitted = np.flatnonzero(possible)
    if len(fitted) == 0:
        return np.zeros(len(start)), rough
    points = np.flatnonzero(possible[group_index(start, len(xy))])
    begins = np.cumsum(size[fitted]) - size[fitted]
    circle = scatter_circles(fit_circles(xy[points], begins), fitted, len(start))
    if always:
        weight = np.where(circle.radius_m <= box.length_m, 1.0, 0.0)
    else:
        weight = circle_weight(circle, box, size, range_noise_m)
    return weight, circle


def must_be_split(grouped: Grouped, shapes: Shapes, config: PerceptionConfig) -> BoolArray:
    """Which groups (g,) must be split. The sensor is the origin."""
    diagonal = shapes.length_m**2 + shapes.width_m**2
    fill = shapes.length_m * shapes.width_m / np.maximum(np.pi / 4 * diagonal, 1e-12)
    large = shapes.radius_m > config.max_radius_m
    split: BoolArray = large & ((shapes.length_m > config.max_length_m) | (fill < THIN))
    end = np.append(grouped.cell_start[1:], len(grouped.cells_m))
    for i in np.flatnonzero(large & ~split):
        cells_m = grouped.cells_m[grouped.cell_start[i] : end[i]]
        split[i] = is_hollow(cells_m, shapes.centre_m[i, :2], float(shapes.radius_m[i]))
    return split


def is_hollow(cells_m: FloatArray, centre_m: FloatArray, radius_m: float) -> bool:
    """Whether an obstacle of cells (k, 2), seen from the origin, is not where its circle is: the circle holds
    the sensor, or the nearest cells on the way to its centre (2,) lie well behind that centre."""
    range_m = float(np.hypot(*centre_m))
    if range_m <= radius_m:
        return True
    towards = centre_m / range_m
    along = cells_m @ towards
    across = np.abs(cells_m @ np.array([-towards[1], towards[0]]))
    on_the_way = along[across < HOLLOW * radius_m]
    return bool(len(on_the_way) > 0 and on_the_way.min() > range_m + HOLLOW * radius_m)


def split_over_long(
    points_m: FloatArray, point_cell: IntArray, cells_m: FloatArray, cell_group: IntArray, config: PerceptionConfig
) -> tuple[Shapes, IntArray, IntArray]:
    """Measure all groups and split the over-long ones.

    Arguments as for `group_points`. Returns the final groups' shapes, each cell's final group (k,),
    and for each final group the group that it is a piece of, or NO_ID, (g,).
    """
    grouped = group_points(points_m, point_cell, cells_m, cell_group)
    shapes = measure(grouped, config, config.centre)
    long = must_be_split(grouped, shapes, config)
    if not long.any():
        return shapes, cell_group, np.full(len(long), NO_ID, dtype=np.int64)

    whole = np.flatnonzero(~long)
    final = np.full(len(cell_group), NO_ID, dtype=np.int64)
    parts = [_take(shapes, whole)]
    origin = [np.full(len(whole), NO_ID, dtype=np.int64)]
    renumber = np.full(len(long) + 1, NO_ID, dtype=np.int64)
    renumber[whole] = np.arange(len(whole))
    final = renumber[cell_group]
    count = len(whole)

    pending = np.where(renumber[cell_group] == NO_ID, cell_group, NO_ID)
    while (pending != NO_ID).any():
        pending, parent = _cut(cells_m, pending, shapes, cell_group, config)
        pieces = measure(group_points(points_m, point_cell, cells_m, pending), config, "box")
        atom = np.bincount(pending[pending != NO_ID], minlength=len(parent)) == 1
        done = np.flatnonzero((pieces.radius_m <= config.max_radius_m) | atom)
        renumber = np.full(len(parent) + 1, NO_ID, dtype=np.int64)
        renumber[done] = count + np.arange(len(done))
        final = np.where(renumber[pending] != NO_ID, renumber[pending], final)
        parts.append(_take(pieces, done))
        origin.append(parent[done])
        count += len(done)
        pending = np.where(renumber[pending] == NO_ID, pending, NO_ID)
        shapes = pieces
    return _join(parts), final, np.concatenate(origin)


def _cut(
    cells_m: FloatArray, group: IntArray, shapes: Shapes, original: IntArray, config: PerceptionConfig
) -> tuple[IntArray, IntArray]:
    """Cut each group (k,) of cells into equal parts across its rectangle's length.

    Returns the cells' new groups from 0 (NO_ID stays) and each new group's original group.
    """
    cells = np.flatnonzero(group != NO_ID)
    owner = group[cells]
    direction = np.column_stack([np.cos(shapes.yaw_rad), np.sin(shapes.yaw_rad)])[owner]
    along = (cells_m[cells] * direction).sum(axis=1)
    low = np.full(len(shapes.yaw_rad), np.inf)
    high = np.full(len(shapes.yaw_rad), -np.inf)
    np.minimum.at(low, owner, along)
    np.maximum.at(high, owner, along)
    half_width = np.minimum(shapes.width_m / 2, config.max_radius_m / np.sqrt(2.0))
    chord = 2 * np.sqrt(config.max_radius_m**2 - half_width**2)
    parts = np.clip(np.ceil(shapes.length_m / chord), 2, MAX_PARTS).astype(np.int64)
    extent = np.maximum(high - low, 1e-9)
    part = np.minimum((parts[owner] * (along - low[owner]) / extent[owner]).astype(np.int64), parts[owner] - 1)
    _, first, piece = np.unique(owner * MAX_PARTS + part, return_index=True, return_inverse=True)
    new = np.full(len(group), NO_ID, dtype=np.int64)
    new[cells] = piece
    return new, original[cells][first]


def _take(shapes: Shapes, rows: IntArray) -> Shapes:
    return Shapes(
        shapes.centre_m[rows],
        shapes.radius_m[rows],
        shapes.height_m[rows],
        shapes.length_m[rows],
        shapes.width_m[rows],
        shapes.yaw_rad[rows],
    )


def _join(parts: list[Shapes]) -> Shapes:
    return Shapes(
        np.concatenate([part.centre_m for part in parts]),
        np.concatenate([part.radius_m for part in parts]),
        np.concatenate([part.height_m for part in parts]),
        np.concatenate([part.length_m for part in parts]),
        np.concatenate([part.width_m for part in parts]),
        np.concatenate([part.yaw_rad for part in parts]),
    )
