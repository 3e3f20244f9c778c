"""Rates of events that hardly ever happen: how large one may be that was never seen, and differences of two.

A bootstrap over pairs of which none differ would call the difference exactly nothing; a score interval
still says how large it may be.
"""

from __future__ import annotations

import math

_Z = 1.959963984540054
_HALVINGS = 60


def rule_of_three(n: int) -> float:
    """What a rate stays below with 95 % confidence where n trials saw no event (Hanley, Lippman-Hand 1983)."""
    return min(3 / n, 1.0)


def difference_interval(only_first: int, only_second: int, n: int) -> tuple[float, float] | None:
    """95 % score interval (Tango 1998) of the first rate minus the second, over n pairs of trials.

    only_first, only_second: pairs in which the event came in that one only. None without pairs.
    """
    if not n:
        return None
    high = _upper(only_first, only_second, n)
    return -_upper(only_second, only_first, n), high


def _upper(first: int, second: int, n: int) -> float:
    """The largest difference from which the seen one is not more than 1.96 standard errors away."""
    low, high = (first - second) / n, 1.0
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if standard_errors(first, second, n, middle) > _Z:
            high = middle
        else:
            low = middle
    return high


def standard_errors(first: int, second: int, n: int, supposed: float) -> float:
    """How far below a supposed difference of rates (-1, 1) the seen one is, in its standard errors there.

    The variance takes the likeliest rate of pairs in which only the second has the event, given the difference:
    the larger root of 2 n q^2 - (first + second - (2 n - first + second) supposed) q - second supposed
    (1 - supposed) = 0.
    """
    linear = first + second - (2 * n - first + second) * supposed
    constant = second * supposed * (1 - supposed)
    rate = (linear + math.sqrt(max(linear * linear + 8 * n * constant, 0.0))) / (4 * n)
    variance = n * (2 * rate + supposed * (1 - supposed))
    short = n * supposed - (first - second)
    if variance <= 0:
        return math.inf if short > 0 else 0.0
    return short / math.sqrt(variance)
