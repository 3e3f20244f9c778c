"""The whole evaluation of a run: one pass over all its records, and, with ground truth, another one over
the predictions, since an object's bias is known only at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.evaluation.accuracy import Accuracy
from adcbf_cli.core.evaluation.association import AssociationScore
from adcbf_cli.core.evaluation.detection import DetectionScore
from adcbf_cli.core.evaluation.forecasts import ForecastScore, Reference, target_stamps
from adcbf_cli.core.evaluation.formulas import bearing, rotate
from adcbf_cli.core.evaluation.later import LaterSeen
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


def evaluate(
    frames: Iterable[Clusters],
    tracks: Iterable[Tracks],
    predictions: Callable[[], Iterable[Predictions]],
    truth: Truth | None,
    config: EvaluationConfig,
    notes: Notes,
) -> Report:
    """Scores one run.

    frames, tracks: one record a LiDAR frame each, the same frames in the order of time. predictions:
    gives the same run's, at most one record a frame, in the same order; called once, and again where
    there is truth, for memory does not hold them all. truth: in the world frame (`truth_in_world`), or
    None, which leaves the metrics that need none. AdcbfError if the records do not belong together.
    """
    range_m = DEFAULT_RANGE_M if config.range_m is None else config.range_m
    scene = None if truth is None else Scene(truth, config, range_m)
    evaluation = _Evaluation(scene, config)
    waiting = _UpTo(predictions())
    for clusters, alive in _together(frames, tracks):
        evaluation.frame(clusters, alive, waiting(alive.frame_index))
    evaluation.end_of_frames(waiting(None))
    if scene is not None:
        for record in predictions():
            evaluation.against_truth(scene, record)
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


class _UpTo:
    """Hands out predictions as far as the frame that they were made in."""

    def __init__(self, predictions: Iterable[Predictions]) -> None:
        self._rest = iter(predictions)
        self._next = next(self._rest, None)

    def __call__(self, frame_index: int | None) -> Iterator[Predictions]:
        """Those of frames up to `frame_index`, or all that are left."""
        while self._next is not None and (frame_index is None or self._next.frame_index <= frame_index):
            yield self._next
            self._next = next(self._rest, None)


_OF_THE_FRAME = {"frame_index", "stamp_ns", "world_from_sensor", "model"}


def _select(tracks: Tracks, keep: BoolArray) -> Tracks:
    """The same record with some of its tracks only."""
    columns: dict[str, Any] = {}
    for name in (column.name for column in fields(tracks) if column.name not in _OF_THE_FRAME):
        values = getattr(tracks, name)
        columns[name] = None if values is None else values[keep]
    return replace(tracks, **columns)


@dataclass(frozen=True, slots=True)
class _Matched:
    """One frame's tracks that stood for objects: track_id, object_id (k,), where each track was (k, 2),
    and where the sensor was (2,)."""

    track_id: IntArray
    object_id: IntArray
    place_m: FloatArray
    sensor_m: FloatArray

    def find(self, track_id: IntArray) -> tuple[IntArray, IntArray]:
        """Rows of track_id (n,) that are matched, and each one's place in this record."""
        _, rows, pairs = np.intersect1d(track_id, self.track_id, assume_unique=True, return_indices=True)
        order = np.argsort(rows)
        return rows[order], pairs[order]


_NO_IDS = np.zeros(0, dtype=np.int64)
_NOTHING_MATCHED = _Matched(_NO_IDS, _NO_IDS, np.zeros((0, 2)), np.zeros(2))


class _Evaluation:
    """The scores while they grow."""

    def __init__(self, scene: Scene | None, config: EvaluationConfig) -> None:
        self._scene = scene
        self._config = config
        self._lives = TrackLives(config)
        self._later = LaterSeen(config)
        self.labelled_in_range = 0
        if scene is not None:
            self._detection = DetectionScore(scene, config)
            self._association = AssociationScore(scene, config)
            self._clustering = Accuracy(scene, "clustering", "cluster")
            self._tracking = Accuracy(scene, "tracking", "track")
            self._forecast = ForecastScore(AGAINST_TRUTH, config.horizons_s)
            self._matched: dict[int, _Matched] = {}
            self._frames_of: dict[int, list[int]] = {}
            self._last_step: dict[int, list[float]] = {}  # sum, count

    def frame(self, clusters: Clusters, tracks: Tracks, predictions: Iterable[Predictions]) -> None:
        self._lives.add(tracks, len(clusters))
        self._later.see(tracks)
        for record in predictions:
            self._later.predict(record)
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
        matched_objects = objects.object_id[match.rows]
        if len(matched_objects):
            self._matched[alive.frame_index] = _Matched(
                alive.track_id[match.columns],
                matched_objects,
                alive.state[match.columns, :2],
                alive.world_from_sensor[:2, 3].copy(),
            )
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

    def end_of_frames(self, predictions: Iterable[Predictions]) -> None:
        """What was predicted after the last frame is left."""
        for record in predictions:
            self._later.predict(record)
        self._later.finish()
        if self._scene is not None:
            self._clustering.finish()
            self._tracking.finish()

    def against_truth(self, scene: Scene, record: Predictions) -> None:
        matched = self._matched.get(record.frame_index, _NOTHING_MATCHED)
        rows, pairs = matched.find(record.track_id)
        objects, place = matched.object_id[pairs], matched.place_m[pairs, None]
        target_ns = target_stamps(record)
        p, steps = len(rows), len(target_ns)
        true_m, yaw = scene.position_at(np.repeat(objects, steps), np.tile(target_ns, p))
        true_m, yaw = true_m.reshape(p, steps, 2), yaw.reshape(p, steps)
        error = record.position_m[rows, :, :2] - true_m
        biases = [self._tracking.biases[i] for i in objects.tolist()]
        sight = np.array([b.sight_m for b in biases]).reshape(p, 1, 2)
        body = np.array([b.body_m for b in biases]).reshape(p, 1, 2)
        line = bearing(matched.sensor_m, true_m)
        corrected = {
            "sight_corrected_": error - rotate(np.broadcast_to(sight, error.shape), line),
            "body_corrected_": error - rotate(np.broadcast_to(body, error.shape), yaw),
            "still_": place - true_m,
        }
        self._forecast.add(record, rows, scene.blocks(objects, record.stamp_ns), error, corrected)
        last = np.hypot(error[:, -1, 0], error[:, -1, 1])
        for i, distance in zip(objects.tolist(), last.tolist(), strict=True):
            if np.isfinite(distance):
                known = self._last_step.setdefault(i, [0.0, 0])
                known[0] += distance
                known[1] += 1

    def report(self) -> Report:
        report = Report()
        if self._scene is not None:
            report.metrics |= self._clustering.metrics(consistency=False)
            report.metrics |= self._tracking.metrics(consistency=True)
            report.metrics |= self._forecast.metrics()
            report.metrics |= self._detection.metrics()
            report.metrics |= self._association.metrics()
            report.objects = self._object_rows(self._scene)
        report.metrics |= self._later.metrics()
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
                "predictions": int(self._last_step.get(i, (0.0, 0))[1]),
                "last_step_error_m": self._last_step[i][0] / self._last_step[i][1] if i in self._last_step else None,
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
