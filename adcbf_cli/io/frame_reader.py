"""From a log to frames: scans wait until the poses up to their end have come, are corrected for motion and placed.

Streaming: what is held is a bounded queue of scans and the poses around them, however long the log is.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.deskew import knot_offsets_ns, move_points, place_points
from adcbf_cli.core.frames import StampedTransform, invert
from adcbf_cli.core.types import FloatArray, Frame, Notes, Scan
from adcbf_cli.io.logs import open_scans
from adcbf_cli.io.placement import EXTRAPOLATE_NS, Placement
from adcbf_cli.io.selection import Selection

QUEUE_SCANS = 20
"""So many scans may always wait for their poses (2 s at 10 Hz). More may wait while they are younger than the widest
gap between poses that is bridged, up to MOST_SCANS; then the oldest must do with what there is."""

MOST_SCANS = 200

FUSE_TOLERANCE_NS = 100_000_000
"""A second LiDAR's scan is fused when it is at most this far in time from the first one's."""

_POSE_HORIZON_NS = 60_000_000_000
_BEHIND_NS = 5_000_000_000
"""Poses older than the oldest waiting scan by this, or than the newest pose by the horizon, are forgotten."""


@dataclass
class _Losses:
    """What did not become a frame, by reason; told once at the end."""

    no_pose: int = 0
    backwards: int = 0
    unfused: int = 0
    uncorrected: int = 0
    first_no_pose_ns: int = 0

    def tell(self, notes: Notes, pose: str) -> None:
        if self.no_pose:
            notes.warn(
                f"{_scans(self.no_pose)} dropped: no pose from {pose} at their time "
                f"(first at {self.first_no_pose_ns / 1e9:.3f} s); --pose chooses another source"
            )
        if self.backwards:
            notes.warn(f"{_scans(self.backwards)} dropped: their stamps do not increase")
        if self.unfused:
            notes.warn(f"{_scans(self.unfused)} had no partner of the other LiDAR within {FUSE_TOLERANCE_NS * 1e-9} s")
        if self.uncorrected:
            notes.warn(f"{_scans(self.uncorrected)} not corrected for motion: poses do not cover all their points")


def _scans(number: int) -> str:
    return f"{number} scan{'' if number == 1 else 's'}"


@dataclass
class _Waiting:
    """Scans of the first LiDAR that wait for poses and partners, and recent scans of the others."""

    scans: deque[Scan] = field(default_factory=deque)
    partners: dict[str, deque[Scan]] = field(default_factory=dict)


class FrameReader:
    """Reads the frames of a log (file or folder), once, in time order.

    `selection` says what was taken; `expected_frames` how many scans the log's index promises, None where it does
    not tell. Raises UsageError on an ambiguous or unknown topic, AdcbfError on what cannot be read.
    """

    def __init__(self, path: Path, config: ReadConfig, notes: Notes) -> None:
        self._source = open_scans(path, config, notes)
        self._placement: Placement = self._source.placement
        self._sensors = self._source.sensor_frames
        self._deskew = config.deskew
        self._notes = notes
        self._losses = _Losses()
        self._last_stamp_ns: int | None = None
        self._index = 0
        self.selection: Selection = self._source.selection
        self.expected_frames: int | None = self._source.expected_frames

    def close(self) -> None:
        self._source.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        waiting = _Waiting(partners={topic: deque(maxlen=QUEUE_SCANS) for topic in self.selection.lidar[1:]})
        for event in self._source.events():
            self._take(event, waiting)
            yield from self._release(waiting, lambda: self._ready(waiting))
            self._forget(waiting)
        yield from self._release(waiting, lambda: True)
        self._losses.tell(self._notes, self.selection.pose)

    def _take(self, event: Scan | StampedTransform | tuple[StampedTransform, ...], waiting: _Waiting) -> None:
        if isinstance(event, StampedTransform):
            self._placement.add_pose(event)
        elif isinstance(event, tuple):
            for transform in event:
                self._placement.tf.add(transform)
        elif event.topic == self.selection.lidar[0]:
            waiting.scans.append(event)
        else:
            waiting.partners[event.topic].append(event)

    def _release(self, waiting: _Waiting, ready: Callable[[], bool]) -> Iterator[Frame]:
        while waiting.scans and (ready() or self._overdue(waiting)):
            frame = self._frame(waiting.scans.popleft(), waiting)
            if frame is not None:
                yield frame

    def _overdue(self, waiting: _Waiting) -> bool:
        """Whether the oldest scan has waited long enough."""
        if len(waiting.scans) <= QUEUE_SCANS:
            return False
        waited_ns = waiting.scans[-1].stamp_ns - waiting.scans[0].stamp_ns
        return len(waiting.scans) > MOST_SCANS or waited_ns > self._placement.max_gap_ns + EXTRAPOLATE_NS

    def _ready(self, waiting: _Waiting) -> bool:
        """Whether the oldest scan has its poses and its partners."""
        scan = waiting.scans[0]
        for partners in waiting.partners.values():
            if not partners or partners[-1].stamp_ns < scan.stamp_ns:
                return False
        if self._placement.source == "none":
            return True
        covered = self._placement.covered_ns(self._sensors[scan.topic])
        return covered is not None and covered >= _end_ns(scan)

    def _forget(self, waiting: _Waiting) -> None:
        oldest = waiting.scans[0].stamp_ns if waiting.scans else self._last_stamp_ns
        newest = self._placement.covered_ns(self._sensors[self.selection.lidar[0]])
        limits = [] if oldest is None else [oldest - _BEHIND_NS]
        if newest is not None:
            limits.append(newest - _POSE_HORIZON_NS)
        if limits:
            self._placement.prune(max(limits))

    def _frame(self, scan: Scan, waiting: _Waiting) -> Frame | None:
        if self._last_stamp_ns is not None and scan.stamp_ns <= self._last_stamp_ns:
            self._losses.backwards += 1
            return None
        sensor = self._sensors[scan.topic]
        matrices, known = self._placement.world_from_sensor(sensor, np.array([scan.stamp_ns]))
        if not known[0]:
            self._losses.first_no_pose_ns = self._losses.first_no_pose_ns or scan.stamp_ns
            self._losses.no_pose += 1
            return None
        world_from_sensor = matrices[0]
        sensor_from_world = invert(world_from_sensor)
        clouds = [self._points(scan, scan.stamp_ns, sensor_from_world)]
        planar = scan.planar
        for partners in waiting.partners.values():
            partner = min(partners, key=lambda other: abs(other.stamp_ns - scan.stamp_ns), default=None)
            if partner is None or abs(partner.stamp_ns - scan.stamp_ns) > FUSE_TOLERANCE_NS:
                self._losses.unfused += 1
                continue
            clouds.append(self._points(partner, scan.stamp_ns, sensor_from_world))
            planar = planar and partner.planar
        self._last_stamp_ns = scan.stamp_ns
        frame = Frame(
            index=self._index,
            stamp_ns=scan.stamp_ns,
            points_m=clouds[0] if len(clouds) == 1 else np.concatenate(clouds),
            world_from_sensor=world_from_sensor,
            planar=planar,
            pose_known=self._placement.source != "none",
        )
        self._index += 1
        return frame

    def _points(self, scan: Scan, at_ns: int, sensor_from_world: FloatArray) -> FloatArray:
        """A scan's points in the first LiDAR's frame at `at_ns`, each moved from its own time where that is known."""
        sensor = self._sensors[scan.topic]
        own = sensor == self._sensors[self.selection.lidar[0]] and scan.stamp_ns == at_ns
        moving = self._placement.source != "none"
        if self._deskew and moving and scan.offset_ns is not None and len(scan.offset_ns):
            knots = knot_offsets_ns(scan.offset_ns)
            matrices, known = self._placement.world_from_sensor(sensor, knots + scan.stamp_ns)
            if known.all() and len(knots) > 1:
                return move_points(scan.points_m, scan.offset_ns, knots, sensor_from_world @ matrices)
            self._losses.uncorrected += int(not known.all())
        if own:
            return scan.points_m
        matrices, known = self._placement.world_from_sensor(sensor, np.array([scan.stamp_ns]))
        if not known[0]:
            self._losses.unfused += 1
            return np.zeros((0, 3))
        return place_points(sensor_from_world @ matrices[0], scan.points_m)


def _end_ns(scan: Scan) -> int:
    late = int(scan.offset_ns.max()) if scan.offset_ns is not None and len(scan.offset_ns) else 0
    return scan.stamp_ns + max(0, late)
