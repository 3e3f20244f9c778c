"""What really was there: the things of a recording at any time, and the distance to them.

Things are circles, or oriented rectangles where length and width are known. Between samples they are
interpolated, across gaps in their samples they are not there. What stands also stays there after the
recording's end.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from adcbf_cli.core.paths import Paths
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, IntArray

MAX_DISCS = 64
"""A rectangle is covered by at most this many discs."""

KEPT_MOMENTS = 4
"""The last moments asked for are kept: drives side by side ask for the same tick and the next one."""

_X, _VX, _RADIUS, _LENGTH, _WIDTH, _YAW = 0, 2, 4, 5, 6, 7


@dataclass(frozen=True)
class WorldObjects:
    """m things at one moment, world frame.

    id: (m,). centre_m, velocity_mps: (m, 2). radius_m: (m,) of the circle, or of the circle around the
    rectangle. length_m, width_m, yaw_rad: (m,) of the rectangle, NaN for a circle.
    """

    id: IntArray
    centre_m: FloatArray
    velocity_mps: FloatArray
    radius_m: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    yaw_rad: FloatArray

    def __len__(self) -> int:
        return len(self.id)

    def clearance(self, point_m: FloatArray, body_radius_m: float) -> FloatArray:
        """(k, m) distance from a circle around each of k points (k, 2) to each thing's surface, in m;
        negative where they overlap, by how deep the point's circle reaches in."""
        offset = np.asarray(point_m)[:, None, :] - self.centre_m
        distance = np.hypot(offset[..., 0], offset[..., 1]) - self.radius_m
        boxes = self.is_box
        if boxes.any():
            distance[:, boxes] = self._box_distance(offset[:, boxes], boxes)
        return np.asarray(distance - body_radius_m)

    @cached_property
    def is_box(self) -> BoolArray:
        return np.isfinite(self.length_m) & np.isfinite(self.width_m) & np.isfinite(self.yaw_rad)

    def _box_distance(self, offset_m: FloatArray, boxes: BoolArray) -> FloatArray:
        """Signed distance of points, given from the centres (k, b, 2), to the rectangles."""
        cos, sin = np.cos(self.yaw_rad[boxes]), np.sin(self.yaw_rad[boxes])
        along = np.abs(cos * offset_m[..., 0] + sin * offset_m[..., 1]) - 0.5 * self.length_m[boxes]
        across = np.abs(cos * offset_m[..., 1] - sin * offset_m[..., 0]) - 0.5 * self.width_m[boxes]
        outside = np.hypot(np.maximum(along, 0.0), np.maximum(across, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(along, across), 0.0))

    @cached_property
    def discs(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Discs that cover the things: centres (d, 2), velocities (d, 2), radii (d,). A rectangle's lie
        in a row along its length, the fewer the squarer it is."""
        boxes = np.flatnonzero(self.is_box)
        count = np.ones(len(self), dtype=np.int64)
        long, short = np.maximum(self.length_m, self.width_m), np.minimum(self.length_m, self.width_m)
        count[boxes] = np.clip(np.ceil(long[boxes] / np.maximum(short[boxes], 1e-3)), 1, MAX_DISCS).astype(np.int64)
        owner = np.repeat(np.arange(len(self)), count)
        place = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
        centre, radius = self.centre_m[owner].copy(), self.radius_m[owner].copy()
        of_box = self.is_box[owner]
        piece = long[owner] / count[owner]
        shift = (place - 0.5 * (count[owner] - 1)) * piece
        yaw = self.yaw_rad[owner] + np.where(self.length_m[owner] < self.width_m[owner], 0.5 * np.pi, 0.0)
        step = shift[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])
        centre[of_box] += step[of_box]
        radius[of_box] = 0.5 * np.hypot(piece, short[owner])[of_box]
        return centre, self.velocity_mps[owner], radius

    def time_to_collision(self, point_m: FloatArray, velocity_mps: FloatArray, body_radius_m: float) -> float:
        """Seconds until a disc at a point (2,) with this velocity (2,) touches any thing, all going on as
        they do, rectangles taken as their discs; NaN where none is in course, 0 where it overlaps one
        that it approaches."""
        centre, velocity, radius = self.discs
        offset, relative = centre - point_m, velocity - velocity_mps
        gap = np.einsum("ij,ij->i", offset, offset) - (radius + body_radius_m) ** 2
        closing = -np.einsum("ij,ij->i", offset, relative)
        square = np.einsum("ij,ij->i", relative, relative)
        root = closing**2 - square * gap
        meets = (closing > 0.0) & (root >= 0.0)
        if not meets.any():
            return float("nan")
        # The smaller root of |offset + relative t|^2 = R^2, written without cancellation.
        time = np.maximum(gap[meets], 0.0) / (closing[meets] + np.sqrt(root[meets]))
        return float(time.min())


@dataclass(frozen=True, slots=True)
class Samples:
    """s samples of things, any order, no (id, stamp) twice.

    id, stamp_ns: (s,). centre_m, velocity_mps: (s, 2); velocities that are NaN are taken from the
    positions. radius_m: (s,). length_m, width_m, yaw_rad: (s,) of rectangles, NaN for circles.
    """

    id: IntArray
    stamp_ns: IntArray
    centre_m: FloatArray
    velocity_mps: FloatArray
    radius_m: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    yaw_rad: FloatArray

    @classmethod
    def of(
        cls,
        id: IntArray,
        stamp_ns: IntArray,
        centre_m: FloatArray,
        radius_m: FloatArray,
        *,
        velocity_mps: FloatArray | None = None,
        length_m: FloatArray | None = None,
        width_m: FloatArray | None = None,
        yaw_rad: FloatArray | None = None,
    ) -> Samples:
        """Circles, unless length, width and yaw are given."""
        n = len(id)

        def or_nan(values: FloatArray | None, shape: tuple[int, ...]) -> FloatArray:
            return np.full(shape, np.nan) if values is None else np.broadcast_to(values, shape).astype(float)

        return cls(
            id=np.asarray(id, dtype=np.int64),
            stamp_ns=np.asarray(stamp_ns, dtype=np.int64),
            centre_m=np.asarray(centre_m, dtype=float).reshape(n, 2),
            velocity_mps=or_nan(velocity_mps, (n, 2)),
            radius_m=np.broadcast_to(radius_m, (n,)).astype(float),
            length_m=or_nan(length_m, (n,)),
            width_m=or_nan(width_m, (n,)),
            yaw_rad=or_nan(yaw_rad, (n,)),
        )

    @classmethod
    def joined(cls, parts: list[Samples]) -> Samples:
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__slots__))

    def where(self, keep: BoolArray | IntArray) -> Samples:
        return Samples(*(getattr(self, name)[keep] for name in Samples.__slots__))

    def __len__(self) -> int:
        return len(self.id)


def joined(parts: list[WorldObjects]) -> WorldObjects:
    """All of them in one, in this order."""
    return WorldObjects(
        *(np.concatenate([getattr(p, name) for p in parts]) for name in WorldObjects.__dataclass_fields__)
    )


class TrueWorld(Protocol):
    """What drives are measured against."""

    def at(self, stamp_ns: int) -> WorldObjects:
        """The things that are there at this time."""
        ...

    def nearest(self, point_m: FloatArray, body_radius_m: float, stamp_ns: int) -> tuple[float, int]:
        """Distance from the circle around a point (2,) to the nearest surface, and whose it is; NaN and
        NO_ID where nothing is known to be there."""
        ...


def nearest_of(objects: WorldObjects, point_m: FloatArray, body_radius_m: float) -> tuple[float, int]:
    """`TrueWorld.nearest` among these."""
    if not len(objects):
        return float("nan"), NO_ID
    clearance = objects.clearance(np.asarray(point_m)[None], body_radius_m)[0]
    nearest = int(np.argmin(clearance))
    return float(clearance[nearest]), int(objects.id[nearest])


class RecordedWorld:
    """The things of a recording.

    standing: ids of things that stay where they are when their samples end, and were there before the
    first, for good: what stands is seen for as long as the sensor is near, and is there all the time.
    """

    def __init__(self, samples: Samples, max_gap_s: float, standing: IntArray | None = None) -> None:
        self._max_gap_ns = round(max_gap_s * 1e9)
        samples = samples.where(np.lexsort((samples.stamp_ns, samples.id)))
        self._id, self._stamp_ns = samples.id, samples.stamp_ns
        velocity = _with_velocities(samples, self._max_gap_ns)
        self._values = np.column_stack(
            [samples.centre_m, velocity, samples.radius_m, samples.length_m, samples.width_m, samples.yaw_rad]
        )
        self._paths = Paths(samples.id, samples.stamp_ns, self._values, self._max_gap_ns, angle_column=_YAW)
        ids = self._paths.ids
        self.standing: IntArray = np.intersect1d(ids, [] if standing is None else standing).astype(np.int64)
        first = np.searchsorted(samples.id, self.standing)
        last = np.searchsorted(samples.id, self.standing, side="right") - 1
        self._first, self._last = self._values[first].copy(), self._values[last].copy()
        self._first[:, _VX : _VX + 2] = self._last[:, _VX : _VX + 2] = 0.0
        self._start_ns = samples.stamp_ns[first]
        self._latest: dict[int, WorldObjects] = {}

    def __len__(self) -> int:
        """The number of things."""
        return len(self._paths.ids)

    @cached_property
    def sha256(self) -> str:
        """Over what was there and when, to the micrometre: in two worlds with the same one, the same can happen."""
        known = np.isfinite(self._values)
        numbers = np.rint(np.where(known, self._values, 0.0) * 1e6).astype(np.int64)
        digest = hashlib.sha256(repr((self._values.shape, self._max_gap_ns)).encode())
        for part in (self._id, self._stamp_ns, known, numbers, self.standing):
            digest.update(np.ascontiguousarray(part).tobytes())
        return digest.hexdigest()

    def bounds(self) -> tuple[FloatArray, FloatArray] | None:
        """Lowest and highest x, y (2,) that any thing's circle ever reached; None in an empty world."""
        if not len(self):
            return None
        centre, radius = self._values[:, _X : _X + 2], self._values[:, _RADIUS, None]
        return (centre - radius).min(axis=0), (centre + radius).max(axis=0)

    def at(self, stamp_ns: int) -> WorldObjects:
        """The things that are there at this time."""
        if stamp_ns not in self._latest:
            if len(self._latest) >= KEPT_MOMENTS:
                self._latest.pop(next(iter(self._latest)))
            self._latest[stamp_ns] = self._at(stamp_ns)
        return self._latest[stamp_ns]

    def _at(self, stamp_ns: int) -> WorldObjects:
        ids, values = self._paths.present(stamp_ns)
        absent = ~np.isin(self.standing, ids)
        early = (stamp_ns < self._start_ns)[absent]
        rest = np.where(early[:, None], self._first[absent], self._last[absent])
        ids, values = np.concatenate([ids, self.standing[absent]]), np.concatenate([values, rest])
        return WorldObjects(
            id=ids,
            centre_m=values[:, _X : _X + 2],
            velocity_mps=values[:, _VX : _VX + 2],
            radius_m=values[:, _RADIUS],
            length_m=values[:, _LENGTH],
            width_m=values[:, _WIDTH],
            yaw_rad=values[:, _YAW],
        )

    def clearance(self, point_m: FloatArray, body_radius_m: float, stamp_ns: int) -> FloatArray:
        """(k, m) as `WorldObjects.clearance`, at this time."""
        return self.at(stamp_ns).clearance(point_m, body_radius_m)

    def nearest(self, point_m: FloatArray, body_radius_m: float, stamp_ns: int) -> tuple[float, int]:
        return nearest_of(self.at(stamp_ns), point_m, body_radius_m)


def _with_velocities(samples: Samples, max_gap_ns: int) -> FloatArray:
    """(s, 2) velocities; where missing, central differences of the positions, one-sided at the ends of a
    stretch without gaps, zero for a single sample. Samples are sorted by id, then time."""
    velocity = samples.velocity_mps.copy()
    missing = ~np.isfinite(velocity).all(axis=1)
    if not missing.any():
        return velocity
    step_ns = np.diff(samples.stamp_ns)
    linked = (np.diff(samples.id) == 0) & (step_ns <= max_gap_ns)
    here = np.arange(len(samples))
    before = here - np.concatenate([[False], linked])
    after = here + np.concatenate([linked, [False]])
    span_s = np.maximum(samples.stamp_ns[after] - samples.stamp_ns[before], 1) / 1e9
    slope = (samples.centre_m[after] - samples.centre_m[before]) / span_s[:, None]
    velocity[missing] = np.where((after > before)[:, None], slope, 0.0)[missing]
    return velocity
