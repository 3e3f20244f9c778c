"""HOTA: detection, association and localisation in one number, averaged over 19 thresholds.

Definition: Luiten et al., "HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking",
IJCV 2021. The similarity of an object and a track is max(0, 1 - d / d0), d their centres' distance.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from adcbf_cli.core.types import FloatArray, IntArray

THRESHOLDS = np.arange(1, 20) * 0.05


@dataclass(frozen=True, slots=True)
class HotaScores:
    """Means over the thresholds, each in [0, 1]; None where nothing could be scored."""

    hota: float | None
    det_a: float | None
    det_re: float | None
    det_pr: float | None
    ass_a: float | None
    loc_a: float | None
    objects: int
    tracks: int


def similarity(distance_m: FloatArray, zero_m: float) -> FloatArray:
    """max(0, 1 - d / zero_m), elementwise."""
    return np.maximum(0.0, 1.0 - distance_m / zero_m)


@dataclass(slots=True)
class Hota:
    """Gathers frames (`add`), since HOTA's matching needs the whole sequence; `scores` ends it."""

    _frames: list[tuple[IntArray, IntArray, FloatArray]] = field(default_factory=list)

    def add(self, object_id: IntArray, track_id: IntArray, similarity: FloatArray) -> None:
        """One frame: (n,) object ids, (m,) track ids, and their (n, m) similarity in [0, 1]."""
        self._frames.append((object_id.copy(), track_id.copy(), similarity.copy()))

    def scores(self) -> HotaScores:
        objects = sum(len(o) for o, _, _ in self._frames)
        tracks = sum(len(t) for _, t, _ in self._frames)
        if not objects or not tracks:
            empty = 0.0 if objects or tracks else None
            det_re, det_pr = (0.0 if objects else None), (0.0 if tracks else None)
            return HotaScores(empty, empty, det_re, det_pr, None, None, objects, tracks)
        object_ids = np.unique(np.concatenate([o for o, _, _ in self._frames]))
        track_ids = np.unique(np.concatenate([t for _, t, _ in self._frames]))
        frames = [(np.searchsorted(object_ids, o), np.searchsorted(track_ids, t), s) for o, t, s in self._frames]
        object_count = np.bincount(np.concatenate([o for o, _, _ in frames]), minlength=len(object_ids))[:, None]
        track_count = np.bincount(np.concatenate([t for _, t, _ in frames]), minlength=len(track_ids))[None, :]
        alignment = _alignment(frames, object_count, track_count)
        pairs = _pairs(frames, alignment)
        return _summarise(pairs, object_count, track_count, objects, tracks)


_Frames = list[tuple[IntArray, IntArray, FloatArray]]


def _alignment(frames: _Frames, object_count: IntArray, track_count: IntArray) -> FloatArray:
    """How well each object and track go together over the whole sequence (a soft Jaccard index)."""
    overlap = np.zeros((object_count.shape[0], track_count.shape[1]))
    for objects, tracks, sim in frames:
        union = sim.sum(axis=0)[None, :] + sim.sum(axis=1)[:, None] - sim
        share = np.divide(sim, union, out=np.zeros_like(sim), where=union > np.finfo(float).eps)
        overlap[np.ix_(objects, tracks)] += share
    result: FloatArray = overlap / (object_count + track_count - overlap)
    return result


def _pairs(frames: _Frames, alignment: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """The one-to-one pairs of every frame: object rank, track rank, similarity."""
    from scipy.optimize import linear_sum_assignment

    found: list[tuple[IntArray, IntArray, FloatArray]] = []
    for objects, tracks, sim in frames:
        if not sim.any():
            continue
        rows, columns = linear_sum_assignment(-(alignment[np.ix_(objects, tracks)] * sim))
        found.append((objects[rows], tracks[columns], sim[rows, columns]))
    if not found:
        none = np.zeros(0, dtype=np.int64)
        return none, none, np.zeros(0)
    return (
        np.concatenate([o for o, _, _ in found]),
        np.concatenate([t for _, t, _ in found]),
        np.concatenate([s for _, _, s in found]),
    )


def _summarise(
    pairs: tuple[IntArray, IntArray, FloatArray],
    object_count: IntArray,
    track_count: IntArray,
    objects: int,
    tracks: int,
) -> HotaScores:
    rank, column, sim = pairs
    det_a, det_re, det_pr, ass_a, loc_a = (np.zeros(len(THRESHOLDS)) for _ in range(5))
    for k, threshold in enumerate(THRESHOLDS):
        hit = sim >= threshold - np.finfo(float).eps
        matched = int(hit.sum())
        together = np.zeros((object_count.shape[0], track_count.shape[1]))
        np.add.at(together, (rank[hit], column[hit]), 1.0)
        det_a[k] = matched / (objects + tracks - matched)
        det_re[k] = matched / objects
        det_pr[k] = matched / tracks
        jaccard = together / np.maximum(1, object_count + track_count - together)
        ass_a[k] = float((together * jaccard).sum()) / max(1, matched)
        # A threshold without matches says nothing of where they are; the reference counts it as 1.
        loc_a[k] = float(sim[hit].sum()) / matched if matched else 1.0
    return HotaScores(
        hota=float(np.sqrt(det_a * ass_a).mean()),
        det_a=float(det_a.mean()),
        det_re=float(det_re.mean()),
        det_pr=float(det_pr.mean()),
        ass_a=float(ass_a.mean()),
        loc_a=float(loc_a.mean()),
        objects=objects,
        tracks=tracks,
    )
