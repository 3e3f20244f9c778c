"""The path to follow, out of a CSV or a log's Path topic."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from adcbf_cli.core.errors import AdcbfError, UsageError, given_by_option
from adcbf_cli.core.frames import clean_frame_id
from adcbf_cli.core.types import FloatArray, Notes
from adcbf_cli.io.detect import match_topic
from adcbf_cli.io.log_base import printable
from adcbf_cli.io.logs import open_log
from adcbf_cli.io.ros_messages import PATH, Undecodable, decode

TOPIC_PREFIX = "topic:"
_MOST_POINTS = 1_000_000
_MOST_M = 1e7


def check_reference(spec: str) -> None:
    """UsageError where `spec` can be no reference path, or is a file that holds none; told before long work."""
    name = spec.removeprefix(TOPIC_PREFIX)
    if not name or (name == spec and not Path(spec).is_file()):
        raise UsageError(
            f"--reference {spec!r}: there is no such file; give a CSV, or topic:/name of a Path in the log"
        )
    if name == spec:
        with given_by_option():
            _from_csv(Path(spec))


def read_reference(spec: str, log: Path, world_frame: str | None) -> FloatArray:
    """(m, 2) x and y in the world frame from `spec`: a CSV with a header naming x_m and y_m (or x and y), or
    `topic:/name`, of which the first non-empty Path counts.

    UsageError where the spec names nothing of the kind, or a file that is no path; AdcbfError where the topic's content
    is none.
    """
    if spec.startswith(TOPIC_PREFIX):
        return _from_topic(spec.removeprefix(TOPIC_PREFIX), log, world_frame)
    with given_by_option():
        return _from_csv(Path(spec))


def _from_csv(path: Path) -> FloatArray:
    points: list[tuple[float, float]] = []
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            table = csv.DictReader(line for line in stream if line.strip() and not line.startswith("#"))
            names = [name.strip() for name in table.fieldnames or ()]
            x, y = next((pair for pair in (("x_m", "y_m"), ("x", "y")) if set(pair) <= set(names)), (None, None))
            if x is None or y is None:
                raise UsageError(f"{path}: a reference path needs a header with the columns x_m and y_m")
            table.fieldnames = names
            for row in table:
                points.append(_point(path, len(points) + 2, row, x, y))
                if len(points) > _MOST_POINTS:
                    raise AdcbfError(f"{path}: over {_MOST_POINTS:,} points; give a thinner path")
    except FileNotFoundError:
        raise UsageError(f"{path}: there is no such reference file") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise AdcbfError(f"{path}: not readable as CSV after row {len(points) + 1}: {error}") from None
    return np.array(points, dtype=float).reshape(-1, 2)


def _point(path: Path, number: int, row: dict[str, str], x: str, y: str) -> tuple[float, float]:
    try:
        point = float(row[x] or ""), float(row[y] or "")
        if not all(math.isfinite(value) and abs(value) < _MOST_M for value in point):
            raise ValueError
    except (ValueError, TypeError):
        shown = printable(",".join("" if value is None else str(value) for value in row.values()))[:80]
        raise AdcbfError(f"{path}: row {number}: not a point of a path: {shown}") from None
    return point


def _from_topic(topic: str, path: Path, world_frame: str | None) -> FloatArray:
    with open_log(path, Notes()) as log:
        types = {connection.topic: connection.msgtype for connection in log.connections}
        name = match_topic(topic, types)
        if name is None or types[name] != PATH:
            paths = ", ".join(sorted(known for known, kind in types.items() if kind == PATH)) or "none"
            raise UsageError(f"{path.name} has no Path topic {topic}; its Path topics: {paths}")
        for message in log.messages((name,)):
            try:
                decoded = decode(message)
            except Undecodable:
                continue
            if len(decoded.poses):
                _check_frame(clean_frame_id(decoded.header.frame_id), world_frame, name)
                return _checked(np.array([[p.pose.position.x, p.pose.position.y] for p in decoded.poses]), name)
    raise AdcbfError(f"{topic} in {path.name} holds no path with points")


def _check_frame(frame: str, world_frame: str | None, topic: str) -> None:
    if frame and world_frame and frame != world_frame:
        raise UsageError(
            f"{topic} is in the frame {frame}, this run's world is {world_frame}; "
            f"run the earlier stages with --world-frame {frame}"
        )


def _checked(points: FloatArray, topic: str) -> FloatArray:
    if not (np.abs(points) < _MOST_M).all():
        raise AdcbfError(f"{topic} holds points that are none (NaN, or far out of reach)")
    return points
