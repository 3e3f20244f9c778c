"""Runs side by side as rows for a terminal's table, as Markdown for a pull request, and as a JSON document."""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from adcbf_cli.core.evaluation.comparison_text import number
from adcbf_cli.core.evaluation.headlines import is_driving_headline, is_headline
from adcbf_cli.core.evaluation.run_comparison import Change, RunComparison, Verdict
from adcbf_cli.core.evaluation.scored_run import ScoredRun

SCHEMA_VERSION = 1
_MOST_SETTINGS = 20


def headline_names(base: ScoredRun, comparisons: Sequence[RunComparison]) -> list[str]:
    """The metrics that a screen shows, in the base's order, as far as any run has a value."""
    measured = [
        name
        for found in comparisons
        for name, change in found.changes.items()
        if change.base is not None or change.value is not None
    ]
    with_truth = base.truth is not None
    return [name for name in dict.fromkeys(measured) if is_headline(name, with_truth) or is_driving_headline(name)]


def side_by_side(
    base: str, comparisons: Sequence[RunComparison], names: Iterable[str]
) -> tuple[list[str], list[list[str]]]:
    """(columns, a row a metric): the base's value, and of each other run its value, its difference with the interval,
    and what that says."""
    columns = ["metric", base]
    for found in comparisons:
        columns += [found.run, "difference (95 %)", ""]
    rows = []
    for name in names:
        changes = [found.changes.get(name) for found in comparisons]
        known = next((change for change in changes if change is not None), None)
        row = [name, number(known.base if known else None)]
        for change in changes:
            row += (
                ["-", "", ""]
                if change is None
                else [number(change.value), difference_text(change), verdict_text(change)]
            )
        rows.append(row)
    return columns, rows


def difference_text(change: Change) -> str:
    """`+0.012 (0.001 to 0.02)`, empty where it is not known."""
    if change.difference is None:
        return ""
    size = "0" if change.difference == 0 else f"{change.difference:+.3g}"
    if change.interval is None:
        return size
    return f"{size} ({change.interval[0]:.2g} to {change.interval[1]:.2g})"


def verdict_text(change: Change) -> str:
    """What to say of it in a table: nothing where there is nothing to say."""
    short = {"unknown": "", "the same": "", "no clear difference": "unclear"}
    return short.get(change.verdict, change.verdict)


def tally(found: RunComparison) -> str:
    """`2 better, 1 worse, 60 without a clear difference, 14 the same; 20 without an interval`, over all metrics."""
    counts = Counter(change.verdict for change in found.changes.values())
    told: tuple[tuple[Verdict, str], ...] = (
        ("better", "better"),
        ("worse", "worse"),
        ("changed", "changed, for better or worse"),
        ("no clear difference", "without a clear difference"),
        ("the same", "the same"),
    )
    parts = ", ".join(f"{counts[verdict]} {words}" for verdict, words in told if counts[verdict])
    unknown = f"{counts['unknown']} without an interval" if counts["unknown"] else ""
    return "; ".join(part for part in (parts, unknown) if part) or "nothing in common"


def markdown(base: ScoredRun, comparisons: Sequence[RunComparison], missed: Mapping[str, Sequence[str]]) -> str:
    """For a pull request: what was missed, what changed, the headline; everything else is folded."""
    lines = [f"## Compared with {_code(base.name)}", ""]
    lines += [f"Log: {_code(base.source_name)}, sha256 `{base.source_sha256[:12]}`.", ""]
    for found in comparisons:
        lines += [f"### {_code(found.run)}", ""]
        lines += [f"- **Threshold missed**: {_plain(line)}" for line in missed.get(found.run, ())]
        lines += [f"- {tally(found)}."]
        lines += [f"- Beware: {_plain(remark)}." for remark in found.remarks]
        lines += list(_settings(found))
        names = headline_names(base, [found])
        lines += ["", *_table(found, names)]
        others = [name for name in found.changes if name not in set(names)]
        if others:
            lines += ["", f"<details><summary>{len(others)} more metrics</summary>", "", *_table(found, others)]
            lines += ["", "</details>"]
        lines += ["", *_unpaired(found), ""]
    lines.append("Differences are the run minus the base; intervals are 95 %, paired by blocks of the log or by seeds.")
    return "\n".join(lines) + "\n"


def _settings(found: RunComparison) -> Iterator[str]:
    for key, (a, b) in list(found.settings.items())[:_MOST_SETTINGS]:
        yield f"- {_code(key)}: {_code(str(a))} → {_code(str(b))}"
    if len(found.settings) > _MOST_SETTINGS:
        yield f"- and {len(found.settings) - _MOST_SETTINGS} settings more"


def _table(found: RunComparison, names: Iterable[str]) -> Iterator[str]:
    yield "| metric | base | run | difference | | 95 % interval | |"
    yield "| --- | ---: | ---: | ---: | ---: | --- | --- |"
    for name in names:
        change = found.changes[name]
        low_high = "" if change.interval is None else " to ".join(number(end) for end in change.interval)
        size, share = difference_text(change).partition(" (")[0], _percent(change)
        verdict = verdict_text(change)
        shown = f"**{verdict}**" if verdict in ("better", "worse") else verdict
        cells = (_code(name), number(change.base), number(change.value), size, share, low_high, shown)
        yield f"| {' | '.join(cells)} |"


def _percent(change: Change) -> str:
    relative = change.relative
    return f"{100 * relative:+.2g} %" if relative and math.isfinite(relative) else ""


def _unpaired(found: RunComparison) -> Iterator[str]:
    """Why some differences have no interval, with how many."""
    reasons = Counter(change.no_interval for change in found.changes.values() if change.no_interval is not None)
    if reasons:
        yield ("Without an interval: " + "; ".join(f"{count} ({why})" for why, count in reasons.most_common()) + ".")


def _plain(text: str) -> str:
    """A line of Markdown that holds text out of a user's file."""
    return html.escape(" ".join(text.split()), quote=False).replace("|", "\\|").replace("`", "'")


def _code(text: str) -> str:
    """The same as code, where nothing but its end and a table's bars need care."""
    return f"`{' '.join(text.split()).replace('`', chr(39)).replace('|', chr(92) + '|')}`"


def document(
    base: ScoredRun,
    others: Sequence[ScoredRun],
    comparisons: Sequence[RunComparison],
    limits: Sequence[str],
    missed: Mapping[str, Sequence[str]],
) -> dict[str, Any]:
    """Everything, JSON-able."""
    return {
        "schema_version": SCHEMA_VERSION,
        "base": _run(base),
        "thresholds": list(limits),
        "runs": [
            {
                **_run(run),
                "remarks": list(found.remarks),
                "settings": {key: list(pair) for key, pair in found.settings.items()},
                "thresholds_missed": list(missed.get(found.run, ())),
                "metrics": {name: change.to_dict() for name, change in found.changes.items()},
            }
            for run, found in zip(others, comparisons, strict=True)
        ],
    }


def _run(run: ScoredRun) -> dict[str, Any]:
    return {
        "run": run.name,
        "adcbf": run.version,
        "source": {"name": run.source_name, "sha256": run.source_sha256},
        "truth": run.truth,
    }
