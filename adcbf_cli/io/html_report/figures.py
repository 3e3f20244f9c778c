"""The figures of a run that a paper can use, drawn from what its page shows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from adcbf_cli.core.replay.records import LOGGED
from adcbf_cli.io.figures.style import FORMATS, write_figure
from adcbf_cli.io.html_report.gather import RunPage
from adcbf_cli.io.html_report.page import comparisons_of
from adcbf_cli.io.report import FIGURES


def write_figures(run: RunPage, folder: Path) -> list[Path]:
    """Draws what the run has evidence for, as SVG and PNG, and returns the files. Those of an earlier call for which
    there is none any more are removed."""
    document = {"run": run.data, "comparisons": comparisons_of(run)}
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for name in FIGURES:
        if _has_evidence(name, document):
            written += write_figure(name, document, folder)
        else:
            for kind in FORMATS:
                (folder / f"{name}.{kind}").unlink(missing_ok=True)
    return written


def _has_evidence(name: str, document: dict[str, Any]) -> bool:
    run = document["run"]
    if name in ("margins", "solve_times"):
        return any(drive["planner"] != LOGGED for group in run["drives"] for drive in group["drives"])
    if name == "calibration":
        return any(point["nominal"] is not None for point in run["calibration"])
    return {"gamma_map": bool(run["gamma"]), "planners": bool(document["comparisons"])}.get(name, True)
