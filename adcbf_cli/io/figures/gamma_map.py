"""Gamma over distance and radius, for the planners that adapt it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from adcbf_cli.io.figures.of_run import values
from adcbf_cli.io.figures.style import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEVELS = (0.1, 0.25, 0.5, 0.75, 0.95)


def draw(document: dict[str, Any]) -> Figure:
    maps = document["run"]["gamma"]
    figure = new_figure(4.6 * len(maps), 3.4)
    for axes, drawn in zip(np.atleast_1d(figure.subplots(1, len(maps), sharey=True)), maps, strict=True):
        distance, radius = values(drawn["distance_mm"], 1e-3), values(drawn["radius_mm"], 1e-3)
        gamma = values(drawn["gamma_e4"], 1e-4).reshape(len(distance), len(radius)).T
        shown = axes.pcolormesh(
            distance, radius, gamma, shading="gouraud", cmap="cividis", vmin=0, vmax=1, rasterized=True
        )
        lines = axes.contour(distance, radius, gamma, levels=LEVELS, colors="white", linewidths=0.7)
        axes.clabel(lines, fmt="%g", fontsize=7.5)
        touching = radius + drawn["keep_out_mm"] / 1000
        inside = touching <= distance[-1]
        axes.plot(touching[inside], radius[inside], color="white", linestyle="--", linewidth=1.2)
        axes.annotate(
            "h = 0", (touching[inside][-1], radius[inside][-1]), (4, -10), textcoords="offset points", color="white",
            fontsize=8,
        )  # fmt: skip
        axes.set(xlabel="distance between centres [m]", title=", ".join(drawn["planners"]))
        axes.grid(False)
        figure.colorbar(shown, ax=axes, label="gamma [-]")
    figure.axes[0].set_ylabel("obstacle's radius [m]")
    return figure
