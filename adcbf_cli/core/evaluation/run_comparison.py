"""Two scored runs side by side: each metric's difference, with an interval where the evidence allows one.

Means, counts and scores are paired by blocks of one log, drives by their seeds. What is not paired, a quantile or HOTA
over the whole log, or a run on another log, has a difference and no interval, and it is said why.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from adcbf_cli.core.evaluation.blocks import MIN_BLOCKS, Blocks, paired_interval
from adcbf_cli.core.evaluation.comparison import Kind, Scores, difference
from adcbf_cli.core.evaluation.driving import BY_NAME
from adcbf_cli.core.evaluation.intervals import MIN_DRIVES
from adcbf_cli.core.evaluation.rare_rates import difference_interval
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.core.evaluation.scored_run import Driven, ScoredRun

Better = Literal["lower", "higher", "neither"]
Verdict = Literal["better", "worse", "no clear difference", "the same", "changed", "unknown"]

_LOWER = re.compile(
    r"(clustering|tracking)\.rmse_.*"
    r"|(prediction|later_seen(\.moving)?)\.(rmse_(?!still_).*|[af]de_m\..*)"
    r"|clear\.(false_positives.*|misses|switches|fragmentations|duplicates|motp_m)"
    r"|tracks\.(short_share|restart_share)"
)
_HIGHER = re.compile(r"detection\..*|clear\.mota.*|hota\..*")
_NEEDS_NO_TRUTH = ("later_seen.", "tracks.", "clusters.")
_NOTHING = Metric(None, "", 0, "", "")


@dataclass(frozen=True, slots=True)
class Change:
    """One metric in the base and in another run.

    difference: the other minus the base; of paired drives, the mean over the pairs. interval: 95 %, of the
    difference. pairs: how many `paired_by` things the interval rests on. no_interval: why there is none.
    """

    name: str
    unit: str
    better: Better
    base: float | None
    value: float | None
    n_base: int
    n: int
    difference: float | None
    interval: tuple[float, float] | None = None
    paired_by: str | None = None
    pairs: int | None = None
    no_interval: str | None = None

    @property
    def relative(self) -> float | None:
        """The difference over the base's size: 0.05 for 5 % more; infinite where the base is nothing."""
        if self.difference is None or self.base is None:
            return None
        if self.base == 0:
            return math.copysign(math.inf, self.difference) if self.difference else 0.0
        return self.difference / abs(self.base)

    @property
    def verdict(self) -> Verdict:
        """What the interval says; "unknown" without one, unless nothing differs at all."""
        if self.difference is None:
            return "unknown"
        if self.interval is None:
            return "the same" if self.difference == 0 and self.n == self.n_base else "unknown"
        low, high = self.interval
        if low <= 0 <= high:
            return "the same" if low == high == 0 else "no clear difference"
        if self.better == "neither":
            return "changed"
        return "better" if (low > 0) == (self.better == "higher") else "worse"

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        relative = self.relative
        return {
            "unit": self.unit,
            "better": self.better,
            "base": self.base,
            "value": self.value,
            "n_base": self.n_base,
            "n": self.n,
            "difference": self.difference,
            "relative": relative if relative is not None and math.isfinite(relative) else None,
            "interval_95": None if self.interval is None else list(self.interval),
            "paired_by": self.paired_by,
            "pairs": self.pairs,
            "no_interval": self.no_interval,
            "verdict": self.verdict,
        }


@dataclass(frozen=True, slots=True)
class RunComparison:
    """run: the other run's name. settings: by key, what the base had and what the other has, where they differ.
    remarks: what makes the two hard to compare."""

    run: str
    changes: Mapping[str, Change]
    settings: Mapping[str, tuple[Any, Any]]
    remarks: tuple[str, ...]


def compare_runs(
    base: ScoredRun, other: ScoredRun, base_blocks: Mapping[str, Blocks], other_blocks: Mapping[str, Blocks]
) -> RunComparison:
    """Every metric that either run has, the base's in their order first."""
    changes: dict[str, Change] = {}
    for name in dict.fromkeys((*base.metrics, *other.metrics)):
        a, b = base.metrics.get(name, _NOTHING), other.metrics.get(name, _NOTHING)
        if name.startswith(("plan.", "replay.")):
            changes[name] = _drives_changed(name, a, b, base, other)
        else:
            reason = _not_paired(name, base, other)
            changes[name] = _mean_changed(name, a, b, reason, (base_blocks, other_blocks), base.block_s or math.nan)
    return RunComparison(other.name, changes, _settings_changed(base, other), _remarks(base, other))


def better_direction(name: str) -> Better:
    """Which way an improvement of an evaluation's or a planner's metric goes."""
    driving = BY_NAME.get(name.rpartition(".")[2]) if name.startswith(("plan.", "replay.")) else None
    if driving is not None:
        return driving.better
    if _LOWER.fullmatch(name):
        return "lower"
    return "higher" if _HIGHER.fullmatch(name) else "neither"


def _change(name: str, a: Metric, b: Metric, **rest: Any) -> Change:
    plain = None if a.value is None or b.value is None else b.value - a.value
    given: dict[str, Any] = {"difference": plain} | rest
    return Change(name, a.unit or b.unit, better_direction(name), a.value, b.value, a.n, b.n, **given)


def _mean_changed(
    name: str,
    a: Metric,
    b: Metric,
    reason: str | None,
    blocks: tuple[Mapping[str, Blocks], Mapping[str, Blocks]],
    block_s: float,
) -> Change:
    if a.value is None or b.value is None:
        return _change(name, a, b, no_interval=f"not measured in {'the base' if a.value is None else 'this run'}")
    if reason is not None:
        return _change(name, a, b, no_interval=reason)
    mine, others = (of_run.get(name) for of_run in blocks)
    if mine is None or others is None:
        kept = all(blocks)
        why = "one number for the whole log" if kept else "a run was scored without score_blocks.parquet"
        return _change(name, a, b, no_interval=why)
    found = paired_interval(mine, others, name)
    if found is None:
        return _change(name, a, b, no_interval=f"fewer than {MIN_BLOCKS} blocks of {block_s:g} s")
    interval, pairs = found
    return _change(name, a, b, interval=interval, paired_by=f"blocks of {block_s:g} s", pairs=pairs)


def _drives_changed(name: str, a: Metric, b: Metric, base: ScoredRun, other: ScoredRun) -> Change:
    kind: Kind = "plan" if name.startswith("plan.") else "replay"
    planner, _, metric = name.partition(".")[2].rpartition(".")
    drives, others = base.driven.get(kind), other.driven.get(kind)
    here, there = (None if d is None else d.scores.get(planner) for d in (drives, others))
    if a.value is None or b.value is None or drives is None or others is None or here is None or there is None:
        return _change(name, a, b, no_interval=f"not measured in {'the base' if a.value is None else 'this run'}")
    if base.source_sha256 != other.source_sha256:
        return _change(name, a, b, no_interval="another log")
    alike = _alike(drives, others)
    if not alike:
        return _change(name, a, b, no_interval="another world, route or start: drives of a seed are no pairs")
    here, there = ({seed: row for seed, row in rows.items() if seed in alike} for rows in (here, there))
    declared = BY_NAME.get(metric)
    if declared is None or not _has(metric, here) or not _has(metric, there):
        return _change(name, a, b, no_interval="no scores by seed")
    found = difference(declared, there, here)
    interval = _rate_interval(metric, there, here) if declared.is_event else found.interval
    if interval is None:
        why = f"fewer than {MIN_DRIVES} seeds with a value in both"
        return _change(name, a, b, no_interval=why)
    return _change(name, a, b, difference=found.value, interval=interval, paired_by="seeds", pairs=found.n)


def _alike(base: Driven, other: Driven) -> set[int]:
    """The seeds whose drives are pairs: they start alike, in the same world."""
    if base.world != other.world:
        return set()
    return {seed for seed, start in base.starts.items() if seed in other.starts and start == other.starts[seed]}


def _has(metric: str, scores: Scores) -> bool:
    return all(metric in row for row in scores.values())


def _rate_interval(metric: str, mine: Scores, base: Scores) -> tuple[float, float] | None:
    """Of a difference of rates, where single drives have 0 or 1: over seeds in which both have one."""
    pairs = [(mine[seed][metric], base[seed][metric]) for seed in mine.keys() & base.keys()]
    known = [(a, b) for a, b in pairs if a is not None and b is not None]
    if len(known) < MIN_DRIVES:
        return None
    return difference_interval(sum(a > b for a, b in known), sum(b > a for a, b in known), len(known))


def _not_paired(name: str, base: ScoredRun, other: ScoredRun) -> str | None:
    """Why no metric of this kind can be paired between the two runs, if so."""
    if base.source_sha256 != other.source_sha256:
        return "another log"
    if base.truth != other.truth and not name.startswith(_NEEDS_NO_TRUTH):
        return "another ground truth"
    if base.block_s != other.block_s:
        return "another evaluation.bootstrap_block_s"
    return None


def _settings_changed(base: ScoredRun, other: ScoredRun) -> dict[str, tuple[Any, Any]]:
    """Of what both runs hold: a report that one lacks was not made with other settings."""
    changed: dict[str, tuple[Any, Any]] = {}
    for made in (made for made in base.settings if made in other.settings):
        mine, others = base.settings[made], other.settings[made]
        for key in dict.fromkeys((*mine, *others)):
            pair = (mine.get(key), others.get(key))
            if pair[0] != pair[1]:
                changed[key] = pair
    return changed


def _remarks(base: ScoredRun, other: ScoredRun) -> tuple[str, ...]:
    remarks = []
    if base.source_sha256 != other.source_sha256:
        remarks.append(
            f"another log: {base.source_name} and {other.source_name}; differences are not of the code alone"
        )
    elif base.truth != other.truth:
        remarks.append("another ground truth, or none in one of the two")
    if base.version != other.version:
        remarks.append(f"another version: {base.version} and {other.version}")
    if other.losses != base.losses:
        remarks.append("of one log another part was lost than of the other")
    return tuple(remarks)
