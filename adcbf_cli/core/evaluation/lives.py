"""Track lives: what can be said of tracks without ground truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adcbf_cli.core.evaluation.quantiles import QuantileSums
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, Tracks, TrackStatus

RESTART_S = 2.0
RESTART_M = 1.0
SHORT_S = 1.0


def reported(tracks: Tracks) -> BoolArray:
    """(n,) which tracks the tool stands by: confirmed or coasting ones."""
    known: BoolArray = np.isin(tracks.status, (TrackStatus.CONFIRMED, TrackStatus.COASTING))
    return known


_Life = np.dtype(
    [
        ("id", np.int64),
        ("alive_ns", np.int64),
        ("first_ns", np.int64),
        ("last_ns", np.int64),
        ("start_m", np.float64, 2),
        ("end_m", np.float64, 2),
    ]
)
"""One track: when it was last alive, and when and where it was first and last reported; first_ns is
NEVER for as long as it was not."""
NEVER = np.iinfo(np.int64).min
_LET_GO_NS = 10_000_000_000
"""A track that is not among the living for so long does not come back under its id."""
_PIECES = 200


class TrackLives:
    """Counts and ends of tracks; feed it every frame. What it keeps is one short row for each track that
    was ever reported, and bounded sums over frames."""

    def __init__(self) -> None:
        self._alive = np.zeros(0, dtype=_Life)
        self._gone: list[NDArray[np.void]] = []
        self._speed_mps = QuantileSums()
        self._created = self._samples = self._seen = self._static = 0
        self.frames = 0
        self.clusters = 0

    def add(self, tracks: Tracks, clusters: int) -> None:
        """One frame's tracks, and how many clusters it had. Frames come in the order of time."""
        shown = reported(tracks)
        self.frames += 1
        self.clusters += clusters
        self._samples += int(shown.sum())
        self._seen += int((tracks.cluster_id[shown] != NO_ID).sum())
        self._static += int(tracks.is_static[shown].sum())
        velocity = tracks.state[shown & ~tracks.is_static, 3:5]
        self._speed_mps.add(np.hypot(velocity[:, 0], velocity[:, 1]))
        self._follow(tracks, shown)

    def _follow(self, tracks: Tracks, shown: BoolArray) -> None:
        """Brings the rows of the living up to this frame."""
        new = np.setdiff1d(tracks.track_id, self._alive["id"])
        rows = np.zeros(len(new), dtype=_Life)
        rows["id"], rows["first_ns"] = new, NEVER
        self._created += len(new)
        alive = np.concatenate([self._alive, rows])
        alive = alive[np.argsort(alive["id"])]
        alive["alive_ns"][np.searchsorted(alive["id"], tracks.track_id)] = tracks.stamp_ns
        at, place = np.searchsorted(alive["id"], tracks.track_id[shown]), tracks.state[shown, :2]
        first = alive["first_ns"][at] == NEVER
        alive["first_ns"][at[first]], alive["start_m"][at[first]] = tracks.stamp_ns, place[first]
        alive["last_ns"][at], alive["end_m"][at] = tracks.stamp_ns, place
        gone = alive["alive_ns"] < tracks.stamp_ns - _LET_GO_NS
        self._alive = alive[~gone]
        self._gone.append(alive[gone & (alive["first_ns"] != NEVER)])
        if len(self._gone) >= _PIECES:
            self._gone = [np.concatenate(self._gone)]

    def _lives(self) -> NDArray[np.void]:
        """The rows of all tracks that were ever reported, by id."""
        lives = np.concatenate([*self._gone, self._alive[self._alive["first_ns"] != NEVER]])
        return lives[np.argsort(lives["id"], kind="stable")]

    def metrics(self) -> dict[str, Metric]:
        lives = self._lives()
        life_s = (lives["last_ns"] - lives["first_ns"]) / 1e9
        frames, samples, tracks, moving = self.frames, self._samples, len(lives), self._speed_mps.count

        def row(value: float | None, unit: str, n: int, sample: str, definition: str) -> Metric:
            return Metric(value if n else None, unit, n, sample, definition)

        return {
            "clusters.per_frame": row(_ratio(self.clusters, frames), "1", frames, "frame", "mean number of clusters"),
            "tracks.created": row(float(self._created), "1", frames, "frame", "track ids ever given out"),
            "tracks.confirmed": row(float(tracks), "1", frames, "frame", "tracks that were ever confirmed"),
            "tracks.per_frame": row(
                _ratio(samples, frames), "1", frames, "frame", "mean number of reported tracks (confirmed or coasting)"
            ),
            "tracks.life_s.median": row(
                _quantile(life_s, 0.5), "s", tracks, "track", "median time from first to last report of a track"
            ),
            "tracks.life_s.p90": row(_quantile(life_s, 0.9), "s", tracks, "track", "90 % quantile of the same"),
            "tracks.short_share": row(
                _ratio(int((life_s < SHORT_S).sum()), tracks),
                "1",
                tracks,
                "track",
                f"share of confirmed tracks reported for less than {SHORT_S:g} s",
            ),
            "tracks.restart_share": row(
                _ratio(_restarts(lives), tracks),
                "1",
                tracks,
                "track",
                f"share of confirmed tracks that begin within {RESTART_S:g} s and {RESTART_M:g} m of where another "
                "ended: likely fragments of one object",
            ),
            "tracks.coasting_share": row(
                _ratio(samples - self._seen, samples), "1", samples, "track and frame", "share without a cluster"
            ),
            "tracks.static_share": row(
                _ratio(self._static, samples), "1", samples, "track and frame", "share taken as static"
            ),
            "tracks.speed_mps.median": row(
                self._speed_mps.quantile(0.5),
                "m/s",
                moving,
                "moving track and frame",
                "median speed of non-static tracks",
            ),
            "tracks.speed_mps.p90": row(
                self._speed_mps.quantile(0.9), "m/s", moving, "moving track and frame", "90 % quantile of the same"
            ),
        }


def _restarts(lives: NDArray[np.void]) -> int:
    """How many tracks begin soon after and near where another ended."""
    by_end = np.argsort(lives["last_ns"], kind="stable")
    ended_ns, ended_m = lives["last_ns"][by_end], lives["end_m"][by_end]
    low = np.searchsorted(ended_ns, lives["first_ns"] - round(RESTART_S * 1e9))
    high = np.searchsorted(ended_ns, lives["first_ns"])
    found = 0
    for i, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        offset = ended_m[a:b] - lives["start_m"][i]
        found += bool((np.hypot(offset[:, 0], offset[:, 1]) <= RESTART_M).any())
    return found


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _quantile(values: FloatArray, q: float) -> float | None:
    return float(np.quantile(values, q)) if len(values) else None
