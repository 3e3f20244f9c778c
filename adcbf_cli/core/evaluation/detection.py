"""Detection: which labelled objects some obstacle covers, and which obstacles cover one."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.evaluation.blocks import BlockSums, block_keys
from adcbf_cli.core.evaluation.report import Metric, block_metric
from adcbf_cli.core.evaluation.scene import FrameObjects, Scene
from adcbf_cli.core.types import FloatArray, IntArray

_COVERED = "centre within match_m of the object's centre, or inside its box enlarged by box_margin_m"


class DetectionScore:
    """Feed it every frame; an object may be covered by several obstacles, and one may cover several."""

    def __init__(self, scene: Scene, config: EvaluationConfig) -> None:
        self._scene = scene
        self._config = config
        self._block_ns = round(config.bootstrap_block_s * 1e9)
        self._sums = BlockSums()
        self._of_tracks = BlockSums(own_ids=True)
        self._classes: set[str] = set()

    def add(
        self,
        objects: FrameObjects,
        cluster_m: FloatArray,
        track_m: FloatArray,
        moving_m: FloatArray,
        moving_id: IntArray,
        stamp_ns: int,
        world_from_sensor: FloatArray,
    ) -> None:
        """One frame: (k, 3) centres of the clusters, of the reported tracks, and of those of them
        that are not static, with their ids."""
        self._recall("recall", objects, cluster_m, stamp_ns)
        self._recall("track_recall", objects, track_m, stamp_ns)
        everything = np.zeros(len(cluster_m), dtype=np.int64)
        judgements = (
            ("precision", cluster_m, everything, self._sums),
            ("moving_precision", moving_m, moving_id, self._of_tracks),
        )
        for name, points, ids, sums in judgements:
            judged = self._scene.labelled(points, stamp_ns, world_from_sensor)
            _, admissible = objects.compare(points[judged], self._config)
            right: FloatArray = np.any(admissible, axis=0).astype(np.float64)
            times = np.full(len(right), stamp_ns, dtype=np.int64)
            sums.add(block_keys(ids[judged], times, self._block_ns), {name: right})

    def _recall(self, name: str, objects: FrameObjects, point_m: FloatArray, stamp_ns: int) -> None:
        near = objects.where(objects.in_range)
        _, admissible = near.compare(point_m, self._config)
        found: FloatArray = np.any(admissible, axis=1).astype(np.float64)
        categories = np.array([self._scene.category[i] for i in near.object_id.tolist()])
        self._classes.update(categories.tolist())
        quantities = {name: found}
        for category in sorted(set(categories.tolist())):
            quantities[f"{name}.{category}"] = np.where(categories == category, found, np.nan)
        self._sums.add(self._scene.blocks(near.object_id, stamp_ns), quantities)

    def metrics(self) -> dict[str, Metric]:
        within = f"{self._scene.range_m:g} m of the sensor"
        result = {}
        for name, what in (("recall", "cluster"), ("track_recall", "confirmed or coasting track")):
            text = f"share of labelled objects within {within} that a {what} covers: {_COVERED}"
            result[f"detection.{name}"] = self._share(name, "object and frame", text)
            for category in sorted(self._classes):
                key = f"{name}.{category}"
                result[f"detection.{key}"] = self._share(key, "object and frame", f"{text}; class {category} only")
        unknown = not self._scene.exhaustive
        for name, what in (("precision", "clusters"), ("moving_precision", "reported tracks that are not static")):
            text = f"share of {what} within {within} and the labelled field of view that cover a labelled object"
            if name == "precision":
                text += (
                    "; scenery without a label counts as wrong, so this is no error rate where scenery is unlabelled"
                )
            metric = self._share(name, "cluster" if name == "precision" else "track and frame", text)
            if unknown:
                metric = Metric(None, "1", metric.n, metric.sample, f"{text}; null: the truth labels one object only")
            result[f"detection.{name}"] = metric
        return result

    def _share(self, name: str, sample: str, definition: str) -> Metric:
        sums = self._of_tracks if name == "moving_precision" else self._sums
        return block_metric(sums, name, "1", sample, definition)
