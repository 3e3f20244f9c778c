"""Poses out of a log's topic, a TUM file or a KITTI pose file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.frames import StampedTransform, quaternion_from_rotation
from adcbf_cli.core.types import FloatArray, IntArray, Notes
from adcbf_cli.io.detect import match_topic
from adcbf_cli.io.log_base import Log
from adcbf_cli.io.logs import open_log
from adcbf_cli.io.ros_messages import POSE_TYPES, Undecodable, transforms

_MOST_M = 1e9
"""No pose lies farther off, whatever a file says."""
_MOST_NS = 1 << 62


@dataclass(frozen=True)
class StampedPoses:
    """Poses of `child` in `frame_id`, sorted by time; '' is an unnamed frame.

    stamp_ns (m,) int64, position_m (m, 3), quaternion_xyzw (m, 4) of unit length.
    """

    stamp_ns: IntArray
    position_m: FloatArray
    quaternion_xyzw: FloatArray
    frame_id: str
    child: str

    def __len__(self) -> int:
        return len(self.stamp_ns)


def check_pose_topic(path: Path, topic: str) -> None:
    """Raises UsageError for an unknown topic of the log or one without poses. Reads no message."""
    with open_log(path, Notes()) as log:
        _pose_topic(log, topic)


def read_pose_topic(path: Path, topic: str, notes: Notes) -> StampedPoses:
    """All poses of one topic (Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped), by header stamp.

    Of equal stamps the first counts. Raises UsageError for an unknown topic or one without poses.
    """
    with open_log(path, notes) as log:
        name = _pose_topic(log, topic)
        rows: list[StampedTransform] = []
        undecodable = 0
        for message in log.messages((name,)):
            try:
                rows.extend(transforms(message))
            except Undecodable:
                undecodable += 1
        if undecodable:
            log.lose(f"{name}: {undecodable} poses could not be decoded", undecodable)
    if not rows:
        raise UsageError(f"{topic} in {path.name} holds no poses")
    return _sorted_poses(
        np.array([row.stamp_ns for row in rows], dtype=np.int64),
        np.array([row.position_m for row in rows]),
        np.array([row.quaternion_xyzw for row in rows]),
        rows[0].parent,
        rows[0].child,
    )


def _pose_topic(log: Log, topic: str) -> str:
    """The topic as the log spells it. Raises UsageError."""
    types = {connection.topic: connection.msgtype for connection in log.connections}
    name = match_topic(topic, types)
    poses = ", ".join(sorted(known for known, kind in types.items() if kind in POSE_TYPES)) or "none"
    if name is None:
        raise UsageError(f"{log.path.name} has no topic {topic}; its pose topics: {poses}")
    if types[name] not in POSE_TYPES:
        raise UsageError(f"{topic} in {log.path.name} is a {types[name]}; pose topics: {poses}")
    return name


def read_tum(path: Path) -> StampedPoses:
    """A TUM trajectory: lines 'seconds tx ty tz qx qy qz qw', # for comments. Raises AdcbfError.

    Seconds are read digit by digit, so that stamps near 1.7e9 s keep their nanoseconds.
    """
    stamps: list[int] = []
    values: list[list[float]] = []
    for number, words in _lines(path):
        if len(words) != 8:
            raise AdcbfError(f"{path} line {number}: a TUM pose has 8 numbers, this line has {len(words)}")
        try:
            stamps.append(seconds_to_ns(words[0]))
            values.append([float(word) for word in words[1:]])
        except ValueError as error:
            raise AdcbfError(f"{path} line {number}: {error}") from error
    table = np.array(values, dtype=np.float64).reshape(-1, 7)
    if len(table) == 0 or not (np.abs(table) < _MOST_M).all():
        raise AdcbfError(f"{path} holds no poses, or numbers that are no pose (NaN, or far out of reach)")
    norms = np.linalg.norm(table[:, 3:], axis=1)
    if (norms < 1e-6).any():
        raise AdcbfError(f"{path} holds a rotation that is none: a zero quaternion")
    return _sorted_poses(np.array(stamps, dtype=np.int64), table[:, :3], table[:, 3:] / norms[:, None], "world", "")


def read_kitti_poses(path: Path, times: IntArray) -> StampedPoses:
    """A KITTI odometry pose file: 12 numbers a line, the upper 3 x 4 of world_from_sensor; line i is at times[i] (ns).

    Raises AdcbfError, also where the number of lines is not that of the times.
    """
    rows: list[list[float]] = []
    for number, words in _lines(path):
        try:
            row = [float(word) for word in words]
        except ValueError as error:
            raise AdcbfError(f"{path} line {number}: {error}") from error
        if len(row) != 12:
            raise AdcbfError(f"{path} line {number}: a KITTI pose has 12 numbers, this line has {len(row)}")
        rows.append(row)
    if len(rows) != len(times):
        raise AdcbfError(f"{path} has {len(rows)} poses for {len(times)} scans; a KITTI pose file has one a scan")
    matrices = np.array(rows, dtype=np.float64).reshape(-1, 3, 4)
    rotations = matrices[:, :, :3]
    if not (np.abs(matrices) < _MOST_M).all() or np.abs(np.linalg.det(rotations) - 1).max(initial=0) > 1e-2:
        raise AdcbfError(f"{path} holds matrices that are no rigid transforms")
    quaternions = np.array([quaternion_from_rotation(rotation) for rotation in rotations]).reshape(-1, 4)
    return _sorted_poses(np.asarray(times, dtype=np.int64), matrices[:, :, 3], quaternions, "world", "")


def seconds_to_ns(text: str) -> int:
    """Decimal seconds to nanoseconds without a float in between, unless written with an exponent. Raises ValueError,
    also for what int64 nanoseconds cannot hold."""
    whole, _, fraction = text.strip().partition(".")
    digits = whole.lstrip("+-")
    if digits.isdigit() and (not fraction or fraction.isdigit()):
        ns = int(digits) * 1_000_000_000 + int((fraction[:9]).ljust(9, "0") or 0)
        return checked_ns(-ns if whole.startswith("-") else ns)
    value = float(text) * 1e9
    if not np.isfinite(value):
        raise ValueError(f"'{text[:20]}' is not a time")
    return checked_ns(round(value))


def checked_ns(stamp_ns: int) -> int:
    """The stamp, if differences of two such fit int64 (146 years either way). Raises ValueError."""
    if abs(stamp_ns) >= _MOST_NS:
        raise ValueError("a time of over a century: are seconds and nanoseconds mixed up?")
    return stamp_ns


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    """Lines that are neither empty nor comments, split at spaces or commas, with their numbers."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AdcbfError(f"{path} could not be read as text: {error}") from error
    numbered = ((number, line.strip()) for number, line in enumerate(text.splitlines(), 1))
    return [(number, line.replace(",", " ").split()) for number, line in numbered if line and line[0] not in "#%"]


def _sorted_poses(
    stamp_ns: IntArray, position_m: FloatArray, quaternion_xyzw: FloatArray, frame_id: str, child: str
) -> StampedPoses:
    stamps, order = np.unique(stamp_ns, return_index=True)
    return StampedPoses(stamps, position_m[order], quaternion_xyzw[order], frame_id, child)
