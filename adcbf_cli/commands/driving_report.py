"""What `plan` and `replay` leave in a run folder: the drives' tables, and a report on them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adcbf_cli.io.run_folder import DRIVING

if TYPE_CHECKING:
    from adcbf_cli.commands.driving import Setting
    from adcbf_cli.core.evaluation.comparison import Comparison
    from adcbf_cli.core.replay.records import Drive

_COUNTERFACTUAL = (
    "Counterfactual: the recorded obstacles moved as they did and would not have reacted to this vehicle; what its "
    "own sensor would have seen is taken from the log's."
)
_REFERENCE_TOLERANCE_M = 0.01
"""The report keeps the reference path within this: enough to draw it."""


def driving_document(
    setting: Setting, kind: str, drives: list[Drive], comparison: Comparison, failures: list[str]
) -> dict[str, Any]:
    """report.json of one kind of driving. failures: the thresholds that were missed."""
    from adcbf_cli.core.planning.presets import PLANNERS
    from adcbf_cli.core.polylines import simplified
    from adcbf_cli.io.plugin_versions import planner_plugins

    source, config = setting.outcome.manifest.source, setting.config
    return {
        "schema_version": 1,
        "mode": "closed loop" if kind == "replay" else "open loop",
        "counterfactual": _COUNTERFACTUAL if kind == "replay" else None,
        "source": {"name": source.name, "sha256": source.sha256},
        "world": setting.world_source,
        "world_sha256": setting.world.sha256,
        "route": {
            "length_m": round(setting.route.length_m, 4),
            "speed_mps": setting.route.speed_mps,
            "start_m": [round(float(value), 4) for value in setting.route.points_m[0]],
            "goal_m": [round(float(value), 4) for value in setting.route.goal_m],
        },
        "reference_m": simplified(setting.route.points_m, _REFERENCE_TOLERANCE_M).round(3).tolist(),
        "starts": _starts(drives),
        "config": {name: getattr(config, name).model_dump(mode="json") for name in ("vehicle", "planning", "replay")},
        "plugins": planner_plugins(setting.planners, PLANNERS),
        "thresholds_missed": failures,
        "warnings": setting.notes.warnings,
        "counters": setting.notes.counters,
        "comparison": comparison.to_dict(),
    }


def _starts(drives: list[Drive]) -> dict[str, dict[str, float]]:
    """Where and when each seed's drives begin: all planners' alike."""
    from adcbf_cli.core.replay.records import LOGGED

    found: dict[str, dict[str, float]] = {}
    for drive in drives:
        if drive.planner != LOGGED and len(drive.stamp_ns):
            x_m, y_m, yaw_rad = (round(float(value), 6) for value in drive.pose[0])
            start = {"timestamp_ns": int(drive.stamp_ns[0]), "x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad}
            found.setdefault(str(drive.seed), start)
    return found


def write_driving(
    setting: Setting, kind: str, drives: list[Drive], comparison: Comparison, document: dict[str, Any]
) -> Path:
    """Writes tables and reports in place of those that were there, and returns their folder."""
    from adcbf_cli.core.evaluation.comparison_text import markdown
    from adcbf_cli.core.planning.gamma_map import gamma_maps
    from adcbf_cli.io.atomic import write_text_atomically
    from adcbf_cli.io.driving_tables import write_drives, write_gamma_map
    from adcbf_cli.io.run_folder import code_version

    outcome = setting.outcome
    folder = outcome.folder.path / DRIVING[kind]
    metadata = {
        "key": outcome.manifest.stages["predict"].key,
        "against": comparison.against,
        "adcbf": code_version(),
        **{name: document[name] for name in ("mode", "source", "world", "route", "config", "plugins")},
    }
    with outcome.folder.locked():
        folder.mkdir(exist_ok=True)
        outcome.folder.remove_driving(kind)
        write_drives(folder, drives, metadata)
        write_gamma_map(folder, gamma_maps(setting.planners, setting.config.planning), metadata)
        write_text_atomically(folder / "report.md", _heading(document) + markdown(comparison))
        write_text_atomically(folder / "report.json", json.dumps(document, indent=2, allow_nan=False) + "\n")
    return folder


def _heading(document: dict[str, Any]) -> str:
    lines = [
        f"# {document['mode'].capitalize()}",
        "",
        f"Log: {document['source']['name']}; world: {document['world']}.",
    ]
    if document["counterfactual"]:
        lines += ["", document["counterfactual"]]
    for failure in document["thresholds_missed"]:
        lines += ["", f"**Threshold missed**: {failure}"]
    lines += [f"\n- Warning: {warning}" for warning in document["warnings"]]
    return "\n".join(lines) + "\n\n"
