"""Split-conformal calibration of predictions: how far off they really were, step by step.

A residual is the distance from a predicted position to where the track was later seen. The radius
that covers the next one with probability p, if residuals are exchangeable, is the ceil((n + 1) p)-th
smallest of n (Vovk, Gammerman, Shafer 2005; Papadopoulos et al. 2002). Too few residuals for p
((n + 1) p > n) give no radius: NaN. Standing and moving tracks have pools of their own, as they are
predicted differently. Residuals of neighbouring frames are not independent; the coverage reached
on a real log is a matter of measurement, not a guarantee.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, IntArray, Predictions, Tracks, TrackStatus

GROUPS = ("moving", "static")
FORMAT = "adcbf-calibration-1"
MAX_FILE_STEPS = 1000
FIRST_CAPACITY = 256


def conformal_quantile(residuals: FloatArray, probability: float) -> float:
    """The split-conformal radius of residuals (n,), NaN where they are too few for the probability."""
    rank = math.ceil((len(residuals) + 1) * probability - 1e-9)
    if rank > len(residuals):
        return math.nan
    return float(np.partition(residuals, rank - 1)[rank - 1])


@dataclass(frozen=True, slots=True)
class Calibration:
    """Conformal radii (2, N) in metres and sample counts (2, N): rows moving, static; NaN: too few."""

    probability: float
    step_s: float
    radius_m: FloatArray
    samples: IntArray
    source: str

    def to_dict(self) -> dict[str, object]:
        """For a JSON file; NaN becomes null."""
        return {
            "format": FORMAT,
            "probability": self.probability,
            "step_s": self.step_s,
            "source": self.source,
            "groups": {
                name: {
                    "radius_m": [None if math.isnan(r) else float(r) for r in self.radius_m[row]],
                    "samples": [int(s) for s in self.samples[row]],
                }
                for row, name in enumerate(GROUPS)
            },
        }

    @classmethod
    def from_dict(cls, data: object) -> Calibration:
        """The inverse of `to_dict`; AdcbfError where the content is not a calibration."""
        try:
            if not isinstance(data, dict) or data["format"] != FORMAT:
                raise ValueError(f"its format is not {FORMAT}")
            groups = [data["groups"][name] for name in GROUPS]
            radius = np.array([[math.nan if r is None else float(r) for r in g["radius_m"]] for g in groups])
            samples = np.array([[int(s) for s in g["samples"]] for g in groups], dtype=np.int64)
            result = cls(float(data["probability"]), float(data["step_s"]), radius, samples, str(data["source"]))
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise AdcbfError(f"not a calibration file ({error}); make one with `adcbf predict`") from error
        result._check()
        return result

    def _check(self) -> None:
        known = self.radius_m[~np.isnan(self.radius_m)]
        sound = (
            self.radius_m.ndim == 2
            and self.radius_m.shape == self.samples.shape
            and 1 <= self.radius_m.shape[1] <= MAX_FILE_STEPS
            and 0 < self.probability < 1
            and 0 < self.step_s < math.inf
            and bool(np.isfinite(known).all() and (known >= 0).all() and (self.samples >= 0).all())
        )
        if not sound:
            raise AdcbfError("not a calibration file (its numbers are out of range or of unequal length)")


class ResidualPool:
    """The newest residuals of each group and step, at most `window` of them."""

    def __init__(self, steps: int, window: int) -> None:
        self._window = window
        self._values = np.zeros((len(GROUPS), steps, min(window, FIRST_CAPACITY)))
        self.count = np.zeros((len(GROUPS), steps), dtype=np.int64)
        """(2, N) residuals ever added."""

    def add(self, group: int, step: int, residuals: FloatArray) -> None:
        """Residuals (n,) of the prediction `step` (from 0) ahead."""
        residuals = residuals[-self._window :]
        start = int(self.count[group, step])
        self._reserve(min(start + len(residuals), self._window))
        places = (start + np.arange(len(residuals))) % self._window
        self._values[group, step, places] = residuals
        self.count[group, step] += len(residuals)

    @property
    def samples(self) -> IntArray:
        """(2, N) residuals held."""
        return np.minimum(self.count, self._window)

    def quantiles(self, probability: float) -> FloatArray:
        """(2, N) conformal radii."""
        samples = self.samples
        return np.array(
            [
                [conformal_quantile(row[:n], probability) for row, n in zip(rows, counts, strict=True)]
                for rows, counts in zip(self._values, samples, strict=True)
            ]
        )

    def _reserve(self, needed: int) -> None:
        held = self._values.shape[2]
        if needed > held:
            size = min(max(needed, 2 * held), self._window)
            grown = np.zeros((*self._values.shape[:2], size))
            grown[:, :, :held] = self._values
            self._values = grown


@dataclass(frozen=True, slots=True)
class _Pending:
    """Predictions of one frame that still wait for their future."""

    stamp_ns: int
    track_id: IntArray
    is_static: BoolArray
    position_m: FloatArray


class ResidualCollector:
    """Holds predictions until their tracks are seen at the predicted times, and pools the residuals.

    Only what has been seen by the current frame is used. Between two frames in both of which a track
    was seen, its filtered positions are interpolated to the predicted times.
    """

    def __init__(self, steps: int, step_s: float, window: int) -> None:
        self.pool = ResidualPool(steps, window)
        self._steps = steps
        self._step_ns = round(step_s * 1e9)
        self._pending: deque[_Pending] = deque()
        self._last: tuple[int, IntArray, FloatArray] | None = None

    def observe(self, tracks: Tracks) -> None:
        """Compares this frame's tracks with what was predicted for the time since the last one."""
        seen = (tracks.status == TrackStatus.CONFIRMED) & (tracks.cluster_id != NO_ID)
        now = (tracks.stamp_ns, tracks.track_id[seen], tracks.state[seen, :2])
        last, self._last = self._last, now
        if last is None or tracks.stamp_ns <= last[0]:
            return
        both, before, after = np.intersect1d(last[1], now[1], assume_unique=True, return_indices=True)
        for pending in self._pending:
            self._compare(pending, both, (last[0], last[2][before]), (now[0], now[2][after]))
        while self._pending and self._pending[0].stamp_ns + self._steps * self._step_ns <= tracks.stamp_ns:
            self._pending.popleft()

    def remember(self, predictions: Predictions) -> None:
        """Keeps a frame's predictions until their horizon has passed."""
        if len(predictions):
            self._pending.append(
                _Pending(
                    predictions.stamp_ns,
                    predictions.track_id,
                    predictions.is_static,
                    predictions.position_m[:, :, :2],
                )
            )

    def _compare(
        self,
        pending: _Pending,
        seen_id: IntArray,
        before: tuple[int, FloatArray],
        after: tuple[int, FloatArray],
    ) -> None:
        first = (before[0] - pending.stamp_ns) // self._step_ns + 1
        last = min((after[0] - pending.stamp_ns) // self._step_ns, self._steps)
        if first > last or not len(seen_id):
            return
        _, rows, seen = np.intersect1d(pending.track_id, seen_id, assume_unique=True, return_indices=True)
        for k in range(max(first, 1), last + 1):
            share = (pending.stamp_ns + k * self._step_ns - before[0]) / (after[0] - before[0])
            place = before[1][seen] + share * (after[1][seen] - before[1][seen])
            residual = np.linalg.norm(pending.position_m[rows, k - 1] - place, axis=1)
            static = pending.is_static[rows]
            for group, members in enumerate((~static, static)):
                self.pool.add(group, k - 1, residual[members])
