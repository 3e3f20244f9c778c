"""What comes out on recorded logs: the tables of docs/results.md, with the commands that made them.

    python benchmarks/real_logs.py [FOLDER] [--only NAME] [--json FILE]

FOLDER holds the recorded logs; without it the environment variable ADCBF_REAL_DATA or the folder
`../shared/data` is taken. Every log goes through `adcbf run`, as a user would type it, at default
settings but for what the printed command shows. A log that is absent is left out, visibly; one
that fails is shown with its message.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PROJECT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Case:
    """One log and how it is run; paths are relative to the folder of recorded logs."""

    log: str
    options: tuple[str, ...] = ()
    truth: str | None = None

    @property
    def name(self) -> str:
        return Path(self.log).stem

    def arguments(self, folder: Path | None = None) -> list[str]:
        """The command after `adcbf`; with `folder`, paths below it."""
        place = (lambda path: path) if folder is None else (lambda path: str(folder / path))
        arguments = ["run", place(self.log), *self.options]
        if self.truth is not None:
            arguments += ["--truth", self.truth if self.truth.startswith("topic:") else place(self.truth)]
        return arguments


MOUNT = "ego_pose>laser:-0.15,0.03,0,0,0,0"
EGO = ("--pose", "/ego_pose", "--extrinsic", MOUNT, "--set", "evaluation.match_m=0.5")
"""These cars are 0.4 m long: what is a metre away from one is not it. The log has no transform to its
laser; MOUNT is where the laser sees the surroundings sharpest (benchmarks/mount.py)."""
NEATO = "neato/neato_c-mawn"
WITH_TRUTH = (
    Case("kitti0000/kitti0000_a.mcap", ("--range", "20"), "kitti0000/kitti0000_a_gt_tracks.csv"),
    Case("kitti0000/kitti0000_full360.mcap", ("--range", "20"), "kitti0000/kitti0000_full360_gt_tracks.csv"),
    Case("datmo/overtakes.bag", EGO, "topic:/red_pose"),
    Case("datmo/parallel.bag", EGO, "topic:/red_pose"),
)
WITHOUT_TRUTH = (
    Case("leg_tracker/demo_stationary_simple_environment.bag"),
    *(Case(f"leg_tracker/positive_{i}.bag") for i in range(1, 8)),
    Case("leg_tracker/negative_2.bag", ("--lidar", "/right_scan")),
    *(Case(f"tamu_people/example{i}") for i in range(1, 10)),
    Case(f"{NEATO}/person_follower_bag"),
    Case(f"{NEATO}/obstacle_avoidance_bag"),
    Case(f"{NEATO}/wall_follower_bag"),
    Case(f"{NEATO}/finite_state_controller_bag"),
)

Column = tuple[str, tuple[str, ...], int]
TRACKING: tuple[Column, ...] = (
    ("clusters, raw", ("clustering.rmse_x_m", "clustering.rmse_y_m"), 3),
    ("clusters, body bias removed", ("clustering.rmse_body_corrected_x_m", "clustering.rmse_body_corrected_y_m"), 3),
    ("bias in the body", ("clustering.bias_body_x_m", "clustering.bias_body_y_m"), 3),
    ("tracks, raw", ("tracking.rmse_x_m", "tracking.rmse_y_m"), 3),
    ("tracks, body bias removed", ("tracking.rmse_body_corrected_x_m", "tracking.rmse_body_corrected_y_m"), 3),
    ("the same, x and y together", ("tracking.rmse_body_corrected_m",), 3),
)
PREDICTION: tuple[Column, ...] = (
    ("prediction, steps 1-30", ("prediction.rmse_x_m", "prediction.rmse_y_m"), 3),
    ("standing still instead", ("prediction.rmse_still_x_m", "prediction.rmse_still_y_m"), 3),
    ("ADE 1, 2, 3 s", tuple(f"prediction.ade_m.{i}.0s" for i in (1, 2, 3)), 2),
    ("FDE 1, 2, 3 s", tuple(f"prediction.fde_m.{i}.0s" for i in (1, 2, 3)), 2),
    ("95 % ellipse covers", ("prediction.coverage_95",), 2),
    ("conformal radius covers", ("prediction.coverage_conformal_radius",), 2),
)
SCORES: tuple[Column, ...] = (
    ("recall", ("detection.recall",), 3),
    ("track recall", ("detection.track_recall",), 3),
    ("moving precision", ("detection.moving_precision",), 2),
    ("MOTA", ("clear.mota",), 2),
    ("MOTP, m", ("clear.motp_m",), 3),
    ("switches", ("clear.switches",), 0),
    ("HOTA", ("hota.hota",), 2),
    ("NEES", ("tracking.nees",), 1),
)
SELF: tuple[Column, ...] = (
    ("tracks confirmed", ("tracks.confirmed",), 0),
    ("life, median s", ("tracks.life_s.median",), 1),
    ("standing share", ("tracks.static_share",), 2),
    ("all: x, y, m", ("later_seen.rmse_x_m", "later_seen.rmse_y_m"), 3),
    ("moving: x, y, m", ("later_seen.moving.rmse_x_m", "later_seen.moving.rmse_y_m"), 2),
    ("moving: FDE 1, 2, 3 s, m", tuple(f"later_seen.moving.fde_m.{i}.0s" for i in (1, 2, 3)), 2),
    ("moving: conformal covers", ("later_seen.moving.coverage_conformal_radius",), 2),
)


@dataclass(frozen=True)
class Outcome:
    """What a case gave: the exit code, the JSON document (None where it failed), its last message."""

    case: Case
    code: int
    document: dict[str, Any] | None
    message: str

    def metric(self, name: str) -> dict[str, Any]:
        assert self.document is not None
        found: dict[str, Any] = self.document["report"]["metrics"][name]
        return found


def run_case(case: Case, data: Path, scratch: Path) -> Outcome:
    command = [sys.executable, "-m", "adcbf_cli", *case.arguments(data), "-o", str(scratch / case.name), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = done.stderr.strip().splitlines()
    document = json.loads(done.stdout) if done.stdout else None
    return Outcome(case, done.returncode, document, lines[-1] if lines else "")


def table(outcomes: Sequence[Outcome], columns: Sequence[Column], sample: str) -> list[str]:
    """One row a log; `sample` names the metric whose number of samples is shown."""
    head = ["log", *(name for name, _, _ in columns), "n"]
    lines = [f"| {' | '.join(head)} |", f"|{' --- |' * len(head)}"]
    for outcome in outcomes:
        if outcome.document is None:
            lines.append(f"| {outcome.case.name} | {outcome.message} |")
            continue
        cells = [" / ".join(_number(outcome.metric(name)["value"], d) for name in names) for _, names, d in columns]
        lines.append(f"| {outcome.case.name} | {' | '.join(cells)} | {outcome.metric(sample)['n']} |")
    return lines


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def overview(outcomes: Sequence[Outcome]) -> list[str]:
    """Scans, obstacles and time a frame, by log."""
    lines = ["| log | scans | s | obstacles a scan | ms a scan | exit code |", "| --- | --- | --- | --- | --- | --- |"]
    for outcome in outcomes:
        if outcome.document is None:
            lines.append(f"| {outcome.case.name} | - | - | - | - | {outcome.code} |")
            continue
        run = outcome.document["run"]
        facts = {fact["name"]: fact["value"] for fact in run["facts"]}
        cells = (facts["scans"], facts["time span"], facts["obstacles a scan, mean"])
        spent = sum(run["time_ms_per_frame"].values())
        lines.append(f"| {outcome.case.name} | {' | '.join(map(str, cells))} | {spent:.0f} | {outcome.code} |")
    return lines


def report(with_truth: Sequence[Outcome], without: Sequence[Outcome]) -> str:
    lines = ["### Overview", "", *overview([*with_truth, *without])]
    if with_truth:
        lines += ["", "### Accuracy against ground truth, RMSE in m, x / y"]
        lines += ["", *table(with_truth, TRACKING, "tracking.rmse_m")]
        lines += [
            "",
            "### Prediction against ground truth, m",
            "",
            *table(with_truth, PREDICTION, "prediction.rmse_x_m"),
        ]
        lines += ["", "### Detection and identity", "", *table(with_truth, SCORES, "detection.recall")]
    if without:
        lines += ["", "### Without ground truth: predictions against where the same track was later seen"]
        lines += ["", *table(without, SELF, "later_seen.rmse_x_m")]
    lines += ["", "### The commands", ""]
    lines += [f"    adcbf {shlex.join(outcome.case.arguments())}" for outcome in (*with_truth, *without)]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    default = Path(os.environ.get("ADCBF_REAL_DATA", PROJECT.parent / "shared" / "data"))
    parser.add_argument("data", type=Path, nargs="?", default=default, metavar="FOLDER")
    parser.add_argument("--only", action="append", metavar="NAME", help="this log; repeatable")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write every run's document here")
    chosen = parser.parse_args(arguments)
    outcomes: tuple[list[Outcome], list[Outcome]] = ([], [])
    with tempfile.TemporaryDirectory() as scratch:
        for group, cases in zip(outcomes, (WITH_TRUTH, WITHOUT_TRUTH), strict=True):
            for case in cases:
                if chosen.only and case.name not in chosen.only:
                    continue
                if not (chosen.data / case.log).exists():
                    print(f"{case.log}: not here, left out", file=sys.stderr)
                    continue
                group.append(run_case(case, chosen.data, Path(scratch)))
                print(f"{case.name}: exit code {group[-1].code}", file=sys.stderr)
    print(report(*outcomes))
    if chosen.json is not None:
        document = {outcome.case.log: outcome.document for group in outcomes for outcome in group}
        chosen.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
