"""Circles and rectangles fitted to many groups of plan-view points at once.

A LiDAR sees only an obstacle's near side, so that the mean of its points lies up to 0.6 radii too
near. A circle through the visible arc, or a rectangle with two visible sides, has its centre where
the obstacle's is.

Groups are given as points (n, 2) sorted by group, and `start` (g,): where each group begins; every
group has at least one point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

REFINEMENTS = 8
"""Gauss-Newton steps of the circle fit: convergence from the algebraic fit needs 3 to 6."""

DIVERGED = 10.0
"""A step of this many times the group's own size: the points are too straight for a circle."""

SMALLEST = 1e-12

COARSE_RAD = np.radians(5.0)
FINE_RAD = np.radians(1.0)
"""The rectangle's direction is searched over a quarter turn coarsely, and around the best finely."""


@dataclass(frozen=True, slots=True)
class Circles:
    """g fitted circles: centre_m (g, 2), radius_m (g,), rms_m (g,) the root mean square distance of the
    points from the circle, arc_rad (g,) the angle that they span on it. All NaN where no circle is
    determined (fewer than three points, or all on a line)."""

    centre_m: FloatArray
    radius_m: FloatArray
    rms_m: FloatArray
    arc_rad: FloatArray


@dataclass(frozen=True, slots=True)
class Rectangles:
    """g rectangles around all points: centre_m (g, 2), length_m >= width_m, yaw_rad (g,) of the length,
    in (-pi/2, pi/2]. rms_m (g,): how far the points scatter about their nearest sides; each side is
    taken where its own points are on average, since the outermost ones lie off it by the noise."""

    centre_m: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    yaw_rad: FloatArray
    rms_m: FloatArray


def group_index(start: IntArray, n: int) -> IntArray:
    """Each point's group, (n,)."""
    sizes = np.diff(np.append(start, n))
    return np.repeat(np.arange(len(start)), sizes)


def algebraic_circles(xy_m: FloatArray, start: IntArray) -> Circles:
    """Kasa's circles (1976), by linear least squares on x^2 + y^2 = 2 a x + 2 b y + c. Cheap, but too
    small for noisy partial arcs: a first guess, and a first test whether there is a circle at all."""
    local, middle, scale = _normalised(xy_m, start)
    centre, radius = _kasa(local, start)
    return _describe(local, start, centre, radius, middle, scale)


def fit_circles(xy_m: FloatArray, start: IntArray) -> Circles:
    """Least-squares circles in the geometric sense: the sum of squared distances from the circle is
    least. Gauss-Newton steps from the algebraic fit."""
    owner = group_index(start, len(xy_m))
    local, middle, scale = _normalised(xy_m, start)
    centre, radius = _kasa(local, start)
    defined = np.isfinite(radius)
    x, y = np.ascontiguousarray(local.T)
    for _ in range(REFINEMENTS):
        east, north = x - centre[owner, 0], y - centre[owner, 1]
        distance = np.maximum(np.sqrt(east**2 + north**2), SMALLEST)
        step, solvable = _normal_equations(east / distance, north / distance, distance - radius[owner], start)
        defined &= solvable & (np.abs(step).max(axis=1) < DIVERGED)
        step[~defined] = 0.0
        centre = centre + step[:, :2]
        radius = radius + step[:, 2]
    return _describe(local, start, centre, np.where(defined & (radius > 0), radius, np.nan), middle, scale)


def scatter_circles(circles: Circles, rows: IntArray, g: int) -> Circles:
    """The circles as rows of a longer record of g, NaN elsewhere."""
    wide = np.full((g, 5), np.nan)
    wide[rows] = np.column_stack([circles.centre_m, circles.radius_m, circles.rms_m, circles.arc_rad])
    return Circles(wide[:, :2], wide[:, 2], wide[:, 3], wide[:, 4])


def _normalised(xy_m: FloatArray, start: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points with each group's mean at the origin and its root mean square distance at 1; the means
    (g, 2) and scales (g,)."""
    owner = group_index(start, len(xy_m))
    size = np.diff(np.append(start, len(xy_m)))
    middle = np.add.reduceat(xy_m, start, axis=0) / size[:, None]
    local = xy_m - middle[owner]
    scale = np.sqrt(np.add.reduceat((local**2).sum(axis=1), start) / size)
    scale = np.maximum(scale, SMALLEST)
    return local / scale[owner, None], middle, scale


def _describe(
    local: FloatArray, start: IntArray, centre: FloatArray, radius: FloatArray, middle: FloatArray, scale: FloatArray
) -> Circles:
    """Residual and arc of normalised circles, scaled back to metres."""
    owner = group_index(start, len(local))
    size = np.diff(np.append(start, len(local)))
    offset = local - centre[owner]
    distance = np.sqrt((offset**2).sum(axis=1))
    rms = np.sqrt(np.add.reduceat((distance - radius[owner]) ** 2, start) / size)
    arc = _arc(np.arctan2(offset[:, 1], offset[:, 0]), owner, len(start))
    blank = np.where(np.isfinite(radius), 1.0, np.nan)
    centre_m = (centre * scale[:, None] + middle) * blank[:, None]
    return Circles(centre_m, radius * scale, rms * scale, arc * blank)


def _kasa(xy: FloatArray, start: IntArray) -> tuple[FloatArray, FloatArray]:
    """Centres (g, 2) and radii (g,) of Kasa's circles; radius NaN where undetermined."""
    x, y = xy[:, 0], xy[:, 1]
    solution, solvable = _normal_equations(2 * x, 2 * y, x**2 + y**2, start)
    solvable &= np.diff(np.append(start, len(xy))) >= 3
    centre = solution[:, :2]
    square = solution[:, 2] + (centre**2).sum(axis=1)
    radius = np.sqrt(np.where(solvable & (square > 0), square, np.nan))
    return np.where(solvable[:, None], centre, 0.0), radius


def _normal_equations(
    u: FloatArray, v: FloatArray, target: FloatArray, start: IntArray
) -> tuple[FloatArray, BoolArray]:
    """Least squares u a + v b + c = target in each group, (n,) each: solutions (g, 3), and which are determined."""
    products: FloatArray = np.stack([u * u, u * v, u, v * v, v, u * target, v * target, target])
    means: FloatArray = np.add.reduceat(products, start, axis=1) / np.diff(np.append(start, len(u)))
    finite = np.asarray(np.isfinite(means).all(axis=0))
    sums = np.ones((len(start), 9))
    sums[:, :8] = means[[0, 1, 2, 1, 3, 4, 2, 4]].T
    matrix: FloatArray = np.where(finite[:, None], sums, np.eye(3).ravel()).reshape(-1, 3, 3)
    solvable: BoolArray = finite & (np.abs(np.linalg.det(matrix)) > 1e-9)
    matrix = np.where(solvable[:, None, None], matrix, np.eye(3))
    right = np.where(solvable[:, None], means[5:].T, 0.0)
    return np.asarray(np.linalg.solve(matrix, right[:, :, None])[:, :, 0], dtype=np.float64), solvable


def _arc(angle_rad: FloatArray, owner: IntArray, g: int) -> FloatArray:
    """2 pi minus the widest empty angle between a group's points."""
    order = np.lexsort((angle_rad, owner))
    angle, group = angle_rad[order], owner[order]
    begins = np.searchsorted(group, np.arange(g))
    following = np.append(angle[1:], 0.0)
    last = np.append(begins[1:], len(angle)) - 1
    following[last] = angle[begins] + 2 * np.pi
    arc: FloatArray = 2 * np.pi - np.maximum.reduceat(following - angle, begins)
    return arc


def fit_yaw(xy_m: FloatArray, start: IntArray, edge_m: float) -> FloatArray:
    """Directions (g,) of the rectangle whose sides the points lie nearest to, modulo a quarter turn.

    The closeness criterion of Zhang et al. (Efficient L-shape fitting, IV 2017), to one degree: the
    largest sum over the points of 1 / (distance to the nearest side + edge_m). (The paper cuts off at
    edge_m instead, which leaves several directions equal.)
    """
    yaw = np.zeros(len(start))
    for step in (np.arange(0.0, np.pi / 2 - 1e-9, COARSE_RAD), FINE_RAD * np.arange(-2.0, 2.5)):
        tried = yaw + step[:, None]
        yaw = tried[np.argmax(_closeness(xy_m, start, tried, edge_m), axis=0), np.arange(len(start))]
    return yaw


def _closeness(xy_m: FloatArray, start: IntArray, yaw_rad: FloatArray, edge_m: float) -> FloatArray:
    """The criterion (a, g) for each of a directions of every group, yaw_rad (a, g)."""
    owner = group_index(start, len(xy_m))
    cosine, sine = np.cos(yaw_rad)[:, owner], np.sin(yaw_rad)[:, owner]
    nearest = np.full(cosine.shape, np.inf)
    for along in (cosine * xy_m[:, 0] + sine * xy_m[:, 1], cosine * xy_m[:, 1] - sine * xy_m[:, 0]):
        low = np.minimum.reduceat(along, start, axis=1)[:, owner]
        high = np.maximum.reduceat(along, start, axis=1)[:, owner]
        np.minimum(nearest, along - low, out=nearest)
        np.minimum(nearest, high - along, out=nearest)
    closeness: FloatArray = np.add.reduceat(1.0 / (nearest + edge_m), start, axis=1)
    return closeness


def rectangles_at(xy_m: FloatArray, start: IntArray, yaw_rad: FloatArray) -> Rectangles:
    """The rectangle around each group's points that is aligned with that yaw."""
    owner = group_index(start, len(xy_m))
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    along = cosine[owner] * xy_m[:, 0] + sine[owner] * xy_m[:, 1]
    across = cosine[owner] * xy_m[:, 1] - sine[owner] * xy_m[:, 0]
    low, high = np.minimum.reduceat(along, start), np.maximum.reduceat(along, start)
    right, left = np.minimum.reduceat(across, start), np.maximum.reduceat(across, start)
    u, v = (low + high) / 2, (right + left) / 2
    centre = np.column_stack([cosine * u - sine * v, sine * u + cosine * v])
    length, width = high - low, left - right
    to_sides = np.stack([along - low[owner], high[owner] - along, across - right[owner], left[owner] - across])
    nearest = 4 * owner + np.argmin(to_sides, axis=0)
    distance = to_sides.min(axis=0)
    on_side = np.maximum(np.bincount(nearest, minlength=4 * len(start)), 1)
    side = np.bincount(nearest, distance, minlength=4 * len(start)) / on_side
    size = np.diff(np.append(start, len(xy_m)))
    rms = np.sqrt(np.add.reduceat((distance - side[nearest]) ** 2, start) / size)
    turned = width > length
    yaw = np.where(turned, yaw_rad + np.pi / 2, yaw_rad)
    yaw = np.pi / 2 - np.mod(np.pi / 2 - yaw, np.pi)
    return Rectangles(centre, np.maximum(length, width), np.minimum(length, width), yaw, rms)


def farthest(xy_m: FloatArray, start: IntArray, centre_m: FloatArray) -> FloatArray:
    """The distance (g,) of each group's farthest point from its centre (g, 2)."""
    offset = xy_m - centre_m[group_index(start, len(xy_m))]
    distance: FloatArray = np.sqrt(np.maximum.reduceat((offset**2).sum(axis=1), start))
    return distance
