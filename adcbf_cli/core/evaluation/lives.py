"""Track lives: what can be said of tracks without ground truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.evaluation.blocks import BlockSums, block_keys, stretch_key
from adcbf_cli.core.evaluation.quantiles import QuantileSums
from adcbf_cli.core.evaluation.report import Metric, block_metric
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

    def __init__(self, config: EvaluationConfig) -> None:
        self._block_ns = round(config.bootstrap_block_s * 1e9)
        self._sums = BlockSums()
        self._alive = np.zeros(0, dtype=_Life)
        self._gone: list[NDArray[np.void]] = []
        self._speed_mps = QuantileSums()

    def add(self, tracks: Tracks, clusters: int) -> None:
        """One frame's tracks, and how many clusters it had. Frames come in the order of time."""
        shown = reported(tracks)
        velocity = tracks.state[shown & ~tracks.is_static, 3:5]
        self._speed_mps.add(np.hypot(velocity[:, 0], velocity[:, 1]))
        created, confirmed = self._follow(tracks, shown)
        n = int(shown.sum())
        self._sums.add_sums(
            stretch_key(tracks.stamp_ns, self._block_ns),
            {
                "clusters": (clusters, 1),
                "tracks": (n, 1),
                "created": (created, 1),
                "confirmed": (confirmed, 1),
                "coasting": (int((tracks.cluster_id[shown] == NO_ID).sum()), n),
                "static": (int(tracks.is_static[shown].sum()), n),
            },
        )

    def _follow(self, tracks: Tracks, shown: BoolArray) -> tuple[int, int]:
        """Brings the rows of the living up to this frame; how many are new, how many reported for the first time."""
        new = np.setdiff1d(tracks.track_id, self._alive["id"])
        rows = np.zeros(len(new), dtype=_Life)
        rows["id"], rows["first_ns"] = new, NEVER
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
        return len(new), int(first.sum())

    def _lives(self) -> NDArray[np.void]:
        """The rows of all tracks that were ever reported, by id."""
        lives = np.concatenate([*self._gone, self._alive[self._alive["first_ns"] != NEVER]])
        return lives[np.argsort(lives["id"], kind="stable")]

    def metrics(self) -> dict[str, Metric]:
        lives, sums = self._lives(), BlockSums()
        life_s = (lives["last_ns"] - lives["first_ns"]) / 1e9
        tracks, moving = len(lives), self._speed_mps.count
        begun = block_keys(np.zeros(tracks, dtype=np.int64), lives["first_ns"], self._block_ns)
        sums.add(
            begun, {"short": (life_s < SHORT_S).astype(np.float64), "restarts": _restarts(lives).astype(np.float64)}
        )
        short = f"share of confirmed tracks reported for less than {SHORT_S:g} s"
        restarts = (
            f"share of confirmed tracks that begin within {RESTART_S:g} s and {RESTART_M:g} m of where another ended: "
            "likely fragments of one object"
        )
        reports = "mean number of reported tracks (confirmed or coasting)"
        of_frames, of_samples = ("1", "frame"), ("1", "track and frame")
        return {
            "clusters.per_frame": block_metric(self._sums, "clusters", *of_frames, "mean number of clusters"),
            "tracks.created": block_metric(self._sums, "created", *of_frames, "track ids ever given out", "total"),
            "tracks.confirmed": block_metric(
                self._sums, "confirmed", *of_frames, "tracks that were ever confirmed", "total"
            ),
            "tracks.per_frame": block_metric(self._sums, "tracks", *of_frames, reports),
            "tracks.life_s.median": Metric(
                _quantile(life_s, 0.5), "s", tracks, "track", "median time from first to last report of a track"
            ),
            "tracks.life_s.p90": Metric(_quantile(life_s, 0.9), "s", tracks, "track", "90 % quantile of the same"),
            "tracks.short_share": block_metric(sums, "short", "1", "track", short),
            "tracks.restart_share": block_metric(sums, "restarts", "1", "track", restarts),
            "tracks.coasting_share": block_metric(self._sums, "coasting", *of_samples, "share without a cluster"),
            "tracks.static_share": block_metric(self._sums, "static", *of_samples, "share taken as static"),
            "tracks.speed_mps.median": Metric(
                self._speed_mps.quantile(0.5),
                "m/s",
                moving,
                "moving track and frame",
                "median speed of non-static tracks",
            ),
            "tracks.speed_mps.p90": Metric(
                self._speed_mps.quantile(0.9), "m/s", moving, "moving track and frame", "90 % quantile of the same"
            ),
        }


def _restarts(lives: NDArray[np.void]) -> BoolArray:
    """(n,) which tracks begin soon after and near where another ended."""
    by_end = np.argsort(lives["last_ns"], kind="stable")
    ended_ns, ended_m = lives["last_ns"][by_end], lives["end_m"][by_end]
    low = np.searchsorted(ended_ns, lives["first_ns"] - round(RESTART_S * 1e9))
    high = np.searchsorted(ended_ns, lives["first_ns"])
    found = np.zeros(len(lives), dtype=bool)
    for i, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        offset = ended_m[a:b] - lives["start_m"][i]
        found[i] = (np.hypot(offset[:, 0], offset[:, 1]) <= RESTART_M).any()
    return found


def _quantile(values: FloatArray, q: float) -> float | None:
    return float(np.quantile(values, q)) if len(values) else None
