"""Paths, block sums, formulas and thresholds of the evaluation, each on its own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.evaluation.blocks import MAX_KEPT, BlockSums, block_keys
from adcbf_cli.core.evaluation.formulas import (
    bearing,
    covered,
    ellipse_threshold,
    mahalanobis2,
    nees_bounds,
    rotate,
)
from adcbf_cli.core.evaluation.report import Metric, Report
from adcbf_cli.core.evaluation.thresholds import check_names, missed, parse_threshold
from adcbf_cli.core.paths import Paths

SECOND = 1_000_000_000


def paths(samples: dict[int, dict[float, list[float]]], max_gap_s: float = 0.5, angle: int | None = None) -> Paths:
    """{id: {seconds: values}}"""
    rows = [(i, round(t * SECOND), v) for i, path in samples.items() for t, v in path.items()]
    return Paths(
        np.array([r[0] for r in rows], dtype=np.int64),
        np.array([r[1] for r in rows], dtype=np.int64),
        np.array([r[2] for r in rows], dtype=np.float64),
        round(max_gap_s * SECOND),
        angle,
    )


def ask(where: Paths, i: int, *seconds: float) -> list[float]:
    stamps = np.array([round(t * SECOND) for t in seconds], dtype=np.int64)
    values, known = where.at(np.full(len(stamps), i), stamps)
    assert (np.isfinite(values[:, 0]) == known).all()
    return values[:, 0].tolist()


def test_paths_interpolate_but_not_across_gaps_or_beyond_ends() -> None:
    where = paths({4: {1.0: [0.0], 1.4: [4.0], 3.0: [10.0], 3.2: [20.0]}, -7: {1.0: [100.0], 1.1: [101.0]}})
    np.testing.assert_allclose(ask(where, 4, 1.0, 1.1, 1.4, 3.0, 3.05), [0.0, 1.0, 4.0, 10.0, 12.5])
    assert np.isnan(ask(where, 4, 0.9, 1.5, 2.9, 3.3)).all(), "outside, and in the gap"
    np.testing.assert_allclose(ask(where, -7, 1.05), [100.5])
    assert np.isnan(ask(where, 5, 1.0)).all(), "an id that is not there"
    np.testing.assert_allclose(ask(where, 4, 0.9995, 3.2005), [0.0, 20.0]), "stamps are rounded by up to a millisecond"
    ids, values = where.present(round(1.05 * SECOND))
    assert ids.tolist() == [-7, 4]
    np.testing.assert_allclose(values[:, 0], [100.5, 0.5])


def test_a_mistyped_stamp_does_not_upset_the_other_paths() -> None:
    """Three objects over fifty years: one stretch of nanoseconds for each would exceed int64."""
    ids = np.array([1, 1, 2, 2, 3, 3, 9])
    stamps = np.array([10, 20, 10, 20, 10, 20, 0]) * 100_000_000 + 1_700_000_000_000_000_000
    stamps[-1] = -1
    values = np.array([[0.0], [1.0], [2.0], [3.0], [4.0], [5.0], [6.0]])
    paths = Paths(ids, stamps, values, 10**10)
    middle = 1_700_000_001_500_000_000
    found, known = paths.at(np.array([3, 2, 1, 9]), np.array([middle, middle, middle, -1]))
    assert known.all()
    np.testing.assert_allclose(found[:, 0], [4.5, 2.5, 0.5, 6.0])
    assert paths.present(middle)[0].tolist() == [1, 2, 3]


def test_angles_take_the_shortest_arc() -> None:
    where = paths({0: {0.0: [0.0, 3.0], 0.2: [1.0, -3.0]}}, angle=1)
    values, _ = where.at(np.zeros(1, dtype=np.int64), np.array([SECOND // 10]))
    assert np.cos(values[0, 1] - np.pi) == pytest.approx(1.0)


def test_an_empty_path_answers_nothing() -> None:
    where = Paths(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), SECOND)
    values, known = where.at(np.array([1]), np.array([5]))
    assert np.isnan(values).all()
    assert not known.any()
    assert len(where.present(5)[0]) == 0


@given(st.data())
def test_paths_agree_with_numpy_interpolation(data: st.DataObject) -> None:
    samples: dict[int, dict[float, list[float]]] = {}
    for i in data.draw(st.sets(st.integers(-5, 5), min_size=1, max_size=4)):
        times = data.draw(st.sets(st.integers(0, 60), min_size=1, max_size=12))
        samples[i] = {t / 10: [data.draw(st.floats(-100, 100))] for t in times}
    where = paths(samples, max_gap_s=100.0)
    for i, path in samples.items():
        at = np.array(sorted(path))
        query = data.draw(st.floats(float(at[0]), float(at[-1])))
        expected = np.interp(query, at, [path[t][0] for t in sorted(path)])
        np.testing.assert_allclose(ask(where, i, query), [expected], atol=1e-5)


def test_block_sums_are_plain_means() -> None:
    sums = BlockSums()
    sums.add(np.array([1, 1, 2]), {"a": np.array([1.0, 2.0, np.nan])})
    sums.add(np.array([2]), {"a": np.array([[4.0, 5.0, np.nan]]), "b": np.array([np.nan])})
    assert sums.value("a") == pytest.approx(3.0)
    assert sums.count("a") == 4
    assert (sums.value("b"), sums.count("b")) == (None, 0)
    assert sums.value("never") is None


def test_intervals_are_drawn_over_blocks_not_samples() -> None:
    """Ten blocks of a hundred equal samples hold ten facts, not a thousand."""
    rng = np.random.default_rng(1)
    by_block, by_sample = BlockSums(), BlockSums()
    facts = rng.normal(0, 1, 10)
    for block, fact in enumerate(facts):
        by_block.add(np.full(100, block), {"a": np.full(100, fact)})
        by_sample.add(block * 100 + np.arange(100), {"a": np.full(100, fact)})
    wide, narrow = (s.interval("a") for s in (by_block, by_sample))
    assert wide is not None
    assert narrow is not None
    standard_error = facts.std() / np.sqrt(10)
    assert wide[1] - wide[0] == pytest.approx(2 * 1.96 * standard_error, rel=0.2)
    assert narrow[1] - narrow[0] == pytest.approx((wide[1] - wide[0]) / 10, rel=0.2)
    few = BlockSums()
    few.add(np.arange(4), {"a": np.ones(4)})
    assert few.interval("a") is None


def test_intervals_of_many_blocks_have_the_right_width() -> None:
    values = np.random.default_rng(2).normal(3, 1, 10_000)
    sums = BlockSums()
    sums.add(np.arange(len(values)), {"a": values})
    interval = sums.interval("a")
    assert interval is not None
    assert interval[1] - interval[0] == pytest.approx(2 * 1.96 / np.sqrt(len(values)), rel=0.15)
    assert interval[0] < values.mean() < interval[1]


def test_blocks_that_come_one_by_one_are_kept_whole_in_bounded_memory() -> None:
    """A block's samples may come at any time, before and after blocks have become too many to keep apart."""
    values = np.random.default_rng(3).normal(-2, 1, 3 * MAX_KEPT)
    sums = BlockSums()
    for _ in range(2):
        for start in range(0, len(values), 100):
            part = slice(start, start + 100)
            sums.add(block_keys(np.arange(len(values))[part], np.zeros(100, np.int64), SECOND), {"a": values[part]})
            assert len(sums._sums["a"]) <= MAX_KEPT
    assert sums.count("a") == 2 * len(values)
    assert sums.value("a") == pytest.approx(values.mean(), rel=1e-12)
    interval = sums.interval("a")
    assert interval is not None
    assert interval[1] - interval[0] == pytest.approx(2 * 1.96 / np.sqrt(len(values)), rel=0.15)


def test_block_keys_tell_objects_and_times_apart() -> None:
    keys = block_keys(np.array([0, 0, 1, 0]), np.array([0, 4, 0, 5]) * SECOND, 5 * SECOND)
    assert keys[0] == keys[1]
    assert len(set(keys.tolist())) == 3


def test_formulas_by_hand() -> None:
    np.testing.assert_allclose(rotate(np.array([1.0, 0.0]), np.array(np.pi / 2)), [0, 1], atol=1e-15)
    assert bearing(np.array([1.0, 1.0]), np.array([1.0, 3.0])) == pytest.approx(np.pi / 2)
    covariance = np.array([[4.0, 1.0], [1.0, 2.0]])
    error = np.array([1.0, -2.0])
    assert mahalanobis2(error, covariance) == pytest.approx(error @ np.linalg.inv(covariance) @ error)
    assert np.isnan(mahalanobis2(error, np.zeros((2, 2))))
    assert covered(np.array([1.0, 2.0, np.nan]), 1.5).tolist()[:2] == [1.0, 0.0]
    assert np.isnan(covered(np.array([np.nan]), 1.5))


def test_consistency_bounds_are_chi_square() -> None:
    from scipy.stats import chi2

    assert ellipse_threshold(0.95) == pytest.approx(chi2.ppf(0.95, 2))
    np.testing.assert_allclose(nees_bounds(40), chi2.ppf([0.025, 0.975], 80) / 40)
    assert nees_bounds(0) is None


def report(**values: float | None) -> Report:
    metrics = {name.replace("__", "."): Metric(v, "m", 5, "frame", "") for name, v in values.items()}
    return Report(metrics=metrics, basis={"truth": {}})


@pytest.mark.parametrize(
    ("text", "fails"),
    [("a__b>0.1", True), ("a__b >= 0.2", True), ("a__b<0.2", False), ("a__b<=0.2", True), ("a__b>2e-1", False)],
)
def test_thresholds_compare(text: str, fails: bool) -> None:
    threshold = parse_threshold(text.replace("__", "."))
    assert bool(missed([threshold], report(a__b=0.2))) is fails


def test_what_was_not_measured_cannot_pass() -> None:
    for text in ("a.b>5", "a.b<5", "detection.recall.Tram<0.5"):
        (line,) = missed([parse_threshold(text)], report(a__b=None))
        assert "not measured" in line
    (line,) = missed([parse_threshold("prediction.rmse_x_m>1")], Report(basis={"truth": None}))
    assert "no ground truth" in line
    (line,) = missed([parse_threshold("replay.dwa.nav_time_s>1")], Report(basis={"truth": None}))
    assert "no such drive" in line


@pytest.mark.parametrize("text", ["", "a.b", "a.b=1", "a.b>x", "a.b>nan", ">1", "a.b>1>2"])
def test_thresholds_that_cannot_be_meant(text: str) -> None:
    with pytest.raises(UsageError, match="--fail-on"):
        parse_threshold(text)


def test_an_unknown_metric_names_the_nearest() -> None:
    names = ["prediction.rmse_x_m", "detection.recall"]
    with pytest.raises(UsageError, match=r"unknown metric prediction.rmse_x; did you mean prediction.rmse_x_m\?"):
        check_names([parse_threshold("prediction.rmse_x>1")], names)
    with pytest.raises(UsageError, match=r"unknown metric no\.such\.metric; docs/metrics\.md lists them"):
        check_names([parse_threshold("no.such.metric>1")], [*names, "hota.det_re"])
    check_names([parse_threshold("detection.recall.Car<0.9"), parse_threshold("detection.recall<0.9")], names)
