"""MCAP logs: chunked or not, indexed or not, whole or cut off, uncompressed, zstd or lz4.

The file is seen as a list of blocks: chunks, and runs of records outside chunks. An indexed file's blocks come
from its summary; otherwise the reader hops from record to record up to the end or to the damage. Record contents
are parsed with the mcap library; the hopping is our own, so that a length field that points past the end of the
file is damage and never an allocation.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Schema, Statistics

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

MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQI")
_FOOTER_BYTES = _RECORD_HEAD.size + 20
_RUN_BYTES = 4 << 20
"""Records outside chunks are read in runs of about this size."""

_PARSE_ERRORS = (McapError, struct.error, ValueError, IndexError, KeyError, TypeError)
"""What the mcap library raises on bytes that are no record."""


@dataclass(frozen=True)
class _Block:
    """Where messages lie in the file. index: (offset, length) of the chunk's message index records."""

    offset: int
    length: int
    start_ns: int
    is_chunk: bool
    channels: frozenset[int] | None
    index: tuple[int, int] | None


class Damaged(ValueError):
    """Bytes that are not what the format says; the text says where."""


class McapLog(Log):
    """One MCAP file."""

    def __init__(self, path: Path, notes: Notes) -> None:
        super().__init__(path, (path,), notes)
        self._file: BinaryIO = path.open("rb")
        self._size = path.stat().st_size
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._by_channel: dict[int, Connection] = {}
        self._counts: dict[int, int] | None = None
        self._compressions: set[str] = set()
        self._blocks: list[_Block] = []
        try:
            self._open()
        except BaseException:
            self._file.close()
            raise

    def _open(self) -> None:
        if self._file.read(len(MAGIC)) != MAGIC:
            raise AdcbfError(f"{self.path} does not begin like an MCAP file; is it a whole download?")
        try:
            indexed = self._read_summary()
        except _PARSE_ERRORS as error:
            self.lose(f"{self.path.name}: the summary is damaged ({error}); read without it")
            indexed = False
        if not indexed:
            self._schemas.clear()
            self._channels.clear()
            self._blocks = list(self._hop())
            self._find_channels()
        for channel in self._channels.values():
            self._connection(channel.id)
        self.connections = tuple(dict.fromkeys(self._by_channel[number] for number in sorted(self._by_channel)))
        packing = ", ".join(sorted(name or "uncompressed" for name in self._compressions)) or "uncompressed"
        self.container = f"MCAP ({packing})" if indexed else f"MCAP ({packing}, no index)"

    def close(self) -> None:
        self._file.close()

    def start_ns(self) -> int:
        return min((block.start_ns for block in self._blocks), default=0)

    def count(self, topic: str) -> int | None:
        if self._counts is None:
            return None
        return sum(n for number, n in self._counts.items() if self._connection(number).topic == topic)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        wanted = None
        if topics is not None:
            wanted = {number for number, at in self._by_channel.items() if at.topic in topics}
        blocks = [
            block
            for block in self._blocks
            if wanted is None or block.channels is None or not wanted.isdisjoint(block.channels)
        ]
        return merge_lazily([(block.start_ns, partial(self._block_messages, block, wanted)) for block in blocks])

    def topics(self) -> tuple[TopicInfo, ...]:
        statistics = {connection.topic: TopicStatistics(connection) for connection in self.connections}
        for block in sorted(self._blocks, key=lambda b: b.start_ns):
            for number, times in self._block_times(block):
                statistics[self._connection(number).topic].add(times)
        return sorted_infos(statistics)

    # --- the file's index

    def _read_summary(self) -> bool:
        """Channels, schemas and chunk positions from the file's end; False where there is no usable summary."""
        tail = _FOOTER_BYTES + len(MAGIC)
        if self._size < tail + len(MAGIC):
            return False
        raw = self._at(self._size - tail, tail)
        if raw[-len(MAGIC) :] != MAGIC or raw[0] != Opcode.FOOTER:
            return False
        footer = Footer.read(_stream(raw[_RECORD_HEAD.size :]))
        if not len(MAGIC) <= footer.summary_start < self._size - tail:
            return False
        if self._size - tail - footer.summary_start > MAX_BLOCK_BYTES:
            raise Damaged("it claims most of the file")
        summary = memoryview(self._at(footer.summary_start, self._size - tail - footer.summary_start))
        checked = zlib.crc32(raw[: _FOOTER_BYTES - 4], zlib.crc32(summary))
        if footer.summary_crc and footer.summary_crc != checked:
            raise Damaged("its checksum is wrong")
        for opcode, body in _records(summary):
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._register(opcode, body)
            elif opcode == Opcode.STATISTICS:
                self._counts = dict(Statistics.read(_stream(body)).channel_message_counts)
            elif opcode == Opcode.CHUNK_INDEX:
                index = ChunkIndex.read(_stream(body))
                self._compressions.add(printable(index.compression))
                end = index.chunk_start_offset + index.chunk_length
                if not len(MAGIC) <= index.chunk_start_offset < end <= self._size:
                    raise Damaged("a chunk index points outside the file")
                self._blocks.append(
                    _Block(
                        index.chunk_start_offset + _RECORD_HEAD.size,
                        index.chunk_length - _RECORD_HEAD.size,
                        index.message_start_time,
                        True,
                        frozenset(index.message_index_offsets) or None,
                        (end, index.message_index_length) if index.message_index_length else None,
                    )
                )
        known = self._counts is None or set(self._counts) <= set(self._channels)
        return bool(self._blocks) and bool(self._channels) and known

    def _hop(self) -> Iterator[_Block]:
        """Blocks by going from record to record; reports where the file breaks off."""
        position = len(MAGIC)
        run: list[int] = []
        run_start_ns = 0
        while position + _RECORD_HEAD.size <= self._size:
            head = self._at(position, _RECORD_HEAD.size + 28)
            opcode, length = _RECORD_HEAD.unpack_from(head)
            end = position + _RECORD_HEAD.size + length
            loose = opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
            if run and (not loose or position - run[0] >= _RUN_BYTES):
                yield _Block(run[0], position - run[0], run_start_ns, False, None, None)
                run = []
            if end > self._size or opcode == 0:
                yield from self._last_block(position, opcode, head)
                return
            if opcode == Opcode.CHUNK:
                start_ns = struct.unpack_from("<Q", head, _RECORD_HEAD.size)[0]
                yield _Block(position + _RECORD_HEAD.size, length, start_ns, True, None, None)
            elif loose:
                if not run:
                    run, run_start_ns = [position], 0
                if opcode == Opcode.MESSAGE and run_start_ns == 0:
                    run_start_ns = struct.unpack_from("<HIQ", head, _RECORD_HEAD.size)[2]
            elif opcode in (Opcode.DATA_END, Opcode.FOOTER):
                if self._at(self._size - len(MAGIC), len(MAGIC)) != MAGIC:
                    self.notes.warn(f"{self.path.name}: the index at its end is cut off; all messages are there")
                return
            position = end
        if run:
            yield _Block(run[0], position - run[0], run_start_ns, False, None, None)
        self.lose(f"{self.path.name} breaks off at byte {self._size}: its end was never written")

    def _last_block(self, position: int, opcode: int, head: bytes) -> Iterator[_Block]:
        self.lose(f"{self.path.name} is readable up to byte {position} of {self._size}; the rest is cut off or damaged")
        if opcode == Opcode.CHUNK and len(head) >= _RECORD_HEAD.size + 8:
            start_ns = struct.unpack_from("<Q", head, _RECORD_HEAD.size)[0]
            offset = position + _RECORD_HEAD.size
            yield _Block(offset, self._size - offset, start_ns, True, None, None)

    def _find_channels(self) -> None:
        """Read a file without summary once through, for its channels and counts."""
        counts: dict[int, int] = {}
        for block in self._blocks:
            for opcode, body in self._block_records(block):
                if opcode == Opcode.MESSAGE and len(body) >= _MESSAGE_HEAD.size:
                    number = _MESSAGE_HEAD.unpack_from(body)[0]
                    counts[number] = counts.get(number, 0) + 1
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    self._register(opcode, body)
        self._counts = {number: n for number, n in counts.items() if number in self._channels}

    def _register(self, opcode: int, body: memoryview) -> None:
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(_stream(body))
                self._schemas[schema.id] = schema
            else:
                channel = Channel.read(_stream(body))
                self._channels.setdefault(channel.id, channel)
        except _PARSE_ERRORS as error:
            self.lose(f"{self.path.name}: a channel's description is damaged ({error})")

    def _connection(self, number: int) -> Connection:
        if number not in self._by_channel:
            channel = self._channels[number]
            schema = self._schemas.get(channel.schema_id)
            self._by_channel[number] = Connection(
                printable(channel.topic),
                printable(ros2_type_name(schema.name)) if schema else "",
                printable(channel.message_encoding),
            )
        return self._by_channel[number]

    # --- blocks

    def _at(self, offset: int, length: int) -> bytes:
        self._file.seek(offset)
        return self._file.read(max(0, min(length, self._size - offset)))

    def _block_messages(self, block: _Block, wanted: set[int] | None) -> Iterator[Message]:
        found: list[tuple[int, int, memoryview]] = []
        for opcode, body in self._block_records(block):
            if opcode != Opcode.MESSAGE or len(body) < _MESSAGE_HEAD.size:
                continue
            number, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(body)
            if number in self._by_channel and (wanted is None or number in wanted):
                found.append((log_ns, number, body[_MESSAGE_HEAD.size :]))
        found.sort(key=lambda item: item[0])
        for log_ns, number, data in found:
            yield Message(self._by_channel[number], log_ns, data)

    def _block_times(self, block: _Block) -> Iterator[tuple[int, IntArray]]:
        """Per channel, the recording times in one block: from the message index where there is one."""
        times: dict[int, list[IntArray]] = {}
        if block.index is not None:
            offset, length = block.index
            for opcode, body in _records(memoryview(self._at(offset, min(length, MAX_BLOCK_BYTES)))):
                if opcode == Opcode.MESSAGE_INDEX and len(body) >= 6:
                    number, length = struct.unpack_from("<HI", body)
                    pairs = np.frombuffer(body[6 : 6 + length // 16 * 16], dtype="<u8").reshape(-1, 2)
                    times.setdefault(number, []).append(pairs[:, 0].astype(np.int64))
        else:
            for opcode, body in self._block_records(block):
                if opcode == Opcode.MESSAGE and len(body) >= _MESSAGE_HEAD.size:
                    number, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(body)
                    times.setdefault(number, []).append(np.array([log_ns], dtype=np.uint64).astype(np.int64))
        for number, parts in times.items():
            if number in self._channels:
                yield number, np.concatenate(parts)

    def _block_records(self, block: _Block) -> Iterator[tuple[int, memoryview]]:
        """The records of a block; a damaged chunk is reported and skipped, a cut one gives its whole records."""
        try:
            if block.length > MAX_BLOCK_BYTES:  # a damaged length may claim the rest of a file of any size
                raise Damaged(f"it claims {block.length} bytes")
            raw = self._at(block.offset, block.length)
            cut = block.offset + block.length >= self._size
            data = memoryview(self._unpack_chunk(raw, cut) if block.is_chunk else raw)
        except Damaged as error:
            self.lose(f"{self.path.name}: chunk at byte {block.offset} skipped: {error}")
            return
        yield from _records(data)

    def _unpack_chunk(self, raw: bytes, cut: bool) -> bytes | memoryview:
        if len(raw) < _CHUNK_HEAD.size + 4:
            raise Damaged("its head is cut off")
        _, _, unpacked_bytes, checksum = _CHUNK_HEAD.unpack_from(raw)
        position = _CHUNK_HEAD.size
        (name_bytes,) = struct.unpack_from("<I", raw, position)
        position += 4
        if name_bytes > 32 or position + name_bytes + 8 > len(raw):
            raise Damaged("its head is damaged")
        compression = raw[position : position + name_bytes].decode("ascii", "replace")
        self._compressions.add(printable(compression))
        packed = memoryview(raw)[position + name_bytes + 8 :]
        if unpacked_bytes > MAX_BLOCK_BYTES:
            raise Damaged(f"it claims {unpacked_bytes} bytes")
        data = unpack(compression, packed, unpacked_bytes, cut)
        if not cut and checksum and zlib.crc32(data) != checksum:
            raise Damaged("its checksum is wrong")
        return data


def unpack(compression: str, packed: memoryview, unpacked_bytes: int, cut: bool) -> bytes | memoryview:
    """Decompress at most `unpacked_bytes`; where the input is cut off, what comes out before the cut.

    Raises Damaged on bytes that are not of that compression.
    """
    if compression == "":
        return packed
    try:
        data = (
            _unpack_zstd(packed, unpacked_bytes)
            if compression == "zstd"
            else _unpack_lz4(compression, packed, unpacked_bytes)
        )
    except (ValueError, RuntimeError, EOFError, MemoryError) as error:
        raise Damaged(str(error)) from error
    if len(data) < unpacked_bytes and not cut:
        raise Damaged(f"it unpacks to {len(data)} bytes instead of {unpacked_bytes}")
    return data


def _unpack_zstd(packed: memoryview, limit: int) -> bytes:
    import zstandard

    decompressor = zstandard.ZstdDecompressor(max_window_size=1 << 27)
    try:
        if zstandard.frame_content_size(packed) == limit:
            with suppress(zstandard.ZstdError):  # Cut off: what comes out in pieces is worth having.
                whole: bytes = decompressor.decompress(packed)
                return whole
        return _in_pieces(decompressor.stream_reader(packed), limit)
    except zstandard.ZstdError as error:
        raise ValueError(f"zstd: {error}") from error


def _in_pieces(reader: Any, limit: int) -> bytes:
    pieces: list[bytes] = []
    got = 0
    while got < limit and (piece := reader.read(min(1 << 22, limit - got))):
        pieces.append(piece)
        got += len(piece)
    return b"".join(pieces)


def _unpack_lz4(compression: str, packed: memoryview, limit: int) -> bytes:
    if compression != "lz4":
        raise ValueError(f"compression '{compression}' is not known")
    import lz4.frame

    data: bytes = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=limit)
    return data


def _records(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """The whole records in these bytes."""
    position = 0
    while position + _RECORD_HEAD.size <= len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, position)
        start = position + _RECORD_HEAD.size
        position = start + length
        if position > len(data):
            return
        yield opcode, data[start:position]


def _stream(body: bytes | memoryview) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
