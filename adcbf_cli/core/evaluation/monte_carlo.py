"""Many random scenes, several planners: rates with intervals, means, paired differences, and what makes it hard.

From one row a run. A run that failed for a reason of the program's is in no rate; it is counted and named.
Scenes are paired by seed: the same seed is the same scene for every planner.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from adcbf_cli.core.evaluation import monte_carlo_text
from adcbf_cli.core.evaluation.comparison import Aggregate, Difference, Scores, aggregate, check_against, difference
from adcbf_cli.core.evaluation.rare_rates import difference_interval
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.core.evaluation.run_measures import MEASURES, Run, RunMeasure
from adcbf_cli.core.replay.records import Result

COLLISION = next(measure for measure in MEASURES if measure.name == Result.COLLISION.value)


@dataclass(frozen=True, slots=True)
class PlannerRuns:
    """One planner's finished runs. aggregates, differences: by measure; differences are to the planner compared
    against, empty for that one itself. collisions: seeds, by whether they were avoidable."""

    planner: str
    runs: int
    aggregates: dict[str, Aggregate]
    differences: dict[str, Difference]
    collisions: dict[bool | None, list[int]]


@dataclass(frozen=True, slots=True)
class Third:
    """A third of the scenes by one feature, from `low` to `high`. collision: each planner's rate in it."""

    feature: str
    low: float
    high: float
    scenes: int
    collision: dict[str, Aggregate]


@dataclass(frozen=True, slots=True)
class MonteCarlo:
    """planners: in the order in which they came. thirds: by feature and rising value. failed: what is known of the
    runs that failed: run, planner, seed, error. ways: scenes by whether they can be driven through."""

    against: str | None
    planners: dict[str, PlannerRuns]
    thirds: list[Third]
    failed: list[dict[str, Any]]
    ways: dict[bool | None, int]

    def metrics(self) -> dict[str, Metric]:
        """By flat name: `simulate.<planner>.<measure>`."""
        return {
            _flat(name, measure): Metric(
                (found := runs.aggregates[measure.name]).value,
                measure.unit,
                found.n,
                "run",
                f"{'rate' if measure.is_event else 'mean'} over runs of: {measure.definition}",
                found.interval,
            )
            for name, runs in self.planners.items()
            for measure in MEASURES
        }

    def headline(self) -> tuple[list[str], list[list[str]]]:
        """(columns, one row a planner) for a terminal."""
        return monte_carlo_text.headline(self)

    def markdown(self) -> str:
        """All of it, with the definitions."""
        return monte_carlo_text.markdown(self)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "against": self.against,
            "measures": {measure.name: _declaration(measure) for measure in MEASURES},
            "scenes": {_TOLD[way]: count for way, count in self.ways.items()},
            "failed": self.failed,
            "planners": {name: _planner_document(runs) for name, runs in self.planners.items()},
            "thirds": [_third_document(third) for third in self.thirds],
        }


def study(rows: Iterable[Mapping[str, Any]], against: str | None = None) -> MonteCarlo:
    """All rows of one campaign: of finished runs (`Run.from_row`), and of failed ones, which have an `error`.

    against: the planner that the others are held against, scene by scene; UsageError if it has no finished run.
    ValueError where a planner and seed come twice.
    """
    failed: list[dict[str, Any]] = []
    runs: dict[str, dict[int, Run]] = {}
    for row in rows:
        if "error" in row:
            failed.append({name: row[name] for name in ("run", "planner", "seed", "error") if name in row})
            continue
        run = Run.from_row(row)
        of_planner = runs.setdefault(run.planner, {})
        if run.seed in of_planner:
            raise ValueError(f"two runs of {run.planner} with seed {run.seed}")
        of_planner[run.seed] = run
    check_against(against, runs)
    ways = _ways(runs)
    scores = {name: _scores(of_planner, ways) for name, of_planner in runs.items()}
    planners = {name: _planner(name, of_planner, scores, against) for name, of_planner in runs.items()}
    counted = {way: sum(found is way for found in ways.values()) for way in (True, False, None)}
    return MonteCarlo(against, planners, _thirds(runs, scores), failed, counted)


def metric_names(planners: Iterable[str]) -> list[str]:
    """The flat names that come out for these planners, whatever happens on the way."""
    return [_flat(planner, measure) for planner in planners for measure in MEASURES]


def _ways(runs: Mapping[str, Mapping[int, Run]]) -> dict[int, bool | None]:
    """By seed, whether a way through the scene exists: one planner's proof holds for all of them."""
    ways: dict[int, bool | None] = {}
    for of_planner in runs.values():
        for seed, run in of_planner.items():
            told = (ways.get(seed), run.way_exists)
            ways[seed] = True if True in told else False if False in told else None
    return dict(sorted(ways.items()))


def _scores(runs: Mapping[int, Run], ways: Mapping[int, bool | None]) -> dict[int, dict[str, float | None]]:
    scores = {}
    for seed, run in sorted(runs.items()):
        known = Run(run.planner, seed, run.result, run.avoidable, ways[seed], run.metrics, run.scene)
        scores[seed] = {measure.name: measure.measure(known) for measure in MEASURES}
    return scores


def _planner(name: str, runs: Mapping[int, Run], scores: Mapping[str, Scores], against: str | None) -> PlannerRuns:
    mine = scores[name]
    differences: dict[str, Difference] = {}
    if against is not None and against != name:
        differences = {measure.name: _difference(measure, mine, scores[against]) for measure in MEASURES}
    collided = [run for _, run in sorted(runs.items()) if run.result is Result.COLLISION]
    collisions = {judged: [run.seed for run in collided if run.avoidable is judged] for judged in (True, False, None)}
    return PlannerRuns(name, len(runs), {m.name: aggregate(m, mine) for m in MEASURES}, differences, collisions)


def _difference(measure: RunMeasure, mine: Scores, other: Scores) -> Difference:
    """As for drives, but for rates with an interval that rare events do not make vanish."""
    found = difference(measure, mine, other)
    if not measure.is_event:
        return found
    pairs = [(mine[seed][measure.name], other[seed][measure.name]) for seed in mine.keys() & other.keys()]
    interval = difference_interval(pairs.count((1.0, 0.0)), pairs.count((0.0, 1.0)), found.n)
    return Difference(found.value, found.n, found.n_dropped, found.n_neither, interval)


def _thirds(runs: Mapping[str, Mapping[int, Run]], scores: Mapping[str, Scores]) -> list[Third]:
    scenes = {seed: run.scene for of_planner in runs.values() for seed, run in sorted(of_planner.items()) if run.scene}
    features = dict.fromkeys(name for scene in scenes.values() for name in scene)
    found: list[Third] = []
    for feature in features:
        values = {seed: scene[feature] for seed, scene in scenes.items() if feature in scene}
        for part in _in_thirds(values):
            collision = {
                name: aggregate(COLLISION, {seed: row for seed, row in mine.items() if seed in part})
                for name, mine in scores.items()
            }
            found.append(Third(feature, min(part.values()), max(part.values()), len(part), collision))
    return found


def _in_thirds(values: Mapping[int, float]) -> list[dict[int, float]]:
    """Split at the two values that a third and two thirds do not exceed. Equal values stay together, so that the
    parts may differ in size, or be fewer."""
    ordered = sorted(values.values())
    cuts = [ordered[math.ceil(len(ordered) * k / 3) - 1] for k in (1, 2, 3)]
    parts = []
    below = -math.inf
    for cut in cuts:
        parts.append({seed: value for seed, value in values.items() if below < value <= cut})
        below = cut
    return [part for part in parts if part]


_TOLD = {True: "way_exists", False: "no_way_found", None: "not_searched"}
_JUDGED = {True: "avoidable", False: "no_way_found", None: "never_known_or_not_judged"}


def _flat(planner: str, measure: RunMeasure) -> str:
    return f"simulate.{planner}.{measure.name}"


def _declaration(measure: RunMeasure) -> dict[str, str]:
    return {
        "unit": measure.unit,
        "better": measure.better,
        "definition": measure.definition,
        "interval": "Wilson" if measure.is_event else "bootstrap over runs",
        "interval_of_difference": "Tango, paired" if measure.is_event else "bootstrap over pairs",
    }


def _planner_document(runs: PlannerRuns) -> dict[str, Any]:
    return {
        "runs": runs.runs,
        "measures": {name: found.to_dict() for name, found in runs.aggregates.items()},
        "differences": {name: found.to_dict() for name, found in runs.differences.items()},
        "collision_seeds": {_JUDGED[judged]: seeds for judged, seeds in runs.collisions.items()},
    }


def _third_document(third: Third) -> dict[str, Any]:
    return {
        "feature": third.feature,
        "low": third.low,
        "high": third.high,
        "scenes": third.scenes,
        "collision": {name: found.to_dict() for name, found in third.collision.items()},
    }
