"""The whole evaluation of a run: two passes, one over clusters and tracks, one over predictions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.evaluation.accuracy import Accuracy
from adcbf_cli.core.evaluation.association import AssociationScore
from adcbf_cli.core.evaluation.blocks import block_keys
from adcbf_cli.core.evaluation.detection import DetectionScore
from adcbf_cli.core.evaluation.forecasts import ForecastScore, Reference
from adcbf_cli.core.evaluation.formulas import bearing, rotate
from adcbf_cli.core.evaluation.lives import TrackLives, reported
from adcbf_cli.core.evaluation.matching import assign
from adcbf_cli.core.evaluation.report import Report
from adcbf_cli.core.evaluation.scene import FrameObjects, Scene
from adcbf_cli.core.types import BoolArray, Clusters, FloatArray, IntArray, Notes, Predictions, Tracks, Truth

DEFAULT_RANGE_M = 20.0

AGAINST_TRUTH = Reference(
    "prediction",
    "true",
    {
        "sight_corrected_": "; each object's mean tracking error along and across the line of sight removed",
        "body_corrected_": "; each object's mean tracking error in its own axes removed; objects of known yaw",
        "still_": "; had every track been predicted to stay where it is, for comparison",
    },
)
AGAINST_LATER = {
    "later_seen": Reference("later_seen", "later seen", {}),
    "later_seen.moving": Reference("later_seen.moving", "later seen", {}),
}


def evaluate(
    frames: Iterable[Clusters],
    tracks: Iterable[Tracks],
    predictions: Iterable[Predictions],
    truth: Truth | None,
    config: EvaluationConfig,
    notes: Notes,
) -> Report:
    """Scores one run.

    frames, tracks: one record a LiDAR frame each, the same frames in the same order. predictions:
    the same run's, at most one record a frame. truth: in the world frame (`truth_in_world`), or
    None, which leaves the metrics that need none. AdcbfError if the records do not belong together.
    """
    range_m = DEFAULT_RANGE_M if config.range_m is None else config.range_m
    scene = None if truth is None else Scene(truth, config, range_m)
    evaluation = _Evaluation(scene, config)
    for clusters, alive in _together(frames, tracks):
        evaluation.frame(clusters, alive)
    evaluation.end_of_frames()
    for record in predictions:
        evaluation.predictions(record)
    report = evaluation.report()
    report.basis = _basis(truth, scene, config, range_m)
    if scene is not None and not evaluation.labelled_in_range:
        notes.warn(
            "no labelled object is within range at any frame: check --truth, its times and its frame, and --range"
        )
    return report


def _together(frames: Iterable[Clusters], tracks: Iterable[Tracks]) -> Iterator[tuple[Clusters, Tracks]]:
    problem = "clusters and tracks are not of the same frames; run `adcbf track` again"
    try:
        for clusters, alive in zip(frames, tracks, strict=True):
            if clusters.frame_index != alive.frame_index:
                raise AdcbfError(problem)
            yield clusters, alive
    except ValueError:
        raise AdcbfError(problem) from None


_OF_THE_FRAME = {"frame_index", "stamp_ns", "world_from_sensor", "model"}


def _select(tracks: Tracks, keep: BoolArray) -> Tracks:
    """The same record with some of its tracks only."""
    columns: dict[str, Any] = {}
    for name in (column.name for column in fields(tracks) if column.name not in _OF_THE_FRAME):
        values = getattr(tracks, name)
        columns[name] = None if values is None else values[keep]
    return replace(tracks, **columns)


class _Evaluation:
    """The scores while they grow."""

    def __init__(self, scene: Scene | None, config: EvaluationConfig) -> None:
        self._scene = scene
        self._config = config
        self._block_ns = round(config.bootstrap_block_s * 1e9)
        self._lives = TrackLives()
        self._later = {name: ForecastScore(ref, config.horizons_s) for name, ref in AGAINST_LATER.items()}
        self.labelled_in_range = 0
        if scene is not None:
            self._detection = DetectionScore(scene, config)
            self._association = AssociationScore(scene, config)
            self._clustering = Accuracy(scene, "clustering", "cluster")
            self._tracking = Accuracy(scene, "tracking", "track")
            self._forecast = ForecastScore(AGAINST_TRUTH, config.horizons_s)
            self._matched: dict[int, dict[int, tuple[int, FloatArray]]] = {}
            self._sensor_m: dict[int, FloatArray] = {}
            self._frames_of: dict[int, list[int]] = {}
            self._last_step: dict[int, list[float]] = {}

    def frame(self, clusters: Clusters, tracks: Tracks) -> None:
        self._lives.add(tracks, len(clusters))
        scene = self._scene
        if scene is None:
            return
        alive = _select(tracks, reported(tracks))
        objects = scene.at_frame(alive.stamp_ns, alive.world_from_sensor)
        self.labelled_in_range += int(objects.in_range.sum())
        moving = ~alive.is_static
        self._detection.add(
            objects,
            clusters.centre_m,
            alive.state[:, :3],
            alive.state[moving, :3],
            alive.track_id[moving],
            alive.stamp_ns,
            alive.world_from_sensor,
        )
        match = self._association.add(objects, alive)
        self._pair_clusters(objects, clusters)
        self._tracking.add(
            objects.where(match.rows),
            alive.track_id[match.columns],
            alive.state[match.columns, :2],
            alive.covariance[match.columns][:, :2, :2],
            alive.stamp_ns,
            alive.world_from_sensor,
        )
        matched_objects = objects.object_id[match.rows].tolist()
        matched_tracks = alive.track_id[match.columns].tolist()
        places = alive.state[match.columns, :2]
        self._matched[alive.frame_index] = {
            track: (i, place) for track, i, place in zip(matched_tracks, matched_objects, places, strict=True)
        }
        self._sensor_m[alive.frame_index] = alive.world_from_sensor[:2, 3]
        for i in objects.object_id[objects.in_range].tolist():
            seen = self._frames_of.setdefault(i, [0, 0])
            seen[0] += 1
            seen[1] += i in matched_objects

    def _pair_clusters(self, objects: FrameObjects, clusters: Clusters) -> None:
        """Clusters and objects, one to one, for the bias of the clusters' centres alone."""
        targets = objects.where(objects.in_range & ~objects.background)
        rows, columns = assign(*targets.compare(clusters.centre_m, self._config))
        self._clustering.add(
            targets.where(rows),
            clusters.cluster_id[columns],
            clusters.centre_m[columns, :2],
            np.full((len(rows), 2, 2), np.nan),
            clusters.stamp_ns,
            clusters.world_from_sensor,
        )

    def end_of_frames(self) -> None:
        self._lives.finish(self._config.max_gap_s)
        if self._scene is not None:
            self._clustering.finish()
            self._tracking.finish()

    def predictions(self, record: Predictions) -> None:
        steps = record.position_m.shape[1]
        ahead_ns = np.round(np.arange(1, steps + 1) * record.step_s * 1e9).astype(np.int64)
        target_ns = record.stamp_ns + ahead_ns
        self._against_later(record, target_ns)
        if self._scene is not None:
            self._against_truth(self._scene, record, target_ns)

    def _against_later(self, record: Predictions, target_ns: IntArray) -> None:
        n, steps = len(record), len(target_ns)
        later, _ = self._lives.later_seen.at(np.repeat(record.track_id, steps), np.tile(target_ns, n))
        error = record.position_m[..., :2] - later.reshape(n, steps, 2)
        stamps = np.full(n, record.stamp_ns, dtype=np.int64)
        blocks = block_keys(record.track_id, stamps, self._block_ns)
        for name, rows in (("later_seen", np.arange(n)), ("later_seen.moving", np.flatnonzero(~record.is_static))):
            self._later[name].add(record, rows, blocks[rows], error[rows], {})

    def _against_truth(self, scene: Scene, record: Predictions, target_ns: IntArray) -> None:
        matched = self._matched.get(record.frame_index, {})
        rows = np.array([i for i, t in enumerate(record.track_id.tolist()) if t in matched], dtype=np.int64)
        pairs = [matched[t] for t in record.track_id[rows].tolist()]
        objects = np.array([i for i, _ in pairs], dtype=np.int64)
        place = np.array([at for _, at in pairs]).reshape(-1, 1, 2)
        p, steps = len(rows), len(target_ns)
        true_m, yaw = scene.position_at(np.repeat(objects, steps), np.tile(target_ns, p))
        true_m, yaw = true_m.reshape(p, steps, 2), yaw.reshape(p, steps)
        error = record.position_m[rows, :, :2] - true_m
        biases = [self._tracking.biases[i] for i in objects.tolist()]
        sight = np.array([b.sight_m for b in biases]).reshape(p, 1, 2)
        body = np.array([b.body_m for b in biases]).reshape(p, 1, 2)
        line = bearing(self._sensor_m[record.frame_index], true_m) if p else np.zeros((0, steps))
        corrected = {
            "sight_corrected_": error - rotate(np.broadcast_to(sight, error.shape), line),
            "body_corrected_": error - rotate(np.broadcast_to(body, error.shape), yaw),
            "still_": place - true_m,
        }
        self._forecast.add(record, rows, scene.blocks(objects, record.stamp_ns), error, corrected)
        last = np.hypot(error[:, -1, 0], error[:, -1, 1])
        for i, distance in zip(objects.tolist(), last.tolist(), strict=True):
            if np.isfinite(distance):
                self._last_step.setdefault(i, []).append(distance)

    def report(self) -> Report:
        report = Report()
        if self._scene is not None:
            report.metrics |= self._clustering.metrics(consistency=False)
            report.metrics |= self._tracking.metrics(consistency=True)
            report.metrics |= self._forecast.metrics()
            report.metrics |= self._detection.metrics()
            report.metrics |= self._association.metrics()
            report.objects = self._object_rows(self._scene)
        for score in self._later.values():
            report.metrics |= score.metrics()
        report.metrics |= self._lives.metrics()
        return report

    def _object_rows(self, scene: Scene) -> list[dict[str, Any]]:
        clustering, tracking = self._clustering.object_errors(), self._tracking.object_errors()
        biases, nothing = self._clustering.object_biases(), dict[str, Any]()
        return [
            {
                "object_id": i,
                "class": scene.category[i],
                "frames_in_range": frames,
                "frames_tracked": None if scene.is_background(i) else tracked,
                "tracks": tracking.get(i, nothing).get("ids"),
                "cluster_rmse_m": clustering.get(i, nothing).get("rmse_m"),
                "track_rmse_m": tracking.get(i, nothing).get("rmse_m"),
                "track_rmse_sight_corrected_m": tracking.get(i, nothing).get("rmse_sight_corrected_m"),
                **biases.get(i, nothing),
                "predictions": len(self._last_step.get(i, ())),
                "last_step_error_m": float(np.mean(self._last_step[i])) if i in self._last_step else None,
            }
            for i, (frames, tracked) in sorted(self._frames_of.items())
        ]


def _basis(truth: Truth | None, scene: Scene | None, config: EvaluationConfig, range_m: float) -> dict[str, Any]:
    basis: dict[str, Any] = {"truth": None, "config": config.model_dump(mode="json"), "range_m": range_m}
    if truth is not None and scene is not None:
        fov = scene.field_of_view_rad
        basis["truth"] = {
            "source": truth.source,
            "labels": len(truth),
            "objects": len(scene.paths.ids),
            "exhaustive": scene.exhaustive,
            "labelled_fov_deg": None if fov is None else [round(float(np.degrees(a)), 3) for a in fov],
        }
    return basis
