"""The multi-object scores of a run: CLEAR MOT and HOTA, with and without unlabelled static tracks.

Labels name people and vehicles, not every tree and wall, so a static track without a label is no
evidence of an error. The headline numbers therefore judge only tracks that claim to move, or that
match a label; the `_all_tracks` variants count every unmatched track as false.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.evaluation.blocks import BlockSums, Form, stretch_key
from adcbf_cli.core.evaluation.clear import ClearMot, FrameMatch
from adcbf_cli.core.evaluation.hota import Hota, similarity
from adcbf_cli.core.evaluation.report import Metric, block_metric
from adcbf_cli.core.evaluation.scene import FrameObjects, Scene
from adcbf_cli.core.types import NO_ID, BoolArray, Tracks

_OBJECT = "labelled object and frame"
_ONE_LABELLED = "; null: the truth labels one object only"


class AssociationScore:
    """Feed it every frame; `tracks` are the reported ones only."""

    def __init__(self, scene: Scene, config: EvaluationConfig) -> None:
        self._scene = scene
        self._config = config
        self._clear = {"": ClearMot(), "_all_tracks": ClearMot()}
        self._hota = {"": Hota(), "_all_tracks": Hota()}
        self._block_ns = round(config.bootstrap_block_s * 1e9)
        self._sums = {"": BlockSums(), "_all_tracks": BlockSums()}

    def add(self, objects: FrameObjects, tracks: Tracks) -> FrameMatch:
        """One frame. Returns the matches among `objects` that are not background, in range, as
        indices into `objects` and `tracks`."""
        place = tracks.state[:, :3]
        foreground = np.flatnonzero(~objects.background)
        targets = objects.where(~objects.background)
        distance, admissible = targets.compare(place, self._config)
        excused = self._excused(objects, tracks)
        stretch = stretch_key(tracks.stamp_ns, self._block_ns)
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
                stretch,
            )
            errors = len(match.missed) + len(match.false) + match.switches
            self._sums[variant].add_sums(
                stretch,
                {
                    "mota": (float(len(scored) - errors), len(scored)),
                    "motp_m": (float(distance[match.rows, match.columns].sum()), len(match.rows)),
                    "false_positives": (len(match.false), 1),
                    "false_positives_coasting": (int((tracks.cluster_id[match.false] == NO_ID).sum()), 1),
                    "misses": (len(match.missed), 1),
                    "switches": (match.switches, 1),
                    "fragmentations": (match.fragmentations, 1),
                    "duplicates": (len(match.duplicate), 1),
                },
            )
        match = matches[""]
        return replace(match, rows=foreground[match.rows], missed=foreground[match.missed])

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
        counts, sums = self._clear[variant], self._sums[variant]
        known, n = self._scene.exhaustive, counts.objects

        def metric(
            name: str, value: float | None, definition: str, form: Form = "total", of_all: bool = False
        ) -> Metric:
            """of_all: it takes a truth that labels everything."""
            if of_all and not known:
                return Metric(None, "1", n, _OBJECT, definition + _ONE_LABELLED)
            if value is None or not n:
                return Metric(None, "1", n, _OBJECT, definition)
            interval, blocks = sums.interval(name, form), sums.blocks(name, form)
            return Metric(value, "1", n, _OBJECT, definition, interval=interval, blocks=blocks)

        def count(name: str, definition: str, of_all: bool = False) -> Metric:
            return metric(name, sums.value(name, "total"), definition, of_all=of_all)

        mota = f"1 - (misses + false positives + switches) / labelled objects; judged: {judged}"
        false = f"unmatched reports within range and the labelled field of view; judged: {judged}"
        result = {
            f"clear.mota{variant}": metric("mota", counts.mota, mota, "mean", of_all=True),
            f"clear.false_positives{variant}": count("false_positives", false, of_all=True),
        }
        if variant:
            return result
        return {
            **result,
            "clear.motp_m": block_metric(
                sums, "motp_m", "m", "matched object and frame", "mean centre distance of matched pairs"
            ),
            "clear.false_positives_coasting": count(
                "false_positives_coasting",
                "those of the false positives that are carried on without a cluster",
                of_all=True,
            ),
            "clear.misses": count("misses", "labelled objects (not background) in range without a track"),
            "clear.switches": count("switches", "matches to another track than the object's last one"),
            "clear.fragmentations": count(
                "fragmentations", "times an object that was tracked, then missed, is tracked again"
            ),
            "clear.duplicates": count(
                "duplicates",
                "false positives that lie on an object another track has, such as the pieces of a split vehicle",
                of_all=True,
            ),
        }

    def _hota_metrics(self, variant: str, judged: str) -> dict[str, Metric]:
        scores, known = self._hota[variant].scores(), self._scene.exhaustive
        how = f"similarity max(0, 1 - d / {self._config.hota_zero_m:g} m), mean over thresholds 0.05 to 0.95"
        rows = {
            "hota": (scores.hota, True, f"square root of DetA times AssA; {how}; judged: {judged}"),
            "det_a": (scores.det_a, True, f"detection accuracy TP / (TP + FN + FP); {how}; judged: {judged}"),
        }
        if not variant:
            rows |= {
                "det_re": (scores.det_re, False, f"detection recall TP / (TP + FN); {how}"),
                "det_pr": (scores.det_pr, True, f"detection precision TP / (TP + FP); {how}; judged: {judged}"),
                "ass_a": (scores.ass_a, False, f"association accuracy; {how}"),
                "loc_a": (scores.loc_a, False, f"mean similarity of matched pairs; {how}"),
            }
        sums = BlockSums()
        for name, influence in scores.influence.items():
            # Pseudo-values of the stretches: their mean is the score, and drawing them moves it by their influence.
            sums.add(scores.stretch, {name: getattr(scores, name) + len(influence) * influence})
        result: dict[str, Metric] = {}
        for name, (value, of_all, text) in rows.items():
            if of_all and not known:
                result[f"hota.{name}{variant}"] = Metric(None, "1", scores.objects, _OBJECT, text + _ONE_LABELLED)
            else:
                interval, blocks = sums.interval(name), sums.blocks(name)
                result[f"hota.{name}{variant}"] = Metric(
                    value, "1", scores.objects, _OBJECT, text, interval=interval, blocks=blocks
                )
        return result
