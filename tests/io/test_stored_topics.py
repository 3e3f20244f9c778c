"""Topics out of a log's index, as the log itself has them."""

from __future__ import annotations

import struct
from contextlib import suppress
from pathlib import Path

import pytest

from adcbf_cli.core.types import Notes
from adcbf_cli.io.logs import open_log
from adcbf_cli.io.stored_topics import stored_topics
from tests.io.conftest import LogMaker


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_topics_of_a_bag_are_those_that_reading_it_gives(make: LogMaker, tmp_path: Path, compression: str) -> None:
    path = make.bag(tmp_path / "log.bag", make.drive(4, ros1=True), compression, chunk_bytes=2000)
    connections = open_log(path, Notes()).connections
    assert stored_topics(path) == {connection.topic: connection.msgtype for connection in connections}
    assert len(connections) > 1


def test_a_bag_that_is_cut_off_or_none_gives_nothing_wrong(make: LogMaker, tmp_path: Path) -> None:
    path = make.bag(tmp_path / "log.bag", make.drive(4, ros1=True))
    content, whole = path.read_bytes(), set(stored_topics(path).values())
    for length in (0, 5, 20, 60, 5000, len(content) - 10):
        path.write_bytes(content[:length])
        with suppress(struct.error, KeyError, ValueError):
            assert set(stored_topics(path).values()) <= whole
