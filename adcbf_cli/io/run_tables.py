"""The `runs` table of a closed-loop campaign: one row a run, sorted by planner as they came, then seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from adcbf_cli.core.evaluation.driving import METRICS
from adcbf_cli.io.parquet import TableWriter

SCENE = ("movers", "fastest_mps", "standing", "bumps_m", "slope_deg")
COLLISION = ("object_id", "kind", "moving", "at_s", "known_since_s", "avoidable", "avoidable_until_s")


def write_runs(path: Path, rows: Sequence[Mapping[str, Any]], metadata: Mapping[str, Any]) -> None:
    """Rows of `evaluation.scene_runs`; a run that failed has its planner, its seed, its error and nothing else."""
    planners = list(dict.fromkeys(row["planner"] for row in rows))
    ordered = sorted(rows, key=lambda row: (planners.index(row["planner"]), row["seed"]))
    with TableWriter(path, "runs", metadata) as writer:
        if ordered:
            flat = [_flat(row) for row in ordered]
            writer.write({name: [row[name] for row in flat] for name in flat[0]})


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    scene, hit, metrics = (row.get(name) or {} for name in ("scene", "collision", "metrics"))
    return {
        **{name: row.get(name) for name in ("planner", "seed", "knowledge", "result", "duration_s", "error")},
        **{name: scene.get(name) for name in SCENE},
        **{f"hit_{name}": hit.get(name) for name in COLLISION},
        "escape_exists": row.get("escape_exists"),
        "log": row.get("log"),
        **{metric.name: metrics.get(metric.name) for metric in METRICS},
    }
