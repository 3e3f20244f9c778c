"""ROS 1 bags (format 2.0): indexed, unindexed (.active, killed recorder) or cut off; uncompressed, bz2 or lz4 chunks.

The reader hops over the records and keeps one entry a chunk, so memory grows neither with the messages nor with their
index, and a bag without its index needs no repair first.
"""

from __future__ import annotations

import bz2
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import IntArray, Notes
from adcbf_cli.io.log_base import (
    MAX_BLOCK_BYTES,
    Connection,
    Log,
    Message,
    TopicInfo,
    TopicStatistics,
    merge_lazily,
    printable,
    sorted_infos,
)
from adcbf_cli.io.ros_messages import ros2_type_name

MAGIC = b"#ROSBAG V2.0\n"
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")
_MAX_HEADER_BYTES = 1 << 20

_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7


class BadRecord(ValueError):
    """Bytes that are no bag record."""


@dataclass
class _Chunk:
    """A chunk's place, and what its index records say. indexes: (connection, offset, entries) of each."""

    offset: int
    length: int
    compression: str
    unpacked_bytes: int
    start_ns: int
    indexes: list[tuple[int, int, int]]
    complete: bool


class BagLog(Log):
    """One ROS 1 bag."""

    def __init__(self, path: Path, notes: Notes) -> None:
        super().__init__(path, (path,), notes)
        self._file: BinaryIO = path.open("rb")
        self._size = path.stat().st_size
        self._by_number: dict[int, Connection] = {}
        self._chunks: list[_Chunk] = []
        try:
            self._open()
        except BaseException:
            self._file.close()
            raise

    def _open(self) -> None:
        if self._file.read(len(MAGIC)) != MAGIC:
            raise AdcbfError(f"{self.path} is not a ROS bag of format 2.0 (older ones: rosbag migrates them)")
        whole = self._hop()
        if not whole:
            self._complete_from_contents()
        self.connections = tuple(dict.fromkeys(self._by_number[number] for number in sorted(self._by_number)))
        packing = ", ".join(sorted({chunk.compression for chunk in self._chunks})) or "empty"
        self.container = f"ROS 1 bag ({'uncompressed' if packing == 'none' else packing})"

    def close(self) -> None:
        self._file.close()

    def start_ns(self) -> int:
        return min((chunk.start_ns for chunk in self._chunks), default=0)

    def count(self, topic: str) -> int | None:
        numbers = {number for number, at in self._by_number.items() if at.topic == topic}
        if any(not chunk.complete for chunk in self._chunks):
            return None
        return sum(entries for chunk in self._chunks for number, _, entries in chunk.indexes if number in numbers)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        wanted = None
        if topics is not None:
            wanted = {number for number, at in self._by_number.items() if at.topic in topics}

        chunks = [
            chunk
            for chunk in self._chunks
            if wanted is None or not chunk.complete or any(number in wanted for number, _, _ in chunk.indexes)
        ]
        return merge_lazily([(chunk.start_ns, partial(self._chunk_messages, chunk, wanted)) for chunk in chunks])

    def topics(self) -> tuple[TopicInfo, ...]:
        statistics = {connection.topic: TopicStatistics(connection) for connection in self.connections}
        for chunk in sorted(self._chunks, key=lambda chunk: chunk.start_ns):
            for number, times in self._chunk_times(chunk):
                statistics[self._by_number[number].topic].add(times)
        return sorted_infos(statistics)

    # --- records

    def _hop(self) -> bool:
        """Collect chunks and connections from record to record; True where the file is whole and indexed."""
        position = len(MAGIC)
        ended, whole, declared = False, True, -1
        resume: list[int] = []
        while position < self._size:
            try:
                header, data, end = self._record_at(position)
                operation = _operation(header)
                if operation == _BAG:
                    declared = _U32.unpack(header.get(b"chunk_count", bytes(4)))[0]
                    resume = self._places_in_index(header)
                    if header.get(b"encryptor"):
                        raise AdcbfError(f"{self.path} is encrypted; decrypt it first")
                elif operation in (_CONNECTION, _MESSAGE) and self._chunks and self._chunks[-1].length == 0:
                    # A chunk that its recorder never closed: its records follow a head that says 0 bytes.
                    self._chunks[-1].length = self._size + 1 - self._chunks[-1].offset
                    break
                elif operation == _CHUNK:
                    self._chunks.append(_chunk(header, data, end - data))
                elif operation == _INDEX:
                    self._add_index(header, data)
                elif operation == _CONNECTION:
                    self._add_connection(header, self._at(data, end - data))
                ended = ended or operation == _CHUNK_INFO
                position = end
            except (BadRecord, struct.error) as error:
                whole = False
                following = next((place for place in resume if place > position), None)
                self._note_damage(position, following, str(error))
                if following is None:
                    return False
                position = following
        if self._chunks and self._chunks[-1].offset + self._chunks[-1].length > self._size:
            self._note_damage(self._chunks[-1].offset, None, "its last chunk is incomplete")
        elif whole and (declared != len(self._chunks) or (self._chunks and not ended)):
            self.lose(f"{self.path.name} is cut off, or was not closed by its recorder: its index is missing")
        return whole and ended and all(chunk.complete for chunk in self._chunks)

    def _places_in_index(self, bag_header: dict[bytes, bytes]) -> list[int]:
        """Where chunks and the index begin, as the index at the end says: places to go on at after damage."""
        (position,) = struct.unpack("<Q", bag_header.get(b"index_pos", bytes(8)))
        places = [position] if position else []
        while 0 < position < self._size:
            try:
                header, _, position = self._record_at(position)
            except (BadRecord, struct.error):
                break
            if b"chunk_pos" in header and len(header[b"chunk_pos"]) == 8:
                places.append(struct.unpack("<Q", header[b"chunk_pos"])[0])
        return sorted(place for place in places if place < self._size)

    def _record_at(self, position: int) -> tuple[dict[bytes, bytes], int, int]:
        """Header fields, where the data starts, and where the record ends."""
        raw = self._at(position, 4)
        if len(raw) < 4:
            raise BadRecord("a record's head is cut off")
        (header_bytes,) = _U32.unpack(raw)
        if header_bytes > _MAX_HEADER_BYTES:
            raise BadRecord(f"a header of {header_bytes} bytes")
        rest = self._at(position + 4, header_bytes + 4)
        if len(rest) < header_bytes + 4:
            raise BadRecord("a record's head is cut off")
        header = _fields(memoryview(rest)[:header_bytes])
        (data_bytes,) = _U32.unpack_from(rest, header_bytes)
        data = position + 4 + header_bytes + 4
        if data + data_bytes > self._size and _operation(header) != _CHUNK:
            raise BadRecord("a record is cut off")
        return header, data, data + data_bytes

    def _note_damage(self, position: int, following: int | None, why: str) -> None:
        until = f"to {following}" if following is not None else f"to the end ({self._size})"
        self.lose(f"{self.path.name} is damaged from byte {position} {until}: {why}")

    def _add_index(self, header: dict[bytes, bytes], data: int) -> None:
        (number,) = _U32.unpack(header[b"conn"]) if b"conn" in header else (0,)
        (entries,) = _U32.unpack(header.get(b"count", bytes(4)))
        if not self._chunks or data + 12 * entries > self._size:
            raise BadRecord("an index record fits no chunk")
        chunk = self._chunks[-1]
        chunk.indexes.append((number, data, entries))
        first_ns = int(self._index_times(data, entries).min(initial=np.iinfo(np.int64).max))
        chunk.start_ns = first_ns if not chunk.complete else min(chunk.start_ns, first_ns)
        chunk.complete = True

    def _index_times(self, offset: int, entries: int) -> IntArray:
        pairs = np.frombuffer(self._at(offset, 12 * entries), dtype="<u4").reshape(-1, 3).astype(np.int64)
        times: IntArray = pairs[:, 0] * 1_000_000_000 + pairs[:, 1]
        return times

    def _add_connection(self, header: dict[bytes, bytes], data: bytes | memoryview) -> None:
        details = _fields(memoryview(data))
        if b"conn" not in header or b"type" not in details:
            raise BadRecord("a connection record without its fields")
        topic = printable(header.get(b"topic", b"").decode("utf-8", "replace"))
        kind = printable(ros2_type_name(details[b"type"].decode("utf-8", "replace")))
        self._by_number.setdefault(_U32.unpack(header[b"conn"])[0], Connection(topic, kind, "ros1"))

    def _complete_from_contents(self) -> None:
        """What a missing index would tell: the connections, and the first times of chunks without index records."""
        for chunk in self._chunks:
            known = all(number in self._by_number for number, _, _ in chunk.indexes)
            if chunk.complete and known:
                continue
            times = [log_ns for _, log_ns, _ in self._chunk_records(chunk)]
            if times and not chunk.complete:
                chunk.start_ns = min(times)

    # --- chunks

    def _at(self, offset: int, length: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(max(0, min(length, self._size - offset)))

    def _chunk_times(self, chunk: _Chunk) -> Iterator[tuple[int, IntArray]]:
        if chunk.complete:
            for number, offset, entries in chunk.indexes:
                if number in self._by_number:
                    yield number, self._index_times(offset, entries)
            return
        times: dict[int, list[int]] = {}
        for number, log_ns, _ in self._chunk_records(chunk):
            times.setdefault(number, []).append(log_ns)
        for number, found in times.items():
            if number in self._by_number:
                yield number, np.array(found, dtype=np.int64)

    def _chunk_messages(self, chunk: _Chunk, wanted: set[int] | None) -> Iterator[Message]:
        found = [
            (log_ns, number, data)
            for number, log_ns, data in self._chunk_records(chunk)
            if number in self._by_number and (wanted is None or number in wanted)
        ]
        found.sort(key=lambda item: item[0])
        for log_ns, number, data in found:
            yield Message(self._by_number[number], log_ns, data)

    def _chunk_records(self, chunk: _Chunk) -> Iterator[tuple[int, int, memoryview]]:
        """(connection, time, data) of a chunk's messages; registers connections on the way. A damaged chunk is
        reported, and gives what comes before the damage."""
        cut = chunk.offset + chunk.length > self._size
        try:
            if chunk.length > MAX_BLOCK_BYTES:  # a damaged length may claim the rest of a file of any size
                raise BadRecord(f"it claims {chunk.length} bytes")
            data = memoryview(_unpack(chunk, self._at(chunk.offset, chunk.length), cut))
            position = 0
            while position + 8 <= len(data):
                (header_bytes,) = _U32.unpack_from(data, position)
                start = position + 8 + header_bytes
                if start > len(data):
                    break
                (data_bytes,) = _U32.unpack_from(data, start - 4)
                if start + data_bytes > len(data):
                    break
                header = _fields(data[position + 4 : start - 4])
                operation = _operation(header)
                if operation == _MESSAGE:
                    seconds, nanoseconds = _TIME.unpack(header[b"time"])
                    (number,) = _U32.unpack(header[b"conn"])
                    yield number, seconds * 1_000_000_000 + nanoseconds, data[start : start + data_bytes]
                elif operation == _CONNECTION:
                    self._add_connection(header, data[start : start + data_bytes])
                position = start + data_bytes
            if position < len(data) and not cut:
                raise BadRecord("its last record is incomplete")
        except (BadRecord, struct.error, KeyError) as error:
            self.lose(f"{self.path.name}: chunk at byte {chunk.offset} is damaged ({error})")


def _fields(header: memoryview) -> dict[bytes, bytes]:
    """name=value fields, each with its length in front. Raises BadRecord."""
    fields: dict[bytes, bytes] = {}
    position = 0
    while position < len(header):
        if position + 4 > len(header):
            raise BadRecord("a header field is cut off")
        (length,) = _U32.unpack_from(header, position)
        position += 4
        if position + length > len(header):
            raise BadRecord("a header field is longer than its header")
        name, equals, value = bytes(header[position : position + length]).partition(b"=")
        if not equals:
            raise BadRecord("a header field has no value")
        fields[name] = value
        position += length
    return fields


def _operation(header: dict[bytes, bytes]) -> int:
    code = header.get(b"op", b"")
    if len(code) != 1:
        raise BadRecord("a record does not say what it is")
    return code[0]


def _chunk(header: dict[bytes, bytes], offset: int, length: int) -> _Chunk:
    compression = printable(header.get(b"compression", b"").decode("ascii", "replace"))
    (unpacked_bytes,) = _U32.unpack(header.get(b"size", bytes(4)))
    return _Chunk(offset, length, compression, unpacked_bytes, 0, [], False)


def _unpack(chunk: _Chunk, raw: bytes, cut: bool) -> bytes:
    """A chunk's records; where the chunk is cut off, those bytes that unpack. Raises BadRecord."""
    if chunk.compression == "none":
        return raw
    if chunk.unpacked_bytes > MAX_BLOCK_BYTES:
        raise BadRecord(f"it claims {chunk.unpacked_bytes} bytes")
    try:
        if chunk.compression == "bz2":
            data = bz2.BZ2Decompressor().decompress(raw, chunk.unpacked_bytes)
        elif chunk.compression == "lz4":
            import lz4.frame

            data = lz4.frame.LZ4FrameDecompressor().decompress(raw, max_length=chunk.unpacked_bytes)
        else:
            raise BadRecord(f"compression '{chunk.compression}' is not known")
    except (OSError, ValueError, RuntimeError, EOFError) as error:
        raise BadRecord(f"{chunk.compression}: {error}") from error
    if len(data) < chunk.unpacked_bytes and not cut:
        raise BadRecord(f"it unpacks to {len(data)} bytes instead of {chunk.unpacked_bytes}")
    return data
