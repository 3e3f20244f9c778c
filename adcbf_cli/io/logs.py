"""The way in: which files make up a log, and opening it, whatever its container."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.frames import StampedTransform
from adcbf_cli.core.types import Notes, Scan
from adcbf_cli.io.log_base import Log
from adcbf_cli.io.mcap_log import McapLog
from adcbf_cli.io.pointcloud import ScanDecoder
from adcbf_cli.io.ros_messages import Undecodable, transforms
from adcbf_cli.io.selection import Plan, plan_reading

Event = Scan | StampedTransform | tuple[StampedTransform, ...]
"""What a source gives: a scan, a pose of the pose source, or the transforms of one tf message."""


def log_files(path: Path) -> tuple[Path, ...]:
    """The files that make up a log, in a fixed order. Raises AdcbfError where there is no log."""
    if not path.exists():
        raise AdcbfError(f"{path} does not exist")
    return (path,)


def open_log(path: Path, notes: Notes) -> Log:
    """Open a recorded log. Raises AdcbfError where it is none."""
    log_files(path)
    return McapLog(path, notes)


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


def open_scans(path: Path, config: ReadConfig, notes: Notes) -> LogScans:
    """Open a log for reading frames."""
    log = open_log(path, notes)
    try:
        return LogScans(log, plan_reading(log, config, notes))
    except BaseException:
        log.close()
        raise
