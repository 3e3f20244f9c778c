"""HOTA: detection, association and localisation in one number, averaged over 19 thresholds.

Definition: Luiten et al., "HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking",
IJCV 2021. The similarity of an object and a track is max(0, 1 - d / d0), d their centres' distance.

The scores are no means, so a stretch of the log has no share in them that could be drawn anew. To first
order it has one: the scores are smooth functions of counts that add up over stretches, and the derivative
along a stretch's own counts is its influence (the infinitesimal jackknife of Jaeckel 1972). It takes who is whom
as it was found: association depends on when in an object's life its track changes, which no redrawing of frames
shows, so that what influences say of AssA, and of HOTA by it, is too little.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from adcbf_cli.core.types import FloatArray, IntArray

THRESHOLDS = np.arange(1, 20) * 0.05


@dataclass(frozen=True, slots=True)
class HotaScores:
    """Means over the thresholds, each in [0, 1]; None where nothing could be scored.

    influence: by score that is not None, (b,) how far each stretch moves it, for the pairs as they were matched over
    the whole sequence; they add up to zero. stretch: (b,) the stretches' keys, ascending.
    """

    hota: float | None
    det_a: float | None
    det_re: float | None
    det_pr: float | None
    ass_a: float | None
    loc_a: float | None
    objects: int
    tracks: int
    stretch: IntArray
    influence: Mapping[str, FloatArray]


def similarity(distance_m: FloatArray, zero_m: float) -> FloatArray:
    """max(0, 1 - d / zero_m), elementwise."""
    return np.maximum(0.0, 1.0 - distance_m / zero_m)


@dataclass(slots=True)
class Hota:
    """Gathers frames (`add`), since HOTA's matching needs the whole sequence; `scores` ends it."""

    _frames: list[tuple[IntArray, IntArray, FloatArray]] = field(default_factory=list)
    _stretch: list[int] = field(default_factory=list)

    def add(self, object_id: IntArray, track_id: IntArray, similarity: FloatArray, stretch: int) -> None:
        """One frame: (n,) object ids, (m,) track ids, their (n, m) similarity in [0, 1], and the key of the stretch
        of time that the frame is in."""
        self._frames.append((object_id.copy(), track_id.copy(), similarity.copy()))
        self._stretch.append(stretch)

    def scores(self) -> HotaScores:
        objects = sum(len(o) for o, _, _ in self._frames)
        tracks = sum(len(t) for _, t, _ in self._frames)
        stretches, of_frame = np.unique(np.array(self._stretch, dtype=np.int64), return_inverse=True)
        if not objects or not tracks:
            empty = 0.0 if objects or tracks else None
            det_re, det_pr = (0.0 if objects else None), (0.0 if tracks else None)
            known = {"hota": empty, "det_a": empty, "det_re": det_re, "det_pr": det_pr}
            still = {name: np.zeros(len(stretches)) for name, value in known.items() if value is not None}
            return HotaScores(empty, empty, det_re, det_pr, None, None, objects, tracks, stretches, still)
        object_ids = np.unique(np.concatenate([o for o, _, _ in self._frames]))
        track_ids = np.unique(np.concatenate([t for _, t, _ in self._frames]))
        frames = [(np.searchsorted(object_ids, o), np.searchsorted(track_ids, t), s) for o, t, s in self._frames]
        sequence = _Sequence(
            object_rank=np.concatenate([o for o, _, _ in frames]),
            track_rank=np.concatenate([t for _, t, _ in frames]),
            object_stretch=np.repeat(of_frame, [len(o) for o, _, _ in frames]),
            track_stretch=np.repeat(of_frame, [len(t) for _, t, _ in frames]),
            stretches=len(stretches),
        )
        pairs = _pairs(frames, _alignment(frames, sequence), of_frame)
        found = [_at_threshold(sequence, *pairs, threshold) for threshold in THRESHOLDS]
        values = {name: float(np.mean([score[name][0] for score in found])) for name in found[0]}
        influence = {name: np.mean([score[name][1] for score in found], axis=0) for name in found[0]}
        return HotaScores(**values, objects=objects, tracks=tracks, stretch=stretches, influence=influence)


_Frames = list[tuple[IntArray, IntArray, FloatArray]]


@dataclass(frozen=True, slots=True)
class _Sequence:
    """Every appearance of an object (n,) and of a track (m,): which, by rank, and in which of the stretches."""

    object_rank: IntArray
    track_rank: IntArray
    object_stretch: IntArray
    track_stretch: IntArray
    stretches: int

    @property
    def object_count(self) -> IntArray:
        """(objects, 1) in how many frames each is."""
        return np.bincount(self.object_rank)[:, None]

    @property
    def track_count(self) -> IntArray:
        """(1, tracks) in how many frames each is."""
        return np.bincount(self.track_rank)[None, :]


def _alignment(frames: _Frames, sequence: _Sequence) -> FloatArray:
    """How well each object and track go together over the whole sequence (a soft Jaccard index)."""
    object_count, track_count = sequence.object_count, sequence.track_count
    overlap = np.zeros((object_count.shape[0], track_count.shape[1]))
    for objects, tracks, sim in frames:
        union = sim.sum(axis=0)[None, :] + sim.sum(axis=1)[:, None] - sim
        share = np.divide(sim, union, out=np.zeros_like(sim), where=union > np.finfo(float).eps)
        overlap[np.ix_(objects, tracks)] += share
    result: FloatArray = overlap / (object_count + track_count - overlap)
    return result


def _pairs(
    frames: _Frames, alignment: FloatArray, of_frame: IntArray
) -> tuple[IntArray, IntArray, FloatArray, IntArray]:
    """The one-to-one pairs of every frame: object rank, track rank, similarity, stretch."""
    from scipy.optimize import linear_sum_assignment

    found: list[tuple[IntArray, IntArray, FloatArray, IntArray]] = []
    for (objects, tracks, sim), stretch in zip(frames, of_frame.tolist(), strict=True):
        if not sim.any():
            continue
        rows, columns = linear_sum_assignment(-(alignment[np.ix_(objects, tracks)] * sim))
        found.append((objects[rows], tracks[columns], sim[rows, columns], np.full(len(rows), stretch)))
    if not found:
        none = np.zeros(0, dtype=np.int64)
        return none, none, np.zeros(0), none
    rank, column, sim, stretches = (np.concatenate(part) for part in zip(*found, strict=True))
    return rank, column, sim, stretches


def _at_threshold(
    sequence: _Sequence, rank: IntArray, column: IntArray, sim: FloatArray, stretch: IntArray, threshold: float
) -> dict[str, tuple[float, FloatArray]]:
    """Each score where pairs of at least this similarity count, and its derivative along every stretch."""
    hit = sim >= threshold - np.finfo(float).eps
    rank, column, sim, stretch = rank[hit], column[hit], sim[hit], stretch[hit]

    def by_stretch(where: IntArray, weights: FloatArray | None = None) -> FloatArray:
        return np.bincount(where, weights, sequence.stretches).astype(np.float64)

    matched, d_matched = len(rank), by_stretch(stretch)
    objects, d_objects = len(sequence.object_rank), by_stretch(sequence.object_stretch)
    tracks, d_tracks = len(sequence.track_rank), by_stretch(sequence.track_stretch)
    either, d_either = objects + tracks - matched, d_objects + d_tracks - d_matched
    det_a = matched / either
    scores = {
        "det_a": (det_a, (d_matched - det_a * d_either) / either),
        "det_re": (matched / objects, (d_matched - matched / objects * d_objects) / objects),
        "det_pr": (matched / tracks, (d_matched - matched / tracks * d_tracks) / tracks),
    }
    if not matched:
        # A threshold without matches says nothing of where they are; the reference counts it as 1.
        nothing = np.zeros(sequence.stretches)
        return scores | {"hota": (0.0, nothing), "ass_a": (0.0, nothing), "loc_a": (1.0, nothing)}
    object_count, track_count = sequence.object_count, sequence.track_count
    together = np.zeros((object_count.shape[0], track_count.shape[1]))
    np.add.at(together, (rank, column), 1.0)
    jaccard = together / (object_count + track_count - together)
    # The sum of A over the matches is that of t A over pairs, A = t / (o + r - t): by t it goes with 2 A + A^2, by
    # the object's count o and the track's r with -A^2.
    ass_a = float((together * jaccard).sum()) / matched
    squared = jaccard**2
    d_sum = (
        by_stretch(stretch, (2.0 * jaccard + squared)[rank, column])
        - by_stretch(sequence.object_stretch, squared.sum(axis=1)[sequence.object_rank])
        - by_stretch(sequence.track_stretch, squared.sum(axis=0)[sequence.track_rank])
    )
    d_ass_a = (d_sum - ass_a * d_matched) / matched
    hota = float(np.sqrt(det_a * ass_a))
    loc_a = float(sim.sum()) / matched
    return scores | {
        "hota": (hota, 0.5 * hota * (scores["det_a"][1] / det_a + d_ass_a / ass_a)),
        "ass_a": (ass_a, d_ass_a),
        "loc_a": (loc_a, (by_stretch(stretch, sim) - loc_a * d_matched) / matched),
    }
