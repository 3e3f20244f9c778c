"""HDBSCAN against DBSCAN: how well each separates labelled objects, and what free space it takes.

    python benchmarks/segmentation.py LOG TRUTH [--range 25] [--label-range 20] [--frames N] [--json FILE]

All methods get the same grid cells of the same scans (this package's crop, ground and outlier removal)
and the same obstacle parameters; only the clusterer differs:

    hdbscan                     this package's, on the neighbour graph of a maximal gap, with small obstacles by returns
    scikit-learn, whole cloud   its HDBSCAN on all cells of the scan, same cluster size and min_samples; cells only
    ..., with epsilon           the same with `cluster_selection_epsilon` = perception.min_gap_m; scans on
                                which scikit-learn's epsilon search raises are left out, and counted
    dbscan, eps 0.3, 0.5, 0.7   with the same min_samples

Over- and under-segmentation are those of `adcbf_cli.core.evaluation.segmentation`, over the points in
each labelled box (grown by 0.1 m). The area is what the obstacles' circles take beyond the cells that
hold points, a scan; `unsplit` is the same without the splitting of walls: what the clusters' own
circles would swallow. Labels count up to --label-range from the sensor, so that the crop cuts none.
"""

from __future__ import annotations

import measuring  # isort: skip - it limits the threads before numpy is imported
import argparse
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.cluster import HDBSCAN

from adcbf_cli.core.config import PerceptionConfig, ReadConfig
from adcbf_cli.core.evaluation.segmentation import Segmentation, inflated_area, points_in_box, segmentation
from adcbf_cli.core.frames import invert, transform_points
from adcbf_cli.core.perception import pipeline
from adcbf_cli.core.perception.clustering import Grouping
from adcbf_cli.core.perception.pipeline import Perception
from adcbf_cli.core.types import NO_ID, Clusters, FloatArray, Frame, IntArray, Notes, Truth
from adcbf_cli.io.frame_reader import FrameReader
from adcbf_cli.io.truth import TruthContext, load_truth

MARGIN_M = 0.1
Clusterer = Callable[..., Grouping]


def scikit_learn(epsilon: bool) -> Clusterer:
    """scikit-learn's HDBSCAN on the whole cloud, in the shape of this package's `hdbscan`."""

    def cluster(points_m: FloatArray, *, min_cluster_size: int, min_samples: int, **others: Any) -> Grouping:
        if len(points_m) < min_cluster_size:
            return Grouping(np.full(len(points_m), NO_ID, dtype=np.int64), np.zeros(len(points_m)))
        gap_m = others["min_gap_m"] if epsilon else 0.0
        found = HDBSCAN(
            min_cluster_size=min_cluster_size, min_samples=min_samples, cluster_selection_epsilon=gap_m, copy=True
        ).fit(points_m)
        return Grouping(found.labels_.astype(np.int64), found.probabilities_)

    return cluster


@dataclass(frozen=True)
class Method:
    """A clusterer and its settings; None: the package's own."""

    name: str
    settings: dict[str, Any] = field(default_factory=dict)
    clusterer: Clusterer | None = None


METHODS = (
    Method("hdbscan"),
    Method("scikit-learn's HDBSCAN, whole cloud", clusterer=scikit_learn(epsilon=False)),
    Method("..., with epsilon", clusterer=scikit_learn(epsilon=True)),
    *(Method(f"dbscan, eps {eps:g} m", {"clusterer": "dbscan", "dbscan_eps_m": eps}) for eps in (0.3, 0.5, 0.7)),
)


@dataclass
class Score:
    """Sums over the scans of one method."""

    score: Segmentation = field(default_factory=Segmentation)
    area_m2: float = 0.0
    unsplit_area_m2: float = 0.0
    clusters: int = 0
    scans: int = 0
    failed: int = 0

    def row(self) -> dict[str, float]:
        scans = max(self.scans, 1)
        return {
            "scans": self.scans,
            "failed_scans": self.failed,
            "objects": self.score.objects,
            "missed": self.score.missed,
            "over": self.score.over,
            "under": self.score.under,
            "clusters_per_scan": round(self.clusters / scans, 1),
            "area_m2_per_scan": round(self.area_m2 / scans, 1),
            "unsplit_area_m2_per_scan": round(self.unsplit_area_m2 / scans, 1),
        }


def frames_of(log: Path, limit: int | None) -> Iterator[Frame]:
    with FrameReader(log, ReadConfig(), Notes()) as reader:
        for frame in reader:
            if limit is not None and frame.index >= limit:
                return
            yield frame


def boxes_at(truth: Truth, frame: Frame, label_range_m: float) -> IntArray:
    """Rows of `truth` that are labelled at this frame, have a box, and are near enough."""
    half_frame_ns = 50_000_000
    near = np.linalg.norm(truth.position_m[:, :2] - frame.world_from_sensor[:2, 3], axis=1) <= label_range_m
    known = np.isfinite(truth.length_m) & np.isfinite(truth.yaw_rad)
    now = np.abs(truth.stamp_ns - frame.stamp_ns) < half_frame_ns
    return np.flatnonzero(near & known & now)


def owners(truth: Truth, rows: IntArray, points_m: FloatArray) -> IntArray:
    """Each point's labelled object (its row of `truth`), or NO_ID. points_m: (n, 3) in the world."""
    owner = np.full(len(points_m), NO_ID, dtype=np.int64)
    for row in rows:
        inside = points_in_box(
            points_m[:, :2],
            truth.position_m[row, :2],
            float(truth.yaw_rad[row]),
            float(truth.length_m[row]),
            float(truth.width_m[row]),
            MARGIN_M,
        )
        owner[inside] = row
    return owner


def run_method(method: Method, frames: Sequence[Frame], truth: Truth, range_m: float, label_range_m: float) -> Score:
    """Scores one method on all frames."""
    total = Score()
    own = pipeline.hdbscan
    if method.clusterer is not None:
        pipeline.hdbscan = method.clusterer  # type: ignore[assignment]
    settings = {"range_m": range_m, "point_labels": True, **method.settings}
    split, unsplit = (
        Perception(PerceptionConfig.model_validate(settings | more), Notes()) for more in ({}, {"max_radius_m": 1e3})
    )
    try:
        for frame in frames:
            try:
                clusters, whole = split(frame), unsplit(frame)
            except TypeError:  # scikit-learn's epsilon search, on some trees
                total.failed += 1
                continue
            add(total, frame, clusters, whole, truth, (range_m, label_range_m))
    finally:
        pipeline.hdbscan = own
    return total


def add(
    total: Score, frame: Frame, clusters: Clusters, unsplit: Clusters, truth: Truth, ranges_m: tuple[float, float]
) -> None:
    assert clusters.labels is not None
    range_m, label_range_m = ranges_m
    points = clusters.labels.points_m
    total.score += segmentation(
        clusters.labels.cluster_id, owners(truth, boxes_at(truth, frame, label_range_m), points)
    )
    seen = transform_points(invert(frame.world_from_sensor), points)[:, :2]
    for found, name in ((clusters, "area_m2"), (unsplit, "unsplit_area_m2")):
        area = inflated_area(found.centre_sensor_m, found.radius_m, seen, 0.1, range_m)
        setattr(total, name, getattr(total, name) + area)
    total.clusters += len(clusters)
    total.scans += 1


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("truth")
    parser.add_argument("--range", type=float, default=25.0, metavar="M", help="crop (default 25)")
    parser.add_argument("--label-range", type=float, default=20.0, metavar="M", help="labels up to here (default 20)")
    parser.add_argument("--frames", type=int, metavar="N", help="the first N scans only")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    chosen = parser.parse_args(arguments)
    warnings.simplefilter("ignore", FutureWarning)
    frames = list(frames_of(chosen.log, chosen.frames))
    stamps = np.array([frame.stamp_ns for frame in frames])
    truth = load_truth(chosen.truth, TruthContext(np.arange(len(frames)), stamps, chosen.log), Notes())
    rows = {
        method.name: run_method(method, frames, truth, chosen.range, chosen.label_range).row() for method in METHODS
    }
    columns = list(next(iter(rows.values())))
    print(measuring.markdown(["method", *columns], [[name, *row.values()] for name, row in rows.items()]))
    if chosen.json is not None:
        measuring.write_json(chosen.json, rows)


if __name__ == "__main__":
    main()
