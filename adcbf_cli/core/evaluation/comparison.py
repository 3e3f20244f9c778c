"""Planners side by side: each metric over a planner's drives, and paired differences between planners.

Drives are paired by seed, which places and starts the vehicle alike for every planner. A drive that
has no value in a metric (a failed one has no navigation time) is counted beside the mean, never left
out in silence: means over what is left favour planners that fail on the hard seeds.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from adcbf_cli.core.config import PlanningConfig, ReplayConfig
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.evaluation.driving import BY_NAME, applicable, score_drive
from adcbf_cli.core.evaluation.driving_evidence import DriveMetric
from adcbf_cli.core.evaluation.intervals import bootstrap_mean, wilson
from adcbf_cli.core.evaluation.report import Metric, Report
from adcbf_cli.core.replay.records import LOGGED, Drive

Kind = Literal["replay", "plan"]
Scores = Mapping[int, Mapping[str, float | None]]
"""By seed, then by metric."""


class Measured(Protocol):
    """What a mean needs to know of its metric."""

    @property
    def name(self) -> str: ...

    @property
    def is_event(self) -> bool:
        """Whether it is 0 or 1 a drive, so that its mean is a rate."""


@dataclass(frozen=True, slots=True)
class Aggregate:
    """value: mean over the n drives that have one; n_missing: the drives that have none."""

    value: float | None
    n: int
    n_missing: int
    interval: tuple[float, float] | None

    def to_dict(self) -> dict[str, Any]:
        return {"value": self.value, "n": self.n, "n_missing": self.n_missing, "interval_95": _pair(self.interval)}


@dataclass(frozen=True, slots=True)
class Difference:
    """value: mean of (this planner - the other) over the n seeds in which both have a value.

    n_dropped: seeds in which only one of the two has a value, or was driven at all. n_neither: seeds
    in which neither has.
    """

    value: float | None
    n: int
    n_dropped: int
    n_neither: int
    interval: tuple[float, float] | None

    def to_dict(self) -> dict[str, Any]:
        return {
            "value": self.value,
            "n_pairs": self.n,
            "n_dropped": self.n_dropped,
            "n_neither": self.n_neither,
            "interval_95": _pair(self.interval),
        }


@dataclass(frozen=True, slots=True)
class PlannerScore:
    """One planner's drives. scores: each drive's. differences: to the planner compared against, empty
    for that one itself."""

    planner: str
    scores: Scores
    aggregates: dict[str, Aggregate]
    differences: dict[str, Difference]


@dataclass(frozen=True, slots=True)
class Comparison:
    """kind: "replay" is closed loop, "plan" open loop. planners: in the order in which they came."""

    kind: Kind
    against: str | None
    planners: dict[str, PlannerScore]

    def metrics(self) -> dict[str, Metric]:
        """By flat name: `replay.<planner>.<metric>` or `plan.<planner>.<metric>`."""
        return {
            f"{self.kind}.{score.planner}.{name}": Metric(
                total.value, BY_NAME[name].unit, total.n, "drive", _definition(BY_NAME[name]), total.interval
            )
            for score in self.planners.values()
            for name, total in score.aggregates.items()
        }

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        used = [name for name in BY_NAME if any(name in score.aggregates for score in self.planners.values())]
        return {
            "kind": self.kind,
            "against": self.against,
            "metrics": {name: _declaration(BY_NAME[name]) for name in used},
            "planners": {name: _planner_document(score) for name, score in self.planners.items()},
        }


def compare(
    drives: Iterable[Drive], replay: ReplayConfig, planning: PlanningConfig, against: str | None = None
) -> Comparison:
    """Scores all drives of one replay, or one open loop, with the log's own driver among them or not.

    against: the planner that the others are held against, seed by seed; UsageError if it is not there.
    ValueError where a planner and seed come twice, or closed and open loop are mixed.
    """
    scores: dict[str, dict[int, Mapping[str, float | None]]] = {}
    kinds: set[Kind] = set()
    for drive in drives:
        of_planner = scores.setdefault(drive.planner, {})
        if drive.seed in of_planner:
            raise ValueError(f"two drives of {drive.planner} with seed {drive.seed}")
        of_planner[drive.seed] = score_drive(drive, replay, planning)
        if drive.planner != LOGGED:
            kinds.add("plan" if drive.result is None else "replay")
    if len(kinds) > 1:
        raise ValueError("closed and open loop in one comparison")
    return compare_scores(scores, kinds.pop() if kinds else "replay", against)


def compare_scores(scores: Mapping[str, Scores], kind: Kind, against: str | None = None) -> Comparison:
    """The same from scores as `score_drive` gives them, by planner and seed."""
    check_against(against, scores)
    return Comparison(kind, against, {name: _score(kind, name, scores, against) for name in scores})


def check_against(against: str | None, planners: Iterable[str]) -> None:
    """UsageError where the planner to compare against is none of these."""
    if against is not None and against not in (names := list(planners)):
        raise UsageError(f"nothing to compare against: {_unknown(against, names)}")


def add_to_report(comparison: Comparison, report: Report) -> None:
    """Adds the comparison's metrics, and what they rest on, to an evaluation's report."""
    report.metrics |= comparison.metrics()
    report.basis[comparison.kind] = {
        "against": comparison.against,
        "drives": {name: len(score.scores) for name, score in comparison.planners.items()},
    }


def metric_names(kind: Kind, planners: Iterable[str]) -> list[str]:
    """The flat names that come out for these planners, whatever happens on the way."""
    return [f"{kind}.{planner}.{metric.name}" for planner in planners for metric in applicable(kind, planner)]


def _score(kind: Kind, planner: str, scores: Mapping[str, Scores], against: str | None) -> PlannerScore:
    mine = dict(sorted(scores[planner].items()))
    metrics = _metrics_of(kind, planner, mine)
    differences: dict[str, Difference] = {}
    if against is not None and against != planner:
        shared = {metric.name for metric in _metrics_of(kind, against, scores[against])}
        differences = {m.name: difference(m, mine, scores[against]) for m in metrics if m.name in shared}
    return PlannerScore(planner, mine, {m.name: aggregate(m, mine) for m in metrics}, differences)


def _metrics_of(kind: Kind, planner: str, scores: Scores) -> list[DriveMetric]:
    """Those that this planner has in this kind of driving and that were kept: wall times may not have been."""
    return [m for m in applicable(kind, planner) if all(m.name in row for row in scores.values())]


def aggregate(metric: Measured, scores: Scores) -> Aggregate:
    """The mean over drives with its interval: Wilson's for events, the bootstrap's otherwise."""
    found = [value for _, row in sorted(scores.items()) if (value := row[metric.name]) is not None]
    interval = wilson(round(sum(found)), len(found)) if metric.is_event else bootstrap_mean(found, metric.name)
    return Aggregate(_mean(found), len(found), len(scores) - len(found), interval)


def difference(metric: Measured, mine: Scores, other: Scores) -> Difference:
    """The mean of paired differences, mine - other, over seeds."""
    pairs, dropped, neither = [], 0, 0
    for seed in sorted(mine.keys() | other.keys()):
        a, b = (scores[seed][metric.name] if seed in scores else None for scores in (mine, other))
        if a is not None and b is not None:
            pairs.append(a - b)
        elif a is None and b is None:
            neither += 1
        else:
            dropped += 1
    return Difference(_mean(pairs), len(pairs), dropped, neither, bootstrap_mean(pairs, metric.name))


def _mean(values: list[float]) -> float | None:
    return math.fsum(values) / len(values) if values else None


def _pair(interval: tuple[float, float] | None) -> list[float] | None:
    return None if interval is None else list(interval)


def _definition(metric: DriveMetric) -> str:
    return f"{'rate' if metric.is_event else 'mean'} over drives of: {metric.definition} (window: {metric.window})"


def _declaration(metric: DriveMetric) -> dict[str, str]:
    return {
        "unit": metric.unit,
        "better": metric.better,
        "window": metric.window,
        "definition": metric.definition,
        "interval": "Wilson" if metric.is_event else "bootstrap over drives",
    }


def _planner_document(score: PlannerScore) -> dict[str, Any]:
    return {
        "drives": len(score.scores),
        "metrics": {name: total.to_dict() for name, total in score.aggregates.items()},
        "differences": {name: found.to_dict() for name, found in score.differences.items()},
        "seeds": {str(seed): dict(row) for seed, row in score.scores.items()},
    }


def _unknown(name: str, names: list[str]) -> str:
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    there = ", ".join(names) or "no planner at all"
    return f"planner {name} has no drive here, but {there}" + (f"; did you mean {close[0]}?" if close else "")
