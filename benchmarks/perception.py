"""Perception beside a plain pipeline of the same libraries, in one process: speed and segmentation.

    python benchmarks/perception.py --log LOG [--truth TRUTH.csv] [--ranges 8 20 40] [--frames 40]

Speed: milliseconds a scan by stage, medians over the frames, after one warm-up frame. The plain
pipeline crops, removes the ground with Patchwork++ at its published settings, thins to the means of
0.1 m cubes, and runs scikit-learn's HDBSCAN on the whole of that. Threads are limited to one.

Segmentation (with --truth, a CSV with the columns frame, class, x_velo, y_velo, yaw_velo, length,
width): over- and under-segmented objects as in `adcbf_cli.core.evaluation.segmentation`, and the area
that circles take beyond the points' footprint, of four ways to cluster the same grid cells: this
project's HDBSCAN, scikit-learn's on the whole cloud, this project's DBSCAN, and the plain pipeline's
3-D cells. All then get the same obstacle parameters; `unsplit` turns the splitting of walls off, which
shows the free space that a clusterer's own circles would swallow.
"""

# ruff: noqa: E402 - the thread limits must be set before numpy is imported

from __future__ import annotations

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import argparse
import csv
import json
import sys
import warnings
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

import numpy as np
import pypatchworkpp
from sklearn.cluster import HDBSCAN

from adcbf_cli.core.config import PerceptionConfig, ReadConfig
from adcbf_cli.core.evaluation.segmentation import Segmentation, inflated_area, points_in_box, segmentation
from adcbf_cli.core.frames import invert, transform_points
from adcbf_cli.core.perception import pipeline
from adcbf_cli.core.perception.clustering import Grouping
from adcbf_cli.core.perception.pipeline import Perception
from adcbf_cli.core.timing import RecordingTimer
from adcbf_cli.core.types import NO_ID, Clusters, Frame, Notes
from adcbf_cli.io.frame_reader import FrameReader

CELL_M = 0.1
STAGES = ("crop", "ground", "grid", "smooth", "cluster", "obstacles")


def whole_cloud(points_m: np.ndarray, *, min_gap_m: float = 0.0) -> np.ndarray:
    """scikit-learn's HDBSCAN labels of all points at once."""
    if len(points_m) < 5:
        return np.full(len(points_m), NO_ID)
    found = HDBSCAN(min_cluster_size=5, min_samples=3, cluster_selection_epsilon=min_gap_m, copy=True).fit(points_m)
    return found.labels_.astype(np.int64)


class PlainPipeline:
    """What one writes first: the libraries one after the other."""

    def __init__(self, range_m: float) -> None:
        self._range_m = range_m
        parameters = pypatchworkpp.Parameters()
        parameters.enable_RNR = False
        self._patchwork = pypatchworkpp.patchworkpp(parameters)

    def __call__(self, frame: Frame, timer: RecordingTimer) -> tuple[np.ndarray, np.ndarray]:
        """Obstacle points (n, 3) in the sensor's frame, and their labels."""
        with timer("crop"):
            points = frame.points_m[(np.abs(frame.points_m[:, :2]) <= self._range_m).all(axis=1)]
        with timer("ground"):
            self._patchwork.estimateGround(points.astype(np.float32))
            points = points[self._patchwork.getNongroundIndices()]
            points = points[points[:, 2] < 0.8]
        with timer("grid"):
            cell = np.floor(points / CELL_M).astype(np.int64)
            _, owner, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
            means = np.stack([np.bincount(owner, points[:, axis]) / count for axis in range(3)], axis=1)
        with timer("cluster"):
            label = whole_cloud(means)
        with timer("obstacles"):
            for cluster in range(label.max(initial=NO_ID) + 1):
                own = means[label == cluster]
                np.hypot(*(own[:, :2] - own[:, :2].mean(axis=0)).T).max()
        return points, label[owner]


def frames_of(log: Path, limit: int) -> Iterator[Frame]:
    with FrameReader(log, ReadConfig(), Notes()) as reader:
        for frame in reader:
            if frame.index >= limit:
                return
            yield frame


def speed(frames: list[Frame], range_m: float) -> dict[str, dict[str, float]]:
    """Median milliseconds a scan by stage, ours and plain, interleaved frame by frame."""
    timers = {"adcbf": RecordingTimer(), "plain": RecordingTimer()}
    ours = Perception(PerceptionConfig(range_m=range_m), Notes(), timers["adcbf"])
    plain = PlainPipeline(range_m)
    spent: dict[str, dict[str, list[float]]] = {name: defaultdict(list) for name in timers}
    for number, frame in enumerate(frames):
        for name, work in (("adcbf", lambda f: ours(f)), ("plain", lambda f: plain(f, timers["plain"]))):
            begin = perf_counter()
            work(frame)
            total = perf_counter() - begin
            stages = timers[name].take()
            if number == 0:
                continue
            spent[name]["total"].append(1e3 * total)
            for stage, nanoseconds in stages.items():
                spent[name][stage].append(nanoseconds / 1e6)
    return {name: {stage: float(np.median(values)) for stage, values in by.items()} for name, by in spent.items()}


class Scored:
    """Adds up segmentation and inflated area over frames."""

    def __init__(self, truth: list[dict[str, str]], label_range_m: float, crop_m: float) -> None:
        self._truth, self._label_range_m, self._crop_m = truth, label_range_m, crop_m
        self.score, self.area_m2, self.clusters, self.frames = Segmentation(), 0.0, 0, 0

    def add(self, frame: Frame, points_m: np.ndarray, label: np.ndarray) -> None:
        belongs = np.full(len(points_m), NO_ID)
        for number, row in enumerate(self._truth):
            x, y, yaw, length, width = (float(row[k]) for k in ("x_velo", "y_velo", "yaw_velo", "length", "width"))
            if int(row["frame"]) == frame.index and np.hypot(x, y) <= self._label_range_m:
                belongs[points_in_box(points_m[:, :2], np.array([x, y]), yaw, length, width, 0.1)] = number
        self.score += segmentation(label, belongs)
        self.frames += 1

    def add_circles(self, clusters: Clusters, points_m: np.ndarray) -> None:
        self.area_m2 += inflated_area(
            clusters.centre_sensor_m, clusters.radius_m, points_m[:, :2], CELL_M, self._crop_m
        )
        self.clusters += len(clusters)

    def row(self) -> dict[str, float]:
        frames = max(self.frames, 1)
        return {
            "objects": self.score.objects,
            "missed": self.score.missed,
            "over": self.score.over,
            "under": self.score.under,
            "area_m2_per_scan": self.area_m2 / frames,
            "clusters_per_scan": self.clusters / frames,
        }


def whole_cloud_grouping(points_m: np.ndarray, **settings: float) -> Grouping:
    """In the place of this project's HDBSCAN: scikit-learn's, on all cells, with the same lower gap."""
    try:
        label = whole_cloud(points_m, min_gap_m=settings["min_gap_m"])
    except TypeError:  # scikit-learn's epsilon search fails on some trees with numpy >= 2.4
        label = whole_cloud(points_m)
    return Grouping(label, (label != NO_ID).astype(np.float64))


def quality(frames: list[Frame], truth: list[dict[str, str]], crop_m: float) -> dict[str, dict[str, float]]:
    """Segmentation by clusterer; labelled objects up to 5 m inside the crop, so that it cuts none."""
    ours = pipeline.hdbscan
    variants = {
        "hdbscan": ({}, ours),
        "hdbscan, scikit-learn, whole cloud": ({}, whole_cloud_grouping),
        "dbscan": ({"clusterer": "dbscan"}, ours),
        "hdbscan, unsplit": ({"max_radius_m": 1e3}, ours),
        "dbscan, unsplit": ({"clusterer": "dbscan", "max_radius_m": 1e3}, ours),
    }
    rows = {}
    for name, (settings, clusterer) in variants.items():
        config = PerceptionConfig.model_validate({"range_m": crop_m, "point_labels": True, **settings})
        perception, scored = Perception(config, Notes()), Scored(truth, crop_m - 5.0, crop_m)
        pipeline.hdbscan = clusterer
        try:
            for frame in frames:
                clusters = perception(frame)
                labels = clusters.labels
                points = transform_points(invert(frame.world_from_sensor), labels.points_m)
                scored.add(frame, points, labels.cluster_id)
                scored.add_circles(clusters, points)
        finally:
            pipeline.hdbscan = ours
        rows[name] = scored.row()
    plain, scored = PlainPipeline(crop_m), Scored(truth, crop_m - 5.0, crop_m)
    timer = RecordingTimer()
    for frame in frames:
        scored.add(frame, *plain(frame, timer))
    rows["plain pipeline (3-D cells)"] = {
        key: value for key, value in scored.row().items() if not key.endswith("_per_scan")
    }
    return rows


def print_table(title: str, rows: dict[str, dict[str, float]], columns: tuple[str, ...]) -> None:
    print(f"\n{title}")
    print(f"{'':36}" + "".join(f"{column:>18}" for column in columns))
    for name, row in rows.items():
        cells = (f"{row[column]:>18.1f}" if column in row else f"{'-':>18}" for column in columns)
        print(f"{name:36}" + "".join(cells))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--log", type=Path, required=True)
    parser.add_argument("--truth", type=Path)
    parser.add_argument("--ranges", type=float, nargs="+", default=[8.0, 20.0, 40.0])
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", FutureWarning)
    frames = list(frames_of(arguments.log, arguments.frames))
    result: dict[str, object] = {"frames": len(frames)}
    for range_m in arguments.ranges:
        rows = speed(frames, range_m)
        result[f"ms_at_{range_m:g}_m"] = rows
        if not arguments.json:
            print_table(f"ms a scan at {range_m:g} m, {len(frames)} scans", rows, (*STAGES, "total"))
    if arguments.truth is not None:
        with arguments.truth.open(newline="") as table:
            truth = [row for row in csv.DictReader(table) if row["class"] != "DontCare"]
        rows = quality(frames, truth, 25.0)
        result["segmentation"] = rows
        if not arguments.json:
            columns = ("objects", "missed", "over", "under", "area_m2_per_scan", "clusters_per_scan")
            print_table("segmentation at 25 m, labels up to 20 m", rows, columns)
    if arguments.json:
        json.dump(result, sys.stdout, indent=2)
        print()


if __name__ == "__main__":
    main()
