"""A log's topics without reading it: from the index at an MCAP file's end, or the table in a rosbag2 database.

For shell completion, which must answer while somebody waits. `adcbf info` reads logs properly.
"""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from pathlib import Path

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
