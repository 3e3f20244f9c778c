"""Paired differences of rates: against the equation they solve, Wilson's interval, and how often they hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from adcbf_cli.core.evaluation.intervals import wilson
from adcbf_cli.core.evaluation.rare_rates import difference_interval, rule_of_three, standard_errors

Z = 1.959963984540054
COUNTS = st.tuples(st.integers(0, 40), st.integers(0, 40), st.integers(0, 200)).filter(lambda c: sum(c) > 0)


def likeliest(first: int, second: int, n: int, supposed: float) -> float:
    """The likeliest rate of pairs with the event in the second only, given the difference; by search."""
    low, high = max(0.0, -supposed), (1 - supposed) / 2

    def unlikelihood(rate: float) -> float:
        terms = ((first, rate + supposed), (second, rate), (n - first - second, 1 - 2 * rate - supposed))
        return -sum(count * math.log(max(p, 1e-300)) for count, p in terms if count)

    found = minimize_scalar(unlikelihood, bounds=(low, high), method="bounded", options={"xatol": 1e-12})
    return float(min((found.x, low, high), key=unlikelihood))


@pytest.mark.parametrize(("first", "second", "n"), [(3, 1, 20), (12, 2, 300), (0, 7, 50), (25, 20, 60), (1, 0, 1000)])
def test_the_bounds_are_where_the_seen_difference_is_just_too_far(first: int, second: int, n: int) -> None:
    for bound in difference_interval(first, second, n) or ():
        rate = likeliest(first, second, n, bound)
        variance = n * (2 * rate + bound * (1 - bound))
        assert abs(first - second - n * bound) / math.sqrt(variance) == pytest.approx(Z, rel=1e-4)


@given(COUNTS)
@settings(max_examples=200, deadline=None)
def test_the_interval_holds_the_seen_difference_and_turns_with_its_sign(counts: tuple[int, int, int]) -> None:
    first, second, rest = counts
    n = first + second + rest
    low, high = difference_interval(first, second, n) or (np.nan, np.nan)
    assert -1 <= low <= (first - second) / n <= high <= 1
    assert low < high
    assert difference_interval(second, first, n) == (-high, -low)
    more = difference_interval(2 * first, 2 * second, 2 * n) or (np.nan, np.nan)
    assert more[1] - more[0] < high - low


def test_where_no_pair_differs_it_is_as_wide_as_wilsons_for_no_event() -> None:
    for n in (1, 20, 1000):
        bound = (wilson(0, n) or (0, 0))[1]
        assert difference_interval(0, 0, n) == pytest.approx((-bound, bound))
    assert (difference_interval(0, 0, 1000) or (0, 0))[1] == pytest.approx(0.003827, abs=1e-6)


def test_against_one_that_never_has_the_event_it_is_wilsons() -> None:
    assert difference_interval(12, 0, 300) == pytest.approx(wilson(12, 300), abs=1e-9)


def test_no_pairs_no_interval() -> None:
    assert difference_interval(0, 0, 0) is None


def test_it_covers_the_difference_about_as_often_as_it_says() -> None:
    """Rates of 4 % and 10 %, 60 pairs, 1500 samples: where the bootstrap would often see no pair differ."""
    drawn = np.random.default_rng(7).multinomial(60, [0.09, 0.03, 0.88], size=1500)
    held = 0
    for first, second, _ in drawn.tolist():
        low, high = difference_interval(first, second, 60) or (np.nan, np.nan)
        held += low <= 0.06 <= high
    assert 0.93 <= held / 1500 <= 0.975


def test_standard_errors_are_nought_at_the_seen_difference() -> None:
    assert standard_errors(9, 3, 60, 0.1) == pytest.approx(0.0, abs=1e-12)
    assert standard_errors(9, 3, 60, 0.2) > 0 > standard_errors(9, 3, 60, 0.0)


def test_the_rule_of_three_is_what_it_says() -> None:
    assert rule_of_three(1000) == 0.003
    assert (1 - rule_of_three(1000)) ** 1000 == pytest.approx(0.05, abs=0.001)
    assert rule_of_three(2) == 1.0
