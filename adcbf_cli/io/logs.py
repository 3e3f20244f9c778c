"""The way in: which files make up a log, and opening it, whatever its container."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.frames import StampedTransform
from adcbf_cli.core.types import Notes, Scan
from adcbf_cli.io.bag_log import BagLog
from adcbf_cli.io.log_base import Log
from adcbf_cli.io.mcap_log import MAGIC as MCAP_MAGIC
from adcbf_cli.io.mcap_log import McapLog
from adcbf_cli.io.pcd_folder import PcdScans, pcd_files, pose_file
from adcbf_cli.io.pointcloud import ScanDecoder
from adcbf_cli.io.ros_messages import Undecodable, transforms
from adcbf_cli.io.rosbag2_log import Rosbag2Log, is_bag_folder, read_metadata, split_files
from adcbf_cli.io.selection import Plan, plan_reading
from adcbf_cli.io.sqlite_log import MAGIC as SQLITE_MAGIC
from adcbf_cli.io.sqlite_log import SqliteLog

Event = Scan | StampedTransform | tuple[StampedTransform, ...]
"""What a source gives: a scan, a pose of the pose source, or the transforms of one tf message."""


_NOT_A_LOG = "adcbf reads MCAP, ROS 1 bags, rosbag2 folders (.db3, .mcap), folders of .pcd scans, .csv object lists"


def log_files(path: Path) -> tuple[Path, ...]:
    """The files that make up a log, in a fixed order; the pose file of PCD scans is the last one. Raises AdcbfError
    where there is no log."""
    if path.is_dir():
        if is_bag_folder(path):
            return split_files(path, read_metadata(path))[0]
        return _with_poses(path, pcd_files(path))
    return _with_poses(path, (path,)) if _kind(path) == "pcd" else (path,)


def _with_poses(path: Path, scans: tuple[Path, ...]) -> tuple[Path, ...]:
    poses = pose_file(path)
    return scans if poses is None else (*scans, poses)


def open_log(path: Path, notes: Notes) -> Log:
    """Open a recorded log of ROS messages. Raises AdcbfError where it is none."""
    if path.is_dir():
        if is_bag_folder(path):
            return Rosbag2Log(path, notes)
        raise AdcbfError(f"{path} is a folder without .db3 or .mcap files; {_NOT_A_LOG}")
    kind = _kind(path)
    if kind == "mcap":
        return McapLog(path, notes)
    if kind == "bag":
        return BagLog(path, notes)
    if kind == "sqlite":
        beside = read_metadata(path.parent)
        return SqliteLog(path, notes, str(beside.get("compression_mode", "")).lower() == "message")
    raise AdcbfError(f"{path} holds no recorded topics; {_NOT_A_LOG}")


def is_log(path: Path) -> bool:
    """Whether the path is something that `open_scans` opens: by magic bytes, not by content."""
    if path.is_dir():
        return is_bag_folder(path) or holds_scans(path)
    try:
        return path.is_file() and _kind(path) != "csv"
    except AdcbfError:
        return False


def is_object_list(path: Path) -> bool:
    """Whether the path is a CSV of objects' positions, which stands for a log whose obstacles are known."""
    return path.is_file() and path.suffix.lower() == ".csv"


def holds_scans(path: Path) -> bool:
    """Whether the path is a PCD file or a folder of them (and no rosbag2 folder)."""
    if path.is_dir():
        return not is_bag_folder(path) and any(entry.suffix.lower() == ".pcd" for entry in path.iterdir())
    return path.is_file() and _kind(path) == "pcd"


def _kind(path: Path) -> str:
    """'mcap', 'bag' or 'sqlite' by a file's first bytes, 'pcd' or 'csv' by its name. Raises AdcbfError for
    anything else."""
    if path.exists() and not path.is_file():
        raise AdcbfError(f"{path} is neither a file nor a folder; {_NOT_A_LOG}")
    try:
        with path.open("rb") as file:
            head = file.read(64)
    except FileNotFoundError as error:
        raise AdcbfError(f"{path} does not exist") from error
    except OSError as error:
        raise AdcbfError(f"{path} cannot be read: {error.strerror}") from error
    for kind, magic in (("mcap", MCAP_MAGIC), ("bag", b"#ROSBAG V"), ("sqlite", SQLITE_MAGIC)):
        if head.startswith(magic):
            return kind
    if path.suffix.lower() in (".pcd", ".csv"):
        return path.suffix.lower()[1:]
    what = "is empty" if not head else "is not a log"
    raise AdcbfError(f"{path} {what}; {_NOT_A_LOG}")


class LogScans:
    """The events of a recorded log: scans of the chosen LiDARs, poses and transforms, in recording order."""

    def __init__(self, log: Log, plan: Plan) -> None:
        self._log = log
        self.selection = plan.selection
        self.placement = plan.placement
        self.sensor_frames = plan.sensor_frames
        self._tf_topics = frozenset(plan.tf_topics)
        self.expected_frames = log.count(plan.selection.lidar[0])

    def events(self) -> Iterator[Event]:
        pose = self.selection.pose
        decoders = {topic: ScanDecoder(topic, self._log.notes) for topic in self.selection.lidar}
        undecodable: dict[str, tuple[int, str]] = {}
        wanted = {*decoders, *self._tf_topics} | ({pose} - {"tf", "none"})
        for message in self._log.messages(wanted):
            topic = message.connection.topic
            try:
                if topic in decoders:
                    yield decoders[topic].scan(message)
                elif topic == pose:
                    yield from transforms(message)
                else:
                    yield tuple(transforms(message))
            except Undecodable as error:
                count, reason = undecodable.get(topic, (0, str(error)))
                undecodable[topic] = count + 1, reason
        for topic, (count, reason) in sorted(undecodable.items()):
            self._log.lose(f"{topic}: {count} messages could not be decoded ({reason})", count)

    def close(self) -> None:
        self._log.close()


ScanSource = LogScans | PcdScans


def open_scans(path: Path, config: ReadConfig, notes: Notes) -> ScanSource:
    """Open a log for reading frames: a recorded log, a folder of PCD scans, or one PCD scan."""
    if holds_scans(path):
        return PcdScans(path, config, notes)
    log = open_log(path, notes)
    try:
        return LogScans(log, plan_reading(log, config, notes))
    except BaseException:
        log.close()
        raise
