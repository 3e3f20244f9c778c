"""The settings with which what a run folder holds was made.

`run.json` has those of the tables. It stays as it is where `evaluate`, `plan` or `replay` are given others and every
table stays valid: what they scored or drove with is in their own reports.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from adcbf_cli.core.config import Config
from adcbf_cli.io.log_base import printable
from adcbf_cli.io.run_folder import DRIVING

OF_TABLES = ("read", "perception", "tracking", "prediction")
OF_DRIVES = ("vehicle", "planning", "replay")

Settings = dict[str, dict[str, Any]]
"""By what was made with them (tables, evaluate, plan, replay), then by key: `planning.starts (replay)` for drives."""


def settings_made_with(
    config: Config, report: Mapping[str, Any] | None, driving: Mapping[str, Mapping[str, Any]]
) -> Settings:
    """config: of `run.json`. report: report.json, if any. driving: the reports of `plan` and `replay`, by kind.

    KeyError or AttributeError where a report does not say.
    """
    found = {"tables": _flat(config.model_dump(mode="json"), OF_TABLES)}
    if report is not None:
        scored = dict(report["basis"]["config"])
        if scored.get("range_m") == config.perception.range_m:  # filled in: as far as perception looked
            scored["range_m"] = None
        found["evaluate"] = _flat({"evaluation": scored}, ("evaluation",))
    for kind, document in driving.items():
        found[kind] = _flat(document["config"], OF_DRIVES, f" ({kind})")
    return found


def changed_settings(settings: Settings) -> list[tuple[str, Any]]:
    """Those that differ from the defaults."""
    default = Config().model_dump(mode="json")
    driving = {kind: {"config": default} for kind in DRIVING}
    defaults = settings_made_with(Config(), {"basis": {"config": default["evaluation"]}}, driving)
    return [
        (key, value)
        for made, values in settings.items()
        for key, value in values.items()
        if key not in defaults[made] or value != defaults[made][key]
    ]


def _flat(config: Mapping[str, Any], stages: tuple[str, ...], suffix: str = "") -> dict[str, Any]:
    return {
        f"{stage}.{printable(key)}{suffix}": printable(value) if isinstance(value, str) else value
        for stage in stages
        for key, value in config[stage].items()
    }
