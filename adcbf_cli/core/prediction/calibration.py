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
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, IntArray, Predictions, Tracks, TrackStatus

GROUPS = ("moving", "static")
FORMAT = "adcbf-calibration-1"
MAX_FILE_STEPS = 1000
FIRST_CAPACITY = 256


RANK_SLACK = 1e-9
"""(n + 1) p is a whole number for common choices, which rounding must not lift to the next."""


def conformal_quantile(residuals: FloatArray, probability: float) -> float:
    """The split-conformal radius of residuals (n,), NaN where they are too few for the probability."""
    return float(conformal_quantiles(residuals[None], probability)[0])


def conformal_quantiles(residuals: FloatArray, probability: float) -> FloatArray:
    """The radii (m,) of m sets of equally many residuals, (m, n)."""
    m, n = residuals.shape
    rank = math.ceil((n + 1) * probability - RANK_SLACK)
    if rank > n:
        return np.full(m, np.nan)
    radius: FloatArray = np.partition(residuals, rank - 1, axis=1)[:, rank - 1]
    return radius


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
    """The newest residuals of each group and step, at most `window` of them, and their quantiles.

    A quantile stays what it was for as long as it has the right number of residuals below it: so those
    numbers are kept up to date, and residuals are searched only where the quantile has moved.
    """

    def __init__(self, steps: int, window: int) -> None:
        cells = len(GROUPS) * steps
        self._steps = steps
        self._window = window
        self._values = np.zeros((cells, min(window, FIRST_CAPACITY)))
        self._count = np.zeros(cells, dtype=np.int64)
        self._probability = math.nan
        self._quantile = np.full(cells, np.nan)
        self._less = np.zeros(cells, dtype=np.int64)  # residuals below the quantile, and up to it
        self._up_to = np.zeros(cells, dtype=np.int64)

    def add(self, group: int, step: int, residuals: FloatArray) -> None:
        """Residuals (n,) of the prediction `step` (from 0) ahead."""
        self.add_all(np.full(len(residuals), group), np.full(len(residuals), step), residuals)

    def add_all(self, group: IntArray, step: IntArray, residuals: FloatArray) -> None:
        """Residuals (n,), the oldest first, each of its group and of a prediction `step` (from 0) ahead."""
        cell = group * self._steps + step
        size = np.bincount(cell, minlength=len(self._count))
        order = np.argsort(cell, kind="stable")
        cell, residuals = cell[order], residuals[order]
        place = np.arange(len(cell)) - (np.cumsum(size) - size)[cell]
        if size.max(initial=0) > self._window:
            kept = place >= size[cell] - self._window
            cell, residuals, place = cell[kept], residuals[kept], place[kept]
        place = (self._count[cell] + place) % self._window
        self._reserve(int(min((self._count + size).max(), self._window)))
        replaced = np.where(self._count[cell] > place, self._values[cell, place], np.inf)
        self._values[cell, place] = residuals
        self._count += size
        level, cells = self._quantile[cell], len(size)
        less = (residuals < level).astype(np.int64) - (replaced < level)
        up_to = (residuals <= level).astype(np.int64) - (replaced <= level)
        self._less += np.bincount(cell, less, cells).astype(np.int64)
        self._up_to += np.bincount(cell, up_to, cells).astype(np.int64)

    @property
    def samples(self) -> IntArray:
        """(2, N) residuals held."""
        return np.minimum(self._count, self._window).reshape(len(GROUPS), self._steps)

    def quantiles(self, probability: float) -> FloatArray:
        """(2, N) conformal radii."""
        if probability != self._probability:
            self._probability = probability
            self._quantile[:], self._less[:], self._up_to[:] = np.nan, 0, 0
        held = np.minimum(self._count, self._window)
        rank = np.ceil((held + 1) * probability - RANK_SLACK).astype(np.int64)
        moved = (rank <= held) & ((self._less >= rank) | (self._up_to < rank))
        for n in np.unique(held[moved]).tolist():
            self._search(np.flatnonzero(moved & (held == n)), n, probability)
        return self._quantile.reshape(len(GROUPS), self._steps).copy()

    def _search(self, cells: IntArray, n: int, probability: float) -> None:
        """Finds the quantiles of cells that hold n residuals each."""
        values = self._values[cells, :n]
        found = conformal_quantiles(values, probability)
        self._quantile[cells] = found
        self._less[cells] = (values < found[:, None]).sum(axis=1)
        self._up_to[cells] = (values <= found[:, None]).sum(axis=1)

    def _reserve(self, needed: int) -> None:
        held = self._values.shape[1]
        if needed > held:
            size = min(max(needed, 2 * held), self._window)
            grown = np.zeros((len(self._values), size))
            grown[:, :held] = self._values
            self._values = grown


class _Pending:
    """Predictions that still wait for their future: one row a frame and track, frames in the order of
    time, a frame's tracks by id. Rows are added at the end and dropped from the beginning."""

    def __init__(self, steps: int) -> None:
        self._stamp_ns = np.zeros(FIRST_CAPACITY, dtype=np.int64)
        self._track_id = np.zeros(FIRST_CAPACITY, dtype=np.int64)
        self._group = np.zeros(FIRST_CAPACITY, dtype=np.int64)
        self._xy_m = np.zeros((FIRST_CAPACITY, steps, 2))
        self._begin = self._end = 0

    @property
    def stamp_ns(self) -> IntArray:
        return self._stamp_ns[self._begin : self._end]

    @property
    def track_id(self) -> IntArray:
        return self._track_id[self._begin : self._end]

    @property
    def group(self) -> IntArray:
        return self._group[self._begin : self._end]

    @property
    def xy_m(self) -> FloatArray:
        return self._xy_m[self._begin : self._end]

    def append(self, predictions: Predictions) -> None:
        n = len(predictions)
        if self._end + n > len(self._stamp_ns):
            self._make_room(n)
        rows = slice(self._end, self._end + n)
        order = np.argsort(predictions.track_id)
        self._stamp_ns[rows] = predictions.stamp_ns
        self._track_id[rows] = predictions.track_id[order]
        self._group[rows] = predictions.is_static[order]
        self._xy_m[rows] = predictions.position_m[order, :, :2]
        self._end += n

    def drop_before(self, stamp_ns: int) -> None:
        """Drops the frames up to this stamp."""
        self._begin += int(np.searchsorted(self.stamp_ns, stamp_ns, side="right"))

    def _make_room(self, n: int) -> None:
        """Moves the rows to the beginning of arrays at least twice as long as what they must hold."""
        size = max(2 * (self._end - self._begin + n), len(self._stamp_ns))
        for name in ("_stamp_ns", "_track_id", "_group", "_xy_m"):
            old = getattr(self, name)
            new = np.zeros((size, *old.shape[1:]), dtype=old.dtype)
            new[: self._end - self._begin] = old[self._begin : self._end]
            setattr(self, name, new)
        self._begin, self._end = 0, self._end - self._begin


class ResidualCollector:
    """Holds predictions until their tracks are seen at the predicted times, and pools the residuals.

    Only what has been seen by the current frame is used. Between two frames in both of which a track
    was seen, its filtered positions are interpolated to the predicted times.
    """

    def __init__(self, steps: int, step_s: float, window: int) -> None:
        self.pool = ResidualPool(steps, window)
        self._steps = steps
        self._step_ns = round(step_s * 1e9)
        self._pending = _Pending(steps)
        self._last: tuple[int, IntArray, FloatArray] | None = None

    def observe(self, tracks: Tracks) -> None:
        """Compares this frame's tracks with what was predicted for the time since the last one."""
        seen = np.flatnonzero((tracks.status == TrackStatus.CONFIRMED) & (tracks.cluster_id != NO_ID))
        seen = seen[np.argsort(tracks.track_id[seen])]
        now = (tracks.stamp_ns, tracks.track_id[seen], tracks.state[seen, :2])
        last, self._last = self._last, now
        if last is None or tracks.stamp_ns <= last[0]:
            return
        found, where = _find(last[1], now[1])
        both = np.flatnonzero(found)
        if len(both):
            self._compare(now[1][both], (last[0], last[2][where[both]]), (now[0], now[2][both]))
        self._pending.drop_before(tracks.stamp_ns - self._steps * self._step_ns)

    def remember(self, predictions: Predictions) -> None:
        """Keeps a frame's predictions until their horizon has passed."""
        if len(predictions):
            self._pending.append(predictions)

    def _compare(self, seen_id: IntArray, before: tuple[int, FloatArray], after: tuple[int, FloatArray]) -> None:
        """Pools the residuals of all predicted times after `before` and up to `after` (stamp, positions (n, 2))
        of the tracks seen_id (n,), ascending."""
        pending = self._pending
        found, seen = _find(seen_id, pending.track_id)
        first = np.maximum((before[0] - pending.stamp_ns) // self._step_ns + 1, 1)
        last = np.minimum((after[0] - pending.stamp_ns) // self._step_ns, self._steps)
        rows = np.flatnonzero(found & (first <= last))
        if not len(rows):
            return
        times = (last - first + 1)[rows]
        rows = np.repeat(rows, times)
        step = first[rows] + np.arange(len(rows)) - np.repeat(np.cumsum(times) - times, times)
        seen = seen[rows]
        share = (pending.stamp_ns[rows] + step * self._step_ns - before[0]) / (after[0] - before[0])
        place = before[1][seen] + share[:, None] * (after[1][seen] - before[1][seen])
        off = pending.xy_m[rows, step - 1] - place
        self.pool.add_all(pending.group[rows], step - 1, np.sqrt(off[:, 0] * off[:, 0] + off[:, 1] * off[:, 1]))


def _find(sorted_ids: IntArray, ids: IntArray) -> tuple[BoolArray, IntArray]:
    """Which of ids (n,) are among sorted_ids (m,), and where (n,)."""
    if not len(sorted_ids):
        return np.zeros(len(ids), dtype=bool), np.zeros(len(ids), dtype=np.int64)
    where = np.minimum(np.searchsorted(sorted_ids, ids), len(sorted_ids) - 1)
    return sorted_ids[where] == ids, where
