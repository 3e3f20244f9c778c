"""The time of each planning step beside the deadline: over time, and as a distribution."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from adcbf_cli.io.figures.of_run import drawn_drives, seconds, values
from adcbf_cli.io.figures.style import BLACK, label_panel, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(document: dict[str, Any]) -> Figure:
    drawn = drawn_drives(document)
    if drawn is None:
        raise ValueError("no drives to draw")
    figure = new_figure(7.0, 3.0)
    over_time, shares = figure.subplots(1, 2, width_ratios=[1.5, 1])
    for drive in drawn.drives:
        solve_ms = values(drive["solve_us"], 1e-3)
        known = np.isfinite(solve_ms)
        if not known.any():
            continue
        look = drawn.look(drive["planner"])
        over_time.plot(
            seconds(drive)[known], solve_ms[known], ".", color=look["color"], markersize=2.5, label=drive["planner"]
        )
        shown = drive["solve_shares"]
        shares.plot(values(shown["us"], 1e-3), values(shown["share_e4"], 1e-4), **look)
    deadline = drawn.group["deadline_ms"]
    over_time.axhline(deadline, color=BLACK, linestyle="--", linewidth=0.9, label=f"deadline {deadline:.4g} ms")
    shares.axvline(deadline, color=BLACK, linestyle="--", linewidth=0.9)
    over_time.set(yscale="log", xlabel="time since the first scan [s]", ylabel="planning step [ms]")
    shares.set(xscale="log", xlabel="planning step [ms]", ylabel="share of the steps")
    label_panel(over_time, "a", "by step")
    label_panel(shares, "b", "distribution")
    figure.legend(loc="outside upper center", ncols=5, fontsize=8, markerscale=3)
    return figure
