"""Quantiles of arbitrarily many numbers in bounded memory: exact for as long as they fit."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.types import FloatArray, IntArray

MAX_KEPT = 65_536
"""So many different numbers are kept apart (a megabyte); with more, they are rounded to a grid."""
FIRST_STEP = 1e-6
"""The grid's first spacing, doubled until the numbers fit."""
_WAITING = 8192


class QuantileSums:
    """Numbers go in, quantiles come out. Quantiles are exact up to `resolution`, which is zero until
    more than MAX_KEPT different numbers have come, and the grid's spacing from then on (rounding to it
    and to all finer grids before it moves a number by half of each spacing at most)."""

    def __init__(self) -> None:
        self._values: FloatArray = np.zeros(0)
        self._counts: IntArray = np.zeros(0, dtype=np.int64)
        self._waiting: list[FloatArray] = []
        self._wait = 0
        self._step = 0.0

    def add(self, values: FloatArray) -> None:
        """Adds finite numbers (k,)."""
        self._waiting.append(values)
        self._wait += len(values)
        if self._wait >= _WAITING:
            self._gather()

    @property
    def count(self) -> int:
        return int(self._counts.sum()) + self._wait

    @property
    def resolution(self) -> float:
        """The largest error that rounding may have brought in."""
        return self._step

    def quantile(self, q: float) -> float | None:
        """As numpy's (linear between neighbours), or None without numbers."""
        self._gather()
        if not len(self._values):
            return None
        place = (self.count - 1) * q
        ranks = np.array([np.floor(place), np.ceil(place)])
        ends = self._values[np.searchsorted(np.cumsum(self._counts), ranks, side="right")]
        return float(np.quantile(ends, place - ranks[0]))

    def _gather(self) -> None:
        values = np.concatenate([self._values, *self._waiting])
        counts = np.concatenate([self._counts, np.ones(self._wait, dtype=np.int64)])
        self._waiting, self._wait = [], 0
        self._put(values, counts)
        while len(self._values) > MAX_KEPT:
            self._step = 2 * self._step or FIRST_STEP
            self._put(self._values, self._counts)

    def _put(self, values: FloatArray, counts: IntArray) -> None:
        """Keeps each different number once, rounded to the grid in force."""
        if self._step:
            values = np.round(values / self._step) * self._step
        self._values, place = np.unique(values, return_inverse=True)
        self._counts = np.bincount(place, counts, len(self._values)).astype(np.int64)
