"""Where a batch's logs are worked on: in processes of this machine."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Mapping
from typing import Any, TypeVar

Task = TypeVar("Task")
Row = dict[str, Any]
Finished = Generator[tuple[str, Row], None, None]
"""Tasks' names and their rows, as they are finished; one whose process died has the row {ERROR: why}."""


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def processes(tasks: Mapping[str, Task], work: Callable[[Task], Row], jobs: int | None) -> Finished:
    """Each task in a process of its own kind, `jobs` of them at once; one that dies takes its own task only along."""
    from adcbf_cli.commands.campaign import run_in_processes, single_threaded

    with single_threaded():
        yield from run_in_processes(tasks, work, jobs or cores())
