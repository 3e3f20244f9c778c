"""The multi-object scores of a run: CLEAR MOT and HOTA, with and without unlabelled static tracks.

Labels name people and vehicles, not every tree and wall, so a static track without a label is no
evidence of an error. The headline numbers therefore judge only tracks that claim to move, or that
match a label; the `_all_tracks` variants count every unmatched track as false.
"""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.evaluation.clear import ClearMot, FrameMatch
from adcbf_cli.core.evaluation.hota import Hota, similarity
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.core.evaluation.scene import FrameObjects, Scene
from adcbf_cli.core.types import NO_ID, BoolArray, Tracks


class AssociationScore:
    """Feed it every frame; `tracks` are the reported ones only."""

    def __init__(self, scene: Scene, config: EvaluationConfig) -> None:
        self._scene = scene
        self._config = config
        self._clear = {"": ClearMot(), "_all_tracks": ClearMot()}
        self._hota = {"": Hota(), "_all_tracks": Hota()}
        self._false_coasting = 0

    def add(self, objects: FrameObjects, tracks: Tracks) -> FrameMatch:
        """One frame. Returns the matches among `objects` that are not background, in range, as
        indices into `objects` and `tracks`."""
        place = tracks.state[:, :3]
        foreground = np.flatnonzero(~objects.background)
        targets = objects.where(~objects.background)
        distance, admissible = targets.compare(place, self._config)
        excused = self._excused(objects, tracks)
        matches: dict[str, FrameMatch] = {}
        for variant, ignorable in (("_all_tracks", excused), ("", excused | tracks.is_static)):
            match = matches[variant] = self._clear[variant].add(
                targets.object_id, tracks.track_id, distance, admissible, targets.in_range, ignorable
            )
            kept = np.union1d(match.columns, match.false)
            scored = np.flatnonzero(targets.in_range)
            self._hota[variant].add(
                targets.object_id[scored],
                tracks.track_id[kept],
                similarity(distance[np.ix_(scored, kept)], self._config.hota_zero_m),
            )
        match = matches[""]
        self._false_coasting += int((tracks.cluster_id[match.false] == NO_ID).sum())
        return FrameMatch(foreground[match.rows], match.columns, foreground[match.missed], match.false, match.duplicate)

    def _excused(self, objects: FrameObjects, tracks: Tracks) -> BoolArray:
        """(m,) tracks that are not false when unmatched: outside what was labelled, on labelled
        scenery, or on an object out of range; every one if only one object was labelled."""
        if not self._scene.exhaustive:
            return np.ones(len(tracks), dtype=bool)
        place = tracks.state[:, :3]
        labelled = self._scene.labelled(place, tracks.stamp_ns, tracks.world_from_sensor)
        unscored = objects.where(objects.background | ~objects.in_range)
        _, admissible = unscored.compare(place, self._config)
        on_unscored: BoolArray = np.any(admissible, axis=0)
        return ~labelled | on_unscored

    def metrics(self) -> dict[str, Metric]:
        result: dict[str, Metric] = {}
        for variant, judged in (
            ("", "tracks that are not static, or match a label"),
            ("_all_tracks", "all reported tracks, so unlabelled scenery counts as false"),
        ):
            result |= self._clear_metrics(variant, judged)
            result |= self._hota_metrics(variant, judged)
        return result

    def _clear_metrics(self, variant: str, judged: str) -> dict[str, Metric]:
        counts = self._clear[variant]
        n, known = counts.objects, self._scene.exhaustive
        unknown = "" if known else "; null: the truth labels one object only"
        sample = "labelled object and frame"

        def row(value: float | None, unit: str, definition: str) -> Metric:
            return Metric(value if n else None, unit, n, sample, definition)

        false = {
            f"clear.mota{variant}": row(
                counts.mota if known else None,
                "1",
                f"1 - (misses + false positives + switches) / labelled objects; judged: {judged}{unknown}",
            ),
            f"clear.false_positives{variant}": row(
                float(counts.false_positives) if known else None,
                "1",
                f"unmatched reports within range and the labelled field of view; judged: {judged}{unknown}",
            ),
        }
        if variant:
            return false
        return {
            **false,
            "clear.motp_m": Metric(
                counts.motp_m, "m", counts.matches, "matched object and frame", "mean centre distance of matched pairs"
            ),
            "clear.false_positives_coasting": row(
                float(self._false_coasting) if known else None,
                "1",
                "those of the false positives that are carried on without a cluster" + unknown,
            ),
            "clear.misses": row(
                float(counts.misses), "1", "labelled objects (not background) in range without a track"
            ),
            "clear.switches": row(float(counts.switches), "1", "matches to another track than the object's last one"),
            "clear.fragmentations": row(
                float(counts.fragmentations), "1", "times an object that was tracked, then missed, is tracked again"
            ),
            "clear.duplicates": row(
                float(counts.duplicates) if known else None,
                "1",
                "false positives that lie on an object another track has, such as the pieces of a split vehicle"
                + unknown,
            ),
        }

    def _hota_metrics(self, variant: str, judged: str) -> dict[str, Metric]:
        scores, known = self._hota[variant].scores(), self._scene.exhaustive
        unknown = "" if known else "; null: the truth labels one object only"
        how = f"similarity max(0, 1 - d / {self._config.hota_zero_m:g} m), mean over thresholds 0.05 to 0.95"
        rows = {
            "hota": (
                scores.hota if known else None,
                f"square root of DetA times AssA; {how}; judged: {judged}{unknown}",
            ),
            "det_a": (
                scores.det_a if known else None,
                f"detection accuracy TP / (TP + FN + FP); {how}; judged: {judged}{unknown}",
            ),
        }
        if not variant:
            rows |= {
                "det_re": (scores.det_re, f"detection recall TP / (TP + FN); {how}"),
                "det_pr": (
                    scores.det_pr if known else None,
                    f"detection precision TP / (TP + FP); {how}; judged: {judged}{unknown}",
                ),
                "ass_a": (scores.ass_a, f"association accuracy; {how}"),
                "loc_a": (scores.loc_a, f"mean similarity of matched pairs; {how}"),
            }
        return {
            f"hota.{name}{variant}": Metric(value, "1", scores.objects, "labelled object and frame", text)
            for name, (value, text) in rows.items()
        }
