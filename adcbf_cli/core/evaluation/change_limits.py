"""Limits on how a metric may change against the base: `prediction.rmse_x_m>+5%` fails if it rises by more than 5 %.

The grammar is that of `--fail-on` elsewhere (`thresholds`), with a signed number: a change. Without `%` it is in the
metric's own unit.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.evaluation.run_comparison import Change
from adcbf_cli.core.evaluation.thresholds import COMPARE, Threshold, parse_threshold

_CHANGE = re.compile(r"^(?P<plain>.*[<>]=?\s*[+-][^%]*?)\s*(?P<percent>%?)\s*$", re.DOTALL)
_EXAMPLE = (
    "a metric, one of < > <= >=, and a change with its sign, such as 'prediction.rmse_x_m>+5%' or 'clear.mota<-0.01'"
)


@dataclass(frozen=True, slots=True)
class ChangeLimit:
    """Fail if the metric's change stands in this relation to the limit; a relative limit is in percent of the base."""

    threshold: Threshold
    relative: bool

    @property
    def metric(self) -> str:
        return self.threshold.metric

    def __str__(self) -> str:
        limit = f"{self.threshold.limit:+g}" + "%" * self.relative
        return f"{self.metric}{self.threshold.relation}{limit}"


def parse_change_limit(text: str) -> ChangeLimit:
    """`metric(<|>|<=|>=)(+|-)number[%]`; UsageError otherwise."""
    match = _CHANGE.match(text)
    try:
        if match is None:
            raise UsageError(text)
        return ChangeLimit(parse_threshold(match["plain"]), bool(match["percent"]))
    except UsageError:
        raise UsageError(f"--fail-on {text!r}: expected {_EXAMPLE}") from None


def exceeded(limits: Iterable[ChangeLimit], changes: Mapping[str, Change]) -> list[str]:
    """One line for each limit that a run goes beyond. A change that is not known does: what was not measured cannot
    have passed."""
    lines = []
    for limit in limits:
        change = changes.get(limit.metric)
        if change is None or change.difference is None or change.relative is None:
            lines.append(f"{limit}: not measured in both runs, so it cannot pass")
            continue
        size = 100 * change.relative if limit.relative else change.difference
        if COMPARE[limit.threshold.relation](size, limit.threshold.limit):
            lines.append(f"{limit}: {_told(change)}")
    return lines


def _told(change: Change) -> str:
    unit = f" {change.unit}" if change.unit not in ("", "1") else ""
    share = "" if not change.base or change.relative is None else f", {100 * change.relative:+.3g}%"
    return f"from {change.base:.6g} to {change.value:.6g}{unit} ({change.difference:+.3g}{share})"
