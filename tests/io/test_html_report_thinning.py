"""What a page leaves out: never an extreme, never more than it says."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from adcbf_cli.core.polylines import simplified
from adcbf_cli.io.html_report.thinning import evenly, integers, with_extremes


def test_numbers_become_integers_and_what_is_not_known_becomes_null() -> None:
    assert integers(np.array([[1.2346, -0.0004], [np.nan, np.inf]]), 1000) == [1235, 0, None, None]
    assert integers(np.array([True, False])) == [1, 0]


@given(st.integers(0, 5000), st.integers(2, 600))
def test_evenly_keeps_the_ends_and_the_limit(count: int, most: int) -> None:
    kept = evenly(count, most)
    assert len(kept) == min(count, most)
    assert (np.diff(kept) > 0).all()
    if count:
        assert kept[0] == 0
        assert kept[-1] == count - 1
    if count > most:
        assert np.diff(kept).max() - np.diff(kept).min() <= 1


@given(arrays(float, st.integers(1, 400), elements=st.floats(-1e3, 1e3) | st.just(np.nan)), st.integers(12, 100))
def test_a_dip_of_one_tick_is_kept(values: np.ndarray, most: int) -> None:
    kept = with_extremes(len(values), most, (values,), (-values,))
    assert len(kept) <= most
    known = values[np.isfinite(values)]
    if len(known):
        assert np.nanmin(values[kept]) == known.min()


@given(arrays(float, st.tuples(st.integers(2, 60), st.just(2)), elements=st.floats(-50, 50)), st.floats(0.001, 5))
def test_a_simplified_path_is_no_farther_than_the_tolerance(points: np.ndarray, tolerance: float) -> None:
    kept = simplified(points, tolerance)
    assert (kept[0] == points[0]).all()
    assert (kept[-1] == points[-1]).all()
    for point in points:
        assert min(_distance(point, a, b) for a, b in pairwise(kept)) <= tolerance + 1e-9


def test_a_straight_path_keeps_its_ends_only() -> None:
    line = np.column_stack([np.linspace(0, 10, 101), np.linspace(0, 5, 101)])
    assert simplified(line, 0.01) == pytest.approx(np.array([[0, 0], [10, 5]]))


def _distance(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    leg = b - a
    squared = float(leg @ leg)
    share = float(np.clip((point - a) @ leg / squared, 0, 1)) if squared > 0.0 else 0.0
    return float(np.hypot(*(point - a - share * leg)))
