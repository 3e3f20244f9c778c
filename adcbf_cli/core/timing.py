"""Stage timing without a clock in the stages: they are handed a timer, by default one that does
nothing. The command that wants a `timings` table hands in a recording one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from time import perf_counter_ns
from typing import Protocol


class Timer(Protocol):
    def __call__(self, stage: str) -> AbstractContextManager[None]: ...


def no_timer(stage: str) -> AbstractContextManager[None]:
    """The default timer: measures nothing."""
    return nullcontext()


class RecordingTimer:
    """Adds up nanoseconds by stage name; `take` returns and clears them, once a frame."""

    def __init__(self) -> None:
        self._spent_ns: dict[str, int] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        start = perf_counter_ns()
        try:
            yield
        finally:
            self._spent_ns[stage] = self._spent_ns.get(stage, 0) + perf_counter_ns() - start

    def take(self) -> dict[str, int]:
        spent, self._spent_ns = self._spent_ns, {}
        return spent
