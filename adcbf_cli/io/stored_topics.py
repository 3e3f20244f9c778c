"""A log's topics without reading it: from the index at the end of an MCAP file or a ROS 1 bag, or the table in a
rosbag2 database.

For shell completion, which must answer while somebody waits. `adcbf info` reads logs properly.
"""

from __future__ import annotations

import json
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import BinaryIO

from adcbf_cli.io.ros_messages import ros2_type_name

MANIFEST = "run.json"
"""As in `run_folder`, whose import takes longer than somebody waits who has pressed Tab."""


def stored_topics(log: Path) -> dict[str, str]:
    """Topic names and their types, `package/msg/Name`; empty for a log without such an index.

    log: a file, a rosbag2 folder, or a run folder, whose log's topics these are. Raises whatever a file that cannot
    be read, or is damaged, leads to.
    """
    if (log / MANIFEST).is_file():
        source = json.loads((log / MANIFEST).read_text(encoding="utf-8"))["source"]["path"]
        return stored_topics(log / source)
    files = [log] if log.is_file() else sorted([*log.glob("*.mcap"), *log.glob("*.db3")])[:1]
    return {name: ros2_type_name(kind) for file in files for name, kind in sorted(_topics(file).items())}


def _topics(file: Path) -> dict[str, str]:
    if file.suffix == ".mcap":
        return _of_mcap(file)
    if file.suffix == ".bag":
        return _of_bag(file)
    return _of_database(file) if file.suffix == ".db3" else {}


def _of_mcap(file: Path) -> dict[str, str]:
    from mcap.reader import SeekingReader

    with file.open("rb") as stream:
        summary = SeekingReader(stream).get_summary()
    if summary is None:
        return {}
    names = {number: schema.name for number, schema in summary.schemas.items()}
    return {channel.topic: names.get(channel.schema_id, "") for channel in summary.channels.values()}


def _of_database(file: Path) -> dict[str, str]:
    with closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)) as database:
        return dict(database.execute("SELECT name, type FROM topics LIMIT 10000"))


_BAG_MAGIC = b"#ROSBAG V2.0\n"
_MOST_BYTES = 1 << 20
"""Of one record's header or definition."""


def _of_bag(file: Path) -> dict[str, str]:
    """From the connections, which stand together at the place that the bag's first record names."""
    with file.open("rb") as stream:
        if stream.read(len(_BAG_MAGIC)) != _BAG_MAGIC:
            return {}
        about = dict(_fields(_block(stream)))
        stream.seek(struct.unpack("<Q", about[b"index_pos"])[0])
        found = {}
        for _ in range(min(struct.unpack("<I", about[b"conn_count"])[0], 10_000)):
            header, data = dict(_fields(_block(stream))), dict(_fields(_block(stream)))
            found[header[b"topic"].decode()] = data[b"type"].decode()
    return found


def _block(stream: BinaryIO) -> bytes:
    """What follows its own length. ValueError where that is beyond all reason, or beyond the file's end."""
    (length,) = struct.unpack("<I", stream.read(4))
    block = stream.read(min(length, _MOST_BYTES))
    if len(block) < length:
        raise ValueError(f"{len(block)} of {length} bytes")
    return block


def _fields(block: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Names and values of a record's header, each with its length before it."""
    position = 0
    while position < len(block):
        (length,) = struct.unpack_from("<I", block, position)
        name, _, value = block[position + 4 : position + 4 + length].partition(b"=")
        yield name, value
        position += 4 + length
