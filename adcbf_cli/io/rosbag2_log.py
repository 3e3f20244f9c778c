"""rosbag2 folders: metadata.yaml, .db3 or .mcap files, several splits, file or message compression.

The splits are merged by time and opened only when their time comes. The folder is also read without its metadata.yaml
(a recorder that was killed never wrote it).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.types import Notes
from adcbf_cli.io.log_base import Log, Message, TopicInfo, merge_lazily
from adcbf_cli.io.mcap_log import McapLog
from adcbf_cli.io.sqlite_log import SqliteLog

SPLIT_SUFFIXES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
_MAX_METADATA_BYTES = 16 << 20


class Rosbag2Log(Log):
    """A folder of splits. File-compressed splits are unpacked into a temporary folder for as long as it is open."""

    def __init__(self, folder: Path, notes: Notes) -> None:
        metadata = read_metadata(folder)
        files, missing = split_files(folder, metadata)
        super().__init__(folder, files, notes)
        for name in missing:
            self.lose(f"{folder.name}: {name} is named in metadata.yaml but is not there")
        self._message_compression = str(metadata.get("compression_mode", "")).lower() == "message"
        self._listed = bool(metadata)
        self._temporary: TemporaryDirectory[str] | None = None
        self._parts: list[tuple[int, Log]] = []
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        for file in self.files:
            try:
                part = self._open_split(file)
            except AdcbfError as error:
                if len(self.files) == 1:
                    raise
                self.lose(str(error))
                continue
            self._parts.append((part.start_ns(), part))
        if not self._parts:
            raise AdcbfError(f"{self.path} holds no readable .db3 or .mcap file")
        if not self._listed:
            self._check_one_recording()
        self.connections = tuple(dict.fromkeys(at for _, part in self._parts for at in part.connections))
        splits = f", {len(self.files)} splits" if len(self.files) > 1 else ""
        self.container = f"rosbag2 folder: {self._parts[0][1].container}{splits}"

    def _check_one_recording(self) -> None:
        """Files without a metadata.yaml are splits of one recording only if one ends before the next begins."""
        spans = []
        for _, part in self._parts:
            infos = part.topics()
            starts = [info.first_ns for info in infos if info.first_ns is not None]
            ends = [info.last_ns for info in infos if info.last_ns is not None]
            if starts:
                spans.append((min(starts), max(ends)))
        spans.sort()
        if any(late[0] < early[1] for early, late in pairwise(spans)):
            names = ", ".join(file.name for file in self.files)
            raise UsageError(f"{self.path} holds several recordings of the same time ({names}); name one of them")

    def _open_split(self, file: Path) -> Log:
        if file.suffix == ".zstd":
            if self._temporary is None:
                self._temporary = TemporaryDirectory(prefix="adcbf-")
            file = _unpack_file(file, Path(self._temporary.name))
        if file.suffix == ".mcap":
            return McapLog(file, self.notes)
        return SqliteLog(file, self.notes, self._message_compression)

    def close(self) -> None:
        for _, part in self._parts:
            part.close()
        if self._temporary is not None:
            self._temporary.cleanup()

    def start_ns(self) -> int:
        return min(start for start, _ in self._parts)

    def count(self, topic: str) -> int | None:
        total = 0
        for _, part in self._parts:
            if topic in {connection.topic for connection in part.connections}:
                counted = part.count(topic)
                if counted is None:
                    return None
                total += counted
        return total

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        return merge_lazily([(start, partial(part.messages, topics)) for start, part in self._parts])

    def topics(self) -> tuple[TopicInfo, ...]:
        joined: dict[str, TopicInfo] = {}
        for _, part in sorted(self._parts, key=lambda item: item[0]):
            for info in part.topics():
                joined[info.name] = join_infos(joined[info.name], info) if info.name in joined else info
        return tuple(joined[name] for name in sorted(joined))


def join_infos(earlier: TopicInfo, later: TopicInfo) -> TopicInfo:
    """One topic's statistics over two splits, the second of which begins later."""
    if earlier.last_ns is None or later.first_ns is None or earlier.first_ns is None or later.last_ns is None:
        return later if earlier.count == 0 else earlier
    gaps = [gap for gap in (earlier.largest_gap_ns, later.largest_gap_ns) if gap is not None]
    return replace(
        earlier,
        count=earlier.count + later.count,
        first_ns=min(earlier.first_ns, later.first_ns),
        last_ns=max(earlier.last_ns, later.last_ns),
        largest_gap_ns=max([*gaps, later.first_ns - earlier.last_ns]),
    )


def is_bag_folder(folder: Path) -> bool:
    """Whether a folder holds rosbag2 files."""
    return (folder / "metadata.yaml").is_file() or any(_split_names(folder))


def read_metadata(folder: Path) -> dict[str, Any]:
    """The rosbag2_bagfile_information of a folder's metadata.yaml; empty where there is none. Raises AdcbfError."""
    import yaml

    path = folder / "metadata.yaml"
    if not path.is_file():
        return {}
    if path.stat().st_size > _MAX_METADATA_BYTES:
        raise AdcbfError(f"{path} is too large to be a rosbag2 metadata file")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError, OSError, RecursionError) as error:
        raise AdcbfError(f"{path} is not readable as YAML; remove it to read the folder without it") from error
    information = content.get("rosbag2_bagfile_information") if isinstance(content, dict) else None
    if not isinstance(information, dict):
        raise AdcbfError(f"{path} is not rosbag2 metadata; remove it to read the folder without it")
    return information


def split_files(folder: Path, metadata: dict[str, Any]) -> tuple[tuple[Path, ...], tuple[str, ...]]:
    """The folder's splits in order, and the names that the metadata lists but that are not there.

    Of a listed path only the last part is used: nothing outside the folder is ever opened.
    """
    listed = metadata.get("relative_file_paths")
    if isinstance(listed, list) and listed:
        names = list(dict.fromkeys(PurePosixPath(str(name)).name for name in listed))
        names = [name for name in names if name.endswith(SPLIT_SUFFIXES)]
        there = tuple(folder / name for name in names if (folder / name).is_file())
        if there:
            return there, tuple(name for name in names if not (folder / name).is_file())
    files = tuple(folder / name for name in sorted(_split_names(folder), key=_natural))
    if not files:
        raise AdcbfError(f"{folder} holds no .db3 or .mcap file")
    return files, ()


def _split_names(folder: Path) -> Iterator[str]:
    return (entry.name for entry in folder.iterdir() if entry.name.endswith(SPLIT_SUFFIXES) and entry.is_file())


def _natural(name: str) -> list[tuple[int, str]]:
    """bag_2 before bag_10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


def _unpack_file(file: Path, folder: Path) -> Path:
    import zstandard

    target = folder / file.stem
    try:
        with file.open("rb") as packed, target.open("wb") as unpacked:
            zstandard.ZstdDecompressor(max_window_size=1 << 27).copy_stream(packed, unpacked)
    except (zstandard.ZstdError, OSError) as error:
        raise AdcbfError(f"{file} could not be unpacked: {error}") from error
    return target
