"""What is counted and averaged over many simulated runs: each rate and mean, declared once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from adcbf_cli.core.evaluation.driving import BY_NAME
from adcbf_cli.core.replay.records import Result

FREEZE_S = 5.0
"""Standing still for longer than this, in sum over a run, is freezing: whoever crosses at 0.5 m/s has left a
lane of 2.5 m in that time."""


@dataclass(frozen=True, slots=True)
class Run:
    """One finished run.

    avoidable: of a collision: True where a way around it was found from when the obstacle was known, False where
        none was, None where it was never known or nobody looked. way_exists: whether the scene can be driven
        through at all: True with a proof, False where a search found none, None where nobody looked.
    metrics: as `score_drive` gives them. scene: what made the scene, numbers by name.
    """

    planner: str
    seed: int
    result: Result
    avoidable: bool | None
    way_exists: bool | None
    metrics: Mapping[str, float | None]
    scene: Mapping[str, float]

    @staticmethod
    def from_row(row: Mapping[str, Any]) -> Run:
        """From a run's row: planner, seed, result, metrics; collision, escape_exists, scene where there are any."""
        collision = row.get("collision") or {}
        scene = {name: value for name, value in (row.get("scene") or {}).items() if value is not None}
        result = Result(row["result"])
        way_exists = True if result is Result.SUCCESS else row.get("escape_exists")
        return Run(row["planner"], row["seed"], result, collision.get("avoidable"), way_exists, row["metrics"], scene)


@dataclass(frozen=True, slots=True)
class RunMeasure:
    """One number of a run; None where it has none. title: for a column of a table."""

    name: str
    title: str
    unit: str
    better: Literal["lower", "higher", "neither"]
    definition: str
    measure: Callable[[Run], float | None]
    is_event: bool


def _avoidable(run: Run) -> float | None:
    if run.result is not Result.COLLISION:
        return 0.0
    return None if run.avoidable is None else float(run.avoidable)


def _collision_despite_a_way(run: Run) -> float | None:
    return float(run.result is Result.COLLISION) if run.way_exists else None


def _freeze(run: Run) -> float | None:
    frozen_s = run.metrics.get("freezing_s")
    return None if frozen_s is None else float(frozen_s > FREEZE_S)


def _fallback(run: Run) -> float | None:
    rates = [run.metrics.get(name) for name in ("braked_rate", "stopped_rate")]
    known = [rate for rate in rates if rate is not None]
    return float(any(rate > 0 for rate in known)) if known else None


def _event(
    name: str,
    title: str,
    better: Literal["lower", "higher"],
    definition: str,
    measure: Callable[[Run], float | None],
) -> RunMeasure:
    return RunMeasure(name, title, "1", better, definition, measure, is_event=True)


def _ended(result: Result) -> RunMeasure:
    declared = BY_NAME[result.value]
    better: Literal["lower", "higher"] = "higher" if declared.better == "higher" else "lower"
    return _event(result.value, result.value, better, declared.definition, lambda run: float(run.result is result))


def _mean(name: str, title: str) -> RunMeasure:
    declared = BY_NAME[name]
    definition = f"{declared.definition} ({declared.window})"
    return RunMeasure(
        name, title, declared.unit, declared.better, definition, lambda run: run.metrics.get(name), is_event=False
    )


RATES: tuple[RunMeasure, ...] = (
    _ended(Result.SUCCESS),
    _ended(Result.COLLISION),
    _event(
        "avoidable_collision",
        "avoidable collision",
        "lower",
        "1 where the run ended in a collision that a way around was found for, from the moment at which the planner "
        "knew of the obstacle; null where it never knew of it",
        _avoidable,
    ),
    _event(
        "collision_despite_way",
        "collision despite a way",
        "lower",
        "1 where the run ended in a collision; only scenes that can be driven through, because a planner did or a "
        "search with full knowledge found how",
        _collision_despite_a_way,
    ),
    _ended(Result.TIMEOUT),
    _event(
        "freeze",
        "freeze",
        "lower",
        f"1 where the vehicle stood still for more than {FREEZE_S:g} s in sum (`freezing_s`)",
        _freeze,
    ),
    _event(
        "fallback",
        "fallback",
        "lower",
        "1 where at least one planning step had no usable plan, and braked or stood still",
        _fallback,
    ),
)

MEANS: tuple[RunMeasure, ...] = (
    _mean("nav_time_s", "nav time s"),
    _mean("min_dist_m", "min dist m"),
    _mean("ref_time_s", "ref time s"),
    _mean("vel_var", "vel var m2/s2"),
    _mean("path_length_m", "path m"),
    _mean("relaxed_rate", "relaxed steps"),
    _mean("braked_rate", "braked steps"),
    _mean("stopped_rate", "stopped steps"),
)

MEASURES: tuple[RunMeasure, ...] = RATES + MEANS
