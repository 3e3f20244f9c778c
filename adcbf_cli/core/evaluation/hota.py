"""HOTA: detection, association and localisation in one number, averaged over 19 thresholds.

Definition: Luiten et al., "HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking",
IJCV 2021. The similarity of an object and a track is max(0, 1 - d / d0), d their centres' distance.

Detection's and localisation's scores are, at each threshold, ratios of counts that add up over stretches of the log.
The derivative along a stretch's own counts is its influence on them (the infinitesimal jackknife of Jaeckel 1972),
which can be drawn anew. AssA, and HOTA by it, are given none: an identity lasts longer than a stretch, and drawn
stretches keep the identity changes that the log has, so that far too little would seem uncertain.
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

    influence: of those of det_a, det_re, det_pr and loc_a that are not None, (b,) how far each stretch moves it, for
    the pairs as they were matched over the whole sequence; they add up to zero. stretch: (b,) the stretches' keys,
    ascending.
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
            detection = {"det_a": empty, "det_re": det_re, "det_pr": det_pr}
            still = {name: np.zeros(len(stretches)) for name, value in detection.items() if value is not None}
            return HotaScores(empty, empty, det_re, det_pr, None, None, objects, tracks, stretches, still)
        object_ids = np.unique(np.concatenate([o for o, _, _ in self._frames]))
        track_ids = np.unique(np.concatenate([t for _, t, _ in self._frames]))
        frames = [(np.searchsorted(object_ids, o), np.searchsorted(track_ids, t), s) for o, t, s in self._frames]
        object_count = np.bincount(np.concatenate([o for o, _, _ in frames]))[:, None]
        track_count = np.bincount(np.concatenate([t for _, t, _ in frames]))[None, :]
        pairs = _pairs(frames, _alignment(frames, object_count, track_count), of_frame)
        objects_in = np.bincount(of_frame, [len(o) for o, _, _ in frames])[:, None].astype(np.float64)
        tracks_in = np.bincount(of_frame, [len(t) for _, t, _ in frames])[:, None].astype(np.float64)
        ratios = _ratios(pairs, objects_in, tracks_in)
        ass_a = _association(pairs, object_count, track_count)
        return HotaScores(
            **{name: float(value.mean()) for name, (value, _) in ratios.items()},
            hota=float(np.sqrt(ratios["det_a"][0] * ass_a).mean()),
            ass_a=float(ass_a.mean()),
            objects=objects,
            tracks=tracks,
            stretch=stretches,
            influence={name: influence.mean(axis=1) for name, (_, influence) in ratios.items()},
        )


_Frames = list[tuple[IntArray, IntArray, FloatArray]]
_Pairs = tuple[IntArray, IntArray, FloatArray, IntArray]


def _alignment(frames: _Frames, object_count: IntArray, track_count: IntArray) -> FloatArray:
    """How well each object and track go together over the whole sequence (a soft Jaccard index)."""
    overlap = np.zeros((object_count.shape[0], track_count.shape[1]))
    for objects, tracks, sim in frames:
        union = sim.sum(axis=0)[None, :] + sim.sum(axis=1)[:, None] - sim
        share = np.divide(sim, union, out=np.zeros_like(sim), where=union > np.finfo(float).eps)
        overlap[np.ix_(objects, tracks)] += share
    result: FloatArray = overlap / (object_count + track_count - overlap)
    return result


def _pairs(frames: _Frames, alignment: FloatArray, of_frame: IntArray) -> _Pairs:
    """The one-to-one pairs of every frame: object rank, track rank, similarity, rank of the stretch."""
    from scipy.optimize import linear_sum_assignment

    found: list[_Pairs] = []
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


def _ratios(pairs: _Pairs, objects: FloatArray, tracks: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
    """By score, (thresholds,) its values and (b, thresholds) the stretches' influences on them. objects, tracks: (b, 1)
    how many appear in each stretch."""
    _, _, sim, stretch = pairs
    hit = sim[:, None] >= THRESHOLDS - np.finfo(float).eps
    matched, similar = np.zeros((2, len(objects), len(THRESHOLDS)))
    np.add.at(matched, stretch, hit)
    np.add.at(similar, stretch, hit * sim[:, None])
    # A threshold without matches says nothing of where they are; the reference counts it as 1.
    none = matched.sum(axis=0) == 0
    parts = {
        "det_a": (matched, objects + tracks - matched),
        "det_re": (matched, objects),
        "det_pr": (matched, tracks),
        "loc_a": (np.where(none, 1.0, similar), np.where(none, 1.0, matched)),
    }
    result = {}
    for name, (part, whole) in parts.items():
        total = whole.sum(axis=0)
        value = part.sum(axis=0) / total
        result[name] = value, (part - value * whole) / total
    return result


def _association(pairs: _Pairs, object_count: IntArray, track_count: IntArray) -> FloatArray:
    """(thresholds,) AssA; 0 where nothing matches."""
    rank, column, sim, _ = pairs
    result = np.zeros(len(THRESHOLDS))
    for k, threshold in enumerate(THRESHOLDS):
        hit = sim >= threshold - np.finfo(float).eps
        together = np.zeros((object_count.shape[0], track_count.shape[1]))
        np.add.at(together, (rank[hit], column[hit]), 1.0)
        jaccard = together / (object_count + track_count - together)
        result[k] = float((together * jaccard).sum()) / max(1, int(hit.sum()))
    return result
