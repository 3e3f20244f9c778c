"""Rates over many scenes, counted by hand; what is missing; what the order of rows must not change."""

from __future__ import annotations

import json
import random
from itertools import pairwise
from typing import Any

import pytest

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.evaluation.intervals import bootstrap_mean, wilson
from adcbf_cli.core.evaluation.monte_carlo import MonteCarlo, metric_names, study
from adcbf_cli.core.evaluation.rare_rates import difference_interval
from adcbf_cli.core.evaluation.report import Report
from adcbf_cli.core.evaluation.run_measures import MEASURES
from adcbf_cli.core.evaluation.thresholds import check_names, missed, parse_threshold


def row(planner: str, seed: int, result: str = "success", **more: Any) -> dict[str, Any]:
    """A run's row. `metrics` adds to those it has anyway."""
    metrics = {
        "nav_time_s": 10.0 + 0.1 * seed if result == "success" else None,
        "min_dist_m": 0.2,
        "freezing_s": 0.0,
        "relaxed_rate": 0.0,
        "braked_rate": 0.0,
        "stopped_rate": 0.0,
        "ref_time_s": None,
    }
    found = {"planner": planner, "seed": seed, "result": result, "collision": None, "escape_exists": None}
    return found | more | {"metrics": metrics | more.get("metrics", {})}


def hit(planner: str, seed: int, avoidable: bool | None, escape: bool | None = None) -> dict[str, Any]:
    return row(planner, seed, "collision", collision={"avoidable": avoidable}, escape_exists=escape)


def ten_scenes() -> list[dict[str, Any]]:
    """`calm` times out twice and freezes once; `swift` collides four times: 0 and 1 avoidably, 2 not, 3 unknown.

    Scene 2 no one can pass: `calm` times out there too, and no search found a way. Scene 3 `calm` passes.
    """
    rows = [row("calm", seed, scene={"movers": seed // 2, "bumps_m": 0.1}) for seed in range(10)]
    rows[2] = row("calm", 2, "timeout", escape_exists=False, scene={"movers": 1, "bumps_m": 0.1})
    rows[9] = row("calm", 9, "timeout", scene={"movers": 4, "bumps_m": 0.1}, metrics={"freezing_s": 5.1})
    rows[8]["metrics"] |= {"freezing_s": 5.0, "braked_rate": 0.25}
    rows[7]["metrics"] |= {"relaxed_rate": 0.5, "stopped_rate": 0.1, "freezing_s": None}
    swift = [row("swift", seed) for seed in range(10)]
    swift[:4] = [hit("swift", 0, True), hit("swift", 1, True), hit("swift", 2, False, False), hit("swift", 3, None)]
    return rows + swift


def found(rows: list[dict[str, Any]] | None = None, against: str | None = "calm") -> MonteCarlo:
    return study(ten_scenes() if rows is None else rows, against)


@pytest.mark.parametrize(
    ("planner", "measure", "events", "n"),
    [
        ("calm", "success", 8, 10),
        ("calm", "timeout", 2, 10),
        ("calm", "collision", 0, 10),
        ("calm", "avoidable_collision", 0, 10),
        ("calm", "freeze", 1, 9),  # 5.0 s is not more than 5 s; in one run it is not known
        ("calm", "fallback", 2, 10),  # braked, or stood; relaxed alone is none
        ("swift", "success", 6, 10),
        ("swift", "collision", 4, 10),
        ("swift", "avoidable_collision", 2, 9),  # one was not judged
        ("swift", "collision_despite_way", 3, 9),  # all but scene 2
        ("calm", "collision_despite_way", 0, 9),
        ("swift", "freeze", 0, 10),
    ],
)
def test_rates_counted_by_hand(planner: str, measure: str, events: int, n: int) -> None:
    total = found().planners[planner].aggregates[measure]
    assert (total.value, total.n, total.n_missing) == (pytest.approx(events / n), n, 10 - n)
    assert total.interval == wilson(events, n)


def test_one_planner_s_success_proves_that_there_is_a_way_for_the_others() -> None:
    result = found()
    assert result.ways == {True: 9, False: 1, None: 0}  # scene 9: `swift` got through
    alone = found([entry for entry in ten_scenes() if entry["planner"] == "swift"], None)
    assert alone.ways == {True: 6, False: 1, None: 3}
    assert alone.planners["swift"].aggregates["collision_despite_way"].value == 0.0
    searched = found([hit("a", 1, None, False), hit("b", 1, None, True), hit("c", 1, None)], None)
    assert searched.ways == {True: 1, False: 0, None: 0}


def test_collisions_are_named_by_seed_and_verdict() -> None:
    assert found().planners["swift"].collisions == {True: [0, 1], False: [2], None: [3]}
    assert found().planners["calm"].collisions == {True: [], False: [], None: []}


def test_means_are_over_the_runs_that_have_a_value() -> None:
    calm = found().planners["calm"].aggregates
    times = [10.0 + 0.1 * seed for seed in range(10) if seed not in (2, 9)]
    assert (calm["nav_time_s"].n, calm["nav_time_s"].n_missing) == (8, 2)
    assert calm["nav_time_s"].value == pytest.approx(sum(times) / 8)
    assert calm["nav_time_s"].interval == bootstrap_mean(times, "nav_time_s")
    assert calm["relaxed_rate"].value == pytest.approx(0.05)
    assert (calm["ref_time_s"].value, calm["ref_time_s"].n_missing) == (None, 10)
    assert calm["vel_var"].value is None, "no row has it"


def test_differences_are_by_scene_with_intervals_that_fit_events() -> None:
    differences = found().planners["swift"].differences
    collided = differences["collision"]
    assert (collided.value, collided.n) == (pytest.approx(0.4), 10)
    assert collided.interval == difference_interval(4, 0, 10)
    assert differences["success"].value == pytest.approx(-0.2)  # lost 0, 1 and 3; won 9; in 2 both failed
    assert differences["success"].interval == difference_interval(1, 3, 10)
    assert differences["avoidable_collision"].n_dropped == 1
    time = differences["nav_time_s"]
    assert (time.value, time.n, time.n_dropped, time.n_neither) == (pytest.approx(0.0), 5, 4, 1)
    assert found().planners["calm"].differences == {}
    assert found(against=None).planners["swift"].differences == {}


def test_two_planners_that_never_collide_may_still_differ() -> None:
    rows = [row(planner, seed) for planner in ("a", "b") for seed in range(200)]
    collided = study(rows, "a").planners["b"].differences["collision"]
    assert collided.value == 0
    assert collided.interval == pytest.approx((-0.018846, 0.018846), abs=1e-6)


def test_failed_runs_are_counted_and_named_and_in_no_rate() -> None:
    failed = [{"run": "swift-10", "error": "ValueError: x"}, {"planner": "calm", "seed": 11, "error": "y"}]
    with_failed = found(ten_scenes() + failed)
    assert with_failed.failed == failed
    assert with_failed.planners == found().planners
    page = with_failed.markdown()
    assert "2 runs gave no result" in page
    assert "- swift-10: ValueError: x" in page
    assert "## Runs that failed" not in found().markdown()


def test_a_scene_that_one_planner_failed_in_is_a_dropped_pair() -> None:
    rows = [entry for entry in ten_scenes() if (entry["planner"], entry["seed"]) != ("calm", 0)]
    collided = found([*rows, {"run": "calm-0", "error": "x"}]).planners["swift"].differences["collision"]
    assert (collided.value, collided.n, collided.n_dropped) == (pytest.approx(3 / 9), 9, 1)


def test_thirds_of_the_scenes() -> None:
    thirds = [third for third in found().thirds if third.feature == "movers"]
    assert [(third.low, third.high, third.scenes) for third in thirds] == [(0, 1, 4), (2, 3, 4), (4, 4, 2)]
    assert [third.collision["swift"].value for third in thirds] == [1.0, 0.0, 0.0]
    assert thirds[0].collision["swift"].interval == wilson(4, 4)
    assert [third.collision["calm"].n for third in thirds] == [4, 4, 2]


def test_a_feature_that_never_varies_has_one_part() -> None:
    same = [third for third in found().thirds if third.feature == "bumps_m"]
    assert [(third.low, third.high, third.scenes) for third in same] == [(0.1, 0.1, 10)]


def test_thirds_of_different_values_are_equally_many_and_hold_each_scene_once() -> None:
    for count in (1, 2, 3, 7, 30):
        values = random.Random(count).sample(range(1000), count)
        rows = [row("a", seed, scene={"speed_mps": float(value)}) for seed, value in enumerate(values)]
        thirds = study(rows).thirds
        assert sum(third.scenes for third in thirds) == count
        assert max(third.scenes for third in thirds) - min(third.scenes for third in thirds) <= 1
        assert all(a.high < b.low for a, b in pairwise(thirds))


def test_the_order_of_rows_and_other_planners_do_not_matter() -> None:
    expected = found()
    for seed in range(5):
        rows = ten_scenes()
        random.Random(seed).shuffle(rows)
        shuffled = found(rows)
        assert shuffled.planners == expected.planners
        assert shuffled.ways == expected.ways
        assert [third for third in shuffled.thirds if third.feature == "movers"] == [
            third for third in expected.thirds if third.feature == "movers"
        ]
    others = [row("third", seed, "timeout") for seed in range(10)]
    assert found(others + ten_scenes()).planners["swift"] == expected.planners["swift"]


def test_mistakes() -> None:
    with pytest.raises(ValueError, match="two runs of calm with seed 3"):
        found([row("calm", 3), row("calm", 3)])
    with pytest.raises(UsageError, match="did you mean swift"):
        found(against="swit")
    with pytest.raises(ValueError, match="crashed"):
        found([row("calm", 3, "crashed")])


def test_nothing_at_all_is_no_evidence() -> None:
    empty = study([{"run": "calm-1", "error": "x"}])
    assert empty.planners == {}
    assert "1 run gave no result" in empty.markdown()
    json.dumps(empty.to_dict(), allow_nan=False)


def test_the_document_is_json_and_complete() -> None:
    document = json.loads(json.dumps(found().to_dict(), allow_nan=False))
    assert document["scenes"] == {"way_exists": 9, "no_way_found": 1, "not_searched": 0}
    swift = document["planners"]["swift"]
    assert swift["runs"] == 10
    assert swift["measures"]["collision"]["interval_95"] == list(wilson(4, 10) or ())
    assert swift["differences"]["nav_time_s"]["n_dropped"] == 4
    assert swift["collision_seeds"] == {"avoidable": [0, 1], "no_way_found": [2], "never_known_or_not_judged": [3]}
    assert set(document["measures"]) == {measure.name for measure in MEASURES}
    assert document["thirds"][0]["collision"]["swift"]["n"] == 4


def test_measures_reach_thresholds() -> None:
    report = Report()
    report.metrics |= found().metrics()
    assert list(report.metrics) == metric_names(["calm", "swift"])
    rules = ["simulate.swift.collision>0.3", "simulate.calm.collision>0", "simulate.calm.ref_time_s>1"]
    thresholds = [parse_threshold(text) for text in rules]
    check_names(thresholds, report.metrics)
    lines = missed(thresholds, report)
    assert [line.split(":")[0] for line in lines] == [rules[0], rules[2]]
    assert "not measured" in lines[1]
    assert report.metrics["simulate.swift.nav_time_s"].unit == "s"


def test_the_headline() -> None:
    columns, rows = found().headline()
    swift = dict(zip(columns, rows[1], strict=True))
    assert (swift["planner"], swift["runs"], swift["collision"]) == ("swift", "10", "40 %")
    assert swift["avoidable collision"] == "22.2 % (9/10)"
    assert swift["nav time s"] == "10.7 (6/10)"
    assert all(len(cells) == len(columns) for cells in rows)


def test_the_page_says_what_may_be_where_nothing_was_seen() -> None:
    page = study([row("calm", seed) for seed in range(1000)]).markdown()
    assert "| calm | 1000 | 100 % (99.6 to 100), 1000/1000 | 0 % (0 to 0.38), 0/1000 |" in page
    assert "- calm: avoidable collision 0 of 1000: below 0.38 % (Wilson), 0.3 % (rule of three)." in page
    assert "calm: success 0" not in page
    assert "Differences" not in page


def test_the_page_of_two_planners() -> None:
    page = found().markdown()
    assert "### swift minus calm" in page
    assert "| collision | 40 |" in page
    assert "| `movers` | 0 to 1 | 4 | 0 % (0 to 49), 0/4 | 100 % (51 to 100), 4/4 |" in page
    assert "- swift, avoidable: 2 (seeds 0, 1)" in page
    assert "- swift, no way around was found: 1 (seed 2)" in page
    assert "Scenes: 9 can be driven through, in 1 a search found no way, 0 were not searched." in page
    assert "\n\n\n" not in page
