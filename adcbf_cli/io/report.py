"""report.json and report.md: an evaluation, for programs and for people. No clock enters either."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.evaluation.report import Metric, Report
from adcbf_cli.io.atomic import check_target, write_text_atomically

JSON_NAME = "report.json"
MARKDOWN_NAME = "report.md"

PAGE = "report.html"
FIGURE_FOLDER = "figures"
FIGURES = ("top_view", "margins", "solve_times", "gamma_map", "calibration", "planners")
FIGURE_FILES = tuple(f"{FIGURE_FOLDER}/{name}.{kind}" for name in FIGURES for kind in ("png", "svg"))
"""What `adcbf report` leaves in a run folder; of several runs, each has a folder of its own in FIGURE_FOLDER."""

_SECTIONS = {
    "clustering": "Cluster centres against truth",
    "tracking": "Tracking against truth",
    "prediction": "Prediction against truth",
    "detection": "Detection",
    "clear": "CLEAR MOT",
    "hota": "HOTA",
    "later_seen": "Prediction against where the same track was later seen",
    "clusters": "Clusters",
    "tracks": "Tracks",
    "plan": "Planning, open loop",
    "replay": "Planning, closed loop (counterfactual)",
}
_DEFINED_ELSEWHERE = ("plan", "replay")
"""Each planner has the same metrics; their definitions are in the reports of these commands."""
_OBJECT_COLUMNS = (
    "object_id", "class", "frames_in_range", "frames_tracked", "tracks", "cluster_rmse_m", "track_rmse_m",
    "track_rmse_sight_corrected_m", "bias_along_m", "bias_across_m", "bias_body_x_m", "bias_body_y_m",
    "predictions", "last_step_error_m",
)  # fmt: skip


def check_page(target: Path, suffix: str) -> None:
    """UsageError where a page of this kind could not be written here, or is to be called something else: a slip of the
    hand must not put it in the place of a log or a manifest."""
    if target.suffix.lower() != suffix:
        raise UsageError(f"{target}: a page's name ends in {suffix}")
    check_target(target)


def figure_folder(page: Path, run: Path) -> Path:
    """Where the figures of a page lie: a run folder's own in FIGURE_FOLDER, any other's in a folder that is called like
    the page, which is nobody else's."""
    own = page.resolve() == (run / PAGE).resolve()
    return page.parent / (FIGURE_FOLDER if own else f"{page.stem}.{FIGURE_FOLDER}")


def remove_page(run: Path) -> None:
    """Removes the page and the figures that `adcbf report` left in a run folder."""
    (run / PAGE).unlink(missing_ok=True)
    figures = run / FIGURE_FOLDER
    if not figures.is_dir() or figures.is_symlink():
        return
    for folder in (*(path for path in figures.iterdir() if path.is_dir() and not path.is_symlink()), figures):
        for name in FIGURE_FILES:
            (folder / Path(name).name).unlink(missing_ok=True)
        if not any(folder.iterdir()):
            folder.rmdir()


def report_document(report: Report, provenance: dict[str, Any]) -> dict[str, Any]:
    """report.json's content: the report, and whatever the caller says of the run it scores."""
    document = report.to_dict()
    return {"schema_version": document.pop("schema_version"), **provenance, **document}


def write_report(folder: Path, document: dict[str, Any], report: Report) -> None:
    """Writes both files into the run folder, each whole or not at all. A page that shows another score is removed."""
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    stored = folder / JSON_NAME
    if not stored.is_file() or stored.read_bytes() != text.encode():
        remove_page(folder)
    write_text_atomically(stored, text)
    write_text_atomically(folder / MARKDOWN_NAME, markdown(document, report))


def number(value: float | None) -> str:
    """Four significant digits, a dash for what was not measured."""
    if value is None:
        return "-"
    return f"{value:.0f}" if value == round(value) and abs(value) < 1e9 else f"{value:.4g}"


def interval(metric: Metric) -> str:
    return "" if metric.interval is None else f"{number(metric.interval[0])} to {number(metric.interval[1])}"


def unit(metric: Metric) -> str:
    return "" if metric.unit == "1" else metric.unit


def markdown(document: dict[str, Any], report: Report) -> str:
    """The report as Markdown: what it rests on, one table a section, then the definitions."""
    lines = ["# Evaluation", "", *_basis(document, report), ""]
    for missed in document.get("thresholds_missed", ()):
        lines += [f"**Threshold missed**: {missed}", ""]
    for warning in document.get("warnings", ()):
        lines += [f"- Warning: {warning}"]
    for prefix, title in _SECTIONS.items():
        chosen = {n: m for n, m in report.metrics.items() if n.split(".")[0] == prefix}
        if chosen:
            lines += ["", f"## {title}", "", *_metric_table(chosen)]
    if report.objects:
        lines += ["", "## Objects", "", *_object_table(report.objects)]
    lines += ["", "## Definitions", ""]
    lines += [
        f"- `{name}` ({metric.sample}): {metric.definition}."
        for name, metric in report.metrics.items()
        if not name.startswith(_DEFINED_ELSEWHERE)
    ]
    return "\n".join(lines) + "\n"


def _basis(document: dict[str, Any], report: Report) -> list[str]:
    source, truth = document.get("source", {}), report.basis.get("truth")
    lines = [f"Log: {source.get('name', 'unknown')}, sha256 `{source.get('sha256', 'unknown')}`.", ""]
    if truth is None:
        lines.append("No ground truth: predictions are held against where the same track was later seen.")
        return lines
    span = truth["labelled_fov_deg"]
    view = "all around" if span is None else f"azimuths {span[0]:g} to {span[1]:g} degrees"
    lines.append(
        f"Ground truth: {truth['source']}, {truth['labels']} labels of {truth['objects']} objects; scored within "
        f"{report.basis['range_m']:g} m of the sensor; labelled: {view}; "
        + ("everything that moves is labelled." if truth["exhaustive"] else "one object only is labelled.")
    )
    return lines


def _metric_table(metrics: dict[str, Metric]) -> Iterable[str]:
    yield "| metric | value | 95 % interval | unit | n | of |"
    yield "| --- | ---: | --- | --- | ---: | --- |"
    for name, metric in metrics.items():
        yield _row(f"`{name}`", number(metric.value), interval(metric), unit(metric), metric.n, metric.sample)


def _object_table(objects: list[dict[str, Any]]) -> Iterable[str]:
    yield _row(*_OBJECT_COLUMNS)
    yield _row(*("---" for _ in _OBJECT_COLUMNS))
    for entry in objects:
        cells = (entry.get(name) for name in _OBJECT_COLUMNS)
        yield _row(*(number(c) if isinstance(c, float) or c is None else c for c in cells))


def _row(*cells: object) -> str:
    """One table row. Class names come from the user's file and may hold anything."""
    return f"| {' | '.join(' '.join(str(cell).split()).replace('|', chr(92) + '|') for cell in cells)} |"
