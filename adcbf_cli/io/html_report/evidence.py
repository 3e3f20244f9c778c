"""What the reports of a run folder say, as rows for a page's tables: scores, planners, warnings, what was run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from adcbf_cli.core.replay.records import LOGGED
from adcbf_cli.io.report import number
from adcbf_cli.io.run_folder import DRIVING, Manifest

HEADLINE = (
    ("detection.recall", "Labelled objects that a cluster stands on"),
    ("detection.moving_precision", "Moving tracks that are something labelled"),
    ("clear.mota", "Tracking accuracy (MOTA)"),
    ("hota.hota", "Tracking accuracy (HOTA)"),
    ("tracking.rmse_m", "Track position error, RMS"),
    ("tracking.coverage_95", "True positions within the tracks' 95 % ellipses"),
    ("prediction.fde_m.1.0s", "Prediction error 1 s ahead, mean"),
    ("prediction.fde_m.2.0s", "Prediction error 2 s ahead, mean"),
    ("prediction.fde_m.3.0s", "Prediction error 3 s ahead, mean"),
    ("prediction.coverage_95", "True positions within the predicted 95 % ellipses"),
    ("prediction.coverage_conformal_radius", "True positions within the conformal radius"),
    ("later_seen.fde_m.1.0s", "Prediction 1 s ahead against where the track was then seen, mean"),
    ("later_seen.fde_m.3.0s", "Prediction 3 s ahead against where the track was then seen, mean"),
    ("later_seen.coverage_95", "Later sightings within the predicted 95 % ellipses"),
    ("clusters.per_frame", "Obstacles a scan"),
    ("tracks.confirmed", "Confirmed tracks"),
    ("tracks.life_s.median", "Life of a confirmed track, median"),
)
"""The scores most looked at, with what they are in plain words; all the others are further down the page."""

PLANNER_ROWS = {
    "replay": (
        "success", "collision", "timeout", "nav_time_s", "min_dist_m", "min_ttc_s", "time_below_clearance_s",
        "ref_time_s", "vel_var", "path_length_m", "jerk_rms_mps3", "freezing_s", "reference_rms_m", "infeasible_rate",
        "relaxed_rate", "braked_rate", "solve_p50_ms", "solve_p95_ms", "solve_max_ms", "deadline_missed_rate",
        "diverged_share",
    ),
    "plan": (
        "plan_error_1s_m", "plan_error_2s_m", "plan_error_3s_m", "barrier_min_m2", "infeasible_rate", "relaxed_rate",
        "braked_rate", "solve_p50_ms", "solve_p95_ms", "solve_max_ms", "deadline_missed_rate",
    ),
}  # fmt: skip
"""The planners' metrics that stand in the open table; the rest is folded."""

_COVERAGE = re.compile(
    r"(?P<reference>prediction|later_seen|later_seen\.moving)"
    r"\.coverage_(?P<level>\d+(?:\.\d+)?|sigma_radius|conformal_radius)(?:\.(?P<horizon>\d+\.\d)s)?"
)


@dataclass(frozen=True)
class Cell:
    """One number of a table: text is a dash where there is no evidence."""

    text: str
    interval: str = ""
    note: str = ""


@dataclass(frozen=True)
class Row:
    """One metric over several columns."""

    name: str
    label: str
    unit: str
    better: str
    definition: str
    cells: tuple[Cell, ...]


def score_cell(metric: dict[str, Any] | None) -> Cell:
    """A score of report.json."""
    if metric is None or metric["value"] is None:
        return Cell("-", note="" if metric is None else "no evidence")
    return Cell(number(metric["value"]), interval_text(metric.get("interval_95")), f"n = {metric['n']:,}")


def interval_text(interval: list[float | None] | None) -> str:
    return "" if interval is None else f"{number(interval[0])} to {number(interval[1])}"


def unit_text(unit: str) -> str:
    return "" if unit == "1" else unit.replace("m2", "m²").replace("s2", "s²").replace("s3", "s³")


DRIVEN_HEADLINE = {
    "replay": (
        ("success", "Drives that reach the goal"),
        ("collision", "Drives that collide"),
        ("min_dist_m", "Smallest clearance of a drive, mean"),
        ("solve_p95_ms", "95 % of its planning steps take at most, mean"),
    ),
    "plan": (
        ("plan_error_3s_m", "Plan's distance from what the log's driver did 3 s later"),
        ("barrier_min_m2", "Smallest barrier that a plan leads to"),
    ),
}
"""What is most looked at of the planner that the others are compared with."""


def headline_rows(reports: list[dict[str, Any] | None], driving: list[dict[str, dict[str, Any]]]) -> list[Row]:
    """The scores most looked at, one column a run: of driving, then of perception."""
    rows = list(_driving_headline(driving))
    for name, label in HEADLINE:
        found = [None if report is None else report["metrics"].get(name) for report in reports]
        known = [metric for metric in found if metric is not None]
        if known:
            cells = tuple(score_cell(metric) for metric in found)
            rows.append(Row(name, label, unit_text(known[0]["unit"]), "", known[0]["definition"], cells))
    return rows


def _driving_headline(driving: list[dict[str, dict[str, Any]]]) -> Iterator[Row]:
    for kind, wanted in DRIVEN_HEADLINE.items():
        comparisons = [documents[kind]["comparison"] if kind in documents else None for documents in driving]
        planner = next((name for found in comparisons if found for name in _main_planner(found)), None)
        for name, label in wanted:
            declared = next((found["metrics"].get(name) for found in comparisons if found), None)
            cells = tuple(_driven_cell(_total(found, planner, name)) for found in comparisons)
            if declared is not None and any(cell.text != "-" for cell in cells):
                unit = unit_text(declared["unit"])
                yield Row(f"{kind}.{planner}.{name}", f"{planner}: {label}", unit, "", declared["definition"], cells)


def _driven_cell(total: dict[str, Any] | None) -> Cell:
    """As in the planners' table, and always with the number of drives."""
    cell = _planner_cell(total)
    if total is None or cell.note or cell.text == "-":
        return cell
    return Cell(cell.text, cell.interval, f"{total['n']} drive{'' if total['n'] == 1 else 's'}")


def _main_planner(comparison: dict[str, Any]) -> list[str]:
    """The planner that the others are compared with, else the first, in a list; none where only the log drove."""
    names = [name for name in comparison["planners"] if name != LOGGED]
    return [comparison["against"]] if comparison["against"] in names else names[:1]


def _total(comparison: dict[str, Any] | None, planner: str | None, metric: str) -> dict[str, Any] | None:
    found = None if comparison is None else comparison["planners"].get(planner)
    return None if found is None else found["metrics"].get(metric)


def all_scores(report: dict[str, Any]) -> list[Row]:
    """Every score of a run but those of planners, which have a table of their own."""
    return [
        Row(name, name, unit_text(metric["unit"]), "", f"{metric['definition']} ({metric['sample']})",
            (score_cell(metric),))
        for name, metric in report["metrics"].items()
        if not name.startswith(("plan.", "replay."))
    ]  # fmt: skip


def planner_tables(document: dict[str, Any]) -> dict[str, Any]:
    """A driving report's comparison: the open rows, the folded ones, and differences by planner."""
    comparison = document["comparison"]
    planners = comparison["planners"]
    rows = [
        Row(
            name,
            name,
            unit_text(declared["unit"]),
            declared["better"],
            f"{declared['definition']} (window: {declared['window']})",
            tuple(_planner_cell(found["metrics"].get(name)) for found in planners.values()),
        )
        for name, declared in comparison["metrics"].items()
    ]
    rows = [row for row in rows if any(cell.text != "-" for cell in row.cells)]
    wanted = PLANNER_ROWS[comparison["kind"]]
    return {
        "planners": [{"name": name, "drives": found["drives"]} for name, found in planners.items()],
        "rows": sorted((row for row in rows if row.name in wanted), key=lambda row: wanted.index(row.name)),
        "more": [row for row in rows if row.name not in wanted],
        "against": comparison["against"],
        "differences": _differences(comparison),
    }


def _planner_cell(total: dict[str, Any] | None) -> Cell:
    if total is None or total["value"] is None:
        return Cell("-")
    partly = f"{total['n']} of {total['n'] + total['n_missing']} drives" if total["n_missing"] else ""
    return Cell(number(total["value"]), interval_text(total["interval_95"]), partly)


def _differences(comparison: dict[str, Any]) -> list[Row]:
    """Each planner minus the one compared against, where anything was paired."""
    others = {name: found for name, found in comparison["planners"].items() if found["differences"]}
    rows = []
    for name, declared in comparison["metrics"].items():
        found = [other["differences"].get(name) for other in others.values()]
        if any(entry is not None and entry["n_pairs"] for entry in found):
            cells = tuple(_difference_cell(entry) for entry in found)
            rows.append(Row(name, name, unit_text(declared["unit"]), declared["better"], declared["definition"], cells))
    return rows


def _difference_cell(entry: dict[str, Any] | None) -> Cell:
    if entry is None or entry["value"] is None:
        return Cell("-")
    return Cell(number(entry["value"]), interval_text(entry["interval_95"]), f"{entry['n_pairs']} pairs")


def calibration_points(report: dict[str, Any]) -> list[dict[str, Any]]:
    """How often positions lay within the predicted ellipses and radii, by reference, level and horizon (null: all)."""
    points = []
    for name, metric in report["metrics"].items():
        match = _COVERAGE.fullmatch(name)
        if match is None or metric["value"] is None:
            continue
        level = match["level"]
        points.append(
            {
                "reference": match["reference"],
                "radius": level if level.endswith("radius") else None,
                "nominal": None if level.endswith("radius") else float(level) / 100,
                "horizon_s": None if match["horizon"] is None else float(match["horizon"]),
                "observed": round(metric["value"], 4),
                "interval": metric.get("interval_95") and [round(value, 4) for value in metric["interval_95"]],
                "n": metric["n"],
            }
        )
    return points


def warnings_of(
    manifest: Manifest, report: dict[str, Any] | None, driving: dict[str, dict[str, Any]]
) -> list[tuple[str, str]]:
    """Every warning, loss, counted repair and missed threshold of a run, with where it comes from, each once."""
    found: dict[tuple[str, str], None] = {}
    told: set[str] = set()

    def tell(where: str, text: str) -> None:
        if text not in told:
            told.add(text)
            found[(where, text)] = None

    for stage, record in manifest.stages.items():
        for text in record.warnings:
            tell(stage, text)
        for loss in record.losses:
            tell(stage, f"lost: {loss.what}" + ("" if loss.count is None else f" ({loss.count})"))
        for name, count in sorted(record.counters.items()):
            tell(stage, f"{name.replace('_', ' ')}: {count}")
    for where, document in {**({} if report is None else {"evaluate": report}), **driving}.items():
        for text in document.get("thresholds_missed", ()):
            tell(where, f"threshold missed: {text}")
        for text in document.get("warnings", ()):
            tell(where, str(text))
        for name, count in sorted(document.get("counters", {}).items()):
            if where in DRIVING:
                tell(where, f"{name.replace('_', ' ')}: {count}")
    return list(found)
