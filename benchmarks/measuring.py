"""What the benchmarks share: one core and one thread, summaries, the machine, Markdown tables.

Import it before numpy: numerical libraries read the number of threads when they are loaded.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
    os.environ[_name] = "1"

ROOT = Path(__file__).resolve().parents[1]
SAMPLE_LOG = ROOT / "sample_data" / "sample.mcap"

BUSY_BELOW = 0.9
"""Share of the wall time that a pinned, computing process gets on an idle machine, at least."""


def pin_to_one_core() -> None:
    """Keeps this process and its children on one core, where the system can do that."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def street_log() -> Path | None:
    """The recorded street log of the data folder, or None where it is absent."""
    folder = Path(os.environ.get("ADCBF_REAL_DATA", ROOT / ".." / "shared" / "data"))
    log = folder / "kitti0000" / "kitti0000_a.mcap"
    return log if log.exists() else None


def machine() -> dict[str, str | int | None]:
    """What figures depend on, without what names this machine."""
    packages = ("numpy", "scipy", "scikit-learn", "filterpy", "pypatchworkpp", "mcap", "rosbags", "pyarrow")
    return {
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "libraries": ", ".join(f"{name} {version(name)}" for name in packages),
    }


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


class Share:
    """How much of the wall time this process computed: well below one, the machine was busy otherwise."""

    def __init__(self) -> None:
        self._wall, self._own = perf_counter(), process_time()

    def __call__(self) -> float:
        return (process_time() - self._own) / max(perf_counter() - self._wall, 1e-9)


def spread(values: Sequence[float]) -> dict[str, float]:
    """Median, 95th percentile (the smallest value that 95 % do not exceed) and largest."""
    ordered = sorted(values)
    rank = -(-len(ordered) * 95 // 100) - 1
    return {"median": statistics.median(ordered), "p95": ordered[rank], "max": ordered[-1]}


def markdown(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table; numbers to the right, None as a dash."""
    texts = [[_text(cell) for cell in row] for row in rows]
    numeric = [all(isinstance(row[k], int | float | None) for row in rows) for k in range(len(head))]
    lines = [f"| {' | '.join(head)} |", "| " + " | ".join("---:" if right else "---" for right in numeric) + " |"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in texts)])


def _text(cell: object) -> str:
    """Three figures where there are that many, whole numbers above a hundred."""
    if cell is None:
        return "-"
    if isinstance(cell, float):
        return f"{cell:,.0f}" if abs(cell) >= 100 else f"{cell:.3g}"
    return f"{cell:,}" if isinstance(cell, int) else str(cell)


def busy_warning(share: object) -> str:
    """A line to put below a table that was measured while others used the core; else empty."""
    if isinstance(share, float) and share < BUSY_BELOW:
        return f"\nThis process got {100 * share:.0f} % of its core: milliseconds are too high, ratios stand.\n"
    return ""


def ratio(slow: float | None, fast: float | None) -> float | None:
    return None if slow is None or fast is None or fast == 0 else slow / fast


def write_json(path: Path | None, document: Mapping[str, Any]) -> None:
    """Writes a benchmark's figures where they were asked for."""
    if path is not None:
        path.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
