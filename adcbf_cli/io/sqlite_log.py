"""rosbag2's SQLite storage (.db3), opened read-only, with or without message compression."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection, Iterator
from itertools import pairwise
from pathlib import Path
from urllib.parse import quote

import numpy as np

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import Notes
from adcbf_cli.io.log_base import (
    MAX_BLOCK_BYTES,
    Connection,
    Log,
    Message,
    TopicInfo,
    TopicStatistics,
    printable,
    sorted_infos,
)
from adcbf_cli.io.ros_messages import ros2_type_name

MAGIC = b"SQLite format 3\0"
_BATCH_ROWS = 10_000


class SqliteLog(Log):
    """One .db3 file. compressed: its messages are zstd-compressed one by one."""

    def __init__(self, path: Path, notes: Notes, compressed: bool = False) -> None:
        super().__init__(path, (path,), notes)
        self._unpack: Callable[[bytes], bytes] = _unpack_zstd if compressed else bytes
        self._database = sqlite3.connect(f"file:{quote(str(path.resolve()))}?mode=ro&immutable=1", uri=True)
        self._database.text_factory = lambda raw: raw.decode("utf-8", "replace")
        self._by_number: dict[int, Connection] = {}
        try:
            self._open()
        except BaseException:
            self._database.close()
            raise

    def _open(self) -> None:
        self._cut_off = self._is_cut_off()
        if self._cut_off:
            self.lose(f"{self.path.name} is cut off: the database is shorter than it says")
            # SQLite refuses a file that lacks pages unless it is told that repairs are under way.
            self._database.execute("PRAGMA writable_schema=ON")
        try:
            rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id")
            for number, topic, kind, encoding in rows:
                self._by_number[int(number)] = Connection(
                    printable(str(topic)), printable(ros2_type_name(str(kind))), printable(str(encoding))
                )
            self._database.execute("SELECT id, topic_id, timestamp, data FROM messages LIMIT 0")
        except (sqlite3.DatabaseError, ValueError, TypeError) as error:
            raise AdcbfError(f"{self.path} is not a readable rosbag2 database ({printable(str(error))})") from error
        journal = self.path.with_name(f"{self.path.name}-wal")
        if journal.is_file() and journal.stat().st_size:
            # Reading it would need write access: SQLite keeps an index of it beside the database.
            self.lose(
                f"{journal.name} holds messages that are not in the database yet; sqlite3 {self.path.name} vacuum"
            )
        self.connections = tuple(dict.fromkeys(self._by_number.values()))
        self.container = "rosbag2 SQLite (.db3)"
        self._sorted_by_index = not self._cut_off and self._has_time_index()

    def close(self) -> None:
        self._database.close()

    def start_ns(self) -> int:
        try:
            return int(self._database.execute("SELECT MIN(timestamp) FROM messages").fetchone()[0] or 0)
        except (sqlite3.DatabaseError, ValueError, TypeError):
            return 0

    def count(self, topic: str) -> int | None:
        numbers = [number for number, at in self._by_number.items() if at.topic == topic]
        try:
            query = f"SELECT COUNT(*) FROM messages WHERE topic_id IN ({_marks(numbers)})"
            return int(self._database.execute(query, numbers).fetchone()[0])
        except sqlite3.DatabaseError:
            return None

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        wanted = [n for n, at in self._by_number.items() if topics is None or at.topic in topics]
        last_ns = -(2**63)
        if self._sorted_by_index:
            try:
                for message in self._rows(wanted, "timestamp", last_ns):
                    last_ns = message.log_ns
                    yield message
                return
            except sqlite3.DatabaseError as error:
                self.lose(f"{self.path.name}: the database is damaged ({error}); read as far as it goes")
        # Where the time index cannot be used, messages come as they were written, which is time order but for
        # messages of different topics written at the same moment. SQLite fills a page that is cut in the middle with
        # zeros, so of a cut file the last message is not to be trusted.
        try:
            rows = self._rows(wanted, "id", last_ns)
            yield from (row for row, _ in pairwise(rows)) if self._cut_off else rows
        except sqlite3.DatabaseError as error:
            self.lose(f"{self.path.name}: the database is damaged ({error}); read as far as it goes")

    def topics(self) -> tuple[TopicInfo, ...]:
        statistics = {connection.topic: TopicStatistics(connection) for connection in self.connections}
        try:
            cursor = self._database.execute("SELECT topic_id, timestamp FROM messages ORDER BY id")
            while batch := cursor.fetchmany(_BATCH_ROWS):
                by_number: dict[int, list[int]] = {}
                for number, log_ns in batch:
                    if isinstance(number, int) and isinstance(log_ns, int):
                        by_number.setdefault(number, []).append(log_ns)
                for number, times in by_number.items():
                    if number in self._by_number:
                        statistics[self._by_number[number].topic].add(np.array(times, dtype=np.int64))
        except sqlite3.DatabaseError as error:
            self.lose(f"{self.path.name}: the database is damaged ({error}); read as far as it goes")
        return sorted_infos(statistics)

    def _rows(self, wanted: list[int], order: str, after_ns: int) -> Iterator[Message]:
        query = (
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({_marks(wanted)}) "
            f"AND timestamp > ? ORDER BY {order}"
        )
        damaged = 0
        for number, log_ns, data in self._database.execute(query, [*wanted, after_ns]):
            if not isinstance(data, bytes) or not isinstance(log_ns, int):
                damaged += 1
                continue
            try:
                yield Message(self._by_number[number], log_ns, self._unpack(data))
            except ValueError:
                damaged += 1
        if damaged:
            self.lose(f"{self.path.name}: {damaged} messages are damaged", damaged)

    def _is_cut_off(self) -> bool:
        """Whether the file is shorter than the pages that its header counts (when that count is valid)."""
        with self.path.open("rb") as file:
            head = file.read(100)
        page_bytes = int.from_bytes(head[16:18], "big")
        page_bytes = 65536 if page_bytes == 1 else page_bytes
        count_is_valid = head[24:28] == head[92:96]
        return count_is_valid and int.from_bytes(head[28:32], "big") * page_bytes > self.path.stat().st_size

    def _has_time_index(self) -> bool:
        """Sorting without an index would hold every message at once."""
        plan = self._database.execute("EXPLAIN QUERY PLAN SELECT id FROM messages ORDER BY timestamp").fetchall()
        return not any("TEMP B-TREE" in str(row[-1]) for row in plan)


def _marks(values: list[int]) -> str:
    return ", ".join("?" * len(values))


def _unpack_zstd(data: bytes) -> bytes:
    import zstandard

    try:
        reader = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(data)
        unpacked: bytes = reader.read(MAX_BLOCK_BYTES)
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error
    return unpacked
