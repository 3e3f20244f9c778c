"""Planners cross a square full of recorded pedestrians: ETH or UCY annotations through `adcbf replay`.

    python benchmarks/pedestrians.py OBSMAT.txt --fps 15 [--seeds 40] [--way across|along] [--json FILE]

An obsmat.txt has the columns frame, id, x, z, y, vx, vz, vy in metres; frames count at 15 a second in
seq_eth and at 25 in the other recordings. It becomes an object list in a temporary folder, and the
package's own object stage sees it: circles of 0.3 m, interpolated to 10 Hz, with noise, tracked and predicted.

The vehicle (a circle of 0.3 m, at most 1.2 m/s) crosses at 1 m/s on a straight line through the median of
all positions: across the direction in which people mostly walk, or along it, from 1 m outside of where
98 % of them are to 1 m outside on the other side. Each seed starts at another time of the recording, and
displaced sideways; all planners start alike. Pedestrians do not react. The planners know everybody within
10 m. Everything else is at its default.
"""

from __future__ import annotations

import measuring  # isort: skip - it limits the threads before numpy is imported
import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from adcbf_cli.core.types import FloatArray

SPEED_MPS = 1.0
FIRST_SEED = 100
OUTSIDE_M = 1.0
TIMES = 3
"""The vehicle may take so many times the crossing's nominal time, which has to be left of the recording."""

SETTINGS = {
    "vehicle.max_speed_mps": 1.2,
    "vehicle.body_radius_m": 0.3,
    "read.object_radius_m": 0.3,
    "replay.range_m": 10.0,
    "replay.timeout_factor": TIMES,
}

AGAINST = "ad-cbf-mpc"
RATES = ("success", "collision", "timeout")
MEANS = {
    "nav_time_s": "nav time s",
    "min_dist_m": "min dist m",
    "path_length_m": "path m",
    "relaxed_rate": "relaxed",
    "braked_rate": "braked",
}
"""Metrics by their name in report.json, and what their columns are called."""


@dataclass(frozen=True)
class Recording:
    """stamp_s, track_id: (s,). place_m, velocity_mps: (s, 2)."""

    stamp_s: FloatArray
    track_id: FloatArray
    place_m: FloatArray
    velocity_mps: FloatArray

    @property
    def length_s(self) -> float:
        return float(np.ptp(self.stamp_s))

    def crossing(self, way: str) -> tuple[FloatArray, FloatArray]:
        """From where to where (2,): a straight line through the median, across or along the main direction."""
        _, axes = np.linalg.eigh(self.velocity_mps.T @ self.velocity_mps)
        axis = axes[:, 0 if way == "across" else 1]
        axis = axis * np.sign(axis[np.argmax(np.abs(axis))])  # eigenvectors come with either sign
        middle = np.median(self.place_m, axis=0)
        low, high = np.percentile((self.place_m - middle) @ axis, [1.0, 99.0])
        return middle + (low - OUTSIDE_M) * axis, middle + (high + OUTSIDE_M) * axis


def read_obsmat(path: Path, fps: float) -> Recording:
    """Rows in the order of time. Exits where the file is no obsmat."""
    rows = np.loadtxt(path, ndmin=2)
    if rows.shape[1] != 8:
        sys.exit(f"benchmarks/pedestrians.py: {path} has {rows.shape[1]} columns, an obsmat has 8")
    rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
    return Recording((rows[:, 0] - rows[0, 0]) / fps, rows[:, 1], rows[:, [2, 4]], rows[:, [5, 7]])


def write_objects(recording: Recording, target: Path) -> None:
    """The recording as an object list."""
    lines = ["timestamp_ns,track_id,class,x_m,y_m"]
    columns = (recording.stamp_s, recording.track_id, recording.place_m)
    for stamp_s, track_id, (x_m, y_m) in zip(*columns, strict=True):
        lines.append(f"{round(1e9 * stamp_s)},{int(track_id)},pedestrian,{x_m:.6f},{y_m:.6f}")
    target.write_text("\n".join(lines) + "\n", encoding="utf-8")


def adcbf(*words: str) -> float:
    """Runs a command; wall seconds. Exits with its message where it fails."""
    begin = perf_counter()
    command = [str(Path(sys.executable).with_name("adcbf")), *words]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode != 0:
        sys.exit(f"benchmarks/pedestrians.py: adcbf {words[0]} failed:\n{done.stderr}")
    return perf_counter() - begin


def measure(path: Path, fps: float, seeds: int, way: str, planners: list[str]) -> dict[str, Any]:
    recording = read_obsmat(path, fps)
    start, goal = recording.crossing(way)
    nominal_s = float(np.hypot(*(goal - start))) / SPEED_MPS
    settings = SETTINGS | {"replay.start_delay_s": round(recording.length_s - TIMES * nominal_s, 1)}
    with tempfile.TemporaryDirectory() as folder:
        objects, run = Path(folder, "people.csv"), Path(folder, "people.adcbf")
        write_objects(recording, objects)
        words = [f"--set={key}={value}" for key, value in settings.items()]
        predict_s = adcbf("predict", str(objects), "-o", str(run), *words)
        words += [f"--{name}={place[0]:.3f},{place[1]:.3f}" for name, place in (("start", start), ("goal", goal))]
        words += [f"--planner={name}" for name in planners]
        words += [f"--against={AGAINST}"] if {AGAINST, "all"} & set(planners) else []
        words += [f"--seeds={FIRST_SEED}:{FIRST_SEED + seeds}", f"--speed={SPEED_MPS}"]
        replay_s = adcbf("replay", str(run), *words)
        report = json.loads((run / "replay" / "report.json").read_text(encoding="utf-8"))
    return {
        "benchmark": "pedestrians",
        "recording": "/".join(path.parts[-2:]),
        "length_s": recording.length_s,
        "people": len(np.unique(recording.track_id)),
        "way": way,
        "seeds": [FIRST_SEED, FIRST_SEED + seeds],
        "settings": settings,
        "seconds": {"predict": predict_s, "replay": replay_s},
        "report": report,
    }


def table(result: dict[str, Any]) -> str:
    """The result as Markdown: shares of drives with their 95 % intervals, means over drives."""
    report, settings = result["report"], result["settings"]
    route, comparison = report["route"], report["comparison"]
    rows = [
        [name, score["drives"], *(_rate(score["metrics"][key]) for key in RATES), _difference(score)]
        + [score["metrics"][key]["value"] for key in MEANS]
        for name, score in comparison["planners"].items()
    ]
    head = ["planner", "drives", *RATES, f"collision minus {comparison['against']}", *MEANS.values()]
    (x, y), (to_x, to_y) = route["start_m"], route["goal_m"]
    return (
        f"`{result['recording']}`: {result['people']} people in {result['length_s']:.0f} s. From ({x:.1f}, {y:.1f}) to "
        f"({to_x:.1f}, {to_y:.1f}), {route['length_m']:.1f} m {result['way']} the main direction; seeds "
        f"{result['seeds'][0]} to {result['seeds'][1] - 1}.\n\n"
        f"Settings: {', '.join(f'`{key}={value}`' for key, value in settings.items())}.\n\n"
        f"{measuring.markdown(head, rows)}\n\n"
        "In brackets 95 % intervals: Wilson's for shares, a bootstrap over seeds for the paired difference. Other "
        "columns are means over the drives that have a value: nav time and path over successes.\n"
    )


def _rate(found: dict[str, Any]) -> str:
    low, high = found["interval_95"]
    return f"{100 * found['value']:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def _difference(score: dict[str, Any]) -> str:
    found = score.get("differences", {}).get("collision")
    if found is None or found["value"] is None:
        return "-"
    between = found["interval_95"]
    said = "" if between is None else f" ({100 * between[0]:+.0f} to {100 * between[1]:+.0f})"
    return f"{100 * found['value']:+.0f} %{said}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("obsmat", type=Path)
    parser.add_argument("--fps", type=float, required=True, help="video frames a second: 15 in seq_eth, else 25")
    parser.add_argument("--seeds", type=int, default=40, metavar="N")
    parser.add_argument("--way", choices=("across", "along"), default="across")
    parser.add_argument("--planner", action="append", metavar="NAME", help="repeatable; default: all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    arguments = parser.parse_args()
    measuring.pin_to_one_core()
    result = measure(arguments.obsmat, arguments.fps, arguments.seeds, arguments.way, arguments.planner or ["all"])
    print(table(result))
    measuring.write_json(arguments.json, result)


if __name__ == "__main__":
    main()
