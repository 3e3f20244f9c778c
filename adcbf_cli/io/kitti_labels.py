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
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from adcbf_cli.core import frames as se3
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import FloatArray, IgnoredSectors, Notes, Truth

if TYPE_CHECKING:
    from adcbf_cli.io.truth import TruthContext

_DONT_CARE = "DontCare"


def read_kitti_labels(path: Path, context: TruthContext, notes: Notes) -> Truth:
    """Labels of one sequence; AdcbfError if a row or the calibration cannot be read."""
    calibration = _read_calibration(path.resolve().parent.parent / "calib" / path.name)
    velo_from_camera = se3.invert(_camera_from_velo(calibration))
    stamp_of = dict(
        zip((context.frame_index + context.kitti_first_frame).tolist(), context.stamp_ns.tolist(), strict=True)
    )
    rows: list[tuple[int, int, list[float]]] = []
    categories: list[str] = []
    sectors: list[tuple[int, float, float]] = []
    outside = 0
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if not line.strip():
            continue
        frame, track, category, values = _parse(path, number, line)
        if frame not in stamp_of:
            outside += 1
        elif category == _DONT_CARE:
            left, right = (_azimuth(u, calibration["P2"], velo_from_camera) for u in (values[3], values[5]))
            sectors.append((stamp_of[frame], right, left))
        else:
            rows.append((stamp_of[frame], track, _box(values, velo_from_camera)))
            categories.append(category)
    if not rows:
        raise AdcbfError(f"{path}: no label falls on a scan of this log (evaluation.truth_first_frame shifts them)")
    if outside:
        notes.warn(f"{path.name}: {outside} labels are of frames that this run does not have and were left out")
    return _truth(path.name, rows, categories, sectors, _field_of_view(calibration["P2"], velo_from_camera))


def _parse(path: Path, number: int, line: str) -> tuple[int, int, str, list[float]]:
    """Frame, track, class, and the numbers after it: truncated, occluded, alpha, box left, top, right,
    bottom (pixels), height, width, length, x, y, z (m), rotation about the camera's y axis."""
    words = line.split()
    try:
        values = [float(word) for word in words[3:17]]
        if len(values) != 14:
            raise ValueError
        return int(words[0]), int(words[1]), words[2], values
    except (ValueError, IndexError):
        raise AdcbfError(f"{path}: line {number}: not a KITTI tracking label: {line.strip()[:60]}") from None


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
    return found


def _camera_from_velo(calibration: dict[str, FloatArray]) -> FloatArray:
    """To the rectified frame of camera 0. Its printed rotations are orthonormal to 7 digits, which
    is enough for a rigid inverse."""
    rectify, to_camera = np.eye(4), np.eye(4)
    rectify[:3, :3] = calibration["R_rect"]
    to_camera[:3] = calibration["Tr_velo_cam"]
    result: FloatArray = rectify @ to_camera
    return result


def _azimuth(column_px: float, projection: FloatArray, velo_from_camera: FloatArray) -> float:
    """The azimuth in the Velodyne's frame of a column of camera 2's image."""
    ray = np.array([(column_px - projection[0, 2]) / projection[0, 0], 0.0, 1.0])
    ahead = velo_from_camera[:3, :3] @ ray
    return math.atan2(ahead[1], ahead[0])


def _field_of_view(projection: FloatArray, velo_from_camera: FloatArray) -> tuple[float, float]:
    """The camera's, its optical axis taken as the middle of the image."""
    right, left = 2 * float(projection[0, 2]), 0.0
    return _azimuth(right, projection, velo_from_camera), _azimuth(left, projection, velo_from_camera)


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
