"""Every container gives the same messages in the same order; damaged ones give what is readable, and a loss."""

from __future__ import annotations

import os
import re
import sqlite3
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.types import Notes
from adcbf_cli.io.log_base import Connection, Message, merge_lazily
from adcbf_cli.io.logs import log_files, open_log
from adcbf_cli.io.recognition import recognise
from adcbf_cli.io.rosbag2_log import split_files

T0 = 1_700_000_000_000_000_000
SMALL_CHUNK = 2_000


def write(make: Any, folder: Path, kind: str, entries: Any = None) -> Path:
    """A small log of this kind, of several chunks."""
    container, _, packing = kind.partition("-")
    ros1 = container in ("mcap1", "bag")
    entries = make.drive(20, ros1) if entries is None else entries
    packing = packing or "none"
    if container in ("mcap", "mcap1"):
        return make.mcap(folder / "log.mcap", entries, packing, SMALL_CHUNK, ros1)
    if container == "bag":
        return make.bag(folder / "log.bag", entries, packing, SMALL_CHUNK)
    compression = packing if packing in ("file", "message") else ""
    return make.rosbag2(folder / "log", entries, container, compression)


KINDS = [
    "mcap-none",
    "mcap-zstd",
    "mcap-lz4",
    "mcap1-lz4",
    "bag-none",
    "bag-bz2",
    "bag-lz4",
    "sqlite3-none",
    "sqlite3-file",
    "sqlite3-message",
    "mcap-none",
]


def contents(path: Path, topics: Any = None) -> tuple[list[tuple[str, int, bytes]], Notes]:
    notes = Notes()
    with open_log(path, notes) as log:
        return [(m.connection.topic, m.log_ns, bytes(m.data)) for m in log.messages(topics)], notes


def expected(make: Any, entries: Any, ros1: bool = False) -> list[tuple[str, int, bytes]]:
    return [(topic, log_ns, make.encode(message, ros1)) for topic, message, log_ns in entries]


@pytest.mark.parametrize("kind", KINDS)
def test_all_messages_in_order(make: Any, tmp_path: Path, kind: str) -> None:
    ros1 = kind.startswith(("mcap1", "bag"))
    path = write(make, tmp_path, kind)
    wanted = sorted(expected(make, make.drive(20, ros1), ros1), key=lambda item: item[1])
    got, notes = contents(path)
    assert sorted(got) == sorted(wanted)
    assert [log_ns for _, log_ns, _ in got] == [log_ns for _, log_ns, _ in wanted]
    assert notes == Notes()
    only, _ = contents(path, ("/odom",))
    assert only == [item for item in wanted if item[0] == "/odom"]


@pytest.mark.parametrize("kind", KINDS)
def test_statistics(make: Any, tmp_path: Path, kind: str) -> None:
    with open_log(write(make, tmp_path, kind), Notes()) as log:
        infos = {info.name: info for info in log.topics()}
        assert {name: info.count for name, info in infos.items()} == {
            "/bump": 20,
            "/odom": 20,
            "/points": 20,
            "/tf_static": 1,
        }
        odom = infos["/odom"]
        assert odom.msgtype == "nav_msgs/msg/Odometry"
        assert (odom.first_ns, odom.last_ns, odom.largest_gap_ns) == (T0, T0 + 1_900_000_000, 100_000_000)
        assert odom.rate_hz == pytest.approx(10)
        assert infos["/tf_static"].rate_hz is None
        assert infos["/tf_static"].largest_gap_ns is None
        assert log.count("/points") == 20
        assert log.start_ns() == T0


def test_mcap_without_chunks_or_summary(make: Any, tmp_path: Path) -> None:
    entries = make.drive(20)
    bare = make.mcap(tmp_path / "bare.mcap", entries, use_chunking=False)
    got, notes = contents(bare)
    assert sorted(got) == sorted(expected(make, entries))
    assert notes == Notes()
    with open_log(bare, Notes()) as log:
        assert {info.name: info.count for info in log.topics()}["/points"] == 20


def test_messages_recorded_out_of_order_come_in_order_across_chunks(make: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    entries = make.drive(20)
    shuffled = [entries[i] for i in rng.permutation(len(entries))]
    for kind in ("mcap-zstd", "sqlite3-none"):
        folder = tmp_path / kind
        folder.mkdir()
        got, _ = contents(write(make, folder, kind, shuffled))
        times = [log_ns for _, log_ns, _ in got]
        assert times == sorted(times)
        assert len(got) == len(entries)


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_split_recordings_are_one_log(make: Any, tmp_path: Path, storage: str) -> None:
    """Splits named so that their alphabetical order is not that of time, without and with a metadata.yaml."""
    entries = make.drive(30)
    folder = tmp_path / "bag"
    folder.mkdir()
    suffix = ".mcap" if storage == "mcap" else ".db3"
    parts = [entries[:40], entries[40:70], entries[70:]]
    names = [f"bag_10{suffix}", f"bag_2{suffix}", f"bag_1{suffix}"]
    for i, (name, part) in enumerate(zip(names, parts, strict=True)):
        made = make.rosbag2(tmp_path / f"part{i}", part, storage)
        next(made.glob(f"*{suffix}")).rename(folder / name)
    got, notes = contents(folder)
    assert got == sorted(expected(make, entries), key=lambda item: item[1])
    assert notes == Notes()
    with open_log(folder, Notes()) as log:
        points = next(info for info in log.topics() if info.name == "/points")
        assert (points.count, points.largest_gap_ns) == (30, 100_000_000)
    listed = "".join(f"    - somewhere/else/{name}\n" for name in [*names, f"bag_99{suffix}"])
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{listed}"
    )
    again, notes = contents(folder)
    assert again == got
    assert f"bag_99{suffix}" in notes.losses[0].what
    assert log_files(folder) == tuple(folder / name for name in names)


def test_separate_recordings_in_one_folder_are_not_merged(make: Any, tmp_path: Path) -> None:
    for name in ("monday.mcap", "tuesday.mcap"):
        make.mcap(tmp_path / name, make.drive(3))
    with pytest.raises(UsageError, match=r"monday\.mcap, tuesday\.mcap"):
        open_log(tmp_path, Notes())


def test_no_path_is_taken_from_metadata(tmp_path: Path) -> None:
    (tmp_path / "outside.db3").write_bytes(b"")
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "inside.db3").write_bytes(b"")
    files, _ = split_files(folder, {"relative_file_paths": ["../outside.db3", "/etc/passwd"]})
    assert files == (folder / "inside.db3",)


@pytest.mark.parametrize("kind", ["mcap-none", "mcap-zstd", "mcap-lz4", "bag-none", "bag-bz2", "bag-lz4"])
@pytest.mark.parametrize("share", [0.1, 0.35, 0.5, 0.77, 0.9, 0.97, 0.999])
def test_a_log_cut_anywhere_gives_a_prefix_and_a_loss(make: Any, tmp_path: Path, kind: str, share: float) -> None:
    path = write(make, tmp_path, kind)
    whole, _ = contents(path)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(len(raw) * share)])
    got, notes = contents(path)
    assert got == whole[: len(got)]
    if len(got) < len(whole):
        assert len(notes.losses) == 1
    else:
        assert notes.losses or notes.warnings
    if kind.endswith("none"):
        # Where nothing is compressed, what lies before the cut can be found in the bytes.
        large = ("/odom", "/points")
        there = [item for item in whole if item[0] in large and item[2] in raw[: int(len(raw) * share)]]
        assert [item for item in got if item[0] in large] == there


def test_an_unclosed_bag_of_one_open_chunk(make: Any, tmp_path: Path) -> None:
    """A killed recorder leaves a chunk head that says 0 bytes, its records, no index and a zero chunk count."""
    path = make.bag(tmp_path / "log.bag", make.drive(20, ros1=True), chunk_bytes=1 << 30)
    whole, _ = contents(path)
    raw = bytearray(path.read_bytes())
    chunk = raw.index(b"op=\x05") - 4
    while raw[chunk - 4 : chunk] != b"":
        (header_bytes,) = np.frombuffer(bytes(raw[chunk - 4 : chunk]), "<u4")
        if 4 < header_bytes < 200 and b"compression" in raw[chunk : chunk + header_bytes]:
            break
        chunk -= 1
    size_at = chunk + int(header_bytes)
    (size,) = np.frombuffer(bytes(raw[size_at : size_at + 4]), "<u4")
    raw[size_at : size_at + 4] = bytes(4)
    count_at = raw.index(b"chunk_count=") + len(b"chunk_count=")
    raw[count_at : count_at + 4] = bytes(4)
    path.write_bytes(bytes(raw[: size_at + 4 + int(size) - 10]))
    got, notes = contents(path)
    assert got == whole[:-1]
    assert len(notes.losses) == 1


@pytest.mark.parametrize("kind", ["mcap-none", "mcap-zstd", "mcap-lz4", "bag-none", "bag-bz2", "bag-lz4"])
def test_a_damaged_place_costs_the_messages_around_it_only(make: Any, tmp_path: Path, kind: str) -> None:
    path = write(make, tmp_path, kind)
    whole, _ = contents(path)
    raw = path.read_bytes()
    costs = []
    for share in np.linspace(0.05, 0.3, 10):
        hurt = bytearray(raw)
        place = int(len(raw) * share)
        hurt[place : place + 20] = bytes(byte ^ 0x55 for byte in hurt[place : place + 20])
        path.write_bytes(bytes(hurt))
        got, notes = contents(path)
        same = set(got) & set(whole)
        costs.append(len(whole) - len(same))
        assert got[-1] == whole[-1]
        assert notes.losses or costs[-1] <= 1, "a loss must be told, but for bytes inside an unchecked message"
    assert 0 < max(costs) < len(whole) / 2


def test_a_bag_goes_on_after_a_chunk_whose_head_is_damaged(make: Any, tmp_path: Path) -> None:
    path = write(make, tmp_path, "bag-none")
    whole, _ = contents(path)
    raw = bytearray(path.read_bytes())
    heads = [place.start() for place in re.finditer(rb"compression=none", raw)]
    assert len(heads) > 3
    raw[heads[1] - 40 : heads[1] + 16] = b"\xff" * 56
    path.write_bytes(bytes(raw))
    got, notes = contents(path)
    assert len(whole) / 2 < len(got) < len(whole)
    assert set(got) < set(whole)
    assert (got[0], got[-1]) == (whole[0], whole[-1])
    assert "is damaged from byte" in notes.losses[0].what


@given(st.binary(max_size=300), st.sampled_from([b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0", b""]))
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_garbage_is_a_one_line_error_or_an_empty_log_with_a_loss(tmp_path: Path, tail: bytes, magic: bytes) -> None:
    path = tmp_path / "garbage"
    path.write_bytes(magic + tail)
    told = ""
    try:
        got, notes = contents(path)
        told = "; ".join(loss.what for loss in notes.losses)
        assert got == []
    except AdcbfError as error:
        told = str(error)
    assert told
    assert "\n" not in told


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_flipped_bytes_never_crash_the_readers(make: Any, tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    kind = ["mcap-none", "mcap-zstd", "bag-none", "bag-lz4", "sqlite3-none"][int(rng.integers(5))]
    folder = tmp_path / f"{kind}"
    if not folder.exists():
        folder.mkdir()
        write(make, folder, kind)
    source = next(p for p in folder.rglob("*") if p.suffix in (".mcap", ".bag", ".db3"))
    raw = bytearray(source.read_bytes())
    for place in rng.integers(0, len(raw), 8):
        raw[place] = rng.integers(256)
    hurt = tmp_path / f"hurt{source.suffix}"
    hurt.write_bytes(bytes(raw))
    told = ""
    try:
        with open_log(hurt, Notes()) as log:
            log.topics()
            for message in log.messages():
                assert isinstance(message.log_ns, int)
    except AdcbfError as error:
        told = str(error)
    assert "\n" not in told


def test_lengths_in_a_file_allocate_nothing(tmp_path: Path) -> None:
    """Records that claim exabytes are damage."""
    huge = (2**62).to_bytes(8, "little")
    for opcode in (1, 3, 4, 5, 6, 9):
        path = tmp_path / f"{opcode}.mcap"
        path.write_bytes(b"\x89MCAP0\r\n" + bytes([opcode]) + huge + bytes(50))
        got, notes = contents(path)
        assert got == []
        assert notes.losses


def test_a_chunk_that_claims_the_rest_of_a_huge_file_is_a_loss(make: Any, tmp_path: Path) -> None:
    """A sparse file: 3 GB that take no room; read whole, they would."""
    path = write(make, tmp_path, "mcap-none")
    data = path.read_bytes()
    size = 3 << 30
    with path.open("wb") as file:
        file.write(data[:8])
        file.write(b"\x06" + struct.pack("<Q", size - 17) + bytes(28))
        file.truncate(size)
    notes = Notes()
    with open_log(path, notes) as log:
        assert list(log.messages()) == []
    assert any("claims" in loss.what for loss in notes.losses)


def test_recording_times_beyond_int64_do_not_stop_the_statistics(tmp_path: Path) -> None:
    path = tmp_path / "late.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/a", "cdr", schema)
        for stamp in (1, 2**63 + 5):
            writer.add_message(channel, stamp, bytes(4), 0)
        writer.finish()
    with open_log(path, Notes()) as log:
        assert log.topics()[0].count == 2


def test_a_truncated_database_gives_its_readable_part(make: Any, tmp_path: Path) -> None:
    folder = write(make, tmp_path, "sqlite3-none", make.drive(40, padding=300))
    path = next(folder.glob("*.db3"))
    whole, _ = contents(path)
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) * 6 // 10])
    got, notes = contents(path)
    assert 0 < len(got) < len(whole)
    assert set(got) <= set(whole)
    assert notes.losses


def test_a_write_ahead_log_beside_the_database_is_a_loss(make: Any, tmp_path: Path) -> None:
    folder = write(make, tmp_path, "sqlite3-none")
    path = next(folder.glob("*.db3"))
    path.with_name(f"{path.name}-wal").write_bytes(b"frames")
    got, notes = contents(folder)
    assert len(got) == 61
    assert "-wal" in notes.losses[0].what


def test_a_database_that_is_no_recording(tmp_path: Path) -> None:
    path = tmp_path / "other.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE people (name TEXT)")
    database.close()
    with pytest.raises(AdcbfError, match="rosbag2"):
        open_log(path, Notes())


def test_a_database_is_opened_read_only(make: Any, tmp_path: Path) -> None:
    folder = write(make, tmp_path, "sqlite3-none")
    path = next(folder.glob("*.db3"))
    strange = folder / "a ?#%41.db3"
    path.rename(strange)
    before = strange.read_bytes(), sorted(p.name for p in folder.iterdir())
    assert len(contents(strange)[0]) == 61
    assert (strange.read_bytes(), sorted(p.name for p in folder.iterdir())) == before


@given(st.lists(st.lists(st.integers(0, 50), min_size=1, max_size=8).map(sorted), max_size=8))
def test_lazy_merge_sorts_and_opens_late(parts: list[list[int]]) -> None:
    connection = Connection("/t", "", "")
    opened: list[int] = []
    given_so_far: list[int] = []

    def source(number: int, times: list[int]) -> Any:
        opened.append(number)
        assert not given_so_far or times[0] >= given_so_far[-1]
        return iter([Message(connection, time, b"") for time in times])

    sources = [(times[0], lambda n=n, times=times: source(n, times)) for n, times in enumerate(parts)]
    for message in merge_lazily(sources):
        given_so_far.append(message.log_ns)
        assert all(parts[n][0] <= message.log_ns for n in opened)
    assert given_so_far == sorted(time for times in parts for time in times)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.bag", b"", "is empty"),
        ("notes.txt", b"hello", "is not a log"),
        ("old.bag", b"#ROSBAG V1.2\n", "format 2.0"),
    ],
)
def test_what_is_no_log_is_told_in_one_line(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(AdcbfError, match=words) as caught:
        open_log(path, Notes())
    assert "\n" not in str(caught.value)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for look in (log_files, recognise):
        with pytest.raises(AdcbfError, match="neither a file nor a folder"):
            look(tmp_path / "pipe")


def test_a_path_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(AdcbfError, match="does not exist"):
        log_files(tmp_path / "nowhere.mcap")
    with pytest.raises(AdcbfError, match=r"\.pcd"):
        log_files(tmp_path)


@pytest.mark.parametrize(
    "name",
    [
        "datmo/two_robots.bag",
        "leg_tracker/positive_1.bag",
        "robot_localization/test2.bag",
        "evo/nav2_turtlebot.mcap",
        "neato/neato_c-mawn/person_follower_bag",
        "tamu_people/example1",
    ],
)
def test_real_logs_as_rosbags_reads_them(real_data: Callable[[str], Path], name: str) -> None:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    path = real_data(name)
    with (Reader1 if path.suffix == ".bag" else Reader2)(path) as reader:
        wanted = [(connection.topic, log_ns, bytes(data)) for connection, log_ns, data in reader.messages()]
    got, notes = contents(path)
    assert sorted(got) == sorted(wanted)
    assert [log_ns for _, log_ns, _ in got] == sorted(log_ns for _, log_ns, _ in wanted)
    assert notes == Notes()
