"""How long `adcbf --help` takes, beside an empty Python process.

    python benchmarks/startup.py [--repeats 10] [--json FILE]

Wall time of whole processes, in turn, on one core; medians. One of each runs first, uncounted.
"""

from __future__ import annotations

import measuring  # isort: skip
import argparse
import subprocess
import sys
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

COMMANDS = {
    "adcbf --help": [str(Path(sys.executable).with_name("adcbf")), "--help"],
    "python -c pass": [sys.executable, "-c", "pass"],
}


def wall_ms(command: list[str]) -> float:
    begin = perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return 1e3 * (perf_counter() - begin)


def measure(repeats: int) -> dict[str, Any]:
    spent: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for number in range(repeats + 1):
        for name, command in COMMANDS.items():
            wall = wall_ms(command)
            if number > 0:
                spent[name].append(wall)
    return {
        "benchmark": "startup",
        "repeats": repeats,
        "ms": {name: {"median": median(values), "least": min(values)} for name, values in spent.items()},
        "machine": measuring.machine(),
    }


def table(result: dict[str, Any]) -> str:
    """The result as Markdown."""
    rows = [[f"`{name}`", found["median"], found["least"]] for name, found in result["ms"].items()]
    return measuring.markdown(["command", "median ms", "least ms"], rows) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=10, metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    arguments = parser.parse_args()
    measuring.pin_to_one_core()
    result = measure(arguments.repeats)
    print(table(result))
    measuring.write_json(arguments.json, result)


if __name__ == "__main__":
    main()
