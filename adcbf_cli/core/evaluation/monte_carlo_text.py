"""A Monte Carlo study as rows for a terminal's table, and as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from adcbf_cli.core.evaluation.comparison_text import number
from adcbf_cli.core.evaluation.rare_rates import rule_of_three
from adcbf_cli.core.evaluation.run_measures import MEANS, MEASURES, RATES, RunMeasure

if TYPE_CHECKING:
    from adcbf_cli.core.evaluation.comparison import Aggregate, Difference
    from adcbf_cli.core.evaluation.monte_carlo import MonteCarlo, PlannerRuns

HEADLINE = ("success", "collision", "avoidable_collision", "timeout", "freeze", "fallback", "nav_time_s", "min_dist_m")
LISTED = 20
"""So many seeds or failed runs are named; report.json has all of them."""


def headline(study: MonteCarlo) -> tuple[list[str], list[list[str]]]:
    """(columns, one row a planner)."""
    shown = [measure for name in HEADLINE for measure in MEASURES if measure.name == name]
    rows = [
        [name, str(runs.runs), *(_short(runs.aggregates[measure.name], measure) for measure in shown)]
        for name, runs in study.planners.items()
    ]
    return ["planner", "runs", *(measure.title for measure in shown)], rows


def markdown(study: MonteCarlo) -> str:
    """Rates, means, differences, thirds of the scenes, what failed, and the definitions."""
    parts = [_rates(study), _means(study), _differences(study), _thirds(study), _collisions(study), _failed(study)]
    lines = [line for part in (*parts, _definitions()) if part for line in ("", *part)]
    return "\n".join(lines[1:]) + "\n"


def _rates(study: MonteCarlo) -> list[str]:
    rows = [
        [name, str(runs.runs), *(_rate(runs.aggregates[measure.name]) for measure in RATES)]
        for name, runs in study.planners.items()
    ]
    found, searched, unknown = (study.ways[way] for way in (True, False, None))
    return [
        "## How runs ended",
        "",
        *_table(["planner", "runs", *(measure.title for measure in RATES)], rows),
        "",
        "In brackets 95 % score intervals (Wilson), then the events and the runs that count. Where n runs saw no "
        "event, the upper end is z2 / (n + z2), z = 1.96; the rule of three gives 3 / n:",
        "",
        *_unseen(study),
        "",
        f"Scenes: {found} can be driven through, in {searched} a search found no way, {unknown} were not searched.",
    ]


def _unseen(study: MonteCarlo) -> list[str]:
    """What the rates that nobody wants may be where nothing was seen."""
    lines = [
        f"- {name}: {measure.title} 0 of {found.n}: below {_percent(found.interval[1])} % (Wilson), "
        f"{_percent(rule_of_three(found.n))} % (rule of three)."
        for name, runs in study.planners.items()
        for measure in RATES
        if measure.better == "lower" and (found := runs.aggregates[measure.name]).interval and found.value == 0
    ]
    return lines or ["- every such event was seen."]


def _means(study: MonteCarlo) -> list[str]:
    rows = [
        [name, *(_mean(runs.aggregates[measure.name]) for measure in MEANS)] for name, runs in study.planners.items()
    ]
    return [
        "## Means over runs",
        "",
        *_table(["planner", *(measure.title for measure in MEANS)], rows),
        "",
        "In brackets 95 % bootstrap intervals; (k/n): only k of n runs have a value. Runs that fail have no nav time "
        "and no path length, so that those means favour planners that fail in hard scenes.",
    ]


def _differences(study: MonteCarlo) -> list[str]:
    lines: list[str] = []
    for name, runs in study.planners.items():
        if not runs.differences:
            continue
        rows = [_difference_row(measure, runs.differences[measure.name]) for measure in MEASURES]
        columns = ["measure", "difference", "95 % interval", "unit", "better", "pairs", "pairs dropped"]
        lines += ["", f"### {name} minus {study.against}", "", *_table(columns, rows)]
    if not lines:
        return []
    how = "The same scenes for both. Rates differ by percentage points, with paired score intervals (Tango 1998);"
    return ["## Differences, scene by scene", "", f"{how} other measures with bootstrap intervals over pairs.", *lines]


def _difference_row(measure: RunMeasure, found: Difference) -> list[str]:
    scale = 100.0 if measure.is_event else 1.0
    unit = "points" if measure.is_event else "" if measure.unit == "1" else measure.unit
    value = number(None if found.value is None else scale * found.value)
    interval = "" if found.interval is None else _span(scale * x for x in found.interval)
    return [measure.title, value, interval, unit, measure.better, str(found.n), str(found.n_dropped)]


def _thirds(study: MonteCarlo) -> list[str]:
    if not study.thirds:
        return []
    rows = [
        [
            f"`{third.feature}`",
            number(third.low) if third.low == third.high else f"{number(third.low)} to {number(third.high)}",
            str(third.scenes),
            *(_rate(third.collision[name]) for name in study.planners),
        ]
        for third in study.thirds
    ]
    return [
        "## Collisions by what the scene holds",
        "",
        "Scenes in thirds of each feature by itself; equal values stay together.",
        "",
        *_table(["feature", "from, to", "scenes", *study.planners], rows),
    ]


def _collisions(study: MonteCarlo) -> list[str]:
    lines = [line for name, runs in study.planners.items() for line in _collisions_of(name, runs)]
    return ["## Collisions", "", *lines] if lines else []


def _collisions_of(name: str, runs: PlannerRuns) -> list[str]:
    meaning = {True: "avoidable", False: "no way around was found", None: "never known, or not judged"}
    return [
        f"- {name}, {meaning[judged]}: {_listed(map(str, seeds), 'seed' if len(seeds) == 1 else 'seeds')}"
        for judged, seeds in runs.collisions.items()
        if seeds
    ]


def _failed(study: MonteCarlo) -> list[str]:
    if not study.failed:
        return []
    count = f"{len(study.failed)} run{'s' * (len(study.failed) > 1)}"
    lines = [f"- {row.get('run', row.get('seed', 'a run'))}: {row['error']}" for row in study.failed[:LISTED]]
    if len(study.failed) > LISTED:
        lines.append(f"- and {len(study.failed) - LISTED} more")
    return ["## Runs that failed", "", f"{count} gave no result: in no rate, in no mean.", "", *lines]


def _definitions() -> list[str]:
    return [
        "## Definitions",
        "",
        *(f"- {measure.title} (`{measure.name}`): {measure.definition}." for measure in MEASURES),
    ]


def _listed(words: Iterable[str], what: str) -> str:
    named = list(words)
    more = f" and {len(named) - LISTED} more" if len(named) > LISTED else ""
    return f"{len(named)} ({what} {', '.join(named[:LISTED])}{more})"


def _short(found: Aggregate, measure: RunMeasure) -> str:
    if found.value is None:
        return "-"
    value = f"{_percent(found.value)} %" if measure.is_event else number(found.value)
    return value + _partly(found)


def _rate(found: Aggregate) -> str:
    """Per cent, its interval, and the events behind it."""
    if found.value is None or found.interval is None:
        return "-"
    low, high = map(_percent, found.interval)
    return f"{_percent(found.value)} % ({low} to {high}), {round(found.value * found.n)}/{found.n}"


def _mean(found: Aggregate) -> str:
    interval = "" if found.interval is None else f" ({_span(found.interval)})"
    return number(found.value) + interval + _partly(found)


def _partly(found: Aggregate) -> str:
    return f" ({found.n}/{found.n + found.n_missing})" if found.n_missing else ""


def _percent(rate: float) -> str:
    """Two significant digits where it is rare, whole tenths otherwise."""
    percent = 100 * rate
    return f"{percent:.2g}" if 0.001 < percent < 1 else f"{percent:.1f}".removesuffix(".0")


def _span(interval: Iterable[float]) -> str:
    low, high = interval
    return f"{number(low)} to {number(high)}"


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(columns)} |"
    yield f"| {' | '.join('---' for _ in columns)} |"
    for row in rows:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
