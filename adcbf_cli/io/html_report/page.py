"""From gathered runs to one HTML file: template, style, script and data, with a policy that lets nothing else in."""

from __future__ import annotations

import base64
import hashlib
import json
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from adcbf_cli.io.html_report import evidence
from adcbf_cli.io.html_report.gather import RunPage

ASSETS = Path(__file__).with_name("assets")
STYLES = ("vendor/uPlot.css", "page.css")
SCRIPTS = ("vendor/uPlot.js", "base.js", "picture.js", "scene.js", "charts.js", "tracks.js", "marks.js", "main.js")

SECTIONS = (
    ("run", "Run"),
    ("warnings", "Warnings"),
    ("headline", "Figures"),
    ("top", "Top view"),
    ("tracks", "Tracks"),
    ("margins", "Clearance"),
    ("planners", "Planners"),
    ("times", "Times"),
    ("map", "Gamma"),
    ("calibration", "Calibration"),
    ("all", "All scores"),
    ("about", "About"),
)


def render(runs: list[RunPage]) -> str:
    """The page of these runs, side by side where they are several. The same runs give the same text."""
    style = "\n".join(_asset(name) for name in STYLES)
    own = "\n".join(_asset(name) for name in SCRIPTS[1:])
    script = f'{_asset(SCRIPTS[0])}\n(() => {{\n"use strict";\n{own}\n}})();\n'
    environment = Environment(
        loader=FileSystemLoader(ASSETS), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    names = [run.name for run in runs]
    return environment.get_template("page.html").render(
        title=f"adcbf: {', '.join(names)}",
        policy=_policy(script, style),
        style=Markup(style),
        script=Markup(script),
        data=Markup(
            script_data({"runs": [run.data for run in runs], "planners": [comparisons_of(run) for run in runs]})
        ),
        sections=SECTIONS,
        runs=[_context(run) for run in runs],
        several=len(runs) > 1,
        names=names if len(runs) > 1 else ["value"],
        headline=evidence.headline_rows([run.report for run in runs], [run.driving for run in runs]),
        caveats=list(
            dict.fromkeys(
                doc["counterfactual"] for run in runs for doc in run.driving.values() if doc["counterfactual"]
            )
        ),
        licence=_asset("vendor/uPlot.LICENSE"),
    )


def script_data(document: Any) -> str:
    """JSON that can stand in a script element: nothing in it can end the element or begin a comment."""
    text = json.dumps(document, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _policy(script: str, style: str) -> str:
    """Nothing is loaded from anywhere; only this script and this style run."""
    return (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _asset(name: str) -> str:
    return (ASSETS / name).read_text(encoding="utf-8")


def comparisons_of(run: RunPage) -> dict[str, Any]:
    """The planners' means and intervals by kind, as `{"metrics": {name: unit, better}, "planners": {name: {metric:
    [mean, interval or None]}}}`."""
    return {
        kind: {
            "metrics": {
                name: {"unit": evidence.unit_text(declared["unit"]), "better": declared["better"]}
                for name, declared in document["comparison"]["metrics"].items()
            },
            "planners": {
                name: {metric: [total["value"], total["interval_95"]] for metric, total in found["metrics"].items()}
                for name, found in document["comparison"]["planners"].items()
            },
        }
        for kind, document in run.driving.items()
    }


def _context(run: RunPage) -> dict[str, Any]:
    """What the template takes of a run."""
    driving = {}
    for kind, table in run.driving.items():
        columns = [
            f"{planner['name']} ({planner['drives']} drive{'' if planner['drives'] == 1 else 's'})"
            for planner in table["planners"]
        ]
        others = [name for name, found in table["comparison"]["planners"].items() if found["differences"]]
        driving[kind] = {**table, "columns": columns, "others": others}
    return {
        "name": run.name,
        "manifest": run.manifest,
        "about": run.about,
        "settings": run.settings,
        "warnings": run.warnings,
        "missing": run.missing,
        "thinned": run.thinned,
        "driving": driving,
        "stage_times": run.stage_times,
        "scores": [] if run.report is None else evidence.all_scores(run.report),
    }
