"""Milliseconds a scan, by stage: read, cluster, track, predict, beside a plain pipeline in the same process.

    python benchmarks/pipeline.py LOG [--ranges 8 20 40] [--frames 45] [--json FILE]

Both sides get the same frames, one after the other, on one core with one thread; the first frames warm up
and are not counted. Reading is the same for both and counts for both; a log's chunks hold several scans,
so the mean of reading is booked on every scan. The plain side is `plain_pipeline.py`. Two comparisons on
equal inputs tell where the gain comes from: scikit-learn's HDBSCAN on the very cells that adcbf clusters,
and filterpy's loop over the very tracks that adcbf predicts (there without the calibration that the stage
adds to the horizon, and the loop does not).
"""

from __future__ import annotations

import measuring  # isort: skip  (before numpy: one thread)
import argparse
import warnings
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from plain_clusters import CELL_M, whole_cloud
from plain_pipeline import PlainResult, PlainRoad, looped_horizon

from adcbf_cli.core.config import PerceptionConfig, PredictionConfig, ReadConfig, TrackingConfig
from adcbf_cli.core.perception import pipeline
from adcbf_cli.core.perception.clustering import Grouping
from adcbf_cli.core.perception.pipeline import Perception
from adcbf_cli.core.prediction.predictor import Predictor
from adcbf_cli.core.timing import RecordingTimer
from adcbf_cli.core.tracking.tracker import Tracker
from adcbf_cli.core.types import FloatArray, Frame, Notes, Tracks, TrackStatus
from adcbf_cli.io.frame_reader import FrameReader

WARM_UP = 5
STAGES = ("read", "crop", "ground", "grid", "smooth", "cluster", "obstacles", "track", "predict", "total")
COUNTS = ("points clustered", "obstacles", "tracks")
REAL_TIME_MS = 100.0


class Road:
    """adcbf's stages with their defaults, as `adcbf run` chains them."""

    def __init__(self, range_m: float, timer: RecordingTimer) -> None:
        self.tracking, self.prediction = TrackingConfig(), PredictionConfig()
        self._perception = Perception(PerceptionConfig(range_m=range_m), Notes(), timer)
        self._tracker = Tracker(self.tracking, Notes(), timer)
        self._predictor = Predictor(self.prediction, self.tracking, Notes(), timer)

    def __call__(self, frame: Frame) -> tuple[dict[str, int], Tracks]:
        clusters = self._perception(frame)
        tracks = self._tracker(clusters)
        predictions = self._predictor(tracks)
        counts = {
            "points clustered": clusters.counts.clustered,
            "obstacles": len(clusters),
            "tracks": len(predictions),
        }
        return counts, tracks


def read_frames(log: Path, limit: int) -> tuple[list[Frame], float]:
    """The first frames, and the mean milliseconds that one took to be read and placed."""
    with FrameReader(log, ReadConfig(), Notes()) as reader:
        begin = perf_counter()
        frames = list(islice(reader, limit))
        return frames, timed_ms(begin) / max(len(frames), 1)


@contextmanager
def cells_kept() -> Iterator[list[FloatArray]]:
    """While open, the list holds the cells that adcbf handed to its clusterer last."""
    original = pipeline.hdbscan  # type: ignore[attr-defined]
    kept: list[FloatArray] = []

    def keeping(points_m: FloatArray, **settings: Any) -> Grouping:
        kept[:] = [points_m]
        found: Grouping = original(points_m, **settings)
        return found

    pipeline.hdbscan = keeping  # type: ignore[attr-defined]
    try:
        yield kept
    finally:
        pipeline.hdbscan = original  # type: ignore[attr-defined]


class Side:
    """Times by stage and counts of one side, over the frames after the warm-up."""

    def __init__(self) -> None:
        self.timer = RecordingTimer()
        self.spent: dict[str, list[float]] = defaultdict(list)
        self.counts: dict[str, list[int]] = defaultdict(list)

    def add(self, number: int, read_ms: float, work_ms: float, counts: dict[str, int]) -> None:
        stages = self.timer.take()
        if number < WARM_UP:
            return
        self.spent["read"].append(read_ms)
        self.spent["total"].append(read_ms + work_ms)
        for stage, nanoseconds in stages.items():
            self.spent[stage].append(nanoseconds / 1e6)
        for name, count in counts.items():
            self.counts[name].append(count)

    def summary(self) -> dict[str, Any]:
        return {
            "ms": {stage: measuring.spread(values) for stage, values in self.spent.items()},
            "counts": {name: median(values) for name, values in self.counts.items()},
        }


def timed_ms(begin: float) -> float:
    return 1e3 * (perf_counter() - begin)


def plain_counts(result: PlainResult) -> dict[str, int]:
    cells = np.unique(np.floor(result.points_m / CELL_M), axis=0)
    return {"points clustered": len(cells), "obstacles": len(result.centres_m), "tracks": result.tracks}


def crop(frames: list[Frame], read_ms: float, range_m: float) -> dict[str, Any]:
    """Both sides at one crop, frame by frame in turn."""
    share = measuring.Share()
    ours, plain = Side(), Side()
    road, plain_road = Road(range_m, ours.timer), PlainRoad(range_m, plain.timer)
    horizon = Predictor(PredictionConfig(calibration="none"), road.tracking, Notes())
    equal: dict[str, list[float]] = defaultdict(list)
    with cells_kept() as cells:
        for number, frame in enumerate(frames):
            begin = perf_counter()
            counts, tracks = road(frame)
            ours.add(number, read_ms, timed_ms(begin), counts)
            begin = perf_counter()
            result = plain_road(frame)
            plain.add(number, read_ms, timed_ms(begin), plain_counts(result))
            if number < WARM_UP:
                continue
            begin = perf_counter()
            whole_cloud(cells[0])
            equal["plain HDBSCAN"].append(timed_ms(begin))
            begin = perf_counter()
            horizon(tracks)
            equal["adcbf horizon"].append(timed_ms(begin))
            equal["plain horizon"].append(_loop_over(tracks, road))
    return {
        "adcbf": ours.summary(),
        "plain": plain.summary(),
        "same_input_ms": {name: median(values) for name, values in equal.items()},
        "share_of_core": share(),
    }


def _loop_over(tracks: Tracks, road: Road) -> float:
    """Milliseconds that filterpy's loop takes for the tracks that adcbf predicts in this frame."""
    rows = (tracks.status == TrackStatus.CONFIRMED) | (tracks.status == TrackStatus.COASTING)
    begin = perf_counter()
    looped_horizon(
        road.tracking, tracks.state[rows], tracks.covariance[rows], road.prediction.steps, road.prediction.step_s
    )
    return timed_ms(begin)


def measure(log: Path, ranges_m: list[float], limit: int) -> dict[str, Any]:
    frames, read_ms = read_frames(log, limit)
    return {
        "benchmark": "pipeline",
        "log": log.name,
        "frames": len(frames),
        "warm_up": WARM_UP,
        "points_read": median(len(frame.points_m) for frame in frames),
        "crops": {f"{range_m:g}": crop(frames, read_ms, range_m) for range_m in ranges_m},
        "machine": measuring.machine(),
    }


def tables(result: dict[str, Any]) -> str:
    """The result as Markdown."""
    crops: dict[str, Any] = result["crops"]
    parts = [
        f"`{result['log']}`: {result['frames']} scans of {result['points_read']:,.0f} points, the first "
        f"{result['warm_up']} not counted; median ms a scan on one core.\n"
    ]
    head = ["stage"]
    for name in crops:
        head += [f"{name} m: adcbf", "plain", "ratio"]
    rows: list[list[object]] = []
    for stage in STAGES:
        row: list[object] = [stage]
        for found in crops.values():
            own, other = (found[side]["ms"].get(stage, {}).get("median") for side in ("adcbf", "plain"))
            row += [own, other, measuring.ratio(other, own)]
        rows.append(row)
    for figure in ("p95", "max"):
        row = [f"total, {figure}"]
        for found in crops.values():
            row += [found["adcbf"]["ms"]["total"][figure], found["plain"]["ms"]["total"][figure], None]
        rows.append(row)
    for count in COUNTS:
        row = [f"{count}, median"]
        for found in crops.values():
            row += [found[side]["counts"].get(count) for side in ("adcbf", "plain")] + [None]
        rows.append(row)
    parts.append(measuring.markdown(head, rows))
    parts.append("\nThe same input to both:\n")
    parts.append(measuring.markdown(["crop", "what", "adcbf ms", "plain ms", "ratio"], list(_equal_rows(crops))))
    parts.append(measuring.busy_warning(min(found["share_of_core"] for found in crops.values())))
    return "\n".join(parts)


def _equal_rows(crops: dict[str, Any]) -> Iterator[list[object]]:
    for name, found in crops.items():
        same = found["same_input_ms"]
        own = {"HDBSCAN": found["adcbf"]["ms"]["cluster"]["median"], "horizon": same["adcbf horizon"]}
        for stage, what in (("HDBSCAN", "HDBSCAN of adcbf's cells"), ("horizon", "horizon of adcbf's tracks")):
            plain = same[f"plain {stage}"]
            yield [f"{name} m", what, own[stage], plain, measuring.ratio(plain, own[stage])]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--ranges", type=float, nargs="+", default=[8.0, 20.0, 40.0], metavar="M")
    parser.add_argument("--frames", type=int, default=45, metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    arguments = parser.parse_args()
    if arguments.frames <= WARM_UP:
        parser.error(f"--frames must be more than the {WARM_UP} that warm up")
    warnings.simplefilter("ignore", FutureWarning)  # scikit-learn's, about a default to come
    measuring.pin_to_one_core()
    result = measure(arguments.log, arguments.ranges, arguments.frames)
    print(tables(result))
    measuring.write_json(arguments.json, result)


if __name__ == "__main__":
    main()
