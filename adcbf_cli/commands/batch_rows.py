"""A log's row in a batch's summary, and what of its run folder goes into it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adcbf_cli.core.errors import EXIT_DATA_LOST, EXIT_OK, EXIT_THRESHOLD

if TYPE_CHECKING:
    from adcbf_cli.core.evaluation.report import Metric

STATUS = {EXIT_OK: "done", EXIT_DATA_LOST: "damaged", EXIT_THRESHOLD: "missed"}
FAILED = "failed"

Row = dict[str, Any]


@dataclass(frozen=True)
class Results:
    """columns: of the summary. headlines: the names of those metrics that a screen shows."""

    columns: Row
    metrics: dict[str, Metric]
    headlines: set[str]


def plain_row(path: str, command: str, status: str, code: int) -> Row:
    """The columns that every log has; the others are empty."""
    nothing: Row = dict.fromkeys(("error", "source_sha256", "run_folder", "frames", "span_s"))
    empty: Row = {name: [] for name in ("warnings", "losses", "thresholds_missed")}
    return {"path": storable(path), "command": storable(command), "status": status, "exit_code": code} | nothing | empty


def storable(text: str) -> str:
    """For a table, whose texts are UTF-8: bytes of a file name that are not, are spelled out."""
    return text.encode(errors="backslashreplace").decode()


def read_results(folder: Path, command: str) -> Results:
    """What `command` left in the run folder. What other commands left there is not of this batch.

    AdcbfError where it is no run folder, or a report in it is damaged.
    """
    from adcbf_cli.core.evaluation.headlines import is_driving_headline, is_headline
    from adcbf_cli.io.run_folder import STAGES, RunFolder
    from adcbf_cli.io.run_scores import read_scored_run

    run = read_scored_run(folder, folder.name)
    recorded = RunFolder(folder).manifest().stages
    needed = STAGES[: STAGES.index(command) + 1] if command in STAGES else STAGES
    report = _report(folder, command)
    metrics = {name: metric for name, metric in run.metrics.items() if report is not None and _is_of(name, command)}
    warnings = [warning for stage in needed for warning in recorded[stage].warnings]
    losses = [loss for stage in needed for loss in recorded[stage].losses]
    frames, span_s = _extent(folder)
    columns = {
        "source_sha256": run.source_sha256,
        "frames": frames,
        "span_s": span_s,
        "warnings": _each_once([*warnings, *_texts(report, "warnings")]),
        "losses": _each_once(loss.what if loss.count is None else f"{loss.what} ({loss.count})" for loss in losses),
        "thresholds_missed": _each_once(_texts(report, "thresholds_missed")),
    }
    with_truth = run.truth is not None
    headlines = {name for name in metrics if is_headline(name, with_truth) or is_driving_headline(name)}
    return Results(columns, metrics, headlines)


def _report(folder: Path, command: str) -> Any:
    """The report that the command wrote, None where it writes none. `read_scored_run` has found it readable."""
    from adcbf_cli.io.report import JSON_NAME
    from adcbf_cli.io.run_folder import DRIVING

    places = {"run": ".", "evaluate": ".", **DRIVING}
    if command not in places:
        return None
    return json.loads((folder / places[command] / JSON_NAME).read_text(encoding="utf-8"))


def _is_of(metric: str, command: str) -> bool:
    """Whether a command gives this metric: those of drives are named `plan.*` and `replay.*`, after their command."""
    from adcbf_cli.io.run_folder import DRIVING

    first = metric.partition(".")[0]
    return first == command if command in DRIVING else first not in DRIVING


def _texts(report: Any, key: str) -> list[str]:
    return [] if report is None else [str(text) for text in report.get(key) or ()]


def _each_once(texts: Iterable[str]) -> list[str]:
    from adcbf_cli.io.log_base import printable

    return list(dict.fromkeys(map(printable, texts)))


def _extent(folder: Path) -> tuple[int, float | None]:
    """How many frames the run has, and the seconds from the first to the last."""
    from adcbf_cli.io.parquet import read_table
    from adcbf_cli.io.run_folder import RunFolder

    stamps = read_table(RunFolder(folder).table("frames"), ["timestamp_ns"])["timestamp_ns"].to_numpy()
    return len(stamps), float(stamps[-1] - stamps[0]) / 1e9 if len(stamps) else None
