"""What the parts that drive have in common: the paper's five planners through a packaged scene, and how their rates,
means and differences are written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from adcbf_cli.core.config import CLOSED_LOOP, Config
from adcbf_cli.core.evaluation.scene_runs import SceneTask, run_scene
from adcbf_cli.core.reproduction.part import Row

OURS = "ad-cbf-mpc"
PLANNERS = ("mpc-dc", "mpc-cbf", "d-cbf-mpc", "a-cbf-mpc", OURS)
"""In the order of Table II."""


def drive(task: SceneTask) -> Row:
    """One run. Nothing in its row depends on the machine: it is not timed."""
    return run_scene(task).row


def config_with(settings: Mapping[str, Any]) -> Config:
    """The closed loop's defaults with these settings, by dotted keys (`planning.steps`)."""
    nested: dict[str, dict[str, Any]] = CLOSED_LOOP.model_dump()
    for key, value in settings.items():
        stage, name = key.split(".", 1)
        nested[stage][name] = value
    return Config.model_validate(nested)


def rate_cell(found: Mapping[str, Any]) -> str:
    """`2/20: 10 % [3, 30]` from an aggregate of events, its interval in per cent."""
    if found["value"] is None or found["interval_95"] is None:
        return "-"
    low, high = found["interval_95"]
    events = round(found["value"] * found["n"])
    return f"{events}/{found['n']}: {100 * found['value']:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def mean_cell(found: Mapping[str, Any], digits: int) -> str:
    """`0.53 [0.41, 0.66]` from an aggregate or a difference; with `(n = 17)` where some runs have no value."""
    if found["value"] is None:
        return "-"
    missing = found.get("n_missing", 0)
    return number_cell(found["value"], found["interval_95"], digits) + (f" (n = {found['n']})" if missing else "")


def number_cell(value: float, interval: Sequence[float] | None, digits: int, scale: float = 1.0) -> str:
    """A number and its interval, if there is one, times `scale`."""
    text = f"{scale * value:.{digits}f}"
    if interval is None:
        return text
    low, high = interval
    return f"{text} [{scale * low:.{digits}f}, {scale * high:.{digits}f}]"


def collisions(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """The runs that ended in one: which, with what, when, and whether a way around was found."""
    return [
        {"planner": row["planner"], "seed": row["seed"], **row["collision"]}
        for row in rows
        if row["collision"] is not None
    ]
