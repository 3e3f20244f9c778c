"""The ablations' picture: how often each planner collides, over the speed of all movers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from adcbf_cli.io.figures.fig6 import COLOURS
from adcbf_cli.io.figures.style import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

APART_MPS = 0.018
"""Planners are drawn this much beside one another, so that their intervals can be told apart."""

MARKERS = ("o", "s", "^", "v", "D")


def draw(document: dict[str, Any]) -> Figure:
    figure = new_figure(6.4, 3.8)
    axes = figure.add_subplot()
    speeds = document["speeds"]
    for number, ((planner, found), marker) in enumerate(zip(speeds.items(), MARKERS, strict=True)):
        points = [point for point in found["points"] if point["here"] is not None]
        rates = [point["here"]["collision"] for point in points]
        at = [point["speed_mps"] + APART_MPS * (number - (len(speeds) - 1) / 2) for point in points]
        value = [100 * rate["value"] for rate in rates]
        below = [100 * (rate["value"] - rate["interval_95"][0]) for rate in rates]
        above = [100 * (rate["interval_95"][1] - rate["value"]) for rate in rates]
        look: dict[str, Any] = {
            "color": COLOURS[planner],
            "marker": marker,
            "markersize": 4.5,
            "elinewidth": 0.9,
            "capsize": 2,
        }
        axes.errorbar(at, value, yerr=[below, above], label=planner, **look)
    axes.set(xlabel="speed of all movers [m/s]", ylabel="runs with a collision [%]", ylim=(-2, 102))
    figure.legend(loc="outside upper center", ncols=len(speeds), fontsize=7.5)
    return figure
