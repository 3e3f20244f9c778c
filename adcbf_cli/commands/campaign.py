"""Many runs of one kind: in parallel processes, resumable, with one row a run whatever happens to it.

A run's row does not depend on how many processes there are, and rows come back in the order of the tasks.
The processes are started one by one, not by a pool: where one is killed (out of memory), it must be known
which run it was at, and the others must go on.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from itertools import islice
from multiprocessing import connection, get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from adcbf_cli.commands.run_progress import RunProgress
from adcbf_cli.commands.terminal import say
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.run_rows import RunRows

Task = TypeVar("Task")
Row = dict[str, Any]
Finished = Generator[tuple[str, Row], None, None]
"""Run ids and their rows, as the runs finish."""

ERROR = "error"
"""The row of a run that failed has this column, why in one line, and beside it `run`, its id."""

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Set to 1: the processes are the parallelism. The libraries read them when they are loaded."""

GRACE_S = 2.0
"""Time that a process has to remove what it had begun before it is killed."""


def run_campaign(
    tasks: Mapping[str, Task], work: Callable[[Task], Row], rows: RunRows, jobs: int, what: str
) -> list[Row]:
    """Each task's row, in the order of `tasks`: those that `rows` has, and the others as they are run now.

    work: a picklable function (as the tasks are) that gives a row which JSON can hold: no NaN, no infinity.
        A run that raises, or whose process dies, has the row {"run": its id, "error": why}; it is counted on
        stderr, the others go on, and the next start tries it again.
    jobs: processes at once; 1 runs in this very process, where nothing guards against its being killed.
    what: names the runs on stderr.
    """
    todo = {run_id: task for run_id, task in tasks.items() if ERROR in rows.done.get(run_id, {ERROR: ""})}
    if len(todo) < len(tasks):
        say(f"{what}: {len(tasks) - len(todo)} of {len(tasks)} runs are there already")
    finished = _run_here(todo, work) if jobs == 1 else run_in_processes(todo, work, jobs)
    with single_threaded(), closing(finished), RunProgress(len(todo), what) as progress:
        for run_id, row in finished:
            rows.add(run_id, {"run": run_id} | row if ERROR in row else row)
            progress.advance(failed=ERROR in row)
    results = [rows.done[run_id] for run_id in tasks]
    _say_failures(results, what)
    return results


def _say_failures(results: list[Row], what: str) -> None:
    failed = [row[ERROR] for row in results if ERROR in row]
    if failed:
        say(f"warning: {what}: {len(failed)} of {len(results)} runs failed, the first with: {failed[0]}")
        say("the same command tries the failed ones again")


@contextmanager
def single_threaded() -> Iterator[None]:
    """Processes that begin within the block use one thread each."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _run_here(todo: Mapping[str, Task], work: Callable[[Task], Row]) -> Finished:
    for run_id, task in todo.items():
        yield run_id, attempt(work, task)


def attempt(run: Callable[[Task], Row], task: Task) -> Row:
    """The run's row as JSON gives it back, or the one that says why there is none."""
    try:
        row: Row = json.loads(json.dumps(run(task), allow_nan=False))
    except AdcbfError as error:
        return {ERROR: str(error)}
    except Exception as error:  # whatever it is, the other runs go on, and the row tells of it
        return {ERROR: in_one_line(error)}
    return row


def in_one_line(error: Exception) -> str:
    """Of an unexpected error: its kind, its text and where it came from."""
    text = " ".join(str(error).split())
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {text}{place}"


def run_in_processes(todo: Mapping[str, Task], work: Callable[[Task], Row], jobs: int) -> Finished:
    """Each task's row as it is done, `jobs` at a time, however a task or its process may end. Close it to stop."""
    upcoming = iter(todo.items())
    crew: list[_Worker] = []
    try:
        for run_id, task in islice(upcoming, jobs):
            crew.append(_Worker())
            crew[-1].give(run_id, work, task)
        while busy := [worker for worker in crew if worker.run_id is not None]:
            ready = connection.wait([worker.pipe for worker in busy])
            for worker in [worker for worker in busy if worker.pipe in ready]:
                finished, row = worker.take()
                following = next(upcoming, None)
                if following is not None:
                    if not worker.alive:
                        crew[crew.index(worker)] = worker = _Worker()
                    worker.give(following[0], work, following[1])
                yield finished, row
    finally:
        _dismiss(crew)


class _Worker:
    """A process that does one run after the other, each as it is given.

    run_id: the run it is at, None where it waits or is no more. alive: False once it was found to have died.
    """

    def __init__(self) -> None:
        self.run_id: str | None = None
        self.alive = True
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        # Ctrl-C reaches the whole group, but only this process is to answer it: the new one begins with the
        # signal held back, until it has learnt to ignore it. The tracker's own start would let it through.
        resource_tracker.ensure_running()
        held_before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, held_before)
        theirs.close()

    def give(self, run_id: str, work: Callable[[Task], Row], task: Task) -> None:
        message = pickle.dumps((work, task))
        self.run_id = run_id
        with suppress(ConnectionError):  # it has died: `take` finds out
            self.pipe.send_bytes(message)

    def take(self) -> tuple[str, Row]:
        """The finished run and its row. Call when the pipe has something to say."""
        assert self.run_id is not None
        run_id, self.run_id = self.run_id, None
        try:
            row: Row = self.pipe.recv()
        except (EOFError, OSError):  # gone before its answer, or in the middle of it
            self.alive = False
            self.pipe.close()
            self.process.join()
            row = {ERROR: _cause_of_death(self.process.exitcode or 0)}
        return run_id, row


def _cause_of_death(exit_code: int) -> str:
    if exit_code >= 0:
        return f"its process ended early, with exit code {exit_code}"
    name = signal.Signals(-exit_code).name
    return f"its process was killed by {name}" + (", out of memory perhaps" if name == "SIGKILL" else "")


def _dismiss(crew: list[_Worker]) -> None:
    """Lets idle processes end and stops the others; none is left when this returns."""
    for worker in crew:
        if worker.run_id is not None:
            worker.process.terminate()
        worker.pipe.close()
    for worker in crew:
        worker.process.join(GRACE_S)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()


def _serve(pipe: Connection[Any, Any]) -> None:
    """What a worker process does: runs what comes through the pipe, until it is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGTERM, _leave)
    threading.Thread(target=_follow_parent, daemon=True).start()
    while True:
        try:
            message = pipe.recv_bytes()
        except EOFError:
            return
        pipe.send(attempt(_unpack_and_run, message))


def _unpack_and_run(message: bytes) -> Row:
    work, task = pickle.loads(message)
    row: Row = work(task)
    return row


def _leave(signal_number: int, _frame: object) -> None:
    """Leaves by way of every `with` and `finally`, so that no temporary file stays."""
    raise SystemExit(128 + signal_number)


def _follow_parent() -> None:
    """Ends this process when the one that started it has ended, however that came about."""
    parent = parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)
