"""Means with honest intervals: sums by block, and the bootstrap over blocks.

Samples of one object at neighbouring times are alike, so an interval that took them for
independent would be far too narrow. A block is one object in one stretch of time; the bootstrap
draws whole blocks.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from adcbf_cli.core.types import FloatArray, IntArray

RESAMPLES = 1000
MIN_BLOCKS = 5
"""With fewer blocks there is no interval: it would say more about chance than about the metric."""
MAX_BLOCKS = 200
"""More blocks than this are dealt into this many hands: the interval's width stays the same, and its
cost no longer grows with the log."""
MAX_KEPT = 2000
"""So many blocks are kept apart while sums run; then they are dealt already, by their keys, so that
memory does not grow with the log either."""
_CHUNK = 100


def block_keys(ids: IntArray, stamp_ns: IntArray, block_ns: int) -> IntArray:
    """(k,) int64 keys, one for each id (below 2**31) and time block. Times of one log only."""
    return (ids << 32) | ((stamp_ns // block_ns) & 0xFFFFFFFF)


class BlockSums:
    """Running sums and counts of named quantities, by block."""

    def __init__(self) -> None:
        self._sums: dict[str, dict[int, list[float]]] = {}
        self._dealt: set[str] = set()

    def add(self, blocks: IntArray, quantities: Mapping[str, FloatArray]) -> None:
        """Adds samples: `blocks` (k,) says where each belongs, a quantity is (k,) or (k, steps) with
        NaN where there is no sample."""
        if not len(blocks):
            return
        keys, place = np.unique(blocks, return_inverse=True)
        for name, values in quantities.items():
            table = values.reshape(len(blocks), -1)
            known = np.isfinite(table)
            total = np.bincount(place, np.where(known, table, 0.0).sum(axis=1), len(keys))
            count = np.bincount(place, known.sum(axis=1), len(keys))
            places = [_hand(key) for key in keys.tolist()] if name in self._dealt else keys.tolist()
            mine = self._sums.setdefault(name, {})
            _add_cells(mine, zip(places, total.tolist(), count.tolist(), strict=True))
            if len(mine) > MAX_KEPT:
                hands: dict[int, list[float]] = {}
                self._sums[name] = hands
                _add_cells(hands, ((_hand(key), s, c) for key, (s, c) in mine.items()))
                self._dealt.add(name)

    def count(self, name: str) -> int:
        return int(sum(c for _, c in self._sums.get(name, {}).values()))

    def mean(self, name: str) -> float | None:
        """The mean over all samples, or None without any."""
        cells = self._sums.get(name, {})
        n = sum(c for _, c in cells.values())
        return sum(s for s, _ in cells.values()) / n if n else None

    def interval(self, name: str, transform: Callable[[FloatArray], FloatArray]) -> tuple[float, float] | None:
        """95 % percentile interval of `transform`(mean) over block resamples (seeded by the name)."""
        cells = self._sums.get(name, {})
        if len(cells) < MIN_BLOCKS:
            return None
        table = np.array([cells[key] for key in sorted(cells)])
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        if len(table) > MAX_BLOCKS:  # at random: dealing in order would even out what differs between objects
            hands = np.zeros((MAX_BLOCKS, 2))
            np.add.at(hands, rng.permutation(len(table)) % MAX_BLOCKS, table)
            table = hands
        share = np.full(len(table), 1.0 / len(table))
        means = np.concatenate([_resampled_means(rng, table, share) for _ in range(RESAMPLES // _CHUNK)])
        low, high = np.quantile(transform(means), [0.025, 0.975])
        return float(low), float(high)


def _add_cells(cells: dict[int, list[float]], more: Iterable[tuple[int, float, float]]) -> None:
    """Adds (key, sum, count) triples to their cells."""
    for key, s, c in more:
        if c:
            cell = cells.setdefault(key, [0.0, 0.0])
            cell[0] += s
            cell[1] += c


def _hand(key: int) -> int:
    """The hand that a block's key falls into: by a checksum, so that neighbours are apart."""
    return zlib.crc32(key.to_bytes(8, "little", signed=True)) % MAX_BLOCKS


def _resampled_means(rng: np.random.Generator, table: FloatArray, share: FloatArray) -> FloatArray:
    drawn = rng.multinomial(len(table), share, size=_CHUNK) @ table
    means: FloatArray = drawn[:, 0] / drawn[:, 1]
    return means
