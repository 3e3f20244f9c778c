"""Metrics of one drive: the paper's five, and what they leave out.

Every metric is declared once, in the tables that `METRICS` gathers; docs/driving-metrics.md repeats
the declarations and a test holds it to them.
"""

from __future__ import annotations

from adcbf_cli.core.config import PlanningConfig, ReplayConfig
from adcbf_cli.core.evaluation.driving_evidence import Applies, DriveMetric, Evidence
from adcbf_cli.core.evaluation.driving_motion import MOTION
from adcbf_cli.core.evaluation.driving_planning import PLANNING
from adcbf_cli.core.evaluation.driving_reaction import REACTION
from adcbf_cli.core.replay.records import LOGGED, Drive

METRICS: tuple[DriveMetric, ...] = MOTION + REACTION + PLANNING
BY_NAME = {metric.name: metric for metric in METRICS}

_OF_PLANNERS = {
    "replay": (Applies.DRIVEN, Applies.CLOSED, Applies.PLANNED),
    "plan": (Applies.PLANNED, Applies.OPEN),
}


def applicable(kind: str, planner: str) -> tuple[DriveMetric, ...]:
    """The metrics that drives of `planner` have in a "replay" (closed loop) or a "plan" (open loop)."""
    wanted = (Applies.DRIVEN,) if planner == LOGGED else _OF_PLANNERS[kind]
    return tuple(metric for metric in METRICS if metric.applies in wanted)


def score_drive(drive: Drive, replay: ReplayConfig, planning: PlanningConfig) -> dict[str, float | None]:
    """All metrics of a drive by name; None where it holds no evidence, or the metric is none of its kind."""
    evidence = Evidence(drive, replay, planning)
    return {m.name: m.measure(evidence) if evidence.applies(m.applies) else None for m in METRICS}
