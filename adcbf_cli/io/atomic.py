"""Outputs that are whole or absent: written under a temporary name beside the target, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from adcbf_cli.core.errors import UsageError

TEMPORARY_SUFFIX = ".partial"


@contextmanager
def atomic_path(target: Path) -> Iterator[Path]:
    """Yields a temporary path to write to; on success it is flushed to disk and renamed to
    `target`, on any exception it is removed and `target` stays as it was."""
    temporary = target.with_name(f".{target.name}.{os.getpid()}{TEMPORARY_SUFFIX}")
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def check_target(target: Path) -> None:
    """UsageError where a file could not be written at this path: asked before long work, not after it."""
    if target.is_dir():
        raise UsageError(f"{target}: is a folder; give a file name")
    if not target.absolute().parent.is_dir():
        raise UsageError(f"{target}: there is no folder {target.parent}; make it first")
    if not os.access(target.absolute().parent, os.W_OK):
        raise UsageError(f"{target}: the folder {target.parent} may not be written to; choose another")


def write_text_atomically(target: Path, text: str) -> None:
    with atomic_path(target) as temporary:
        temporary.write_text(text, encoding="utf-8")


def remove_leftovers(folder: Path) -> None:
    """Removes temporary files that killed commands left in `folder`. Hold the folder's lock."""
    for leftover in folder.glob(f".*{TEMPORARY_SUFFIX}"):
        leftover.unlink(missing_ok=True)
