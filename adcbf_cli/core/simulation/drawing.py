"""Random values in a scenario file, drawn with a seed.

Wherever a value stands, the file may hold `{uniform: [a, b]}`, `{integer: [a, b]}` (both ends included)
or `{choice: [...]}`. Each value comes from a generator of its own, named by the seed and by the value's
place in the file, so that one change leaves the other values as they were.
"""

from __future__ import annotations

import hashlib
import math
from typing import Any

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.simulation.randomness import Purpose, generator

MAX_DEPTH = 20
MAX_VALUES = 1_000_000
"""Values in a drawn scenario: a file whose aliases hold each other is refused before it fills the memory."""

KINDS = ("uniform", "integer", "choice")

Place = tuple[str | int, ...]
"""The keys that lead to a value in the file."""


class Drawing:
    """Draws the random values of one scene. Raises UsageError naming the place of a wrong one."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._values = 0
        self._drawn_values = 0

    def value(self, node: Any, place: Place, copy: int = 0, attempt: int = 0) -> Any:
        """What a node of the file becomes: mappings and lists with every random value in them drawn.

        copy, attempt: each gives other values; for entries that are repeated, and for drawing again.
        """
        self._values += 1
        if self._values > MAX_VALUES or len(place) > MAX_DEPTH:
            raise UsageError(f"{dotted(place[:4])}: holds too many values, or too deep ones, for a scenario")
        if is_random(node):
            return self._drawn(node, place, copy, attempt)
        if isinstance(node, dict):
            return {key: self.value(inner, (*place, key), copy, attempt) for key, inner in node.items()}
        if isinstance(node, list):
            return [self.value(inner, (*place, index), copy, attempt) for index, inner in enumerate(node)]
        return node

    def varies(self, node: Any, place: Place) -> bool:
        """Whether a node of the file is or holds a random value."""
        before = self._drawn_values
        self.value(node, place)
        return self._drawn_values > before

    def _drawn(self, node: dict[str, Any], place: Place, copy: int, attempt: int) -> Any:
        self._drawn_values += 1
        ((kind, given),) = node.items()
        rng = generator(self.seed, Purpose.SCENE, _number_of(place, copy, attempt))
        if kind == "choice":
            if not isinstance(given, list) or not given:
                raise UsageError(f"{dotted(place)}: choice takes a list of at least one value")
            index = int(rng.integers(len(given)))
            return self.value(given[index], (*place, "choice", index), copy, attempt)
        low, high = _bounds(kind, given, place)
        if kind == "integer":
            return int(rng.integers(int(low), int(high) + 1))
        return _legible(low + (high - low) * rng.random(), low, high)


def is_random(node: Any) -> bool:
    """Whether a node of the file is itself a random value."""
    return isinstance(node, dict) and len(node) == 1 and next(iter(node)) in KINDS


def dotted(place: Place) -> str:
    """A place as messages write it: movers.2.path.speed_mps."""
    return ".".join(str(part) for part in place)


def _bounds(kind: str, given: Any, place: Place) -> tuple[float, float]:
    allowed = (int,) if kind == "integer" else (int, float)
    numbers = isinstance(given, list) and len(given) == 2 and all(type(value) in allowed for value in given)
    if not numbers or not all(math.isfinite(value) and abs(value) <= 1e9 for value in given) or given[0] > given[1]:
        what = "whole numbers" if kind == "integer" else "numbers"
        raise UsageError(f"{dotted(place)}: {kind} takes [lowest, highest], two {what}")
    return given[0], given[1]


def _legible(value: float, low: float, high: float) -> float:
    """A value between two others without the digits beyond a ten-millionth of their distance."""
    if low == high:
        return float(low)
    rounded = round(value, 7 - math.floor(math.log10(high - low)))
    return float(min(max(rounded, low), high))


def _number_of(place: Place, copy: int, attempt: int) -> int:
    """A number for a value's place that is the same on every machine and in every run."""
    text = f"{dotted(place)}|{copy}|{attempt}"
    return int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest(), "little")
