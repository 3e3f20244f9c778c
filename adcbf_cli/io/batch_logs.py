"""Which logs a batch is of, and a name for each: safe in a path and in a hive partition, no two alike."""

from __future__ import annotations

import glob
import os
import re
import sys
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from adcbf_cli.core.errors import UsageError
from adcbf_cli.io.batch_tables import DATASETS, RUNS
from adcbf_cli.io.run_folder import MANIFEST

STDIN = "-"
_MOST_CHARACTERS = 120
_READ_AS_OTHER_THAN_TEXT = re.compile(
    r"(?i)[\d.+_TZe-]*|0[xbo][\da-f_]*|[+-]?inf(?:inity)?|epoch|null|nan|true|false|__hive_default_partition__"
)
"""Partition values that some readers take for numbers, dates or nothing."""


def find_logs(words: Sequence[str], list_file: str | None) -> list[Path]:
    """The logs that paths, quoted glob patterns and a list of both name, each once, in the order given.

    list_file: a file, or `-` for standard input, with a path or pattern a line, where empty lines and those that begin
    with # say nothing; or, where it has NULs, as `find -print0` writes them, with one before each. Paths are
    relative to the current folder. A path that leads nowhere is kept: its failing is told with the log. What adcbf
    itself wrote is not taken for a log because a pattern matches it. UsageError where a pattern matches nothing
    else, or there is no log at all.
    """
    if not words and list_file is None:
        raise UsageError("no logs: name them, quote a pattern such as 'logs/*.mcap', or give --from LIST")
    listed = [] if list_file is None else _listed(list_file)
    found = {resolved(path): path for word in (*words, *listed) for path in _expand(word)}
    if not found:
        raise UsageError(f"--from {list_file}: names no log")
    return list(found.values())


def resolved(path: Path) -> Path:
    """Without links; as it is, but absolute, where they lead in a circle, or nowhere that can be asked for."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        return path.absolute()


def _listed(list_file: str) -> list[str]:
    try:
        content = sys.stdin.buffer.read() if list_file == STDIN else Path(list_file).read_bytes()
    except OSError as error:
        raise UsageError(f"{list_file}: cannot be read ({error.strerror})") from None
    if b"\0" in content:
        return [os.fsdecode(name) for name in content.split(b"\0") if name]
    lines = (os.fsdecode(line).strip() for line in content.split(b"\n"))
    return [line for line in lines if line and not line.startswith("#")]


def _expand(word: str) -> list[Path]:
    if os.path.exists(word) or not glob.has_magic(word):
        return [Path(word)]
    matches = [Path(name) for name in sorted(glob.glob(word, recursive=True))]
    found = [path for path in matches if not _is_result(path)]
    if not found:
        only = " but what adcbf itself wrote" if matches else ""
        raise UsageError(f"{word}: no file matches this pattern{only}")
    return found


def _is_result(path: Path) -> bool:
    """Whether it is a run folder or a batch's, or lies in a run folder."""
    place = path.absolute()
    is_batch = all((path / folder).is_dir() for folder in (*DATASETS, RUNS))
    return is_batch or any(os.path.isfile(folder / MANIFEST) for folder in (place, *place.parents))


def unique_names(logs: Iterable[Path], before: Mapping[Path, str]) -> list[str]:
    """A name for each log: its stem, with as many of its folders before it as tell it from the others.

    Letters, digits, `.`, `_` and `-` only; unlike in more than case. before: the names that logs (by their resolved
    paths) had already, which they keep.
    """
    paths = [resolved(path) for path in logs]
    names = [before.get(path, name) for path, name in zip(paths, _told_apart(paths), strict=True)]
    order = sorted(range(len(paths)), key=lambda i: paths[i] not in before)
    numbered = dict(zip(order, _numbered([names[i] for i in order]), strict=True))
    return [numbered[i] for i in range(len(paths))]


def _told_apart(paths: list[Path]) -> list[str]:
    """Stems, with as many of their folders before them as it takes; alike where no folder tells them apart."""
    leaves = _leaves(paths)
    depth = [0] * len(paths)
    while True:
        names = [
            _safe("-".join([*_parents(p)[-d:], leaf] if d else [leaf])) for p, leaf, d in _zip(paths, leaves, depth)
        ]
        count = Counter(name.casefold() for name in names)
        alike = [i for i, name in enumerate(names) if count[name.casefold()] > 1]
        deeper = [i for i in alike if depth[i] < len(_parents(paths[i]))]
        if not deeper:  # what no folder tells apart differs in case, or in what is not safe: it is counted
            return [_safe(leaves[i]) if i in alike else name for i, name in enumerate(names)]
        for i in deeper:
            depth[i] += 1


def _zip(paths: list[Path], leaves: list[str], depth: list[int]) -> Iterable[tuple[Path, str, int]]:
    return zip(paths, leaves, depth, strict=True)


def _parents(path: Path) -> list[str]:
    return [part for part in path.parent.parts if part != path.anchor]


def _leaves(paths: list[Path]) -> list[str]:
    """Stems; names with their suffix where one folder holds two of a stem."""
    stems = [path.name if os.path.isdir(path) else path.stem for path in paths]
    count = Counter((path.parent, stem) for path, stem in zip(paths, stems, strict=True))
    return [path.name if count[path.parent, stem] > 1 else stem for path, stem in zip(paths, stems, strict=True)]


def _safe(text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9._-]+", "_", text).strip(".")
    if len(name) > _MOST_CHARACTERS:
        name = f"{name[-_MOST_CHARACTERS:].lstrip('.')}-{zlib.crc32(text.encode(errors='surrogateescape')):08x}"
    return f"log-{name}" if _READ_AS_OTHER_THAN_TEXT.fullmatch(name) else name


def _numbered(names: list[str]) -> list[str]:
    """The names, with a number where one has been there before."""
    taken = {name.casefold() for name in names}
    seen: set[str] = set()
    result = []
    for name in names:
        number, free = 2, name
        while free.casefold() in seen or (free != name and free.casefold() in taken):
            free, number = f"{name}-{number}", number + 1
        seen.add(free.casefold())
        result.append(free)
    return result
