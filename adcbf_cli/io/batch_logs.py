"""Which logs a batch is of, and a name for each: safe in a path and in a hive partition, no two alike."""

from __future__ import annotations

import glob
import re
import sys
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from adcbf_cli.core.errors import UsageError
from adcbf_cli.io.settings import read_text

STDIN = "-"
_MOST_CHARACTERS = 120
_READ_AS_OTHER_THAN_TEXT = re.compile(r"(?i)[\d.+_TZe-]*|null|nan|inf|true|false|__hive_default_partition__")
"""Partition values that some readers take for numbers, dates or nothing."""


def find_logs(words: Sequence[str], list_file: str | None) -> list[Path]:
    """The logs that paths, quoted glob patterns and a list of both name, each once, in the order given.

    list_file: a file with a path or pattern a line, `-` for standard input; empty lines and lines that begin with #
    say nothing. Paths are relative to the current folder. A path that leads nowhere is kept: its failing is told
    with the log. UsageError where a pattern matches nothing, or there is no log at all.
    """
    if not words and list_file is None:
        raise UsageError("no logs: name them, quote a pattern such as 'logs/*.mcap', or give --from LIST")
    listed = [] if list_file is None else _lines(list_file)
    found = {path.resolve(): path for word in (*words, *listed) for path in _expand(word)}
    if not found:
        raise UsageError(f"--from {list_file}: names no log")
    return list(found.values())


def _lines(list_file: str) -> list[str]:
    text = sys.stdin.read() if list_file == STDIN else read_text(Path(list_file))
    lines = (line.strip() for line in text.splitlines())
    return [line for line in lines if line and not line.startswith("#")]


def _expand(word: str) -> list[Path]:
    if Path(word).exists() or not glob.has_magic(word):
        return [Path(word)]
    found = sorted(glob.glob(word, recursive=True))
    if not found:
        raise UsageError(f"{word}: no file matches this pattern")
    return [Path(name) for name in found]


def unique_names(logs: Iterable[Path]) -> list[str]:
    """A name for each log: its stem, with as many of its folders before it as tell it from the others.

    Letters, digits, `.`, `_` and `-` only; unlike in more than case.
    """
    paths = [path.resolve() for path in logs]
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
            return _numbered([_safe(leaves[i]) if i in alike else name for i, name in enumerate(names)])
        for i in deeper:
            depth[i] += 1


def _zip(paths: list[Path], leaves: list[str], depth: list[int]) -> Iterable[tuple[Path, str, int]]:
    return zip(paths, leaves, depth, strict=True)


def _parents(path: Path) -> list[str]:
    return [part for part in path.parent.parts if part != path.anchor]


def _leaves(paths: list[Path]) -> list[str]:
    """Stems; names with their suffix where one folder holds two of a stem."""
    stems = [path.name if path.is_dir() else path.stem for path in paths]
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
