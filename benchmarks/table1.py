"""The paper's Table I: an obstacle on equation 11's circle, from LiDAR points to prediction.

A cylinder of 0.48 m radius goes around (8.5, 2.0) m with A = 2.5 m and w = 0.015 Hz, once (66.7 s). A
16-channel LiDAR with 0.02 m range noise stands at the origin and scans at 10 Hz. Every scan goes
through the package's own perception, tracking and prediction (N = 30 steps of 0.1 s), at their
default settings but for the crop, which has to hold the circle. Errors are against equation 11:

    centre      the obstacle's cluster, before any filter
    tracking    the confirmed track's position, at each frame's stamp
    prediction  each step 1..30 from each frame with a confirmed track, all steps together
    step 30     the last step alone, 3 s ahead

An RMSE is taken over a run (one seed); shown are the mean over runs and the half width of its 95 %
t interval. With --vary, each further row changes one choice, and the others stay.

    python benchmarks/table1.py                    # the case itself, 20 seeds
    python benchmarks/table1.py --vary --seeds 5   # which choices move it
    python benchmarks/table1.py --only "model ct" --only base
    python benchmarks/table1.py --set tracking.model=ct --seeds 5 --first-seed 100
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import numpy as np  # noqa: E402 - after the thread counts

from adcbf_cli.core.config import Config  # noqa: E402
from adcbf_cli.core.perception.pipeline import Perception  # noqa: E402
from adcbf_cli.core.prediction.predictor import Predictor  # noqa: E402
from adcbf_cli.core.simulation.paths import motion_along  # noqa: E402
from adcbf_cli.core.simulation.scenario import CirclePath, Scenario  # noqa: E402
from adcbf_cli.core.simulation.simulator import Simulator  # noqa: E402
from adcbf_cli.core.tracking.tracker import Tracker  # noqa: E402
from adcbf_cli.core.types import Clusters, FloatArray, Frame, Notes, Predictions, Tracks, TrackStatus  # noqa: E402

PAPER = {"tracking": (0.015, 0.014), "prediction": (0.063, 0.051)}
MEASURES = ("centre", "tracking", "prediction", "step_30")
PERIOD_S = 1 / 0.015
MATCH_M = 1.0
"""A cluster or track farther than this from the obstacle is not the obstacle's."""

CIRCLE: dict[str, Any] = {"kind": "circle", "centre_m": [8.5, 2.0], "radius_m": 2.5, "frequency_hz": 0.015}
LIDAR: dict[str, Any] = {
    "kind": "spinning",
    "channels": 16,
    "azimuth_step_deg": 0.2,
    "instantaneous": True,
    "range_sigma_m": 0.02,
    "max_range_m": 20.0,
}
ROUGH: dict[str, Any] = {"kind": "bumps", "size_m": 50, "amplitude_m": 0.15, "wavelength_m": 3.0, "slope_deg": 4.0}
BASE_SETTINGS: dict[str, Any] = {"perception.range_m": 12.0, "prediction.calibration": "none"}


@dataclass(frozen=True)
class Variant:
    """One row: what it changes in the LiDAR, in the terrain and in the package's settings."""

    name: str
    lidar: dict[str, Any] = field(default_factory=dict)
    terrain: dict[str, Any] = field(default_factory=lambda: {"kind": "flat"})
    settings: dict[str, Any] = field(default_factory=dict)

    def scene(self, duration_s: float) -> Scenario:
        return Scenario.model_validate(
            {
                "duration_s": duration_s,
                "terrain": self.terrain,
                "movers": [{"kind": "cylinder", "radius_m": 0.48, "path": CIRCLE}],
                "ego": {"path": {"kind": "stand", "at_m": [0, 0]}},
                "lidar": LIDAR | self.lidar,
            }
        )

    def config(self, extra: dict[str, Any]) -> Config:
        nested: dict[str, dict[str, Any]] = {}
        for key, value in (BASE_SETTINGS | self.settings | extra).items():
            stage, name = key.split(".", 1)
            nested.setdefault(stage, {})[name] = value
        return Config.model_validate(nested)


VARIANTS = (
    Variant("base"),
    Variant("filter ekf", settings={"tracking.filter": "ekf"}),
    Variant("filter kf", settings={"tracking.filter": "kf"}),
    Variant("model ca", settings={"tracking.model": "ca"}),
    Variant("model ct", settings={"tracking.model": "ct"}),
    Variant("one noise level, 1 m/s^2", settings={"tracking.cruise_ratio": 1.0}),
    Variant("noise as configured, not adapted", settings={"tracking.adaptive_noise": False}),
    Variant("centre: rectangle", settings={"perception.centre": "box"}),
    Variant("centre: mean of points", settings={"perception.centre": "mean"}),
    Variant("centre: always a circle", settings={"perception.centre": "circle"}),
    Variant("clusterer dbscan", settings={"perception.clusterer": "dbscan"}),
    Variant("no outlier removal", settings={"perception.smoothing": False}),
    Variant("range noise 0.005 m", lidar={"range_sigma_m": 0.005}),
    Variant("range noise 0.05 m", lidar={"range_sigma_m": 0.05}),
    Variant("32 channels", lidar={"channels": 32}),
    Variant("azimuth step 0.4 deg", lidar={"azimuth_step_deg": 0.4}),
    Variant("rough ground, 4 deg slope", terrain=ROUGH),
    Variant("spinning, stamp at its start", lidar={"instantaneous": False}),
)


class Road:
    """One variant's stages, fed frame by frame, and the errors so far, (samples, 2) of x and y."""

    def __init__(self, config: Config) -> None:
        notes = Notes()
        self._perceive = Perception(config.perception, notes)
        self._track = Tracker(config.tracking, notes)
        self._predict = Predictor(config.prediction, config.tracking, notes)
        self.step_s = config.prediction.step_s
        self.errors: dict[str, list[FloatArray]] = {measure: [] for measure in MEASURES}
        self.frames = 0
        self.tracked = 0
        self.ids: set[int] = set()

    def feed(self, frame: Frame, now_s: float) -> None:
        clusters = self._perceive(frame)
        tracks = self._track(clusters)
        predictions = self._predict(tracks)
        self.frames += 1
        place = positions(np.array([now_s]))[0]
        self._score_cluster(clusters, place)
        self._score_track(tracks, predictions, place, now_s)

    def _score_cluster(self, clusters: Clusters, place: FloatArray) -> None:
        nearest = nearest_row(clusters.centre_m, place)
        if nearest is not None:
            self.errors["centre"].append(clusters.centre_m[nearest : nearest + 1, :2] - place)

    def _score_track(self, tracks: Tracks, predictions: Predictions, place: FloatArray, now_s: float) -> None:
        confirmed = np.flatnonzero((tracks.status == TrackStatus.CONFIRMED) | (tracks.status == TrackStatus.COASTING))
        nearest = nearest_row(tracks.state[confirmed], place)
        if nearest is None:
            return
        row = int(confirmed[nearest])
        self.tracked += 1
        self.ids.add(int(tracks.track_id[row]))
        self.errors["tracking"].append(tracks.state[row : row + 1, :2] - place)
        ahead = predictions.position_m[np.flatnonzero(predictions.track_id == tracks.track_id[row])[0], :, :2]
        later_s: FloatArray = now_s + self.step_s * np.arange(1.0, len(ahead) + 1)
        error: FloatArray = ahead - positions(later_s)
        self.errors["prediction"].append(error)
        self.errors["step_30"].append(error[-1:])

    def rmse(self) -> dict[str, FloatArray]:
        """Each measure's RMSE on x and y, (2,); NaN where nothing was found."""
        return {
            measure: np.sqrt(np.mean(np.concatenate(found) ** 2, axis=0)) if found else np.full(2, np.nan)
            for measure, found in self.errors.items()
        }


def positions(time_s: FloatArray) -> FloatArray:
    """(n, 2) where equation 11 puts the obstacle."""
    motion = motion_along(CirclePath.model_validate(CIRCLE), time_s)
    return np.column_stack([motion.x_m, motion.y_m])


def nearest_row(places_m: FloatArray, place_m: FloatArray) -> int | None:
    """The row whose x, y is nearest to a place (2,), if it is within MATCH_M."""
    distance = np.hypot(*(places_m[:, :2] - place_m).T)
    return int(distance.argmin()) if len(distance) and distance.min() < MATCH_M else None


def straight_ahead(steps: int = 30, step_s: float = 0.1) -> tuple[FloatArray, FloatArray]:
    """RMSE (2,) of a constant velocity prediction that starts from the exact position and velocity:
    over all steps, and at the last alone. No such prediction can be expected to be better."""
    now = np.linspace(0, PERIOD_S, 2000, endpoint=False)
    motion = motion_along(CirclePath.model_validate(CIRCLE), now)
    start = np.column_stack([motion.x_m, motion.y_m])
    velocity = np.column_stack([motion.vx_mps, motion.vy_mps])
    ahead = step_s * np.arange(1, steps + 1)
    error = np.stack([start + velocity * t - positions(now + t) for t in ahead], axis=1)
    return np.sqrt(np.mean(error**2, axis=(0, 1))), np.sqrt(np.mean(error[:, -1] ** 2, axis=0))


def run_seed(variants: Sequence[Variant], extra: dict[str, Any], seed: int, duration_s: float) -> Iterator[Road]:
    """Each variant's finished road; variants that see the same scene share its simulation."""
    roads = [Road(variant.config(extra)) for variant in variants]
    scenes = [variant.scene(duration_s) for variant in variants]
    for scene in dict.fromkeys(scenes):
        simulator = Simulator(scene, seed)
        mine = [road for road, other in zip(roads, scenes, strict=True) if other == scene]
        for simulated in simulator:
            now_s = float(simulator.world.seconds(np.array(simulated.scan.stamp_ns)))
            for road in mine:
                road.feed(simulated.frame, now_s)
    yield from roads


def summarise(runs: Sequence[Road]) -> dict[str, Any]:
    """Mean over runs and half width of the mean's 95 % t interval, for each measure, x and y."""
    from scipy.stats import t

    result: dict[str, Any] = {}
    for measure in MEASURES:
        values = np.array([run.rmse()[measure] for run in runs])
        half = np.full(2, np.nan)
        if len(runs) > 1:
            half = t.ppf(0.975, len(runs) - 1) * values.std(axis=0, ddof=1) / np.sqrt(len(runs))
        result[measure] = {
            axis: {
                "mean_m": _number(values[:, k].mean()),
                "half_width_m": _number(half[k]),
                "runs_m": [_number(value) for value in values[:, k]],
            }
            for k, axis in enumerate("xy")
        }
    result["tracked_share"] = sum(run.tracked for run in runs) / sum(run.frames for run in runs)
    result["identities"] = sum(len(run.ids) for run in runs) / len(runs)
    return result


def _number(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None


def markdown(results: dict[str, dict[str, Any]], seeds: range) -> str:
    """The results as a table, metres, x / y."""
    head = ("variant", "centre", "tracking", "prediction", "prediction, step 30", "tracked", "ids")
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    tracking, prediction = (" / ".join(f"{value:.3f}" for value in PAPER[key]) for key in ("tracking", "prediction"))
    lines.append(f"| paper's Table I | | {tracking} | {prediction} | | | |")
    all_steps, last = straight_ahead()
    lines.append(
        f"| exact state, straight ahead | | | {all_steps[0]:.4f} / {all_steps[1]:.4f} | "
        f"{last[0]:.4f} / {last[1]:.4f} | | |"
    )
    for name, result in results.items():
        cells = [" / ".join(_cell(result[measure][axis]) for axis in "xy") for measure in MEASURES]
        share = f"{100 * result['tracked_share']:.1f} %"
        lines.append(f"| {name} | {' | '.join(cells)} | {share} | {result['identities']:.2f} |")
    lines.append("")
    lines.append(f"RMSE in m, x / y: mean over seeds {seeds[0]} to {seeds[-1]}, and half of its 95 % interval.")
    return "\n".join(lines)


def _cell(value: dict[str, Any]) -> str:
    if value["mean_m"] is None:
        return "-"
    half = "" if value["half_width_m"] is None else f" ± {value['half_width_m']:.4f}"
    return f"{value['mean_m']:.4f}{half}"


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    summary, _, rest = (__doc__ or "").partition("\n\n")
    parser = argparse.ArgumentParser(
        description=summary, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="runs of each variant (default 20)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="N", help="seeds count from here (default 0)")
    parser.add_argument("--duration", type=float, default=PERIOD_S, metavar="S", help="default: one turn, 66.7 s")
    parser.add_argument("--vary", action="store_true", help="all variants, not the base case alone")
    parser.add_argument("--only", action="append", metavar="NAME", help="this variant; repeatable")
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.KEY=VALUE", help="a setting for all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all runs' values here")
    parsed = parser.parse_args(arguments)
    if parsed.seeds < 1:
        parser.error("--seeds must be at least 1")
    names = {variant.name for variant in VARIANTS}
    unknown = sorted(set(parsed.only or ()) - names)
    if unknown:
        parser.error(f"no variant {unknown[0]!r}; there are: {', '.join(sorted(names))}")
    if any("=" not in item or "." not in item.split("=")[0] for item in parsed.set):
        parser.error("--set takes STAGE.KEY=VALUE")
    return parsed


def main(arguments: Sequence[str] | None = None) -> None:
    import yaml

    chosen = parse_arguments(arguments)
    wanted = chosen.only or (None if chosen.vary else ["base"])
    variants = [variant for variant in VARIANTS if wanted is None or variant.name in wanted]
    extra = {key: yaml.safe_load(value) for key, value in (item.split("=", 1) for item in chosen.set)}
    runs: dict[str, list[Road]] = {variant.name: [] for variant in variants}
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    for seed in seeds:
        for variant, road in zip(variants, run_seed(variants, extra, seed, chosen.duration), strict=True):
            runs[variant.name].append(road)
        print(f"seed {seed} done", file=sys.stderr)
    results = {name: summarise(found) for name, found in runs.items()}
    print(markdown(results, seeds))
    if chosen.json is not None:
        document = {"seeds": list(seeds), "duration_s": chosen.duration, "settings": extra, "results": results}
        chosen.json.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
