"""Where things were at any time: sampled paths of many ids, interpolated, never across a gap."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.frames import wrap_angle
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

EDGE_TOLERANCE_NS = 1_000_000
"""A path still answers this long before its first and after its last sample, and on either side of a
gap: stamps written with few decimals round to either side."""


class Paths:
    """Samples of many ids, answered in bulk.

    ids, stamp_ns: (m,) int64, any order, no (id, stamp) twice. values: (m, k); column
    `angle_column`, if any, is an angle in radians and is interpolated along the shortest arc. A
    pair of samples more than `max_gap_ns` apart is a gap.
    """

    def __init__(
        self, ids: IntArray, stamp_ns: IntArray, values: FloatArray, max_gap_ns: int, angle_column: int | None = None
    ) -> None:
        order = np.lexsort((stamp_ns, ids))
        self.ids, rank = np.unique(ids[order], return_inverse=True)
        self._values = values[order]
        self._angle = angle_column
        self._max_gap_ns = max_gap_ns
        self._time_ns = stamp_ns[order]
        # One sorted key for all paths: each has its own stretch of the axis, where times are counted, not
        # measured, for a path's number times a stretch of nanoseconds may exceed int64.
        self._times_ns = np.unique(self._time_ns)
        self._key = rank * (len(self._times_ns) + 1) + np.searchsorted(self._times_ns, self._time_ns)
        self._first = np.searchsorted(rank, np.arange(len(self.ids)))
        self._last = np.searchsorted(rank, np.arange(len(self.ids)), side="right") - 1
        self.start_ns = self._time_ns[self._first]
        self.end_ns = self._time_ns[self._last]

    def at(self, ids: IntArray, stamp_ns: IntArray) -> tuple[FloatArray, BoolArray]:
        """The values (q, k) of `ids` (q,) at `stamp_ns` (q,), and (q,) whether they are known.

        Unknown ids, times outside a path and times within a gap give NaN and False.
        """
        result = np.full((len(ids), self._values.shape[1]), np.nan)
        if not len(self.ids):
            return result, np.zeros(len(ids), dtype=bool)
        rank = np.minimum(np.searchsorted(self.ids, ids), len(self.ids) - 1)
        begun = stamp_ns >= self.start_ns[rank] - EDGE_TOLERANCE_NS
        known = (self.ids[rank] == ids) & begun & (stamp_ns <= self.end_ns[rank] + EDGE_TOLERANCE_NS)
        rank = rank[known]
        time = np.clip(stamp_ns[known], self.start_ns[rank], self.end_ns[rank])
        place = rank * (len(self._times_ns) + 1) + np.searchsorted(self._times_ns, time)
        after = np.searchsorted(self._key, place)
        exact = self._time_ns[after] == time
        before = np.where(exact, after, after - 1)
        since, until = time - self._time_ns[before], self._time_ns[after] - time
        gap = since + until
        # At a gap's edges the nearer sample answers alone.
        after = np.where((gap > self._max_gap_ns) & (since <= EDGE_TOLERANCE_NS), before, after)
        before = np.where((gap > self._max_gap_ns) & (until <= EDGE_TOLERANCE_NS), after, before)
        result[known] = self._blend(before, after, since / np.maximum(gap, 1))
        bridged = (gap <= self._max_gap_ns) | (np.minimum(since, until) <= EDGE_TOLERANCE_NS)
        found = np.flatnonzero(known)
        result[found[~bridged]] = np.nan
        known[found[~bridged]] = False
        return result, known

    def _blend(self, before: IntArray, after: IntArray, weight: FloatArray) -> FloatArray:
        step = self._values[after] - self._values[before]
        if self._angle is not None:
            step[:, self._angle] = wrap_angle(step[:, self._angle])
        blended: FloatArray = self._values[before] + weight[:, None] * step
        return blended

    def present(self, stamp_ns: int) -> tuple[IntArray, FloatArray]:
        """The ids whose paths are known at this time, ascending, and their values (q, k)."""
        candidates = self.ids[
            (self.start_ns - EDGE_TOLERANCE_NS <= stamp_ns) & (stamp_ns <= self.end_ns + EDGE_TOLERANCE_NS)
        ]
        values, known = self.at(candidates, np.full(len(candidates), stamp_ns, dtype=np.int64))
        return candidates[known], values[known]
