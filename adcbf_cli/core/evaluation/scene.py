"""The labelled objects of one log, in the world frame and at any time, and what of a frame was labelled."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from adcbf_cli.core import frames as se3
from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.evaluation.blocks import block_keys
from adcbf_cli.core.evaluation.matching import centre_distances, inside_boxes
from adcbf_cli.core.paths import EDGE_TOLERANCE_NS, Paths
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray, Notes, Truth

_X, _YAW, _LENGTH, _WIDTH = 0, 3, 4, 5


@dataclass(frozen=True, slots=True)
class FrameObjects:
    """The n objects labelled at one frame's stamp. in_range: (n,) near enough to be scored."""

    object_id: IntArray
    position_m: FloatArray
    yaw_rad: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    background: BoolArray
    in_range: BoolArray

    def __len__(self) -> int:
        return len(self.object_id)

    def where(self, keep: BoolArray | IntArray) -> FrameObjects:
        return FrameObjects(*(getattr(self, name)[keep] for name in FrameObjects.__slots__))

    def compare(self, point_m: FloatArray, config: EvaluationConfig) -> tuple[FloatArray, BoolArray]:
        """(n, m) distances to m points (m, 2+), and which pairs are admissible: centres within
        `match_m`, or the point inside the object's box enlarged by `box_margin_m`."""
        distance = centre_distances(self.position_m, point_m)
        inside = inside_boxes(self.position_m, self.yaw_rad, self.length_m, self.width_m, point_m, config.box_margin_m)
        return distance, (distance <= config.match_m) | inside


class Scene:
    """Ground truth, ready to be asked. truth: in the world frame (see `truth_in_world`)."""

    def __init__(self, truth: Truth, config: EvaluationConfig, range_m: float) -> None:
        self._config = config
        self.range_m = range_m
        self.exhaustive = truth.exhaustive if config.truth_exhaustive is None else config.truth_exhaustive
        values = np.column_stack([truth.position_m, truth.yaw_rad, truth.length_m, truth.width_m])
        self.paths = Paths(truth.track_id, truth.stamp_ns, values, round(config.max_gap_s * 1e9), angle_column=_YAW)
        self.category = dict(zip(truth.track_id.tolist(), truth.category, strict=True))
        self._background_classes = {name.casefold() for name in config.background_classes}
        self._background = np.array([self.is_background(i) for i in self.paths.ids.tolist()], dtype=bool)
        self.field_of_view_rad = _field_of_view(truth, config)
        self._ignored = truth.ignored

    def is_background(self, object_id: int) -> bool:
        return self.category[object_id].casefold() in self._background_classes

    def at_frame(self, stamp_ns: int, world_from_sensor: FloatArray) -> FrameObjects:
        ids, values = self.paths.present(stamp_ns)
        position = values[:, :3]
        distance = centre_distances(position, world_from_sensor[None, :3, 3])[:, 0]
        return FrameObjects(
            object_id=ids,
            position_m=position,
            yaw_rad=values[:, _YAW],
            length_m=values[:, _LENGTH],
            width_m=values[:, _WIDTH],
            background=self._background[np.searchsorted(self.paths.ids, ids)],
            in_range=distance <= self.range_m,
        )

    def labelled(self, point_m: FloatArray, stamp_ns: int, world_from_sensor: FloatArray) -> BoolArray:
        """(m,) whether a label would exist at each of m points (m, 3) if something were there:
        within range, inside the labelled field of view, outside ignored sectors."""
        local = se3.transform_points(se3.invert(world_from_sensor), point_m)
        inside: BoolArray = np.hypot(local[:, 0], local[:, 1]) <= self.range_m
        azimuth = np.arctan2(local[:, 1], local[:, 0])
        if self.field_of_view_rad is not None:
            inside &= _within(azimuth, *self.field_of_view_rad)
        if self._ignored is not None:
            now = np.abs(self._ignored.stamp_ns - stamp_ns) <= EDGE_TOLERANCE_NS
            for start, end in zip(self._ignored.start_rad[now], self._ignored.end_rad[now], strict=True):
                inside &= ~_within(azimuth, float(start), float(end))
        return inside

    def blocks(self, object_id: IntArray, stamp_ns: int) -> IntArray:
        """Bootstrap blocks: one an object and stretch of time."""
        times = np.full(len(object_id), stamp_ns, dtype=np.int64)
        block_ns = round(self._config.bootstrap_block_s * 1e9)
        return block_keys(np.searchsorted(self.paths.ids, object_id), times, block_ns)

    def position_at(self, ids: IntArray, stamp_ns: IntArray) -> tuple[FloatArray, FloatArray]:
        """True xy positions (q, 2) and yaw (q,) of objects at times, NaN where unknown."""
        values, _ = self.paths.at(ids, stamp_ns)
        return values[:, _X : _X + 2], values[:, _YAW]


def _field_of_view(truth: Truth, config: EvaluationConfig) -> tuple[float, float] | None:
    if config.truth_fov_deg is None:
        return truth.labelled_fov_rad
    start, end = config.truth_fov_deg
    return math.radians(start), math.radians(end)


def _within(azimuth_rad: FloatArray, start_rad: float, end_rad: float) -> BoolArray:
    """Whether azimuths lie between start and end, going counter-clockwise from start. An end that
    is a full turn or more after the start holds everything."""
    width = end_rad - start_rad
    if width >= 2 * math.pi:
        return np.ones(len(azimuth_rad), dtype=bool)
    inside: BoolArray = (azimuth_rad - start_rad) % (2 * math.pi) <= width % (2 * math.pi)
    return inside


def truth_in_world(truth: Truth, poses: Iterable[tuple[int, FloatArray]], notes: Notes) -> Truth:
    """Truth given in the sensor's frame, moved to the world with the run's own frames.

    poses: (stamp_ns, world_from_sensor) of every frame, ascending. Labels at a stamp without a
    frame are left out, counted in the notes. Truth that is in the world already comes back as is.
    """
    if truth.frame == "world":
        return truth
    keep = np.zeros(len(truth), dtype=bool)
    position, yaw = truth.position_m.copy(), truth.yaw_rad.copy()
    for stamp_ns, world_from_sensor in poses:
        first, last = np.searchsorted(truth.stamp_ns, [stamp_ns, stamp_ns + 1])
        rows = slice(int(first), int(last))
        keep[rows] = True
        position[rows] = se3.transform_points(world_from_sensor, truth.position_m[rows])
        heading = np.arctan2(world_from_sensor[1, 0], world_from_sensor[0, 0])
        yaw[rows] = se3.wrap_angle(truth.yaw_rad[rows] + heading)
    if not keep.any():
        raise AdcbfError(f"{truth.source}: no label falls on a frame of this log; is it this log's ground truth?")
    if not keep.all():
        notes.warn(f"{truth.source}: {int((~keep).sum())} labels fall on no frame of this log and were left out")
    return replace(
        truth,
        frame="world",
        stamp_ns=truth.stamp_ns[keep],
        track_id=truth.track_id[keep],
        category=tuple(c for c, k in zip(truth.category, keep, strict=True) if k),
        position_m=position[keep],
        yaw_rad=yaw[keep],
        length_m=truth.length_m[keep],
        width_m=truth.width_m[keep],
        height_m=truth.height_m[keep],
    )
