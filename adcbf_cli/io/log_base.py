"""What every recorded log looks like from above: connections, time-ordered raw messages, statistics.

A log is a list of blocks (chunks of a bag, splits of a recording), each with its time span. Blocks are
opened only when their time comes, so memory holds the blocks that overlap at one moment and never the log.
"""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from adcbf_cli.core.types import IntArray, Notes

MAX_BLOCK_BYTES = 1 << 29
"""No chunk may unpack to more than this, whatever its header claims."""


def printable(text: str) -> str:
    """Text out of a file, as one line that is safe on a terminal."""
    return "".join(character if character.isprintable() else " " for character in text)


@dataclass(frozen=True)
class Connection:
    """A topic as recorded. msgtype in ROS 2 form: sensor_msgs/msg/PointCloud2; encoding 'cdr', 'ros1' or other."""

    topic: str
    msgtype: str
    encoding: str


class Message(NamedTuple):
    """One recorded message, still encoded; `log_ns` is when it was recorded."""

    connection: Connection
    log_ns: int
    data: bytes | memoryview


@dataclass(frozen=True)
class TopicInfo:
    """Statistics of one topic, by recording time. Times are None where there is no message."""

    name: str
    msgtype: str
    encoding: str
    count: int
    first_ns: int | None
    last_ns: int | None
    largest_gap_ns: int | None

    @property
    def rate_hz(self) -> float | None:
        if self.count < 2 or self.first_ns is None or self.last_ns is None or self.last_ns == self.first_ns:
            return None
        return (self.count - 1) / ((self.last_ns - self.first_ns) * 1e-9)


@dataclass
class TopicStatistics:
    """Gathers a TopicInfo from batches of recording times that arrive in rough time order."""

    connection: Connection
    count: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    largest_gap_ns: int | None = None

    def add(self, times_ns: IntArray) -> None:
        if len(times_ns) == 0:
            return
        ordered = np.sort(times_ns)
        gaps = np.diff(ordered if self.last_ns is None else np.concatenate([[self.last_ns], ordered]))
        if len(gaps):
            self.largest_gap_ns = max(self.largest_gap_ns or 0, int(gaps.max()))
        self.count += len(ordered)
        self.first_ns = int(ordered[0]) if self.first_ns is None else min(self.first_ns, int(ordered[0]))
        self.last_ns = int(ordered[-1]) if self.last_ns is None else max(self.last_ns, int(ordered[-1]))

    def info(self) -> TopicInfo:
        at = self.connection
        return TopicInfo(
            at.topic, at.msgtype, at.encoding, self.count, self.first_ns, self.last_ns, self.largest_gap_ns
        )


@dataclass
class Log(ABC):
    """A recorded log, opened. Subclasses fill `connections` when they open.

    What cannot be read is reported once to `notes` as a loss; the rest is delivered.
    """

    path: Path
    files: tuple[Path, ...]
    notes: Notes
    container: str = ""
    connections: tuple[Connection, ...] = ()
    _reported: set[str] = field(default_factory=set)

    @abstractmethod
    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages of these topics (None: all), in the order they were recorded."""

    @abstractmethod
    def topics(self) -> tuple[TopicInfo, ...]:
        """Statistics of every topic, sorted by name; reads the index, or the whole log where there is none."""

    @abstractmethod
    def start_ns(self) -> int:
        """When the first message was recorded; 0 in an empty log."""

    @abstractmethod
    def close(self) -> None: ...

    def count(self, topic: str) -> int | None:
        """How many messages a topic has, where that is known without reading the log."""
        return None

    def lose(self, what: str, count: int | None = None) -> None:
        """Report a loss once, however often the damaged place is read."""
        if what not in self._reported:
            self._reported.add(what)
            self.notes.lose(printable(what), count)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def merge_lazily(sources: Iterable[tuple[int, Callable[[], Iterator[Message]]]]) -> Iterator[Message]:
    """Merge sources of messages by time, opening each one only when its time has come.

    sources: (start_ns, open) pairs; each opened iterator must itself be in time order and start no
    earlier than start_ns. Equal times keep the order of the sources.
    """
    waiting = sorted(enumerate(sources), key=lambda item: (item[1][0], item[0]))
    waiting.reverse()
    active: list[tuple[int, int, Message, Iterator[Message]]] = []
    while waiting or active:
        if waiting and (not active or waiting[-1][1][0] <= active[0][0]):
            number, (_, open_source) = waiting.pop()
            iterator = open_source()
            first = next(iterator, None)
            if first is not None:
                heapq.heappush(active, (first.log_ns, number, first, iterator))
            continue
        _, number, message, iterator = active[0]
        yield message
        following = next(iterator, None)
        if following is None:
            heapq.heappop(active)
        else:
            heapq.heapreplace(active, (following.log_ns, number, following, iterator))


def sorted_infos(by_topic: dict[str, TopicStatistics]) -> tuple[TopicInfo, ...]:
    return tuple(by_topic[name].info() for name in sorted(by_topic))
