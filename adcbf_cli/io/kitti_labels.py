"""KITTI tracking labels: boxes in the camera's frame, brought to the Velodyne's frame.

A label file numbers its frames as the sequence's scans, so label frame i belongs to the log's scan
i - `kitti_first_frame`. The boxes stay in the sensor's frame: the run's own poses place them in the
world. What the label files say of the camera's view bounds what was labelled: its horizontal field
of view, and the DontCare regions as sectors of azimuth (the 0.3 m between camera and LiDAR are
neglected there, and only there).

Format: KITTI tracking devkit, readme.txt; rectified camera coordinates are x right, y down, z
forward, a box is placed by the middle of its underside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from adcbf_cli.core import frames as se3
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import FloatArray, IgnoredSectors, Notes, Truth
from adcbf_cli.io.log_base import printable

if TYPE_CHECKING:
    from adcbf_cli.io.truth import TruthContext

_DONT_CARE = "DontCare"
_MOST = 1e9
"""No number of a label or a calibration is larger."""


@dataclass(frozen=True, slots=True)
class _Label:
    """One line: the label frame, the object's track, its class, and the 14 numbers that follow."""

    frame: int
    track: int
    category: str
    values: list[float]


class KittiLabels:
    """One sequence's labels and calibration, read; `on_run` brings them to a run's frames."""

    def __init__(self, source: str, labels: list[_Label], projection: FloatArray, velo_from_camera: FloatArray) -> None:
        self._source = source
        self._labels = labels
        self._projection = projection
        self._velo_from_camera = velo_from_camera

    def on_run(self, context: TruthContext, notes: Notes) -> Truth:
        """The labels of the frames that the run has, in the sensor's frame. AdcbfError where there are none."""
        stamp_of = dict(
            zip((context.frame_index + context.kitti_first_frame).tolist(), context.stamp_ns.tolist(), strict=True)
        )
        rows: list[tuple[int, int, list[float]]] = []
        categories: list[str] = []
        sectors: list[tuple[int, float, float]] = []
        outside = 0
        for label in self._labels:
            if label.frame not in stamp_of:
                outside += 1
            elif label.category == _DONT_CARE:
                left, right = (self._azimuth(column) for column in (label.values[3], label.values[5]))
                sectors.append((stamp_of[label.frame], right, left))
            else:
                rows.append((stamp_of[label.frame], label.track, _box(label.values, self._velo_from_camera)))
                categories.append(label.category)
        if not rows:
            raise AdcbfError(
                f"{self._source}: no label falls on a scan of this log (evaluation.truth_first_frame shifts them)"
            )
        if outside:
            notes.warn(f"{self._source}: {outside} labels are of frames that this run does not have and were left out")
        return _truth(self._source, rows, categories, sectors, self._field_of_view())

    def _azimuth(self, column_px: float) -> float:
        """The azimuth in the Velodyne's frame of a column of camera 2's image."""
        projection = self._projection
        ray = np.array([(column_px - projection[0, 2]) / projection[0, 0], 0.0, 1.0])
        ahead = self._velo_from_camera[:3, :3] @ ray
        return math.atan2(ahead[1], ahead[0])

    def _field_of_view(self) -> tuple[float, float]:
        """The camera's, its optical axis taken as the middle of the image."""
        return self._azimuth(2 * float(self._projection[0, 2])), self._azimuth(0.0)


def read_kitti_labels(path: Path) -> KittiLabels:
    """Labels of one sequence; AdcbfError if a row or the calibration cannot be read."""
    calibration = _read_calibration(path.resolve().parent.parent / "calib" / path.name)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        raise AdcbfError(f"{path}: not readable as text to its end") from None
    labels = [_parse(path, number, line) for number, line in enumerate(lines, start=1) if line.strip()]
    seen: set[tuple[int, int]] = set()
    for label in labels:
        if label.category == _DONT_CARE:
            continue
        if (label.frame, label.track) in seen:
            raise AdcbfError(f"{path}: object {label.track} has two labels in frame {label.frame}; leave one")
        seen.add((label.frame, label.track))
    return KittiLabels(path.name, labels, calibration["P2"], se3.invert(_camera_from_velo(calibration)))


def _parse(path: Path, number: int, line: str) -> _Label:
    """A label's 14 numbers are: truncated, occluded, alpha, box left, top, right, bottom (pixels), height, width,
    length, x, y, z (m), rotation about the camera's y axis."""
    words = line.split()
    try:
        values = [float(word) for word in words[3:17]]
        if len(values) != 14 or not all(abs(value) < _MOST for value in values):
            raise ValueError
        frame, track = int(words[0]), int(words[1])
        if abs(track) > _MOST:
            raise ValueError
        return _Label(frame, track, words[2], values)
    except (ValueError, IndexError):
        shown = printable(line.strip()[:60])
        raise AdcbfError(f"{path}: line {number}: not a KITTI tracking label: {shown}") from None


def _box(values: list[float], velo_from_camera: FloatArray) -> list[float]:
    """x, y, z of the centre, yaw, length, width, height in the Velodyne's frame."""
    height, width, length, x, y, z, rotation = values[7:14]
    centre = se3.transform_points(velo_from_camera, np.array([[x, y - height / 2, z]]))[0]
    ahead = velo_from_camera[:3, :3] @ np.array([math.cos(rotation), 0.0, -math.sin(rotation)])
    return [*centre.tolist(), math.atan2(ahead[1], ahead[0]), length, width, height]


def _read_calibration(path: Path) -> dict[str, FloatArray]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError:
        raise AdcbfError(f"{path}: the labels' calibration is missing; KITTI keeps it there") from None
    except UnicodeDecodeError:
        raise AdcbfError(f"{path}: not a text file; it should be the labels' calibration") from None
    found: dict[str, FloatArray] = {}
    for line in lines:
        words = line.replace(":", " ").split()
        shapes = {"P2": (3, 4), "R_rect": (3, 3), "R0_rect": (3, 3), "Tr_velo_cam": (3, 4), "Tr_velo_to_cam": (3, 4)}
        if words and words[0] in shapes:
            try:
                found[words[0]] = np.array([float(w) for w in words[1:]]).reshape(shapes[words[0]])
            except ValueError:
                raise AdcbfError(f"{path}: {words[0]}: not the numbers of a calibration matrix") from None
    for name, other in (("R_rect", "R0_rect"), ("Tr_velo_cam", "Tr_velo_to_cam")):
        found[name] = found.get(name, found.get(other, np.zeros(0)))
    missing = [name for name in ("P2", "R_rect", "Tr_velo_cam") if not found.get(name, np.zeros(0)).size]
    if missing:
        raise AdcbfError(f"{path}: lacks {missing[0]}")
    for name in ("R_rect", "Tr_velo_cam"):
        rotation = found[name][:, :3]
        if not (np.abs(found[name]) < _MOST).all() or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
            raise AdcbfError(f"{path}: {name}: holds no rotation")
    if not (np.abs(found["P2"]) < _MOST).all() or found["P2"][0, 0] <= 0:
        raise AdcbfError(f"{path}: P2: not a camera's projection")
    return found


def _camera_from_velo(calibration: dict[str, FloatArray]) -> FloatArray:
    """To the rectified frame of camera 0. Its printed rotations are orthonormal to 7 digits, which
    is enough for a rigid inverse."""
    rectify, to_camera = np.eye(4), np.eye(4)
    rectify[:3, :3] = calibration["R_rect"]
    to_camera[:3] = calibration["Tr_velo_cam"]
    result: FloatArray = rectify @ to_camera
    return result


def _truth(
    source: str,
    rows: list[tuple[int, int, list[float]]],
    categories: list[str],
    sectors: list[tuple[int, float, float]],
    fov_rad: tuple[float, float],
) -> Truth:
    order = sorted(range(len(rows)), key=lambda i: rows[i][:2])
    columns = np.array([rows[i][2] for i in order])
    ignored = IgnoredSectors(
        np.array([s for s, _, _ in sectors], dtype=np.int64),
        np.array([a for _, a, _ in sectors]),
        np.array([b for _, _, b in sectors]),
    )
    return Truth(
        frame="sensor",
        stamp_ns=np.array([rows[i][0] for i in order], dtype=np.int64),
        track_id=np.array([rows[i][1] for i in order], dtype=np.int64),
        category=tuple(categories[i] for i in order),
        position_m=columns[:, :3],
        yaw_rad=columns[:, 3],
        length_m=columns[:, 4],
        width_m=columns[:, 5],
        height_m=columns[:, 6],
        labelled_fov_rad=fov_rad,
        source=source,
        ignored=ignored,
    )
