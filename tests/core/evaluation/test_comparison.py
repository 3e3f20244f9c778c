"""Planners side by side: means, intervals, pairs, and what is missing from them."""

from __future__ import annotations

import json
import random
from dataclasses import replace

import numpy as np
import pytest

from adcbf_cli.core.config import PlanningConfig, ReplayConfig
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.evaluation.comparison import Comparison, add_to_report, compare, compare_scores, metric_names
from adcbf_cli.core.evaluation.comparison_text import headline, markdown
from adcbf_cli.core.evaluation.intervals import bootstrap_mean, wilson
from adcbf_cli.core.evaluation.report import Report
from adcbf_cli.core.evaluation.thresholds import check_names, missed, parse_threshold
from adcbf_cli.core.replay.records import Drive, Result
from tests.core.evaluation.driving_scenes import drive_of

REPLAY, PLANNING = ReplayConfig(), PlanningConfig()


def driven(planner: str, seed: int, ticks: int, clearance_m: float, result: Result = Result.SUCCESS) -> Drive:
    """`ticks` periods of 0.1 s at 1 m/s."""
    return drive_of(
        [1.0] * (ticks + 1), planner=planner, seed=seed, clearance_m=np.full(ticks + 1, clearance_m), result=result
    )


def two_planners(seeds: int = 6) -> list[Drive]:
    """`swift` is 0.5 s faster and passes 0.2 m nearer than `calm`; it collides with seed 1, `calm` times out with 2."""
    drives = []
    for seed in range(seeds):
        swift = Result.COLLISION if seed == 1 else Result.SUCCESS
        calm = Result.TIMEOUT if seed == 2 else Result.SUCCESS
        drives.append(driven("swift", seed, 50 + seed, 0.5 + 0.01 * seed**2, swift))
        drives.append(driven("calm", seed, 55 + seed, 0.7 + 0.01 * seed**2, calm))
    return drives


def both(drives: list[Drive] | None = None, against: str | None = "calm") -> Comparison:
    return compare(two_planners() if drives is None else drives, REPLAY, PLANNING, against)


@pytest.mark.parametrize(
    ("events", "n", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0000, 0.1611),
        (1, 29, 0.0061, 0.1718),
        (5, 10, 0.2366, 0.7634),
        (10, 10, 0.7225, 1.0),
    ],
)
def test_wilson(events: int, n: int, low: float, high: float) -> None:
    """The first four rows are Newcombe 1998's, table I, method 3."""
    assert wilson(events, n) == (pytest.approx(low, abs=5e-5), pytest.approx(high, abs=5e-5))


def test_a_rate_is_never_outside_of_its_own_interval() -> None:
    """Not by a rounding error either: pictures draw the ends as distances from the rate."""
    for n in range(1, 200):
        for events in (0, 1, n - 1, n):
            low, high = wilson(events, n) or (np.nan, np.nan)
            assert low <= events / n <= high
        assert (wilson(0, n) or ())[0] == 0.0
        assert (wilson(n, n) or (0.0,))[-1] == 1.0


def test_wilson_solves_its_equation() -> None:
    """The bounds are the rates p from which the seen one is 1.96 standard errors of p away."""
    for events, n in ((3, 20), (17, 20), (40, 300)):
        for p in wilson(events, n) or ():
            assert abs(events / n - p) / np.sqrt(p * (1 - p) / n) == pytest.approx(1.959964, abs=1e-6)
    assert wilson(0, 0) is None


def test_bootstrap_covers_the_mean_about_as_often_as_it_says() -> None:
    """400 samples of 30 normal values: the percentile bootstrap of a mean covers 93 to 94 % there."""
    rng = np.random.default_rng(100)
    hits = 0
    for i in range(400):
        low, high = bootstrap_mean(rng.normal(3.0, 2.0, 30).tolist(), f"m{i}") or (np.nan, np.nan)
        hits += low <= 3.0 <= high
    assert 0.90 <= hits / 400 <= 0.97


def test_bootstrap_width_is_the_standard_error() -> None:
    values = np.random.default_rng(101).normal(0, 1, 200)
    low, high = bootstrap_mean(values.tolist(), "x") or (np.nan, np.nan)
    assert high - low == pytest.approx(2 * 1.96 * values.std() / np.sqrt(200), rel=0.1)


def test_bootstrap_moves_and_scales_with_the_values_and_repeats() -> None:
    values = [1.0, 4.0, 2.0, 8.0, 3.0, 3.5]
    low, high = bootstrap_mean(values, "x") or (np.nan, np.nan)
    assert bootstrap_mean(values, "x") == (low, high)
    assert bootstrap_mean(values, "y") != (low, high), "another name draws another sample"
    assert bootstrap_mean([10 + 2 * v for v in values], "x") == pytest.approx((10 + 2 * low, 10 + 2 * high))
    assert min(values) < low < np.mean(values) < high < max(values)
    assert bootstrap_mean(values[:4], "x") is None, "four drives"
    assert bootstrap_mean([0.3] * 5, "x") == (0.3, 0.3)


def test_means_leave_failed_drives_out_and_say_so() -> None:
    swift = both().planners["swift"].aggregates
    assert (swift["nav_time_s"].n, swift["nav_time_s"].n_missing) == (5, 1)
    assert swift["nav_time_s"].value == pytest.approx(np.mean([5.0, 5.2, 5.3, 5.4, 5.5]))
    low, high = swift["nav_time_s"].interval or (np.nan, np.nan)
    assert 5.0 < low < 5.28 < high < 5.5
    assert (swift["min_dist_m"].n, swift["min_dist_m"].n_missing) == (6, 0)
    assert (swift["ref_time_s"].value, swift["ref_time_s"].n, swift["ref_time_s"].n_missing) == (None, 0, 6)


def test_rates_have_wilson_intervals_even_of_few_drives() -> None:
    swift = both(two_planners(3)).planners["swift"].aggregates
    assert swift["collision"].value == pytest.approx(1 / 3)
    assert swift["collision"].interval == pytest.approx(wilson(1, 3))
    assert swift["timeout"].interval == pytest.approx(wilson(0, 3))
    assert swift["min_dist_m"].interval is None


def test_a_constant_shift_is_found_exactly_and_dropped_pairs_are_counted() -> None:
    found = both().planners["swift"].differences
    time = found["nav_time_s"]
    assert (time.n, time.n_dropped, time.n_neither) == (4, 2, 0), "seeds 1 and 2: one of the two failed"
    assert time.value == pytest.approx(-0.5, abs=1e-9)
    assert time.interval is None, "four pairs"
    near = found["min_dist_m"]
    assert (near.n, near.n_dropped) == (6, 0)
    assert near.value == pytest.approx(-0.2, abs=1e-12)
    assert near.interval == pytest.approx((-0.2, -0.2), abs=1e-12), "though the seeds themselves differ by 0.25 m"
    assert (found["ref_time_s"].value, found["ref_time_s"].n, found["ref_time_s"].n_neither) == (None, 0, 6)
    assert found["collision"].value == pytest.approx(1 / 6)
    assert both().planners["calm"].differences == {}
    assert both(against=None).planners["swift"].differences == {}


def test_pairs_are_made_by_seed_and_a_seed_that_one_did_not_drive_is_dropped() -> None:
    drives = [driven("a", 3, 10, 1.0), driven("a", 7, 20, 2.0), driven("b", 7, 10, 1.5), driven("b", 9, 10, 9.0)]
    found = both(drives, "b").planners["a"].differences["min_dist_m"]
    assert (found.value, found.n, found.n_dropped, found.n_neither) == (0.5, 1, 2, 0)


def test_the_order_of_drives_does_not_matter() -> None:
    expected = both().to_dict()
    drives = two_planners()
    for seed in range(5):
        random.Random(seed).shuffle(drives)
        found = both(drives).to_dict()
        assert found == expected
        assert list(found["planners"]["calm"]["seeds"]) == list("012345")


def test_scores_kept_apart_from_their_drives_compare_alike() -> None:
    expected = both()
    kept = {name: json.loads(json.dumps(score.scores)) for name, score in expected.planners.items()}
    scores = {name: {int(seed): row for seed, row in rows.items()} for name, rows in kept.items()}
    assert compare_scores(scores, "replay", "calm") == expected
    for row in scores["swift"].values():
        del row["solve_p50_ms"]
    without = compare_scores(scores, "replay", "calm").planners["swift"]
    assert set(expected.planners["swift"].differences) - set(without.differences) == {"solve_p50_ms"}
    assert set(expected.planners["swift"].aggregates) - set(without.aggregates) == {"solve_p50_ms"}
    with pytest.raises(UsageError, match="did you mean swift"):
        compare_scores(scores, "replay", "swit")


def test_other_planners_do_not_matter() -> None:
    others = [driven("other", seed, 40, 0.1) for seed in range(6)]
    alone, among = both(), both([*others, *two_planners()])
    assert among.planners["swift"] == alone.planners["swift"]


def test_the_log_own_driver_is_compared_in_what_it_has() -> None:
    logged = replace(driven("logged", 0, 60, 0.9), result=None, steps=None, stages=None)
    comparison = both([*two_planners(), logged], "logged")
    own = comparison.planners["logged"].aggregates
    assert own["nav_time_s"].value == pytest.approx(6.0)
    assert "solve_p50_ms" not in own
    assert "collision" not in own
    found = comparison.planners["swift"].differences
    assert set(found) == set(own)
    assert found["nav_time_s"].value == pytest.approx(-1.0)
    assert (found["nav_time_s"].n, found["nav_time_s"].n_dropped) == (1, 4), "of five more seeds one failed, too"
    assert found["nav_time_s"].n_neither == 1


def test_open_loop_has_its_own_names() -> None:
    drive = replace(driven("swift", 0, 9, 1.0), result=None, plan_error_m=np.full((10, 31), 0.25))
    comparison = compare([drive], REPLAY, PLANNING)
    metrics = comparison.metrics()
    assert metrics["plan.swift.plan_error_3s_m"].value == 0.25
    assert list(metrics) == metric_names("plan", ["swift"])
    assert "plan.swift.nav_time_s" not in metrics
    with pytest.raises(ValueError, match="closed and open loop"):
        compare([drive, driven("calm", 0, 9, 1.0)], REPLAY, PLANNING)


def test_the_same_drive_twice_is_a_mistake() -> None:
    with pytest.raises(ValueError, match="two drives of swift with seed 4"):
        compare([driven("swift", 4, 9, 1.0), driven("swift", 4, 9, 1.0)], REPLAY, PLANNING)


def test_an_unknown_planner_to_compare_against_names_the_nearest() -> None:
    with pytest.raises(UsageError, match="did you mean swift"):
        both(against="swit")


def test_metrics_reach_reports_and_thresholds() -> None:
    report = Report(basis={"truth": None})
    add_to_report(both(), report)
    assert list(report.metrics) == metric_names("replay", ["swift", "calm"])
    rules = ["replay.swift.collision>0.1", "replay.calm.collision>0.1", "replay.swift.ref_time_s>9"]
    thresholds = [parse_threshold(text) for text in rules]
    check_names(thresholds, report.metrics)
    lines = missed(thresholds, report)
    assert [line.split(":")[0] for line in lines] == [rules[0], rules[2]]
    assert "not measured" in lines[1]
    assert report.basis["replay"] == {"against": "calm", "drives": {"swift": 6, "calm": 6}}
    document = report.to_dict()["metrics"]["replay.swift.nav_time_s"]
    assert document["unit"] == "s"
    assert document["n"] == 5
    assert len(document["interval_95"]) == 2


def test_the_document_is_json_and_holds_every_drive() -> None:
    document = json.loads(json.dumps(both().to_dict(), allow_nan=False))
    swift = document["planners"]["swift"]
    assert swift["drives"] == 6
    assert swift["metrics"]["nav_time_s"]["n_missing"] == 1
    assert swift["differences"]["nav_time_s"]["n_dropped"] == 2
    assert swift["seeds"]["1"]["nav_time_s"] is None
    assert swift["seeds"]["3"]["nav_time_s"] == pytest.approx(5.3)
    assert document["metrics"]["nav_time_s"]["better"] == "lower"


def test_the_headline_says_over_how_many_drives_a_mean_is() -> None:
    columns, rows = headline(both())
    swift = dict(zip(columns, rows[0], strict=True))
    assert (swift["planner"], swift["drives"]) == ("swift", "6")
    assert swift["nav time s"] == "5.28 (5/6)"
    assert swift["collision"] == "0.167"
    assert swift["ref time s"] == "-"
    assert all(len(row) == len(columns) for row in rows)


def test_the_markdown_page() -> None:
    page = markdown(both())
    assert "| swift | 6 | 0.833 |" in page
    assert "Minus calm, seed by seed:" in page
    assert "| `nav_time_s` | -0.5 |  | s | lower | 4 | 2 |" in page
    assert page.count("Minus calm") == 1
    assert "- `min_dist_m` (ticks with a known obstacle):" in page
