"""CLEAR MOT: misses, false tracks, identity switches and what they add up to.

Definitions: Bernardin and Stiefelhagen, "Evaluating Multiple Object Tracking Performance: The
CLEAR MOT Metrics", EURASIP JIVP 2008. Tracks that may not count as false ("ignorable": outside
what was labelled) vanish when unmatched; a track matched to an object that is not scored vanishes
with it. That is how KITTI's and MOTChallenge's own evaluations treat their don't-care regions.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from adcbf_cli.core.evaluation.matching import match_frame
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class FrameMatch:
    """One frame's outcome. rows, columns: the matched pairs of scored objects (indices into the
    frame's objects and tracks). missed: scored objects without a track. false: tracks that are
    wrong. duplicate: those of `false` whose centre is admissible for some scored object. switches, fragmentations:
    how many of the matches are to another track than the object's last, and come after it was missed."""

    rows: IntArray
    columns: IntArray
    missed: IntArray
    false: IntArray
    duplicate: IntArray
    switches: int
    fragmentations: int


@dataclass(slots=True)
class ClearMot:
    """Counts over a sequence; feed it frame by frame with `add`."""

    objects: int = 0
    matches: int = 0
    misses: int = 0
    false_positives: int = 0
    duplicates: int = 0
    switches: int = 0
    fragmentations: int = 0
    distance_sum_m: float = 0.0
    _previous: dict[int, int] = field(default_factory=dict)
    _last_track: dict[int, int] = field(default_factory=dict)
    _lost: set[int] = field(default_factory=set)

    def add(
        self,
        object_id: IntArray,
        track_id: IntArray,
        distance_m: FloatArray,
        admissible: BoolArray,
        scored: BoolArray | None = None,
        ignorable: BoolArray | None = None,
    ) -> FrameMatch:
        """One frame: n objects, m tracks, their (n, m) distances and which pairs may match.

        scored: (n,) False for objects that are neither to be found nor to be missed.
        ignorable: (m,) True for tracks that are not false when unmatched.
        """
        scored = np.ones(len(object_id), dtype=bool) if scored is None else scored
        ignorable = np.zeros(len(track_id), dtype=bool) if ignorable is None else ignorable
        rows, columns = match_frame(object_id, track_id, distance_m, admissible, self._previous)
        self._previous = {int(object_id[i]): int(track_id[j]) for i, j in zip(rows, columns, strict=True)}
        unmatched = np.ones(len(track_id), dtype=bool)
        unmatched[columns] = False
        counts = scored[rows]
        rows, columns = rows[counts], columns[counts]
        missed = np.setdiff1d(np.flatnonzero(scored), rows)
        false = np.flatnonzero(unmatched & ~ignorable)
        duplicate = false[admissible[scored][:, false].any(axis=0)]
        switches, fragmentations = self._follow(object_id, track_id, rows, columns, missed)
        self.matches += len(rows)
        self.misses += len(missed)
        self.switches += switches
        self.fragmentations += fragmentations
        self.objects += int(scored.sum())
        self.false_positives += len(false)
        self.duplicates += len(duplicate)
        self.distance_sum_m += float(distance_m[rows, columns].sum())
        return FrameMatch(rows, columns, missed, false, duplicate, switches, fragmentations)

    def _follow(
        self, object_id: IntArray, track_id: IntArray, rows: IntArray, columns: IntArray, missed: IntArray
    ) -> tuple[int, int]:
        """Remembers who was matched to what; how many matches are switches, and how many end a gap."""
        switches = fragmentations = 0
        for i, j in zip(rows, columns, strict=True):
            key, track = int(object_id[i]), int(track_id[j])
            switches += self._last_track.get(key, track) != track
            fragmentations += key in self._lost
            self._last_track[key] = track
            self._lost.discard(key)
        self._lost.update(int(object_id[i]) for i in missed if int(object_id[i]) in self._last_track)
        return switches, fragmentations

    @property
    def mota(self) -> float | None:
        """1 - (misses + false positives + switches) / objects; None without objects."""
        if not self.objects:
            return None
        return 1.0 - (self.misses + self.false_positives + self.switches) / self.objects

    @property
    def motp_m(self) -> float | None:
        """Mean centre distance of the matched pairs, metres; None without matches."""
        return self.distance_sum_m / self.matches if self.matches else None
