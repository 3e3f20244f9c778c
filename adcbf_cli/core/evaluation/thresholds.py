"""Limits that a user sets on metrics: `prediction.rmse_x_m>0.1` means "fail if it is above 0.1"."""

from __future__ import annotations

import difflib
import math
import operator
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.evaluation.report import Report

_FORM = re.compile(r"^\s*([A-Za-z][\w.\- ]*?)\s*(<=|>=|<|>)\s*(\S+)\s*$")
COMPARE: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}
OPEN_ENDED = ("detection.recall.", "detection.track_recall.")
"""Prefixes of metrics that exist once for each labelled class."""


@dataclass(frozen=True, slots=True)
class Threshold:
    """Fail if the metric stands in this relation to the limit."""

    metric: str
    relation: str
    limit: float

    def __str__(self) -> str:
        return f"{self.metric}{self.relation}{self.limit:g}"


def parse_threshold(text: str) -> Threshold:
    """`metric(<|>|<=|>=)number`; UsageError otherwise."""
    match = _FORM.match(text)
    try:
        if match is None:
            raise ValueError
        limit = float(match[3])
        if not math.isfinite(limit):
            raise ValueError
    except ValueError:
        raise UsageError(
            f"--fail-on {text!r}: expected metric, one of < > <= >=, and a number, such as 'detection.recall<0.9'"
        ) from None
    return Threshold(match[1], match[2], limit)


def check_names(thresholds: Iterable[Threshold], names: Iterable[str]) -> None:
    """UsageError, naming the nearest metric, if a threshold is on one that cannot come out."""
    known = list(names)
    for threshold in thresholds:
        if threshold.metric in known or threshold.metric.startswith(OPEN_ENDED):
            continue
        close = difflib.get_close_matches(threshold.metric, known, n=1, cutoff=0.7)
        hint = f"; did you mean {close[0]}?" if close else "; docs/metrics.md lists them"
        raise UsageError(f"--fail-on: unknown metric {threshold.metric}{hint}")


def missed(thresholds: Iterable[Threshold], report: Report) -> list[str]:
    """One line for each threshold that was missed. A metric without a value misses: what was not
    measured cannot have passed."""
    lines = []
    for threshold in thresholds:
        metric = report.metrics.get(threshold.metric)
        if metric is None or metric.value is None:
            lines.append(f"{threshold}: not measured, so it cannot pass ({_why(threshold, report)})")
        elif COMPARE[threshold.relation](metric.value, threshold.limit):
            lines.append(f"{threshold}: it is {metric.value:.6g} {metric.unit if metric.unit != '1' else ''}".rstrip())
    return lines


def _why(threshold: Threshold, report: Report) -> str:
    if threshold.metric.startswith(("plan.", "replay.")):
        return "no drive has a value" if threshold.metric in report.metrics else "there is no such drive"
    if report.basis.get("truth") is None and not threshold.metric.startswith(("later_seen", "tracks", "clusters")):
        return "no ground truth was given"
    if threshold.metric not in report.metrics:
        return "no object of this class was in range"
    return "no samples" if not report.metrics[threshold.metric].n else "null by its definition"
