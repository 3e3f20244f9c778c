"""A run folder's reports, read back: report.json, and those of `plan` and `replay` beside their tables.

What the drives score is taken from their own reports: report.json may have been written before they were.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.evaluation.comparison import Kind
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.core.evaluation.scored_run import Driven, ScoredRun
from adcbf_cli.io.log_base import printable
from adcbf_cli.io.parquet import table_metadata
from adcbf_cli.io.report import JSON_NAME
from adcbf_cli.io.run_folder import DRIVING, Manifest, RunFolder
from adcbf_cli.io.run_settings import settings_made_with

REPORTS = (JSON_NAME, *(f"{place}/{JSON_NAME}" for place in DRIVING.values()))
"""Where a run folder keeps its scores."""


def read_scored_run(path: Path, name: str) -> ScoredRun:
    """What the folder says of itself and of its scores. AdcbfError where it is no run folder or a report is damaged."""
    folder = RunFolder(path)
    manifest = folder.manifest()
    report = _document(path / JSON_NAME, "evaluate")
    metrics: dict[str, Metric] = {}
    truth: Any = None
    block_s: float | None = None
    settings = settings_made_with(manifest.config, None, {})
    if report is not None:
        with _unreadable(path / JSON_NAME, "evaluate"):
            found = {n: m for n, m in report["metrics"].items() if n.partition(".")[0] not in DRIVING}
            metrics = {printable(n): _metric(m) for n, m in found.items()}
            truth = _truth(report)
            block_s = _number(report["basis"]["config"]["bootstrap_block_s"])
            settings |= settings_made_with(manifest.config, report, {})
    driven: dict[Kind, Driven] = {}
    found_driving = {kind: _document(path / place / JSON_NAME, kind) for kind, place in DRIVING.items()}
    driving = {kind: document for kind, document in found_driving.items() if document is not None}
    for kind, document in driving.items():
        with _unreadable(path / DRIVING[kind] / JSON_NAME, kind):
            metrics |= _driving_metrics(kind, document["comparison"])
            driven[cast(Kind, kind)] = _driven(document)
            settings |= settings_made_with(manifest.config, None, {kind: document})
    documents = [*([] if report is None else [report]), *driving.values()]
    return ScoredRun(
        name=name,
        version=printable(str((table_metadata(folder.table("frames")) or {}).get("adcbf", "unknown"))),
        source_name=manifest.source.name,
        source_sha256=manifest.source.sha256,
        truth=truth,
        settings=settings,
        block_s=block_s,
        metrics=metrics,
        driven=driven,
        warnings=_all_texts([r.warnings for r in manifest.stages.values()], documents, "warnings"),
        losses=_losses(manifest),
        thresholds_missed=_all_texts([], documents, "thresholds_missed"),
        scored=bool(documents),
    )


def _document(path: Path, remake: str) -> dict[str, Any] | None:
    """A report, None where there is none; AdcbfError where it is not one. remake: the command that writes it."""
    with _unreadable(path, remake):
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        found = json.loads(text, parse_constant=_refuse, parse_float=_finite)
        if not isinstance(found, dict):
            raise TypeError("no mapping")
        return found


def _refuse(word: str) -> float:
    raise ValueError(f"{word} is not a number")


def _finite(digits: str) -> float:
    """What is too large for a float would be infinite, which no report holds."""
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits:.20} is too large")
    return value


@contextmanager
def _unreadable(path: Path, remake: str) -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError) as error:
        reason = printable((str(error) or type(error).__name__).splitlines()[0])[:120]
        raise AdcbfError(f"{path}: unreadable ({reason}); make it anew with `adcbf {remake}`") from None


def _metric(document: Mapping[str, Any]) -> Metric:
    return Metric(
        value=_number(document["value"]),
        unit=printable(str(document["unit"])),
        n=int(document["n"]),
        sample=printable(str(document["sample"])),
        definition=printable(str(document["definition"])),
        interval=_pair(document.get("interval_95")),
        bounds=_pair(document.get("bounds_95")),
    )


def _number(value: Any) -> float | None:
    if value is not None and not isinstance(value, int | float):
        raise TypeError(f"{value!r:.40} is not a number")
    return None if value is None else float(value)


def _pair(values: Any) -> tuple[float, float] | None:
    if values is None:
        return None
    low, high = (_number(value) for value in values)
    return None if low is None or high is None else (low, high)


def _truth(report: Mapping[str, Any]) -> Any:
    """The truth file's hash; of a truth out of the log, which topic it is."""
    truth = report["basis"]["truth"]
    if truth is None:
        return None
    return report["truth_sha256"] or f"{truth['source']} of the log"


def _driving_metrics(kind: str, comparison: Mapping[str, Any]) -> dict[str, Metric]:
    declared = comparison["metrics"]
    return {
        f"{kind}.{printable(planner)}.{name}": Metric(
            value=_number(found["value"]),
            unit=printable(str(declared[name]["unit"])),
            n=int(found["n"]),
            sample="drive",
            definition=printable(str(declared[name]["definition"])),
            interval=_pair(found["interval_95"]),
        )
        for planner, score in comparison["planners"].items()
        for name, found in score["metrics"].items()
    }


def _driven(document: Mapping[str, Any]) -> Driven:
    """Reports of older versions do not say where drives start: none of theirs are pairs."""
    world = {"sha256": document.get("world_sha256"), "route": document["route"]}
    starts = {int(seed): start for seed, start in document.get("starts", {}).items()}
    scores = {
        printable(planner): {
            int(seed): {str(name): _number(value) for name, value in row.items()}
            for seed, row in score["seeds"].items()
        }
        for planner, score in document["comparison"]["planners"].items()
    }
    return Driven(scores, world, starts)


def _all_texts(first: list[list[str]], documents: list[dict[str, Any]], key: str) -> tuple[str, ...]:
    """The texts of all lists, each once."""
    lists = [*first, *(document.get(key) or [] for document in documents)]
    return tuple(dict.fromkeys(printable(str(text)) for texts in lists for text in texts))


def _losses(manifest: Manifest) -> tuple[str, ...]:
    found = [loss for record in manifest.stages.values() for loss in record.losses]
    texts = (loss.what if loss.count is None else f"{loss.what} ({loss.count})" for loss in found)
    return tuple(dict.fromkeys(printable(text) for text in texts))
