"""What a driving metric is made of: its declaration, the drive it looks at, and plain reductions.

A tick stands for the time until the next one, the last tick for none: durations then add up to
the drive's own, however the ticks are spaced.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from adcbf_cli.core.config import PlanningConfig, ReplayConfig
from adcbf_cli.core.replay.records import Drive, Result
from adcbf_cli.core.types import BoolArray, FloatArray


class Applies(enum.StrEnum):
    """The drives that a metric exists for."""

    DRIVEN = "closed loop, logged drive"
    CLOSED = "closed loop"
    PLANNED = "closed loop, open loop"
    OPEN = "open loop"


@dataclass(frozen=True, slots=True)
class Evidence:
    """One drive and the settings that its metrics depend on."""

    drive: Drive
    replay: ReplayConfig
    planning: PlanningConfig

    @property
    def elapsed_s(self) -> FloatArray:
        """(T,) seconds since the first tick."""
        stamps = self.drive.stamp_ns
        return np.asarray((stamps - stamps[:1]) / 1e9, dtype=np.float64)

    @property
    def held_s(self) -> FloatArray:
        """(T,) seconds that each tick stands for."""
        return np.append(np.diff(self.elapsed_s), np.zeros(min(len(self.drive.stamp_ns), 1)))

    @property
    def arrived(self) -> bool:
        """Whether the drive covers the way to its goal, as the logged one does by definition."""
        if self.drive.result is None:
            return self.drive.steps is None
        return self.drive.result is Result.SUCCESS

    def applies(self, to: Applies) -> bool:
        drive = self.drive
        return {
            Applies.DRIVEN: drive.result is not None or drive.steps is None,
            Applies.CLOSED: drive.result is not None,
            Applies.PLANNED: drive.steps is not None,
            Applies.OPEN: drive.plan_error_m is not None,
        }[to]


@dataclass(frozen=True, slots=True)
class DriveMetric:
    """One number of a drive.

    unit: "1" for shares. better: which way an improvement goes. is_event: 0 or 1 a drive, so that
    its mean over drives is a rate. measure: gives None where the drive holds no evidence.
    """

    name: str
    unit: str
    better: Literal["lower", "higher", "neither"]
    applies: Applies
    window: str
    definition: str
    measure: Callable[[Evidence], float | None]
    is_event: bool = False


def known(values: FloatArray) -> FloatArray:
    """The finite ones, flat."""
    return np.asarray(values[np.isfinite(values)], dtype=np.float64)


def lowest(values: FloatArray) -> float | None:
    finite = known(values)
    return float(finite.min()) if finite.size else None


def highest(values: FloatArray) -> float | None:
    finite = known(values)
    return float(finite.max()) if finite.size else None


def mean(values: FloatArray) -> float | None:
    finite = known(values)
    return float(finite.mean()) if finite.size else None


def rms(values: FloatArray) -> float | None:
    finite = known(values)
    return float(np.sqrt(np.mean(finite**2))) if finite.size else None


def quantile(values: FloatArray, share: float) -> float | None:
    """Linear between order statistics, as numpy's default."""
    finite = known(values)
    return float(np.quantile(finite, share)) if finite.size else None


def share(true: BoolArray) -> float | None:
    return float(true.mean()) if true.size else None
