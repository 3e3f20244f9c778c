"""Ground truth from the outside world, as `Truth` records.

Which kind a file is shows in its content, not its name:

- a CSV with a header: `timestamp_ns` (or `stamp_s`), `track_id`, `x_m`, `y_m`, and optionally `class`,
  `z_m`, `yaw_rad`, `length_m`, `width_m`, `height_m`; world frame. `adcbf simulate` writes this.
- a CSV with the columns of KITTI boxes in the odometry frame (`stamp_s`, `x_odom`, `yaw_odom`, ...);
- a KITTI tracking label file with its calibration in `../calib/` under the same name;
- a TUM trajectory (`time x y z qx qy qz qw`): one object;
- `topic:/name`: one object's poses, from a topic of the log itself.

A file is read in full before anything is computed from the log, so that a mistake in it costs no
time (`read_truth`); what needs the run's frames comes after them.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adcbf_cli.core.errors import AdcbfError, UsageError, given_by_option
from adcbf_cli.core.types import FloatArray, IntArray, Notes, Truth
from adcbf_cli.io.log_base import printable
from adcbf_cli.io.poses import check_pose_topic, checked_ns, read_pose_topic, read_tum, seconds_to_ns

TOPIC_PREFIX = "topic:"
_MAX_BYTES = 1 << 30
_MOST_M = 1e9
"""No label lies farther off, or is larger: beyond it squares lose what scoring needs."""
_MOST_ID = 1 << 62


@dataclass(frozen=True, slots=True)
class TruthContext:
    """The run that the truth is for: its frames' indices and stamps (both (n,), ascending), the log,
    the world frame's name, and the KITTI label frame of the log's first scan."""

    frame_index: IntArray
    stamp_ns: IntArray
    log: Path
    world_frame: str | None = None
    kitti_first_frame: int = 0


PlaceTruth = Callable[[TruthContext, Notes], Truth]
"""Truth that was read, waiting for the run that it is for."""


def read_truth(spec: str, log: Path) -> PlaceTruth:
    """Reads ground truth from a file, or finds the log's topic of `topic:/name`; AdcbfError or UsageError
    if it cannot be read as any known kind. What is returned gives the truth once the run's frames are known."""
    if spec.startswith(TOPIC_PREFIX):
        topic = spec.removeprefix(TOPIC_PREFIX)
        if not log.exists():
            raise AdcbfError(f"{log}: this log is gone, and the truth is a topic in it")
        check_pose_topic(log, topic)
        return lambda context, notes: _from_topic(topic, context, notes)
    path = Path(spec)
    first = _first_line(path)
    if "," in first:
        return _from_csv(path, [name.strip() for name in first.split(",")])
    words = first.split()
    if len(words) == 8 and all(_is_number(word) for word in words):
        poses = read_tum(path)
        object_poses = _one_object(path.name, poses.stamp_ns, poses.position_m, poses.quaternion_xyzw)
        return lambda context, notes: object_poses
    if len(words) in (17, 18) and not _is_number(words[2]):
        from adcbf_cli.io.kitti_labels import read_kitti_labels

        labels = read_kitti_labels(path)
        return labels.on_run
    raise UsageError(
        f"{path}: not a ground truth that is known (CSV with a header, KITTI tracking labels, TUM trajectory, "
        "or topic:/name); docs/metrics.md describes them"
    )


def read_truth_option(spec: str, log: Path) -> PlaceTruth:
    """As `read_truth`, of what --truth says: a file that holds no truth is wrong usage."""
    if spec.startswith(TOPIC_PREFIX):
        return read_truth(spec, log)
    with given_by_option():
        return read_truth(spec, log)


def load_truth(spec: str, context: TruthContext, notes: Notes) -> Truth:
    """Ground truth of a run whose frames are known; raises as `read_truth` does, and AdcbfError where
    the truth fits no frame of the run."""
    return read_truth(spec, context.log)(context, notes)


def _first_line(path: Path) -> str:
    """The first line that is neither empty nor a comment."""
    try:
        if path.is_dir():
            raise UsageError(f"{path}: is a folder; name the ground truth file in it")
        if path.exists() and not path.is_file():
            raise UsageError(f"{path}: is no regular file; save the ground truth to a file first")
        if path.stat().st_size > _MAX_BYTES:
            raise AdcbfError(f"{path}: over 1 GiB, too large for a ground truth file")
        with path.open(encoding="utf-8-sig") as lines:
            for line in lines:
                if line.strip() and not line.startswith("#"):
                    return line
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise UsageError(f"{path}: not a text file; ground truth is CSV, KITTI labels or a TUM trajectory") from None
    raise AdcbfError(f"{path}: holds no ground truth, it is empty")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


# CSV ---------------------------------------------------------------------------------------------

_GENERIC = {
    "x": "x_m",
    "y": "y_m",
    "z": "z_m",
    "yaw": "yaw_rad",
    "length": "length_m",
    "width": "width_m",
    "height": "height_m",
}
_KITTI_ODOM = {
    "x": "x_odom", "y": "y_odom", "z": "z_odom_center", "yaw": "yaw_odom",
    "length": "length", "width": "width", "height": "height",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Rows:
    """A CSV's rows. numbers: (m, 7) as `_GENERIC` orders them; azimuth_rad: (m,) in the sensor's frame, boxes only."""

    stamp_ns: list[int]
    track_id: list[int]
    category: list[str]
    numbers: list[list[float]]
    azimuth_rad: list[float]


def _from_csv(path: Path, header: Sequence[str]) -> PlaceTruth:
    boxes = "x_odom" in header
    names = _KITTI_ODOM if boxes else _GENERIC
    time = "timestamp_ns" if "timestamp_ns" in header else "stamp_s"
    missing = [name for name in (time, "track_id", names["x"], names["y"]) if name not in header]
    if missing:
        raise UsageError(f"{path}: lacks the column {missing[0]}; needs timestamp_ns (or stamp_s), track_id, x_m, y_m")
    rows = _csv_rows(path, header, time, list(names.values()), boxes)
    truth = _sorted_truth(
        path.name,
        np.array(rows.stamp_ns, dtype=np.int64),
        np.array(rows.track_id, dtype=np.int64),
        rows.category,
        np.array(rows.numbers).reshape(-1, len(names)),
    )
    if not boxes or not len(truth):
        return lambda context, notes: truth
    fov_rad = min(rows.azimuth_rad), max(rows.azimuth_rad)

    def on_frames(context: TruthContext, notes: Notes) -> Truth:
        notes.warn(
            f"{path.name}: the camera's labels span {math.degrees(fov_rad[0]):.1f} to {math.degrees(fov_rad[1]):.1f} "
            "degrees of azimuth; tracks elsewhere are neither right nor wrong (evaluation.truth_fov_deg overrides)"
        )
        return _on_frames(truth, fov_rad, context, notes)

    return on_frames


def _csv_rows(path: Path, header: Sequence[str], time: str, columns: Sequence[str], boxes: bool) -> _Rows:
    """All rows below the header; AdcbfError, naming the row, at the first that is no labelled position."""
    rows = _Rows([], [], [], [], [])
    number = 1
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            table = csv.DictReader(line for line in stream if line.strip() and not line.startswith("#"))
            table.fieldnames = list(header)
            next(table)  # the header itself: its names are stripped above
            for number, row in enumerate(table, start=2):
                try:
                    stamp = checked_ns(int(row[time])) if time == "timestamp_ns" else seconds_to_ns(row[time])
                    numbers = [_optional(row.get(name)) for name in columns]
                    if not all(math.isfinite(value) for value in numbers[:2]):
                        raise ValueError("no position")
                    rows.track_id.append(checked_id(row["track_id"]))
                    if boxes:
                        rows.azimuth_rad.append(math.atan2(float(row["y_velo"]), float(row["x_velo"])))
                except (ValueError, TypeError, KeyError):
                    raise AdcbfError(f"{path}: row {number}: not a labelled position: {_shown(row)}") from None
                rows.stamp_ns.append(stamp)
                rows.numbers.append(numbers)
                rows.category.append(row.get("class") or "object")
    except (csv.Error, UnicodeDecodeError) as error:
        raise AdcbfError(f"{path}: not readable as CSV after row {number}: {error}") from None
    return rows


def checked_id(text: str) -> int:
    """An object's id as written; ValueError where it is no whole number that a table's id column holds."""
    number = int(text)
    if abs(number) >= _MOST_ID:
        raise ValueError(f"{text[:20]} is too large an id")
    return number


def _optional(text: str | None) -> float:
    """A number, NaN where the cell is empty or absent. ValueError for what no length or angle can be."""
    value = float(text) if text else math.nan
    if abs(value) > _MOST_M:
        raise ValueError(f"{text} is out of reach")
    return value


def _shown(row: dict[str, str]) -> str:
    return printable(",".join("" if value is None else str(value) for value in row.values()))[:80]


def _sorted_truth(
    source: str, stamp_ns: IntArray, track_id: IntArray, categories: Sequence[str], columns: FloatArray
) -> Truth:
    """columns: (m, 7) x, y, z, yaw, length, width, height. An unknown z is taken as 0: scoring is
    done seen from above."""
    order = np.lexsort((track_id, stamp_ns))
    stamp_ns, track_id, columns = stamp_ns[order], track_id[order], columns[order]
    again = (np.diff(stamp_ns) == 0) & (np.diff(track_id) == 0)
    if again.any():
        i = int(np.flatnonzero(again)[0])
        raise AdcbfError(f"{source}: object {track_id[i]} has two positions at {stamp_ns[i]} ns; leave one")
    columns[:, 2] = np.nan_to_num(columns[:, 2])
    return Truth(
        frame="world",
        stamp_ns=stamp_ns,
        track_id=track_id,
        category=tuple(categories[i] for i in order),
        position_m=columns[:, :3],
        yaw_rad=columns[:, 3],
        length_m=columns[:, 4],
        width_m=columns[:, 5],
        height_m=columns[:, 6],
        source=source,
    )


def _on_frames(truth: Truth, fov_rad: tuple[float, float], context: TruthContext, notes: Notes) -> Truth:
    """Labels were made frame by frame, their stamps printed with few decimals: gives each the stamp of
    the nearest frame, within half a frame, and leaves out labels that have none."""
    frames = context.stamp_ns
    if not len(frames) or not len(truth):
        raise AdcbfError(f"{truth.source}: no labels, or a run without frames: nothing to compare")
    half = round(float(np.median(np.diff(frames))) / 2) if len(frames) > 1 else 50_000_000
    after = np.clip(np.searchsorted(frames, truth.stamp_ns), 1, max(len(frames) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(frames) - 1)
    nearer = np.abs(frames[after] - truth.stamp_ns) < np.abs(frames[before] - truth.stamp_ns)
    nearest = np.where(nearer, frames[after], frames[before])
    keep = np.abs(nearest - truth.stamp_ns) <= half
    if not keep.any():
        raise AdcbfError(
            f"{truth.source}: no label is within half a frame of a scan of this log; is it this log's ground truth?"
        )
    if not keep.all():
        notes.warn(f"{truth.source}: {int((~keep).sum())} labels have no scan within half a frame and were left out")
    return Truth(
        frame="world",
        stamp_ns=nearest[keep],
        track_id=truth.track_id[keep],
        category=tuple(name for name, k in zip(truth.category, keep, strict=True) if k),
        position_m=truth.position_m[keep],
        yaw_rad=truth.yaw_rad[keep],
        length_m=truth.length_m[keep],
        width_m=truth.width_m[keep],
        height_m=truth.height_m[keep],
        labelled_fov_rad=fov_rad,
        source=truth.source,
    )


# One object's poses ------------------------------------------------------------------------------


def _from_topic(topic: str, context: TruthContext, notes: Notes) -> Truth:
    poses = read_pose_topic(context.log, topic, notes)
    world = (context.world_frame or "").strip("/")
    frame = (poses.frame_id or "").strip("/")
    if world and frame and world != frame:
        notes.warn(f"{topic} is in frame '{frame}', the run's world is '{world}': taken as the same")
    return _one_object(f"{TOPIC_PREFIX}{topic}", poses.stamp_ns, poses.position_m, poses.quaternion_xyzw)


def _one_object(source: str, stamp_ns: IntArray, position_m: FloatArray, quaternion_xyzw: FloatArray) -> Truth:
    if not len(stamp_ns):
        raise AdcbfError(f"{source}: holds no poses")
    x, y, z, w = quaternion_xyzw.T
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    stamps, first = np.unique(stamp_ns, return_index=True)
    unknown = np.full(len(stamps), np.nan)
    return Truth(
        frame="world",
        stamp_ns=stamps,
        track_id=np.zeros(len(stamps), dtype=np.int64),
        category=("object",) * len(stamps),
        position_m=position_m[first],
        yaw_rad=yaw[first],
        length_m=unknown,
        width_m=unknown,
        height_m=unknown,
        source=source,
        exhaustive=False,
    )
