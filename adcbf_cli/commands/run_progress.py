"""How far a campaign of runs has come: a bar on a terminal, a line now and then elsewhere, all on stderr."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, Any

from adcbf_cli.commands.terminal import say

if TYPE_CHECKING:
    from rich.progress import Progress

REPORT_S = 30.0
"""How often there is a line where there is no terminal to draw a bar on."""


class RunProgress:
    """Counts finished runs while its `with` block lasts."""

    def __init__(self, total: int, what: str, unit: str = "runs") -> None:
        self._total = total
        self._what = what
        self._unit = unit
        self._done = self._failed = 0
        self._began_s = self._reported_s = time.monotonic()
        self._bar = _bar(total, what, unit) if total and sys.stderr.isatty() else None

    def __enter__(self) -> RunProgress:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def advance(self, failed: bool) -> None:
        self._done += 1
        self._failed += failed
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], advance=1, failed=f"{self._failed} failed" * bool(self._failed))
        elif time.monotonic() - self._reported_s >= REPORT_S:
            self._reported_s = time.monotonic()
            say(self._line(self._reported_s - self._began_s))

    def _line(self, elapsed_s: float) -> str:
        rate = self._done / elapsed_s
        failed = f", {self._failed} failed" if self._failed else ""
        left = duration((self._total - self._done) / rate)
        return (
            f"{self._what}: {self._done} of {self._total} {self._unit}{failed}, {rate:.2g} {self._unit}/s, {left} left"
        )


def duration(seconds: float) -> str:
    """Rounded to what one wants to know: 40 s, 3 min, 2 h 05 min."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def _bar(total: int, what: str, unit: str) -> Progress:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(f"{task.finished_speed or task.speed or 0:.2g} {unit}/s")

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[failed]}"),
    )
    # Lines printed meanwhile go above the bar on a terminal; results that go elsewhere are left alone.
    on_top = sys.stdout.isatty()
    bar = Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=on_top)
    bar.add_task(what, total=total, failed="")
    return bar
