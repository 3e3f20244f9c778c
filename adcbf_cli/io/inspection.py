"""What a log holds, and what the other commands would take from it: the facts behind `adcbf info`."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import Notes
from adcbf_cli.io.detect import raw_packet_driver
from adcbf_cli.io.log_base import Log, TopicInfo
from adcbf_cli.io.logs import log_files, open_log
from adcbf_cli.io.pcd import read_pcd
from adcbf_cli.io.pcd_folder import PcdScans, pcd_files
from adcbf_cli.io.ros_messages import ODOMETRY
from adcbf_cli.io.selection import (
    Selection,
    lidar_candidates,
    plan_reading,
    pose_candidates,
    static_transforms,
    tf_tree,
)

_TF_MESSAGES = 20_000
_TF_NS = 3_600_000_000_000
"""So many messages of /tf, or an hour, are looked at for the tree; a frame that comes later is not shown."""


@dataclass(frozen=True)
class TopicFacts:
    """A topic's statistics, its messages' frame where it is a LiDAR or a pose, and what is special about it."""

    info: TopicInfo
    frame_id: str
    remark: str


@dataclass(frozen=True)
class LogFacts:
    """What was found. selection: what other commands would take, or None with the `problem` that stops them.

    edges: (parent, child, how), how being 'static', 'moving' or the odometry topic that carries it.
    loose_frames: LiDAR frames that no transform mentions.
    """

    path: Path
    container: str
    files: tuple[Path, ...]
    bytes: int
    topics: tuple[TopicFacts, ...]
    edges: tuple[tuple[str, str, str], ...]
    loose_frames: tuple[str, ...]
    selection: Selection | None
    problem: str

    @property
    def messages(self) -> int:
        return sum(topic.info.count for topic in self.topics)

    @property
    def start_ns(self) -> int | None:
        return min((t.info.first_ns for t in self.topics if t.info.first_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        return max((t.info.last_ns for t in self.topics if t.info.last_ns is not None), default=None)

    @property
    def flags(self) -> tuple[str, ...]:
        """The flags that say aloud what is taken by itself."""
        if self.selection is None:
            return ()
        named = [flag for topic in self.selection.lidar for flag in ("--lidar", topic)]
        return (*named, "--pose", self.selection.pose)


def inspect_log(path: Path, notes: Notes) -> LogFacts:
    """Look through a recorded log. Raises AdcbfError where it is none."""
    with open_log(path, notes) as log:
        frames, edges, loose = _frames(log)
        topics = tuple(TopicFacts(info, frames.get(info.name, ""), _remark(info)) for info in log.topics())
        selection, problem = None, ""
        try:
            selection = plan_reading(log, ReadConfig(), notes).selection
        except AdcbfError as error:
            problem = str(error)
        size = sum(file.stat().st_size for file in log.files)
        return LogFacts(path, log.container, log.files, size, topics, edges, loose, selection, problem)


def inspect_scans(path: Path, notes: Notes) -> LogFacts:
    """Look at a folder of PCD scans, or one scan. Raises AdcbfError."""
    files = pcd_files(path)
    scans = PcdScans(path, ReadConfig(), notes)
    first = read_pcd(files[0])
    stamps = scans.stamps_ns
    gap = max((int(late - early) for early, late in pairwise(stamps)), default=None)
    info = TopicInfo(scans.selection.lidar[0], "PCD", "pcd", len(files), int(stamps[0]), int(stamps[-1]), gap)
    remark = f"{len(first)} points in the first scan; fields {', '.join(first.dtype.names or ())}"
    size = sum(file.stat().st_size for file in files)
    topics = (TopicFacts(info, scans.selection.sensor_frame, remark),)
    return LogFacts(path, "PCD scans", log_files(path), size, topics, (), (), scans.selection, "")


def _frames(log: Log) -> tuple[dict[str, str], tuple[tuple[str, str, str], ...], tuple[str, ...]]:
    """Each LiDAR and pose topic's frame, the edges of the TF tree, and LiDAR frames outside of it."""
    lidars, poses = lidar_candidates(log), pose_candidates(log)
    names = {item.topic: item.frame_id for item in lidars}
    names |= {i.topic: f"{i.frame_id} > {i.child_frame_id}" if i.child_frame_id else i.frame_id for i in poses}
    tree = tf_tree(log, static_transforms(log, []), _TF_MESSAGES, _TF_NS)
    edges = {(parent, child): "static" if static else "moving" for parent, child, static in tree.edges()}
    for item in poses:
        if item.msgtype == ODOMETRY and item.frame_id and item.child_frame_id:
            edges.setdefault((item.frame_id, item.child_frame_id), item.topic)
    known = {frame for edge in edges for frame in edge}
    loose = sorted({item.frame_id for item in lidars if item.frame_id} - known)
    return names, tuple((*edge, how) for edge, how in sorted(edges.items())), tuple(loose)


def _remark(info: TopicInfo) -> str:
    driver = raw_packet_driver(info.msgtype)
    if driver:
        return f"raw packets: decode them with {driver}"
    return "" if info.count else "no messages"


def tree_lines(edges: tuple[tuple[str, str, str], ...]) -> list[tuple[int, str, str]]:
    """The TF tree from the roots down: (depth, frame, how it hangs on its parent). A loop is cut where it closes."""
    children: dict[str, list[tuple[str, str]]] = {}
    for parent, child, how in edges:
        children.setdefault(parent, []).append((child, how))
    below = {child for _, child, _ in edges}
    lines: list[tuple[int, str, str]] = []
    seen: set[str] = set()
    roots = [parent for parent in sorted(children) if parent not in below] or sorted(children)[:1]
    waiting = [(0, root, "") for root in reversed(roots)]
    while waiting:
        depth, frame, how = waiting.pop()
        lines.append((depth, frame, how))
        if frame not in seen:
            seen.add(frame)
            waiting.extend((depth + 1, child, what) for child, what in sorted(children.get(frame, ()), reverse=True))
    return lines


def first_bytes(path: Path, count: int) -> bytes:
    with path.open("rb") as file:
        return file.read(count)


def first_lines(path: Path, count: int) -> list[str]:
    """The first lines of a text file; empty where it is none."""
    head = first_bytes(path, 8192)
    if b"\0" in head:
        return []
    lines = (line.strip() for line in head.decode("utf-8", "replace").splitlines())
    return list(islice((line for line in lines if line and line[0] not in "#%"), count))
