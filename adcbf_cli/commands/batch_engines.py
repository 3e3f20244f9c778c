"""Where a batch's logs are worked on: in processes of this machine, or on a Ray cluster."""

from __future__ import annotations

import os
import re
import socket
import sys
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from itertools import islice
from typing import Any, TypeVar

from adcbf_cli.core.errors import AdcbfError, UsageError

Task = TypeVar("Task")
Row = dict[str, Any]
Finished = Generator[tuple[str, Row], None, None]
"""Tasks' names and their rows, as they are finished; one whose process died has the row {ERROR: why}."""

REACHED_WITHIN_S = 10.0

RETRIES = 3
"""How often Ray starts a task anew whose worker, or its machine, died."""

NO_USAGE_STATISTICS = {"RAY_USAGE_STATS_ENABLED": "0"}
"""Ray would report home what it runs on, unless the user says otherwise."""

FEW_OOM_RETRIES = {"RAY_task_oom_retries": str(RETRIES)}
"""Where memory runs out, Ray would start a task anew without end: a log that is too large would hold up its batch."""


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def on_processes(tasks: Mapping[str, Task], work: Callable[[Task], Row], jobs: int | None) -> Finished:
    """Every task in a process of this machine, `jobs` at once; one that dies takes only its own task along."""
    from adcbf_cli.commands.campaign import run_in_processes, single_threaded

    with single_threaded():
        yield from run_in_processes(tasks, work, jobs or cores())


def on_ray(tasks: Mapping[str, Task], work: Callable[[Task], Row], jobs: int | None, address: str | None) -> Finished:
    """Every task on a CPU of a Ray cluster, `jobs` at once, or as many as it has CPUs.

    address: the cluster's; without one, RAY_ADDRESS, and without that a cluster that lasts as long as this does, in
    processes of this machine. A task whose worker dies is started anew, up to RETRIES times. The cluster's machines
    must have this adcbf installed and see the logs and the batch's folder under the same paths.
    """
    from adcbf_cli.commands.campaign import ERROR, attempt, single_threaded

    with single_threaded(), _connected(address or os.environ.get("RAY_ADDRESS"), jobs) as ray:
        remote = ray.remote(num_cpus=1, max_retries=RETRIES)(attempt)
        given = ray.put(work)
        upcoming = iter(tasks.items())
        # Ray queues what has no CPU yet, so one more than fit keeps every CPU at work.
        at_once = jobs or int(ray.cluster_resources().get("CPU", 1)) + 1
        running = {remote.remote(given, task): name for name, task in islice(upcoming, at_once)}
        while running:
            (ready, *_), _ = ray.wait(list(running), num_returns=1)
            name = running.pop(ready)
            for following, task in islice(upcoming, 1):
                running[remote.remote(given, task)] = following
            try:
                row: Row = ray.get(ready)
            except ray.exceptions.RayError as error:
                row = {ERROR: _why(error)}
            yield name, row


def _why(error: Exception) -> str:
    """Why there is no row, in one line, of an error that Ray raised."""
    from ray.exceptions import OutOfMemoryError, RayTaskError

    if isinstance(error, OutOfMemoryError):
        return "its Ray worker was ended each time that it was tried, since its machine's memory ran out"
    if isinstance(error, RayTaskError):  # `attempt` lets none through: the worker did not come as far
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        return f"its Ray worker could not begin: {lines[-1] if lines else type(error).__name__:.200}"
    return f"its Ray worker died {RETRIES + 1} times ({type(error).__name__})"


@contextmanager
def _connected(address: str | None, jobs: int | None) -> Iterator[Any]:
    """Ray, connected to the cluster, or with one of its own; what still runs is stopped in the end."""
    ray = load_ray()
    if address is not None:
        _check_reachable(address)
    own = {} if address else {"num_cpus": jobs or cores(), "include_dashboard": False}
    with redirect_stdout(sys.stderr):  # Ray prints there what happens to its workers
        try:
            ray.init(address or "local", log_to_driver=False, logging_level="ERROR", **own)
        except Exception as error:  # where a cluster takes too long to start, Ray raises a bare Exception
            raise _no_cluster(address or "this machine", error) from None
        try:
            yield ray
        finally:
            ray.shutdown()


def _check_reachable(address: str) -> None:
    """AdcbfError at once where nobody listens at HOST:PORT; Ray itself would try for minutes."""
    match = re.fullmatch(r"(?:\w+://)?(.+):(\d{1,5})", address)
    if match is None:  # such as "auto"
        return
    try:
        socket.create_connection((match[1].strip("[]"), int(match[2])), timeout=REACHED_WITHIN_S).close()
    except (OSError, OverflowError) as error:
        raise _no_cluster(address, error) from None


def _no_cluster(where: str, error: Exception) -> AdcbfError:
    return AdcbfError(f"no Ray cluster at {where}: {' '.join(str(error).split())[:200]}")


def load_ray() -> Any:
    """The package, told what it reads when it is loaded; UsageError where it is not installed."""
    for name, value in {**NO_USAGE_STATISTICS, **FEW_OOM_RETRIES}.items():
        os.environ.setdefault(name, value)
    try:
        import ray
    except ImportError:
        raise UsageError("--engine ray: Ray is not installed; `pip install 'adcbf[ray]'` does that") from None
    return ray
