"""Two runs side by side: pairing, intervals, verdicts, limits and Markdown, on runs made up of known numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.evaluation.blocks import Blocks, Form, paired_interval
from adcbf_cli.core.evaluation.change_limits import exceeded, parse_change_limit
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.core.evaluation.run_comparison import Change, RunComparison, better_direction, compare_runs
from adcbf_cli.core.evaluation.run_comparison_text import document, markdown, side_by_side
from adcbf_cli.core.evaluation.scored_run import Driven, ScoredRun

SETTINGS = {"tables": {"tracking.filter": "ukf"}, "evaluate": {"evaluation.match_m": 1.0}}
OTHER_FILTER = SETTINGS | {"tables": {"tracking.filter": "ekf"}}
ERROR = "tracking.rmse_x_m"


def metric(value: float | None, n: int = 100) -> Metric:
    return Metric(value, "m", n, "pair", "a number")


def scored(name: str, metrics: Mapping[str, Metric], **rest: Any) -> ScoredRun:
    known: dict[str, Any] = {
        "version": "1",
        "source_name": "drive.mcap",
        "source_sha256": "ab" * 32,
        "truth": "cd" * 32,
        "settings": SETTINGS,
        "block_s": 5.0,
        "driven": {},
        "scored": True,
    }
    return ScoredRun(name=name, metrics=metrics, **(known | rest))


def blocks(means: np.ndarray[Any, Any], keys: list[int] | None = None, form: Form = "mean") -> Blocks:
    """Blocks of ten samples each with these means."""
    count = np.full(len(means), 10.0)
    where = np.arange(len(means)) if keys is None else np.array(keys)
    return Blocks(where.astype(np.int64), means * count, count, False, form)


def change(**values: Any) -> Change:
    known: dict[str, Any] = {"name": ERROR, "unit": "m", "better": "lower", "n_base": 9, "n": 9}
    return Change(**(known | {"base": 1.0, "value": 1.0, "difference": 0.0} | values))


def test_pairing_takes_out_what_blocks_have_in_common() -> None:
    """Blocks differ by metres, the runs by a millimetre each: the paired interval sees the millimetre."""
    rng = np.random.default_rng(5)
    common = rng.uniform(1.0, 9.0, 40)
    found = paired_interval(blocks(common), blocks(common + 0.001 + rng.normal(0, 1e-4, 40)), "a")
    assert found is not None
    (low, high), pairs = found
    assert 0.0008 < low < 0.001 < high < 0.0012
    assert pairs == 40


def test_an_interval_holds_the_true_difference_as_often_as_it_says() -> None:
    rng = np.random.default_rng(7)
    hits = 0
    for trial in range(100):
        base = rng.normal(5.0, 2.0, 60)
        found = paired_interval(blocks(base), blocks(base + rng.normal(0.3, 0.5, 60)), f"trial {trial}")
        assert found is not None
        hits += found[0][0] <= 0.3 <= found[0][1]
    assert 0.88 <= hits / 100 <= 0.99


def test_a_root_mean_square_is_compared_as_one() -> None:
    found = paired_interval(blocks(np.full(8, 4.0), form="root_mean"), blocks(np.full(8, 9.0), form="root_mean"), "a")
    assert found is not None
    assert found[0] == pytest.approx((1.0, 1.0))


def test_a_count_is_compared_as_one() -> None:
    """A stretch in which nothing was counted says as much as the others: totals are of all that was looked at."""
    rng = np.random.default_rng(11)
    hits = 0
    for trial in range(100):
        counts = [rng.poisson(rate, 60).astype(np.float64) for rate in (0.2, 0.5)]
        base, other = (blocks(c / 10.0, form="total") for c in counts)
        found = paired_interval(base, other, f"trial {trial}")
        assert found is not None
        assert found[1] == 60
        hits += found[0][0] <= 60 * 0.3 <= found[0][1]
    assert 0.88 <= hits / 100 <= 0.99


def test_blocks_that_only_one_run_has_count_for_that_run() -> None:
    base = blocks(np.full(6, 1.0), keys=[0, 1, 2, 3, 4, 5])
    other = blocks(np.array([1.0, 1, 1, 1, 1, 7]), keys=[0, 1, 2, 3, 4, 9])
    found = paired_interval(base, other, "a")
    assert found is not None
    (low, high), pairs = found
    assert low == pytest.approx(0.0)
    assert high > 1.0
    assert pairs == 7


def test_a_run_whose_blocks_were_dealt_is_paired_with_one_whose_were_not() -> None:
    rng = np.random.default_rng(3)
    plain = blocks(rng.random(500))
    zeroed = Blocks(plain.keys, plain.sums + plain.counts, plain.counts, False, "mean")
    from adcbf_cli.core.evaluation.blocks import _in_hands

    dealt = _in_hands(zeroed)
    assert dealt.dealt
    assert dealt.sums.sum() == pytest.approx(zeroed.sums.sum())
    found = paired_interval(plain, dealt, "a")
    assert found is not None
    assert found[0] == pytest.approx((1.0, 1.0))
    assert found[1] == len(dealt.keys) < 200, "hands are what is paired"


def compared(
    base: ScoredRun, other: ScoredRun, first: Blocks | None = None, second: Blocks | None = None
) -> RunComparison:
    kept = [{} if b is None else {ERROR: b} for b in (first, second)]
    return compare_runs(base, other, *kept)


def test_a_run_compared_with_itself_differs_by_nothing() -> None:
    mine = blocks(np.linspace(1, 2, 10))
    run = scored("a", {ERROR: metric(1.5), "clear.mota": metric(0.7)})
    found = compared(run, replace(run, name="b"), mine, mine)
    assert found.changes[ERROR].interval == (0.0, 0.0)
    assert [c.verdict for c in found.changes.values()] == ["the same", "the same"]
    assert found.settings == {}
    assert found.remarks == ()


@pytest.mark.parametrize(
    ("rest", "reason"),
    [
        ({"source_sha256": "ef" * 32}, "another log"),
        ({"truth": None}, "another ground truth"),
        ({"block_s": 2.0}, "another evaluation.bootstrap_block_s"),
    ],
)
def test_what_cannot_be_paired_has_a_difference_and_a_reason(rest: dict[str, Any], reason: str) -> None:
    base, mine = scored("a", {ERROR: metric(1.0)}), blocks(np.linspace(1, 2, 10))
    found = compared(base, scored("b", {ERROR: metric(1.5)}, **rest), mine, mine).changes[ERROR]
    assert (found.difference, found.interval, found.no_interval) == (0.5, None, reason)
    assert found.verdict == "unknown"


def test_reasons_within_a_pair_of_runs() -> None:
    base = scored("a", {ERROR: metric(1.0), "clear.mota": metric(0.5), "hota.hota": metric(None)})
    few = blocks(np.ones(4))
    changes = compared(base, replace(base, name="b"), few, few).changes
    assert changes[ERROR].no_interval == "fewer than 5 blocks of 5 s"
    assert changes["clear.mota"].no_interval == "one number for the whole log"
    assert changes["hota.hota"].no_interval == "not measured in the base"
    older = compared(base, replace(base, name="b"), few, None).changes
    assert older[ERROR].no_interval == "a run was scored without score_blocks.parquet"


def test_metrics_of_either_run_are_there_and_settings_that_differ() -> None:
    other = scored(
        "b", {"tracks.created": metric(3.0)}, settings=OTHER_FILTER | {"plan": {"planning.starts (plan)": 2}}
    )
    found = compared(scored("a", {ERROR: metric(1.0)}), other)
    assert list(found.changes) == [ERROR, "tracks.created"]
    assert found.changes["tracks.created"].no_interval == "not measured in the base"
    assert found.settings == {"tracking.filter": ("ukf", "ekf")}, "what only one has a report of does not differ"


def driven(values: dict[str, list[float | None]], world: str, moved: int) -> Driven:
    seeds = range(len(next(iter(values.values()))))
    scores = {"mpc": {seed: {name: of[seed] for name, of in values.items()} for seed in seeds}}
    return Driven(scores, world, {seed: {"x_m": 0.5 if seed < moved else 0.0} for seed in seeds})


def driven_run(name: str, values: dict[str, list[float | None]], world: str = "here", moved: int = 0) -> ScoredRun:
    """moved: so many seeds start elsewhere."""
    known = {n: [v for v in of if v is not None] for n, of in values.items()}
    metrics = {f"replay.mpc.{n}": metric(sum(of) / len(of), len(of)) for n, of in known.items()}
    return scored(name, metrics, driven={"replay": driven(values, world, moved)})


def test_drives_are_paired_by_seed() -> None:
    """By hand: six pairs, of which one lacks a value; every other takes 0.5 s longer."""
    base = driven_run("a", {"nav_time_s": [10, 11, 12, 13, 14, 15], "collision": [0, 0, 0, 0, 0, 1]})
    other = driven_run("b", {"nav_time_s": [10.5, 11.5, 12.5, 13.5, 14.5, None], "collision": [0, 0, 1, 1, 1, 1]})
    changes = compared(base, other).changes
    time = changes["replay.mpc.nav_time_s"]
    assert (time.difference, time.pairs, time.paired_by) == (0.5, 5, "seeds")
    assert time.interval == pytest.approx((0.5, 0.5))
    assert time.verdict == "worse"
    hits = changes["replay.mpc.collision"]
    assert hits.difference == 0.5
    assert hits.interval is not None
    assert hits.interval[0] < 0.5 < hits.interval[1]


@pytest.mark.parametrize(("world", "moved"), [("there", 0), ("here", 9)])
def test_equal_seeds_from_other_starts_are_no_pairs(world: str, moved: int) -> None:
    base = driven_run("a", {"nav_time_s": [1.0] * 9})
    found = compared(base, driven_run("b", {"nav_time_s": [2.0] * 9}, world, moved)).changes["replay.mpc.nav_time_s"]
    assert found.difference == 1.0
    assert found.no_interval is not None
    assert found.no_interval.startswith("another world, route or start")


def test_only_the_seeds_that_start_alike_are_pairs() -> None:
    base = driven_run("a", {"nav_time_s": [float(k) for k in range(9)]})
    other = driven_run("b", {"nav_time_s": [99.0, 99.0, *(k + 1.0 for k in range(2, 9))]}, moved=2)
    found = compared(base, other).changes["replay.mpc.nav_time_s"]
    assert (found.difference, found.pairs) == (1.0, 7)


def test_no_event_in_any_of_few_pairs_is_still_uncertain() -> None:
    base = driven_run("a", {"collision": [0.0] * 6})
    found = compared(base, replace(base, name="b")).changes["replay.mpc.collision"]
    assert found.difference == 0
    assert found.interval is not None
    assert found.interval[0] < -0.1 < 0.1 < found.interval[1]
    assert found.verdict == "no clear difference"


@pytest.mark.parametrize(
    ("better", "interval", "verdict"),
    [
        ("lower", (-0.3, -0.1), "better"),
        ("lower", (0.1, 0.3), "worse"),
        ("higher", (0.1, 0.3), "better"),
        ("higher", (-0.3, -0.1), "worse"),
        ("neither", (0.1, 0.3), "changed"),
        ("lower", (-0.1, 0.3), "no clear difference"),
    ],
)
def test_verdicts(better: str, interval: tuple[float, float], verdict: str) -> None:
    assert change(better=better, interval=interval, difference=0.1).verdict == verdict


def test_which_way_is_better() -> None:
    assert {n: better_direction(n) for n in ("prediction.rmse_x_m", "later_seen.moving.fde_m.2.0s")} == {
        "prediction.rmse_x_m": "lower",
        "later_seen.moving.fde_m.2.0s": "lower",
    }
    assert better_direction("detection.recall.person") == "higher"
    assert better_direction("hota.hota") == "higher"
    assert better_direction("prediction.rmse_still_x_m") == "neither", (
        "the task's difficulty, not the predictor's merit"
    )
    assert better_direction("tracking.coverage_95") == "neither", "0.95 is right, not 1"
    assert better_direction("replay.ad-cbf-mpc.collision") == "lower"
    assert better_direction("replay.some.other.min_dist_m") == "higher"


@pytest.mark.parametrize(
    ("limit", "values", "fails"),
    [
        ("tracking.rmse_x_m>+5%", {"value": 1.06, "difference": 0.06}, True),
        ("tracking.rmse_x_m>+5%", {"value": 1.04, "difference": 0.04}, False),
        ("tracking.rmse_x_m > +0.03", {"value": 1.04, "difference": 0.04}, True),
        ("tracking.rmse_x_m<-5%", {"value": 0.9, "difference": -0.1}, True),
        ("tracking.rmse_x_m<-5 %", {"value": 1.1, "difference": 0.1}, False),
        ("tracking.rmse_x_m>=+0", {}, True),
        ("tracking.rmse_x_m>+0", {}, False),
        ("tracking.rmse_x_m>+5%", {"base": 0.0, "value": 0.1, "difference": 0.1}, True),
        ("tracking.rmse_x_m>+5%", {"base": 0.0, "value": 0.0}, False),
        ("tracking.rmse_x_m>+5%", {"base": -2.0, "value": -1.8, "difference": 0.2}, True),
        ("tracking.rmse_x_m>+5%", {"value": None, "difference": None}, True),
        ("hota.hota<-1%", {}, True),
    ],
)
def test_limits_on_changes(limit: str, values: dict[str, Any], fails: bool) -> None:
    lines = exceeded([parse_change_limit(limit)], {ERROR: change(**values)})
    assert bool(lines) == fails, lines


@pytest.mark.parametrize(
    "text", ["tracking.rmse_x_m>5%", "recall<0.9", "x>+", "x>+5%%", "x+5%", ">+5%", "x>+nan", "x>+1e999"]
)
def test_limits_that_are_none(text: str) -> None:
    with pytest.raises(UsageError, match="a change with its sign"):
        parse_change_limit(text)


def test_a_line_tells_what_happened() -> None:
    lines = exceeded([parse_change_limit("tracking.rmse_x_m>+5%")], {ERROR: change(value=1.1, difference=0.1)})
    assert lines == ["tracking.rmse_x_m>+5%: from 1 to 1.1 m (+0.1, +10%)"]


def test_markdown_is_safe_and_whole() -> None:
    name = "detection.recall.<b>|`x`"
    base = scored("main.adcbf", {ERROR: metric(1.0), name: metric(0.5)}, source_name="a|<script>.mcap")
    other = scored("pr.adcbf", {ERROR: metric(2.0), name: metric(0.5)}, settings=OTHER_FILTER)
    mine = (blocks(np.ones(9)), blocks(np.full(9, 2.0)))
    found = compared(base, other, *mine)
    page = markdown(base, [found], {"pr.adcbf": ["too much"]})
    assert f"| `{ERROR}` | 1 | 2 | +1 | +1e+02 % | 1 to 1 | **worse** |" in page
    assert "- **Threshold missed**: too much" in page
    assert "- `tracking.filter`: `ukf` → `ekf`" in page
    assert "`detection.recall.<b>\\|'x'`" in page
    rows = [line for line in page.splitlines() if line.startswith("|")]
    assert {line.replace("\\|", "").count("|") for line in rows} == {8}
    assert "Without an interval: 1 (one number for the whole log)." in page


def test_rows_have_a_place_for_every_run() -> None:
    base = scored("a", {ERROR: metric(1.0)})
    others = [compared(base, scored("b", {ERROR: metric(2.0)})), compared(base, scored("c", {}))]
    columns, rows = side_by_side("a", others, [ERROR])
    assert len(columns) == len(rows[0]) == 8
    assert rows[0] == [ERROR, "1", "2", "+1", "", "-", "", ""]


def test_the_document_is_json_without_infinity() -> None:
    base, other = scored("a", {ERROR: metric(0.0)}), scored("b", {ERROR: metric(1.0)})
    found = compared(base, other)
    assert found.changes[ERROR].relative == math.inf
    entry = document(base, [other], [found], ["x>+1"], {})["runs"][0]["metrics"][ERROR]
    assert (entry["difference"], entry["relative"], entry["interval_95"]) == (1.0, None, None)
