"""What drawing needs: colours that stay with a track, ellipses, labels of points, paths so far."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.frames import transform_points
from adcbf_cli.core.types import NO_ID, Clusters, FloatArray, IntArray
from adcbf_cli.io.viz.records import LabelledCloud

Rgb = tuple[int, int, int]

NO_CLUSTER: Rgb = (120, 120, 120)
NO_TRACK: Rgb = (225, 225, 225)
"""Points of no obstacle; obstacles of no track."""

_GOLDEN = 0.6180339887498949
_LABEL_MARGIN_M = 0.01
_LEAST_HALF_M = 0.001
"""Viewers complain of things without a size."""

_PLANNER_HUES = (0.56, 0.08, 0.44, 0.02, 0.90, 0.75, 0.14, 0.30, 0.64)


def track_rgb(track_id: int) -> Rgb:
    """The same colour for an id always; neighbouring ids far apart in hue."""
    if track_id == NO_ID:
        return NO_TRACK
    return _rgb((track_id * _GOLDEN) % 1.0, 0.45 + 0.35 * ((track_id * 3) % 5) / 4)


def planner_rgb(place: int) -> Rgb:
    """The colour of the planner at this place among those shown."""
    return _rgb(_PLANNER_HUES[place % len(_PLANNER_HUES)], 0.9)


def _rgb(hue: float, saturation: float) -> Rgb:
    red, green, blue = (round(255 * part) for part in colorsys.hsv_to_rgb(hue, saturation, 0.95))
    return red, green, blue


@dataclass(frozen=True, slots=True)
class Ellipse:
    """Half axes, the longer first, and its direction."""

    half_m: tuple[float, float]
    yaw_rad: float


def ellipse(covariance_m2: FloatArray, probability: float) -> Ellipse:
    """Where a Gaussian (2 x 2) lies with this probability."""
    variance, axes = np.linalg.eigh(covariance_m2)
    scale = np.sqrt(-2.0 * np.log1p(-probability))
    minor, major = np.maximum(scale * np.sqrt(np.maximum(variance, 0.0)), _LEAST_HALF_M)
    return Ellipse((float(major), float(minor)), float(np.arctan2(axes[1, 1], axes[0, 1])))


def label_points(points_m: FloatArray, world_from_sensor: FloatArray, clusters: Clusters) -> IntArray:
    """(n,) the cluster whose rectangle and height each point (n, 3, sensor's frame) lies in, the nearest by its centre
    where there are several, or NO_ID. The rectangle holds all points of its cluster, and at corners a few others."""
    label = np.full(len(points_m), NO_ID, dtype=np.int64)
    if not len(clusters):
        return label
    world = transform_points(world_from_sensor, points_m)
    order = np.argsort(world[:, 0], kind="stable")
    world = world[order]
    reach = np.hypot(clusters.length_m, clusters.width_m) / 2 + 2 * _LABEL_MARGIN_M
    first = np.searchsorted(world[:, 0], clusters.centre_m[:, 0] - reach)
    end = np.searchsorted(world[:, 0], clusters.centre_m[:, 0] + reach)
    best = np.full(len(points_m), np.inf)
    for i in range(len(clusters)):
        strip = slice(first[i], end[i])
        which = first[i] + np.flatnonzero(np.abs(world[strip, 1] - clusters.centre_m[i, 1]) <= reach[i])
        offset = world[which] - clusters.centre_m[i]
        cos, sin = np.cos(clusters.yaw_rad[i]), np.sin(clusters.yaw_rad[i])
        along = np.abs(cos * offset[:, 0] + sin * offset[:, 1])
        across = np.abs(cos * offset[:, 1] - sin * offset[:, 0])
        inside = (
            (along <= clusters.length_m[i] / 2 + _LABEL_MARGIN_M)
            & (across <= clusters.width_m[i] / 2 + _LABEL_MARGIN_M)
            & (np.abs(offset[:, 2]) <= clusters.height_m[i] / 2 + _LABEL_MARGIN_M)
        )
        distance = np.where(inside, along * along + across * across, np.inf)
        nearer = distance < best[which]
        best[which[nearer]] = distance[nearer]
        label[order[which[nearer]]] = clusters.cluster_id[i]
    return label


POINT = np.dtype(
    [(name, "<f4") for name in "xyz"]
    + [(name, "<i4") for name in ("cluster_id", "track_id")]
    + [(name, "u1") for name in ("blue", "green", "red", "alpha")]
)
"""A labelled point as both MCAPs hold it; its last four bytes are ROS's packed `rgb`."""


def packed_cloud(cloud: LabelledCloud) -> np.ndarray:
    """(n,) of POINT, each point in its track's colour."""
    rows = np.empty(len(cloud.points_m), dtype=POINT)
    for axis, name in enumerate("xyz"):
        rows[name] = cloud.points_m[:, axis]
    rows["cluster_id"], rows["track_id"] = cloud.cluster_id, cloud.track_id
    colours = cloud_rgb(cloud)
    for place, name in enumerate(("red", "green", "blue")):
        rows[name] = colours[:, place]
    rows["alpha"] = 255
    return rows


def cloud_rgb(cloud: LabelledCloud) -> np.ndarray:
    """(n, 3) uint8."""
    known, which = np.unique(cloud.track_id, return_inverse=True)
    colours = np.array([track_rgb(int(one)) for one in known], dtype=np.uint8).reshape(-1, 3)[which]
    colours[cloud.cluster_id == NO_ID] = NO_CLUSTER
    return colours


SHOWN_EVERY_NS = 500_000_000
"""Paths so far are brought up to date so often: with every scan or tick, they would be most of the file."""


class Trail:
    """A path so far in bounded memory: where it would hold more than `most` poses, every other one is dropped, and
    from then on only every other one is kept."""

    def __init__(self, most: int = 512) -> None:
        self._most = most
        self._shown_ns: int | None = None
        self._kept: list[FloatArray] = []
        self._every = 1
        self._count = 0
        self._last: FloatArray = np.zeros(3)

    def add(self, pose: FloatArray) -> None:
        if self._count % self._every == 0:
            self._kept.append(pose)
            if len(self._kept) > self._most:
                self._kept = self._kept[::2]
                self._every *= 2
        self._count += 1
        self._last = pose

    def shown(self, stamp_ns: int, is_last: bool) -> FloatArray | None:
        """The path, where it is time to bring it up to date, at the latest at its end."""
        if self._shown_ns is not None and stamp_ns - self._shown_ns < SHOWN_EVERY_NS and not is_last:
            return None
        self._shown_ns = stamp_ns
        return self.poses()

    def poses(self) -> FloatArray:
        """(k, 3), the newest last."""
        newest_kept = (self._count - 1) % self._every == 0
        return np.array(self._kept if newest_kept else [*self._kept, self._last]).reshape(-1, 3)


class Floor:
    """Height of the ground around, from the bottoms of the obstacles: the sensor's own height where there are none
    yet, and with a planar laser."""

    _QUANTILE = 0.25
    _SHARE = 0.2

    def __init__(self) -> None:
        self._height_m: float | None = None

    def at(self, clusters: Clusters) -> float:
        if clusters.planar or not len(clusters):
            sensor = float(clusters.world_from_sensor[2, 3])
            return sensor if clusters.planar or self._height_m is None else self._height_m
        bottom = float(np.quantile(clusters.centre_m[:, 2] - clusters.height_m / 2, self._QUANTILE))
        last = bottom if self._height_m is None else self._height_m
        self._height_m = last + self._SHARE * (bottom - last)
        return self._height_m
