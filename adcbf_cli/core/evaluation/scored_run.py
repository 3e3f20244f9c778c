"""What is known of a run that was scored: its metrics, its drives' scores, and what they rest on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from adcbf_cli.core.evaluation.comparison import Kind, Scores
from adcbf_cli.core.evaluation.report import Metric


@dataclass(frozen=True, slots=True)
class Driven:
    """One kind of driving. scores: by planner. world: what says what was there and where drives lead, starts: by seed,
    where and when its drives begin; both JSON-able."""

    scores: Mapping[str, Scores]
    world: Any
    starts: Mapping[int, Any]


@dataclass(frozen=True, slots=True)
class ScoredRun:
    """name: tells it from others. version: of the code that made it. settings: by what was made with them (tables,
    a report), then by dotted key. block_s: how long the blocks are that intervals are drawn over; None without any.

    truth: says what the metrics against ground truth were held against, JSON-able; None without any.
    metrics: by flat name, of the evaluation and of the planners. driven: by kind.
    """

    name: str
    version: str
    source_name: str
    source_sha256: str
    truth: Any
    settings: Mapping[str, Mapping[str, Any]]
    block_s: float | None
    metrics: Mapping[str, Metric]
    driven: Mapping[Kind, Driven]
    warnings: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()
    thresholds_missed: tuple[str, ...] = ()
    scored: bool = field(default=False)
    """Whether there is any report at all."""
