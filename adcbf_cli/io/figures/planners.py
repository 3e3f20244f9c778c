"""The planners' main metrics as dots with their 95 % intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from adcbf_cli.core.replay.records import LOGGED
from adcbf_cli.io.figures.of_run import planner_look
from adcbf_cli.io.figures.style import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COMPARED = {
    "replay": ("success", "collision", "min_dist_m", "nav_time_s", "jerk_rms_mps3", "solve_p95_ms"),
    "plan": ("plan_error_1s_m", "plan_error_3s_m", "barrier_min_m2", "solve_p95_ms"),
}
RATES = ("success", "collision")
COLUMNS = 3


def draw(document: dict[str, Any]) -> Figure:
    kind = next(kind for kind in COMPARED if kind in document["comparisons"])
    found = document["comparisons"][kind]
    names = list(found["planners"])
    wanted = [m for m in COMPARED[kind] if any(_known(found["planners"][name].get(m)) for name in names)]
    rows = -(-len(wanted) // COLUMNS)
    figure = new_figure(7.0, rows * (0.75 + 0.2 * len(names)))
    panels = figure.subplots(rows, COLUMNS, squeeze=False, sharey=True).ravel()
    for axes, metric in zip(panels, wanted, strict=False):
        _panel(axes, metric, found, names)
    for axes in panels[len(wanted) :]:
        axes.set_visible(False)
    return figure


def _known(total: list[Any] | None) -> bool:
    return total is not None and total[0] is not None


def _panel(axes: Axes, metric: str, found: dict[str, Any], names: list[str]) -> None:
    planners = [name for name in names if name != LOGGED]
    for row, name in enumerate(names):
        total = found["planners"][name].get(metric)
        if not _known(total):
            continue
        value, interval = total
        around = None if interval is None else np.abs(np.array([interval], dtype=float).T - value)
        axes.errorbar(value, row, xerr=around, fmt="o", markersize=4, color=planner_look(name, planners)["color"])
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    if metric in RATES:
        axes.set_xlim(-0.05, 1.05)
    unit = found["metrics"][metric]["unit"]
    axes.set_title(f"{metric} [{unit}]" if unit else metric, fontsize=8.5)
