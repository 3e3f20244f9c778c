"""What is left out so that a page stays small, and numbers as short JSON. Pure functions of arrays."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

MILLI = 1000
"""Metres to millimetres, radians to milliradians: the page's lengths and angles are integers of these."""


def integers(values: FloatArray | IntArray | BoolArray, scale: float = 1) -> list[int | None]:
    """Values times `scale`, rounded, row by row; None where a value is not finite."""
    numbers = np.asarray(values, dtype=float).ravel() * scale
    finite = np.isfinite(numbers)
    if finite.all():
        return np.rint(numbers).astype(np.int64).tolist()  # type: ignore[no-any-return]
    whole = np.rint(np.where(finite, numbers, 0.0)).astype(np.int64).tolist()
    return [value if known else None for value, known in zip(whole, finite.tolist(), strict=True)]


def evenly(count: int, most: int) -> IntArray:
    """At most `most` >= 2 indices of range(count), evenly spread, the first and the last among them."""
    if count <= most:
        return np.arange(count, dtype=np.int64)
    return np.unique(np.rint(np.linspace(0, count - 1, most)).astype(np.int64))


def stride_for(count: int, most: int) -> int:
    """The smallest step that leaves at most `most` of `count` things."""
    return max(1, -(-count // most))


def with_extremes(count: int, most: int, lowest: Iterable[FloatArray], highest: Iterable[FloatArray]) -> IntArray:
    """About `most` indices of range(count), ascending: evenly spread, and where in each span between them each of these
    arrays (count,) is lowest or highest. A dip of one tick is not lost."""
    low, high = list(lowest), list(highest)
    wanted = len(low) + len(high) + 1
    if count <= most:
        return np.arange(count, dtype=np.int64)
    edges = evenly(count, max(2, most // wanted))
    kept = [edges]
    for values, worst in [*((v, -np.inf) for v in map(np.negative, low)), *((v, -np.inf) for v in high)]:
        filled = np.where(np.isfinite(values), values, worst)
        kept.append(_highest_between(filled, edges))
    return np.unique(np.concatenate(kept))


def _highest_between(values: FloatArray, edges: IntArray) -> IntArray:
    spans = zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    return np.array([first + int(np.argmax(values[first:last])) for first, last in spans], dtype=np.int64)
