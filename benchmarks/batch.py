"""How a batch scales over processes, and what Ray costs against them.

    python benchmarks/batch.py [--copies N] [--log LOG] [--processes 1 2] [--json FILE]

`adcbf batch` as a user calls it, from its start to its end, on copies of one log; each time into a new folder, so that
nothing is there already. The same with lists of one object, as many as there are processes, so that each of them
starts: what is left then is what starting the engine, its processes and the libraries costs. Rounds are taken in turn;
the fastest of each counts, since the machine can only make it slower.
"""

from __future__ import annotations

import measuring  # isort: skip - it limits the threads before numpy is imported
import argparse
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

ONE_OBJECT = "timestamp_ns,track_id,class,x_m,y_m\n0,1,person,3,0\n100000000,1,person,3,0.1\n"


@dataclass(frozen=True)
class Way:
    """An engine with so many processes."""

    engine: str
    processes: int

    def wall_s(self, logs: Path, folder: Path, options: Sequence[str]) -> float:
        """Seconds that the batch takes. Raises CalledProcessError where a log fails."""
        command = [sys.executable, "-m", "adcbf_cli", "batch", f"{logs}/*", "-o", str(folder)]
        command += ["--engine", self.engine, "--jobs", str(self.processes), "--", "run", *options]
        began = perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return perf_counter() - began


def copies(log: Path, count: int, folder: Path) -> Path:
    """A folder with `count` copies of the log, each of another name."""
    folder.mkdir()
    for i in range(count):
        shutil.copy(log, folder / f"copy{i}{log.suffix}")
    return folder


def measure(logs: Mapping[Way, Path], options: Sequence[str], rounds: int, scratch: Path) -> dict[Way, float]:
    """The fastest round of each way on the logs in its folder, the ways in turn."""
    found: dict[Way, float] = {}
    for number in range(rounds):
        for way, given in logs.items():
            folder = scratch / f"{given.name}-{way.engine}-{way.processes}-{number}.batch"
            found[way] = min(found.get(way, float("inf")), way.wall_s(given, folder, options))
            shutil.rmtree(folder)
    return found


def table(ways: Sequence[Way], work: dict[Way, float], start: dict[Way, float], count: int) -> list[dict[str, Any]]:
    """A row a way; speed-ups are against the first way."""
    return [
        {
            "engine": way.engine,
            "processes": way.processes,
            "wall_s": work[way],
            "start_s": start[way],
            "s_a_log": (work[way] - start[way]) / count,
            "speed_up": work[ways[0]] / work[way],
        }
        for way in ways
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--log", type=Path, default=measuring.SAMPLE_LOG)
    parser.add_argument("--copies", type=int, default=8)
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--range", default="12", metavar="M")
    parser.add_argument("--json", type=Path, metavar="FILE")
    given = parser.parse_args()
    engines = ["processes", "ray"] if find_spec("ray") else ["processes"]
    ways = [Way(engine, count) for engine in engines for count in given.processes]
    options = ["--range", given.range]
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        logs = copies(given.log, given.copies, scratch / "logs")
        tiny = scratch / "one.csv"
        tiny.write_text(ONE_OBJECT, encoding="utf-8")
        tiny_ones = {count: copies(tiny, count, scratch / f"tiny{count}") for count in {*given.processes}}
        start = measure({way: tiny_ones[way.processes] for way in ways}, [], given.rounds, scratch)
        work = measure(dict.fromkeys(ways, logs), options, given.rounds, scratch)
    rows = table(ways, work, start, given.copies)
    document = {"machine": measuring.machine(), "log": given.log.name, "copies": given.copies, "rows": rows}
    measuring.write_json(given.json, document)
    print(f"`adcbf batch` on {given.copies} copies of `{given.log.name}`, fastest of {given.rounds} rounds:\n")
    head = ["engine", "processes", "wall s", "of it start s", "s a log", "times the first"]
    print(measuring.markdown(head, [list(row.values()) for row in rows]))
    if "ray" not in engines:
        print("\nRay is not installed, and was not measured.")


if __name__ == "__main__":
    main()
