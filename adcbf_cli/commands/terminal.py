"""What goes to the terminal, and where: results to stdout, everything else to stderr."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from adcbf_cli.core.types import Loss, Notes

T = TypeVar("T")


_SOON_S = 2.0
_AGAIN_S = 0.5


class Compiling:
    """What takes long where the fast solver has to be compiled; loading a compiled one may take long too, on a busy
    machine, but is no compiling."""

    text = "compiling the solver for this machine; this happens once"

    @staticmethod
    def goes_on() -> bool:
        loop = sys.modules.get("adcbf_cli.core.planning.solvers.sqp_loop")
        entry = getattr(loop, "entry", None)
        return entry is not None and entry.cache_info().currsize > 0 and bool(entry().stats.cache_misses)


COMPILING = Compiling()


@contextmanager
def patience(what: str | Compiling) -> Iterator[None]:
    """Says `what` where the block takes longer than a person expects."""
    done = threading.Event()

    def watch() -> None:
        if done.wait(_SOON_S):
            return
        while isinstance(what, Compiling) and not what.goes_on():
            if done.wait(_AGAIN_S):
                return
        say(what.text if isinstance(what, Compiling) else what)

    threading.Thread(target=watch, daemon=True).start()
    try:
        yield
    finally:
        done.set()


def print_json(document: Any) -> None:
    """One JSON document on stdout. NaN is not JSON and would be an error in the program."""
    print(json.dumps(document, indent=2, allow_nan=False))


def say(text: str) -> None:
    """A line for the person at the terminal, on stderr."""
    print(f"adcbf: {text}", file=sys.stderr)


def told_loss(loss: Loss) -> str:
    """What of the input could not be read, and how much where that is known."""
    return f"lost: {loss.what}" + ("" if loss.count is None else f" ({loss.count})")


def show_notes(notes: Notes) -> None:
    """Warnings, losses and counted repairs, a line each."""
    for warning in notes.warnings:
        say(f"warning: {warning}")
    for loss in notes.losses:
        say(told_loss(loss))
    for name, number in sorted(notes.counters.items()):
        say(f"note: {name.replace('_', ' ')}: {number}")


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """A table on stdout: the first column to the left, numbers to the right."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i == 0 else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    # Piped output keeps its full width: folding at 80 columns would break scripts that read it. Names come from users'
    # files: a class may be called [/b], and is to be shown so.
    Console(width=None if sys.stdout.isatty() else 240, markup=False, emoji=False).print(table)


def progress(items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
    """Passes items on, with a bar on stderr where that is a terminal: count, rate, time left."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(f"{task.finished_speed or task.speed or 0:.1f} frames/s")

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield from bar.track(items, total=total, description=what)
