"""What a part of the reproduction is: runs that are independent of each other, and what they add up to."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Row = dict[str, Any]
"""One finished run: JSON values, nothing that is not finite."""

Document = dict[str, Any]
"""What a part found, JSON values. What only its picture needs is under the key `drawn`."""


@dataclass(frozen=True)
class Part:
    """A table or figure of the paper, or an addition to it.

    settings: JSON values that its runs depend on beside the code and their own task.
    tasks: from the seeds asked for to one picklable task a run, by the run's id; a part that takes no
        seed leaves them alone.
    run: does one task; a function of a module, so that another process finds it.
    summarise: from the finished runs' rows, in the order of the tasks, to the document.
    markdown: the document as text below the part's heading.
    figure: whether `io.figures` has a module of this name, whose `draw` takes the document.
    runs_of: the part whose runs these are, with the same settings, so that none is run twice; empty: its own.
    """

    name: str
    title: str
    tasks: Callable[[Sequence[int]], Mapping[str, Any]]
    run: Callable[[Any], Row]
    summarise: Callable[[Sequence[Row]], Document]
    markdown: Callable[[Document], str]
    figure: bool = False
    settings: Mapping[str, Any] = field(default_factory=dict)
    runs_of: str = ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table: the first column to the left, the others to the right."""
    ruled = ["---", *["---:"] * (len(head) - 1)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ruled, *rows))


def seed_text(seeds: Sequence[int]) -> str:
    """`seeds 0 to 19 (n = 20)`, or the list of them where they have gaps."""
    if not seeds:
        return "no seed"
    if len(seeds) == 1:
        return f"seed {seeds[0]}"
    closed = list(seeds) == list(range(seeds[0], seeds[0] + len(seeds)))
    named = f"{seeds[0]} to {seeds[-1]}" if closed else ", ".join(map(str, seeds))
    return f"seeds {named} (n = {len(seeds)})"
