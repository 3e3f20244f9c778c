"""95 % intervals over independent drives: the bootstrap of a mean, and Wilson's for a rate."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence

import numpy as np

RESAMPLES = 1000
MIN_DRIVES = 5
"""With fewer there is no bootstrap interval: it would say more about chance than about the planner."""
_Z = 1.959963984540054


def bootstrap_mean(values: Sequence[float], name: str) -> tuple[float, float] | None:
    """95 % percentile interval of the mean of `values`, drawn anew with a seed that `name` gives; None with
    fewer than MIN_DRIVES values. Equal names and numbers of values draw equal resamples."""
    n = len(values)
    if n < MIN_DRIVES:
        return None
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    drawn = rng.multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES)
    middle = math.fsum(values) / n  # equal values then have an interval of no width, to the last digit
    low, high = middle + np.quantile(drawn @ (np.asarray(values) - middle) / n, [0.025, 0.975])
    return float(low), float(high)


def wilson(events: int, n: int) -> tuple[float, float] | None:
    """95 % score interval of a rate (Wilson 1927); None without trials."""
    if not n:
        return None
    rate, z2 = events / n, _Z * _Z
    middle = (rate + z2 / (2 * n)) / (1 + z2 / n)
    half = _Z / (1 + z2 / n) * math.sqrt(rate * (1 - rate) / n + z2 / (4 * n * n))
    # With none or all of the trials, one end is the rate itself, which rounding must not push to its other side.
    return max(0.0, middle - half) if events else 0.0, min(1.0, middle + half) if events < n else 1.0
