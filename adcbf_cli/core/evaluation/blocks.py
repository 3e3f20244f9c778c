"""Means and totals with honest intervals: sums by block, and the bootstrap over blocks.

Samples of one object at neighbouring times are alike, so an interval that took them for
independent would be far too narrow. A block is one object in one stretch of time, or all that is
in one stretch; the bootstrap draws whole blocks.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

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
_TIME = 0xFFFFFFFF
"""The part of a block's key that says which stretch of time it is."""

Form = Literal["mean", "root_mean", "total"]
"""What a metric is of its blocks' sums: their sum over that of the counts, its square root, or their sum alone."""


def in_form(form: Form, sums: FloatArray, counts: FloatArray) -> FloatArray:
    """The metric's value from sums and counts over the same blocks; counts above 0."""
    if form == "total":
        return sums
    means: FloatArray = sums / counts
    return np.sqrt(means) if form == "root_mean" else means


def block_keys(ids: IntArray, stamp_ns: IntArray, block_ns: int) -> IntArray:
    """(k,) int64 keys, one for each id (below 2**31) and time block. Times of one log only."""
    return (ids << 32) | ((stamp_ns // block_ns) & _TIME)


def stretch_key(stamp_ns: int, block_ns: int) -> int:
    """The key of all that is in one time block."""
    return int(block_keys(np.zeros(1, dtype=np.int64), np.array([stamp_ns]), block_ns)[0])


@dataclass(frozen=True, slots=True)
class Blocks:
    """What a metric is made of, so that two runs on one log can be paired block by block.

    keys: (k,) int64, ascending, the same in every run for the same block. sums, counts: (k,). dealt: the keys are
    hands that blocks were dealt into. form: what the metric is of them.
    """

    keys: IntArray
    sums: FloatArray
    counts: FloatArray
    dealt: bool
    form: Form


class BlockSums:
    """Running sums and counts of named quantities, by block.

    own_ids: the blocks' ids are the run's own (tracks), and say nothing in another run on the same log.
    """

    def __init__(self, own_ids: bool = False) -> None:
        self._own_ids = own_ids
        self._sums: dict[str, dict[int, list[float]]] = {}
        self._times: dict[str, dict[int, list[float]]] = {}  # of names that are dealt: by hand, but of time alone
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
            self._gather(name, list(zip(keys.tolist(), total.tolist(), count.tolist(), strict=True)))

    def add_sums(self, block: int, sums: Mapping[str, tuple[float, float]]) -> None:
        """Adds to one block what is summed already: (sum, count) of each quantity. A sum may come without a count:
        something false where there was nothing to find."""
        for name, (total, count) in sums.items():
            self._gather(name, [(block, total, count)])

    def _gather(self, name: str, found: list[tuple[int, float, float]]) -> None:
        mine = self._sums.setdefault(name, {})
        if name in self._dealt:
            self._deal(name, found)
        else:
            _add_cells(mine, found)
        if len(mine) > MAX_KEPT:
            self._sums[name] = {}
            self._dealt.add(name)
            self._deal(name, [(key, s, c) for key, (s, c) in mine.items()])

    def _deal(self, name: str, found: list[tuple[int, float, float]]) -> None:
        _add_cells(self._sums[name], ((_hand(key), s, c) for key, s, c in found))
        if self._own_ids:
            _add_cells(self._times.setdefault(name, {}), ((_hand(key & _TIME), s, c) for key, s, c in found))

    def blocks(self, name: str, form: Form = "mean") -> Blocks | None:
        """The sums in a form that another run on the same log has too; None without any sample."""
        dealt = name in self._dealt
        cells = self._times.get(name, {}) if dealt and self._own_ids else self._sums.get(name, {})
        if self._own_ids and not dealt:
            by_time: dict[int, list[float]] = {}
            _add_cells(by_time, ((key & _TIME, s, c) for key, (s, c) in cells.items()))
            cells = by_time
        if not cells:
            return None
        keys = sorted(cells)
        table = np.array([cells[key] for key in keys])
        return Blocks(np.array(keys, dtype=np.int64), table[:, 0], table[:, 1], dealt, form)

    def count(self, name: str) -> int:
        return int(sum(c for _, c in self._sums.get(name, {}).values()))

    def value(self, name: str, form: Form = "mean") -> float | None:
        """The metric over all samples, or None without any."""
        cells = self._sums.get(name, {})
        total, n = (float(sum(column)) for column in zip(*cells.values(), strict=True)) if cells else (0.0, 0.0)
        return float(in_form(form, np.array(total), np.array(n))) if n else None

    def interval(self, name: str, form: Form = "mean") -> tuple[float, float] | None:
        """95 % percentile interval of the metric over block resamples (seeded by the name)."""
        cells = self._sums.get(name, {})
        if len(cells) < MIN_BLOCKS:
            return None
        table = np.array([cells[key] for key in sorted(cells)])
        drawn = _resampled_sums(table, name)
        drawn = drawn[drawn[:, 1] > 0]
        low, high = np.quantile(in_form(form, drawn[:, 0], drawn[:, 1]), [0.025, 0.975])
        return float(low), float(high)


def paired_interval(base: Blocks, other: Blocks, name: str) -> tuple[tuple[float, float], int] | None:
    """95 % percentile interval of a metric in `other` minus the same in `base`, over resamples of the blocks that
    either has, drawn alike for both (seeded by the name), and how many blocks (or hands, where either was dealt) that
    are; None with fewer than MIN_BLOCKS."""
    if base.dealt or other.dealt:
        base, other = _in_hands(base), _in_hands(other)
    keys = np.union1d(base.keys, other.keys)
    if len(keys) < MIN_BLOCKS:
        return None
    table = np.zeros((len(keys), 4))
    for blocks, column in ((base, 0), (other, 2)):
        rows = np.searchsorted(keys, blocks.keys)
        table[rows, column], table[rows, column + 1] = blocks.sums, blocks.counts
    drawn = _resampled_sums(table, name)
    drawn = drawn[(drawn[:, 1] > 0) & (drawn[:, 3] > 0)]
    values = in_form(base.form, drawn[:, [0, 2]], drawn[:, [1, 3]])
    low, high = np.quantile(values[:, 1] - values[:, 0], [0.025, 0.975])
    return (float(low), float(high)), len(keys)


def _in_hands(blocks: Blocks) -> Blocks:
    if blocks.dealt:
        return blocks
    cells: dict[int, list[float]] = {}
    rows = zip(blocks.keys.tolist(), blocks.sums.tolist(), blocks.counts.tolist(), strict=True)
    _add_cells(cells, ((_hand(key), s, c) for key, s, c in rows))
    table = np.array([cells[hand] for hand in sorted(cells)])
    return Blocks(np.array(sorted(cells), dtype=np.int64), table[:, 0], table[:, 1], True, blocks.form)


def _add_cells(cells: dict[int, list[float]], more: Iterable[tuple[int, float, float]]) -> None:
    """Adds (key, sum, count) triples to their cells."""
    for key, s, c in more:
        if c or s:
            cell = cells.setdefault(key, [0.0, 0.0])
            cell[0] += s
            cell[1] += c


def _hand(key: int) -> int:
    """The hand that a block's key falls into: by a checksum, so that neighbours are apart."""
    return zlib.crc32(key.to_bytes(8, "little", signed=True)) % MAX_BLOCKS


def _resampled_sums(table: FloatArray, name: str) -> FloatArray:
    """(RESAMPLES, columns) column sums of (blocks, columns), over blocks drawn with a seed that `name` gives."""
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    if len(table) > MAX_BLOCKS:  # at random: dealing in order would even out what differs between objects
        hands = np.zeros((MAX_BLOCKS, table.shape[1]))
        np.add.at(hands, rng.permutation(len(table)) % MAX_BLOCKS, table)
        table = hands
    share = np.full(len(table), 1.0 / len(table))
    draws = [rng.multinomial(len(table), share, size=_CHUNK) @ table for _ in range(RESAMPLES // _CHUNK)]
    sums: FloatArray = np.concatenate(draws)
    return sums
