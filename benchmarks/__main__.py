"""The speed and memory benchmarks, one after the other: what `make bench` runs.

    python benchmarks [--results FOLDER]

They run on the sample log, and on the street log (kitti0000_a.mcap) where the folder named by
ADCBF_REAL_DATA, or ../shared/data, has it. Tables go to the terminal as Markdown, figures to
benchmarks/results/*.json. Beside speed and memory there is one table on segmentation, so that nothing is
gained by clustering worse. The paper's Table I is `benchmarks/table1.py`, recorded pedestrians are
`benchmarks/pedestrians.py`: they measure errors and driving, not speed.
"""

from __future__ import annotations

import measuring  # isort: skip
import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent


def run(script: str, *arguments: str) -> str:
    """One benchmark in its own process. Raises CalledProcessError when it fails."""
    done = subprocess.run([sys.executable, str(HERE / script), *arguments], check=True, stdout=subprocess.PIPE)
    return done.stdout.decode()


def tracking(results: Path) -> str:
    """`tracking.py`'s figures as Markdown."""
    found: dict[str, Any] = json.loads(run("tracking.py", "--json"))
    measuring.write_json(results / "tracking.json", found)
    rows = [[row["case"], row["tracks"], row["batched_ms"], row["filterpy_ms"], row["ratio"]] for row in found["rows"]]
    return measuring.markdown(["case", "tracks", "batched ms", "filterpy ms", "ratio"], rows) + "\n"


def segmentation(log: Path, truth: Path, results: Path, *options: str) -> str:
    """`segmentation.py`'s figures as Markdown."""
    return run(
        "segmentation.py", str(log), str(truth), *options, "--json", str(results / f"segmentation_{log.stem}.json")
    )


def on_log(log: Path, results: Path, frames: int) -> None:
    """The benchmarks that read a log."""
    for script in ("pipeline", "reading", "memory"):
        more = ["--frames", str(frames)] if script == "pipeline" else []
        print(f"### {script}\n", flush=True)
        print(run(f"{script}.py", str(log), *more, "--json", str(results / f"{script}_{log.stem}.json")), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--results", type=Path, default=HERE / "results", metavar="FOLDER")
    results: Path = parser.parse_args().results
    results.mkdir(parents=True, exist_ok=True)
    print("## Batch\n")
    print(run("batch.py", "--json", str(results / "batch.json")), flush=True)  # with all cores, unlike what follows
    measuring.pin_to_one_core()
    machine = measuring.machine()
    print(
        f"{machine['cpu']}, {machine['cores']} cores, one used; Python {machine['python']}; {machine['libraries']}.\n"
    )
    print("## Start\n")
    print(run("startup.py", "--json", str(results / "startup.json")), flush=True)
    print("## Filters and horizon\n")
    print(tracking(results), flush=True)
    print("## Planning\n")
    print(run("planning.py", "--json", str(results / "planning.json")), flush=True)
    print("## Closed loop\n")
    print(run("closed_loop.py", "--json", str(results / "closed_loop.json")), flush=True)
    print(f"## {measuring.SAMPLE_LOG.name}\n")
    on_log(measuring.SAMPLE_LOG, results, 45)
    print("### segmentation\n")
    sample_truth = measuring.SAMPLE_LOG.with_name("truth.csv")
    print(segmentation(measuring.SAMPLE_LOG, sample_truth, results, "--range", "15", "--label-range", "12"), flush=True)
    street = measuring.street_log()
    if street is None:
        print("No street log: ADCBF_REAL_DATA does not name a folder with kitti0000/kitti0000_a.mcap.")
        return
    print(f"## {street.name}\n")
    on_log(street, results, 45)
    print("### segmentation\n")
    street_truth = street.with_name(f"{street.stem}_gt_tracks.csv")
    print(segmentation(street, street_truth, results), flush=True)


if __name__ == "__main__":
    main()
