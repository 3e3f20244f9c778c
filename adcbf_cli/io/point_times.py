"""Per-point times of a cloud: which field holds them, in which unit, relative to what.

Drivers store them under several names, in seconds to nanoseconds, as integers or floats, relative to the header
stamp or absolute. The rule is rko_lio's, widened to milli- and microseconds: the length of a scan tells the unit,
nearness to the header stamp or to zero tells absolute from relative. The unit is settled once a topic.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from adcbf_cli.core.types import IntArray, Notes

TIME_FIELDS = ("t", "time", "timestamp", "time_stamp", "timeStamp", "offset_time", "stamps", "stamp", "timestamps")
_NS_PER = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
_ALWAYS_NS = ("t", "offset_time")
"""As unsigned integers these are Ouster's and Livox's, in nanoseconds."""

MAX_SCAN_NS = 2_000_000_000
"""A scan does not last longer; times that say so are not times of points."""

_ENOUGH_POINTS = 100
_NEAR_NS = 10_000_000_000
_SURELY_ABSOLUTE_NS = 100_000_000_000
"""A header stamp below this (a simulator's clock) does not tell absolute times from relative ones."""


class PointTimes:
    """Turns one topic's time column into offsets from the header stamp, int64 nanoseconds."""

    def __init__(self, topic: str, notes: Notes) -> None:
        self._topic = topic
        self._notes = notes
        self._unit: str | None = None

    def offsets_ns(self, name: str, column: np.ndarray[Any, Any], stamp_ns: int) -> IntArray | None:
        """(n,) raw times of the points that are kept -> (n,) offsets; None where they make no sense."""
        if len(column) == 0:
            return np.zeros(0, dtype=np.int64)
        if column.dtype.kind == "f" and not np.isfinite(column).all():
            self._notes.warn(f"{self._topic}: per-point times hold NaN; motion within those scans is not corrected")
            return None
        if column.dtype.kind == "u" and column.dtype.itemsize == 8:
            column = column.astype(np.int64)
        low, high = column.min().item(), column.max().item()
        unit = self._unit or _unit_of(name, column.dtype.kind, low, high, stamp_ns)
        if self._unit is None and high > low and len(column) >= _ENOUGH_POINTS:
            self._unit = unit
        scale = _NS_PER[unit]
        offsets: IntArray
        if column.dtype.kind == "f":
            # Subtracting the least value first is exact, also for float64 seconds since 1970.
            offsets = np.rint((column.astype(np.float64) - low) * scale).astype(np.int64)
        else:
            offsets = (column.astype(np.int64) - low) * scale
        if offsets.max() > MAX_SCAN_NS:
            self._notes.warn(f"{self._topic}: field '{name}' spans {offsets.max() * 1e-9:.3g} s; not used as time")
            return None
        return offsets + self._start_offset_ns(low, scale, stamp_ns)

    def _start_offset_ns(self, low: float | int, scale: int, stamp_ns: int) -> int:
        """Of the earliest point, from the header stamp: its time is absolute if that is nearer than relative."""
        low_ns = _whole_ns(low, scale)
        offset_ns = low_ns if abs(low_ns) <= abs(low_ns - stamp_ns) else low_ns - stamp_ns
        if abs(offset_ns) > MAX_SCAN_NS:
            self._notes.warn(
                f"{self._topic}: per-point times are on another clock than the header; the first point is taken "
                "to be at the header's stamp"
            )
            return 0
        return offset_ns


def _whole_ns(value: float | int, scale: int) -> int:
    if isinstance(value, int):
        return value * scale
    whole = int(value // 1)
    return whole * scale + round((value - whole) * scale)


def _unit_of(name: str, kind: str, low: float | int, high: float | int, stamp_ns: int) -> str:
    """'s', 'ms', 'us' or 'ns': the unit in which absolute times meet the header stamp, else the one that makes
    the span a plausible scan."""
    if kind in "iu" and name in _ALWAYS_NS:
        return "ns"
    if stamp_ns > _SURELY_ABSOLUTE_NS:
        for unit, scale in _NS_PER.items():
            if abs(_whole_ns(low, scale) - stamp_ns) <= _NEAR_NS:
                return unit
    for unit, least in (("ns", 1e17), ("us", 1e14), ("ms", 1e11), ("s", 1e8)):
        if abs(low) >= least:  # Since 1970, on a clock that is not the header's.
            return unit
    for unit in ("s", "ms", "us"):
        if (high - low) * _NS_PER[unit] <= MAX_SCAN_NS and (kind == "f" or unit != "s"):
            return unit if high > low or kind == "f" else "ns"
    return "ns"
