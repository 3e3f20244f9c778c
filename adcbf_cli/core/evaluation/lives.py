"""Track lives: what can be said of tracks without ground truth, and where each was later seen."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.evaluation.paths import Paths
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, IntArray, Tracks, TrackStatus

RESTART_S = 2.0
RESTART_M = 1.0
SHORT_S = 1.0


def reported(tracks: Tracks) -> BoolArray:
    """(n,) which tracks the tool stands by: confirmed or coasting ones."""
    known: BoolArray = np.isin(tracks.status, (TrackStatus.CONFIRMED, TrackStatus.COASTING))
    return known


class TrackLives:
    """Every reported track's positions, as compact arrays; feed it every frame."""

    def __init__(self) -> None:
        self._parts: list[tuple[IntArray, IntArray, FloatArray, BoolArray, IntArray]] = []
        self._created: set[int] = set()
        self.frames = 0
        self.clusters = 0

    def add(self, tracks: Tracks, clusters: int) -> None:
        """One frame's tracks, and how many clusters it had."""
        self.frames += 1
        self.clusters += clusters
        self._created.update(tracks.track_id.tolist())
        keep = reported(tracks)
        stamps = np.full(int(keep.sum()), tracks.stamp_ns, dtype=np.int64)
        motion = tracks.state[keep][:, [0, 1, 3, 4]]
        self._parts.append((tracks.track_id[keep], stamps, motion, tracks.is_static[keep], tracks.cluster_id[keep]))

    def finish(self, max_gap_s: float) -> None:
        """Joins the frames."""
        if self._parts:
            joined = [np.concatenate(column) for column in zip(*self._parts, strict=True)]
        else:
            none = np.zeros(0, dtype=np.int64)
            joined = [none, none, np.zeros((0, 4)), np.zeros(0, dtype=bool), none]
        self._id, self._stamp_ns, self._motion, self._static, cluster_id = joined
        self._seen = cluster_id != NO_ID
        self.later_seen = Paths(
            self._id[self._seen], self._stamp_ns[self._seen], self._motion[self._seen, :2], round(max_gap_s * 1e9)
        )

    def metrics(self) -> dict[str, Metric]:
        first, last, start_m, end_m = self._ends()
        life_s = (last - first) / 1e9
        speed = np.hypot(self._motion[~self._static, 2], self._motion[~self._static, 3])
        frames, samples, tracks = self.frames, len(self._id), len(life_s)

        def row(value: float | None, unit: str, n: int, sample: str, definition: str) -> Metric:
            return Metric(value if n else None, unit, n, sample, definition)

        return {
            "clusters.per_frame": row(_ratio(self.clusters, frames), "1", frames, "frame", "mean number of clusters"),
            "tracks.created": row(float(len(self._created)), "1", frames, "frame", "track ids ever given out"),
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
                _ratio(_restarts(first, last, start_m, end_m), tracks),
                "1",
                tracks,
                "track",
                f"share of confirmed tracks that begin within {RESTART_S:g} s and {RESTART_M:g} m of where another "
                "ended: likely fragments of one object",
            ),
            "tracks.coasting_share": row(
                _ratio(int((~self._seen).sum()), samples), "1", samples, "track and frame", "share without a cluster"
            ),
            "tracks.static_share": row(
                _ratio(int(self._static.sum()), samples), "1", samples, "track and frame", "share taken as static"
            ),
            "tracks.speed_mps.median": row(
                _quantile(speed, 0.5), "m/s", len(speed), "moving track and frame", "median speed of non-static tracks"
            ),
            "tracks.speed_mps.p90": row(
                _quantile(speed, 0.9), "m/s", len(speed), "moving track and frame", "90 % quantile of the same"
            ),
        }

    def _ends(self) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
        """Each track's first and last reported time and place."""
        order = np.lexsort((self._stamp_ns, self._id))
        ids = self._id[order]
        first = np.flatnonzero(np.diff(ids, prepend=ids[:1] - 1)) if len(ids) else np.zeros(0, dtype=np.int64)
        last = np.append(first[1:], len(ids)) - 1 if len(ids) else first
        stamps, places = self._stamp_ns[order], self._motion[order, :2]
        return stamps[first], stamps[last], places[first], places[last]


def _restarts(first_ns: IntArray, last_ns: IntArray, start_m: FloatArray, end_m: FloatArray) -> int:
    """How many tracks begin soon after and near where another ended."""
    by_end = np.argsort(last_ns, kind="stable")
    ended_ns, ended_m = last_ns[by_end], end_m[by_end]
    low = np.searchsorted(ended_ns, first_ns - round(RESTART_S * 1e9))
    high = np.searchsorted(ended_ns, first_ns)
    found = 0
    for i, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        offset = ended_m[a:b] - start_m[i]
        found += bool((np.hypot(offset[:, 0], offset[:, 1]) <= RESTART_M).any())
    return found


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None


def _quantile(values: FloatArray, q: float) -> float | None:
    return float(np.quantile(values, q)) if len(values) else None
