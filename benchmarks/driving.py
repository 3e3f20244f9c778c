"""All planners on recorded logs: the driving tables of docs/results.md, with the commands that made them.

    python benchmarks/driving.py [FOLDER] [--only NAME]

FOLDER holds the recorded logs, as for `real_logs.py`; the sample log is the project's own. Every log goes through
`adcbf plan` and `adcbf replay` as a user would type them. A log that is absent is left out, visibly.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
VEHICLES = PROJECT / "benchmarks" / "vehicles"
SEEDS = ("--seeds", "0:10")


@dataclass(frozen=True)
class Case:
    """One command on a log: paths of logs and truths are relative to their folder."""

    name: str
    command: str
    log: str
    options: tuple[str, ...]
    truth: str
    vehicle: str | None = None
    own: bool = False
    """The log is the project's sample."""

    def words(self, folder: Path | None = None) -> list[str]:
        """The command after `adcbf`; with `folder`, whole paths."""

        def place(path: str) -> str:
            if path.startswith("topic:") or folder is None:
                return path
            return str((PROJECT if self.own else folder) / path)

        words = [self.command, place(self.log), *self.options, "--truth", place(self.truth), "--planner", "all"]
        if self.vehicle is not None:
            file = VEHICLES / self.vehicle
            words += ["--config", str(file if folder is not None else file.relative_to(PROJECT))]
        return [*words, "--against", "ad-cbf-mpc"]


SAMPLE = ("sample_data/sample.mcap", ("--range", "12"), "sample_data/truth.csv")
MOUNT = "ego_pose>laser:-0.15,0.03,0,0,0,0"
DATMO = ("datmo/overtakes.bag", ("--pose", "/ego_pose", "--extrinsic", MOUNT, "--range", "5"), "topic:/red_pose")
KITTI = ("kitti0000/kitti0000_a.mcap", ("--range", "20"), "kitti0000/kitti0000_a_gt_tracks.csv")


def cases() -> list[Case]:
    log, options, truth = SAMPLE
    bag, posed, other = DATMO
    street, far, labels = KITTI
    car, scaled = "street_car.yaml", "scaled_car.yaml"
    return [
        Case("sample, open loop", "plan", log, options, truth, own=True),
        Case("sample, the log's own way", "replay", log, (*options, *SEEDS), truth, own=True),
        Case("sample, across the scene", "replay", log, (*options, "--goal", "14,-3", *SEEDS), truth, own=True),
        Case("datmo overtakes, open loop", "plan", bag, posed, other, scaled),
        Case("datmo overtakes, closed loop", "replay", bag, (*posed, "--speed", "1", *SEEDS), other, scaled),
        Case("kitti0000_a, open loop", "plan", street, far, labels, car),
        Case("kitti0000_a, closed loop", "replay", street, (*far, "--speed", "4", *SEEDS), labels, car),
    ]


def table(case: Case, folder: Path) -> str:
    """The command's table as Markdown, or why there is none."""
    with tempfile.TemporaryDirectory() as place:
        run = Path(place, "run.adcbf")
        command = [str(Path(sys.executable).with_name("adcbf")), *case.words(folder), "--output", str(run)]
        done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if done.returncode not in (0, 3):
            return f"failed with exit code {done.returncode}: {done.stderr.strip().splitlines()[-1]}\n"
        kind = "open_loop" if case.command == "plan" else "replay"
        report = (run / kind / "report.md").read_text(encoding="utf-8")
    world = next(line for line in report.splitlines() if line.startswith("Log:"))
    rows = [line for line in report.split("###")[0].splitlines() if line.startswith("|")]
    return "\n".join([world, "", *rows]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    default = Path(os.environ.get("ADCBF_REAL_DATA", PROJECT.parent / "shared" / "data"))
    parser.add_argument("folder", type=Path, nargs="?", default=default, metavar="FOLDER")
    parser.add_argument("--only", metavar="NAME", default="", help="cases whose name contains this")
    arguments = parser.parse_args()
    for case in cases():
        if arguments.only not in case.name:
            continue
        print(f"### {case.name}\n\n    adcbf {shlex.join(case.words())}\n", flush=True)
        here = PROJECT if case.own else arguments.folder
        print(table(case, arguments.folder) if (here / case.log).exists() else f"{case.log} is not here.\n", flush=True)


if __name__ == "__main__":
    main()
