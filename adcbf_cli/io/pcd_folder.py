"""A folder of PCD scans as a log, with an optional TUM or KITTI pose file in it or beside it.

Scan times come from the file names where those look like times, else from the lines of a TUM file that has as many,
else 10 Hz is assumed, with a warning.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.frames import StampedTransform, TfBuffer
from adcbf_cli.core.types import IntArray, Notes, Scan
from adcbf_cli.io.pcd import read_pcd
from adcbf_cli.io.placement import Placement, parse_extrinsic
from adcbf_cli.io.point_times import TIME_FIELDS, PointTimes
from adcbf_cli.io.pointcloud import finite_points
from adcbf_cli.io.selection import Selection

if TYPE_CHECKING:
    from adcbf_cli.io.poses import StampedPoses

DEFAULT_STEP_NS = 100_000_000
SENSOR, WORLD = "sensor", "world"
_TUM_NAMES = ("poses.tum", "poses_tum.txt", "trajectory.tum", "traj.tum")
_EITHER_NAMES = ("poses.txt", "trajectory.txt", "groundtruth.txt")


def pcd_files(path: Path) -> tuple[Path, ...]:
    """The .pcd files of a folder (or the one file), by the numbers in their names. Raises AdcbfError."""
    if path.is_file():
        return (path,)
    if not path.is_dir():
        raise AdcbfError(f"{path} does not exist")
    found = [entry for entry in path.iterdir() if entry.suffix.lower() == ".pcd" and entry.is_file()]
    if not found:
        raise AdcbfError(f"{path} holds no .mcap, .db3 or .pcd files; give it the folder that does")
    return tuple(sorted(found, key=lambda entry: _numbers_first(entry.name)))


def pose_file(path: Path) -> Path | None:
    """The pose file of a folder of scans: in it, or beside it. Raises UsageError where there are several."""
    folder = path if path.is_dir() else path.parent
    for place in (folder, folder.parent) if path.is_dir() else (folder,):
        named = [place / name for name in (*_TUM_NAMES, *_EITHER_NAMES) if (place / name).is_file()]
        found = named or sorted(place.glob("*.tum"))
        if len(found) > 1:
            raise UsageError(f"several pose files: {', '.join(str(file) for file in found)}; keep one, or --pose FILE")
        if found:
            return found[0]
    return None


class PcdScans:
    """The events of a folder of PCD scans: all poses first, then the scans one by one."""

    def __init__(self, path: Path, config: ReadConfig, notes: Notes) -> None:
        if config.lidar:
            raise UsageError("--lidar chooses among a log's topics; a folder of PCD scans has none")
        self._files = pcd_files(path)
        self._notes = notes
        self._topic = path.name
        self.stamps_ns, named = scan_times(self._files)
        source, self._poses, timed = self._find_poses(path, config.pose, named)
        if not timed:
            notes.warn(f"the scans' file names hold no times: 10 Hz is assumed for {len(self._files)} scans")
        if source == "none" and config.pose is None:
            notes.warn("no pose file (poses.txt, *.tum) in or beside the folder: the sensor is taken to stand still")
        tf = TfBuffer()
        for text in config.extrinsics:
            extrinsic = parse_extrinsic(text)
            tf.add_static(extrinsic.parent, extrinsic.child, extrinsic.parent_from_child, fixed=True)
        child = tf.ancestors(SENSOR)[-1]
        gap_ns = round(config.max_pose_gap_s * 1e9)
        world = config.world_frame or WORLD
        kind = "none" if source == "none" else "topic"
        self.placement = Placement(kind, world, world, child, {SENSOR: child != SENSOR}, tf, gap_ns)
        reasons = (
            f"LiDAR: {len(self._files)} PCD scans",
            f"pose: {source} (--pose FILE or --pose none)",
            f"world frame {world}, sensor frame {SENSOR} (--extrinsic 'base>{SENSOR}:x,y,z,roll,pitch,yaw')",
        )
        self.selection = Selection((self._topic,), source, world, SENSOR, reasons)
        self.sensor_frames = {self._topic: SENSOR}
        self.expected_frames: int | None = len(self._files)

    def _find_poses(self, path: Path, asked: str | None, named: bool) -> tuple[str, StampedPoses | None, bool]:
        """('poses file' or 'none', the poses, whether the scans' times are known): a TUM file's times may become the
        scans'."""
        from adcbf_cli.io.poses import read_kitti_poses, read_tum

        file = pose_file(path) if asked is None else Path(asked)
        if asked == "none" or file is None:
            return "none", None, named
        if not file.is_file():
            raise UsageError(f"--pose {asked}: there is no such file; for PCD scans it is a TUM or KITTI pose file")
        if _columns(file) == 12:
            return "poses file", read_kitti_poses(file, self.stamps_ns), named
        poses = read_tum(file)
        if not named and len(poses) == len(self._files):
            self.stamps_ns = poses.stamp_ns
            named = True
        return "poses file", poses, named

    def events(self) -> Iterator[Scan | StampedTransform | tuple[StampedTransform, ...]]:
        if self._poses is not None:
            poses = self._poses
            for stamp, position, rotation in zip(poses.stamp_ns, poses.position_m, poses.quaternion_xyzw, strict=True):
                yield StampedTransform(int(stamp), WORLD, SENSOR, position, rotation)
        times = PointTimes(self._topic, self._notes)
        unreadable: list[str] = []
        for file, stamp in zip(self._files, self.stamps_ns.tolist(), strict=True):
            try:
                yield pcd_scan(file, stamp, self._topic, times)
            except AdcbfError as error:
                unreadable.append(str(error))
        if unreadable:
            self._notes.lose(f"{len(unreadable)} PCD files could not be read (first: {unreadable[0]})", len(unreadable))

    def close(self) -> None:
        """Nothing stays open between scans."""


def pcd_scan(file: Path, stamp_ns: int, topic: str, times: PointTimes) -> Scan:
    """One PCD file as a scan in the sensor's frame. Raises AdcbfError."""
    rows = read_pcd(file)
    if any(rows.dtype[name].subdtype is not None for name in ("x", "y", "z")):
        raise AdcbfError(f"{file}: x, y and z must be single numbers")
    points, kept = finite_points([rows[name] for name in ("x", "y", "z")])
    name = next((name for name in TIME_FIELDS if name in (rows.dtype.names or ())), None)
    offsets: IntArray | None = None
    if name is not None and rows.dtype[name].subdtype is None:
        offsets = times.offsets_ns(name, rows[name] if kept is None else rows[name][kept], stamp_ns)
    planar = len(points) > 2 and bool(np.ptp(points[:, 2]) == 0.0)
    return Scan(stamp_ns, SENSOR, topic, points, offsets, planar)


def scan_times(files: tuple[Path, ...]) -> tuple[IntArray, bool]:
    """Each scan's time in ns, and whether it came from the file names.

    Names that look like times: seconds with a decimal point or underscore (1581624663.149), or integers of 13, 16 or
    19 digits (ms, us, ns since 1970), strictly increasing.
    """
    stamps = [_time_in(file.stem) for file in files]
    known = [stamp for stamp in stamps if stamp is not None]
    if len(known) == len(files) and all(early < late for early, late in pairwise(known)):
        return np.array(known, dtype=np.int64), True
    return np.arange(len(files), dtype=np.int64) * DEFAULT_STEP_NS, False


def _time_in(stem: str) -> int | None:
    """The time in a file name, in ns."""
    from adcbf_cli.io.poses import seconds_to_ns

    seconds = re.search(r"(?<!\d)(\d{9,10})[._](\d{1,9})(?!\d)", stem)
    if seconds:
        return seconds_to_ns(f"{seconds[1]}.{seconds[2]}")
    for digits, scale in ((19, 1), (16, 1_000), (13, 1_000_000)):
        found = re.search(rf"(?<!\d)(\d{{{digits}}})(?!\d)", stem)
        if found:
            return int(found[1]) * scale
    return None


def _columns(file: Path) -> int:
    """Numbers in the first line that is no comment."""
    with file.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            if line.strip() and not line.lstrip().startswith(("#", "%")):
                return len(line.replace(",", " ").split())
    return 0


def _numbers_first(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
