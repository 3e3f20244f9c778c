"""A comparison as rows for a terminal's table, and as Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from adcbf_cli.core.evaluation.comparison import Aggregate, Comparison, Difference, PlannerScore
from adcbf_cli.core.evaluation.driving import BY_NAME

HEADLINE: dict[str, dict[str, str]] = {
    "replay": {
        "success": "success",
        "collision": "collision",
        "timeout": "timeout",
        "nav_time_s": "nav time s",
        "min_dist_m": "min dist m",
        "ref_time_s": "ref time s",
        "vel_var": "vel var m2/s2",
        "path_length_m": "path m",
        "infeasible_rate": "infeasible",
        "relaxed_rate": "relaxed",
        "braked_rate": "braked",
        "solve_p95_ms": "p95 ms",
    },
    "plan": {
        "plan_error_1s_m": "error 1 s m",
        "plan_error_2s_m": "error 2 s m",
        "plan_error_3s_m": "error 3 s m",
        "barrier_min_m2": "min h m2",
        "infeasible_rate": "infeasible",
        "relaxed_rate": "relaxed",
        "braked_rate": "braked",
        "solve_p95_ms": "p95 ms",
    },
}
"""The metrics that fit across a terminal, and what their columns are called."""


def number(value: float | None) -> str:
    """Three significant digits, a dash for what was not measured."""
    if value is None:
        return "-"
    return f"{value:.0f}" if abs(value) >= 1000 or value == round(value) else f"{value:.3g}"


def headline(comparison: Comparison) -> tuple[list[str], list[list[str]]]:
    """(columns, one row a planner). A mean over fewer drives than were driven says over how many."""
    columns = HEADLINE[comparison.kind]
    rows = [
        [score.planner, str(len(score.scores)), *(_headline_cell(score, name) for name in columns)]
        for score in comparison.planners.values()
    ]
    return ["planner", "drives", *columns.values()], rows


def _headline_cell(score: PlannerScore, name: str) -> str:
    total = score.aggregates.get(name)
    if total is None or total.value is None:
        return "-"
    partly = f" ({total.n}/{total.n + total.n_missing})" if total.n_missing else ""
    return number(total.value) + partly


def markdown(comparison: Comparison) -> str:
    """The headline, all metrics of each planner, differences if any, and the definitions."""
    columns, rows = headline(comparison)
    title = "Closed loop" if comparison.kind == "replay" else "Open loop"
    lines = [f"## {title}", "", *_table(columns, rows), ""]
    lines.append("Means over drives; (k/n): only k of n drives have a value.")
    for score in comparison.planners.values():
        lines += ["", f"### {score.planner}", "", *_table(*_metric_rows(score))]
        if score.differences:
            lines += ["", f"Minus {comparison.against}, seed by seed:", "", *_table(*_difference_rows(score))]
    lines += ["", "### Definitions", ""]
    used = {name for score in comparison.planners.values() for name in score.aggregates}
    lines += [f"- `{m.name}` ({m.window}): {m.definition}." for m in BY_NAME.values() if m.name in used]
    return "\n".join(lines) + "\n"


def _metric_rows(score: PlannerScore) -> tuple[list[str], list[list[str]]]:
    rows = [
        [f"`{name}`", number(found.value), _interval(found), _unit(name), str(found.n), str(found.n_missing)]
        for name, found in score.aggregates.items()
        if found.n
    ]
    return ["metric", "mean", "95 % interval", "unit", "drives", "without a value"], rows


def _difference_rows(score: PlannerScore) -> tuple[list[str], list[list[str]]]:
    rows = [
        [
            f"`{name}`",
            number(found.value),
            _interval(found),
            _unit(name),
            BY_NAME[name].better,
            str(found.n),
            str(found.n_dropped),
        ]
        for name, found in score.differences.items()
        if found.n or found.n_dropped
    ]
    return ["metric", "difference", "95 % interval", "unit", "better", "pairs", "pairs dropped"], rows


def _interval(found: Aggregate | Difference) -> str:
    return "" if found.interval is None else f"{number(found.interval[0])} to {number(found.interval[1])}"


def _unit(name: str) -> str:
    unit = BY_NAME[name].unit
    return "" if unit == "1" else unit


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    yield f"| {' | '.join(columns)} |"
    yield f"| {' | '.join('---' for _ in columns)} |"
    for row in rows:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
