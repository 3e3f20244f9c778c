"""What the campaigns of the tests do. A module of its own: worker processes import it."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adcbf_cli.core.errors import AdcbfError


@dataclass(frozen=True)
class Job:
    """A run: takes `lasts_s`, leaves a line in `log`, and does what `does` says."""

    number: int
    log: Path
    lasts_s: float = 0.0
    does: str = "count"


def run(job: Job) -> dict[str, Any]:
    with job.log.open("a") as log:
        log.write(f"{job.number} {os.getpid()}\n")
    time.sleep(job.lasts_s)
    actions = {
        "count": lambda job: {"number": job.number, "square": job.number**2, "third": job.number / 3},
        "raise": fail,
        "refuse": refuse,
        "nan": lambda job: {"value": float("nan")},
        "die": lambda job: os.kill(os.getpid(), signal.SIGKILL),
        "exit": lambda job: os._exit(3),
        "leave": lambda job: sys.exit(5),
        "meet": meet,
        "ignore": ignore,
        "threads": threads,
    }
    row: dict[str, Any] = actions[job.does](job)
    return row


def fail(job: Job) -> dict[str, Any]:
    raise ValueError(f"no root\nfor {job.number}")


def refuse(job: Job) -> dict[str, Any]:
    raise AdcbfError(f"scene {job.number}: nothing to drive on")


def meet(job: Job) -> dict[str, Any]:
    """Whether two runs have begun, within 20 s."""
    deadline = time.monotonic() + 20
    while len(job.log.read_text().splitlines()) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    return {"met": len(job.log.read_text().splitlines()) == 2}


def ignore(job: Job) -> dict[str, Any]:
    """Does not let itself be terminated, and says so with a file."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    (job.log.parent / "deaf").touch()
    time.sleep(60)
    return {}


def threads(job: Job) -> dict[str, Any]:
    """How many threads BLAS may have here, and the threads of Python there are."""
    import numpy  # noqa: F401 - loads BLAS
    from threadpoolctl import threadpool_info

    return {"blas": [pool["num_threads"] for pool in threadpool_info()], "python": threading.active_count()}


def jobs(count: int, log: Path, **rest: Any) -> dict[str, Job]:
    return {f"run {number}": Job(number, log, **rest) for number in range(count)}
