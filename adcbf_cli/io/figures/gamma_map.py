"""Gamma over distance and radius, for the planners that adapt it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from adcbf_cli.core.types import FloatArray
from adcbf_cli.io.figures.of_run import values
from adcbf_cli.io.figures.style import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
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
        levels = [level for level in LEVELS if gamma.min() < level < gamma.max()]
        if levels:
            lines = axes.contour(distance, radius, gamma, levels=levels, colors="white", linewidths=0.7)
            axes.clabel(lines, fmt="%g", fontsize=7.5)
        _touching(axes, distance, radius, drawn["keep_out_mm"] / 1000)
        axes.set(xlabel="distance between centres [m]", title=", ".join(drawn["planners"]))
        axes.grid(False)
        figure.colorbar(shown, ax=axes, label="gamma [-]")
    figure.axes[0].set_ylabel("obstacle's radius [m]")
    return figure


def _touching(axes: Axes, distance: FloatArray, radius: FloatArray, keep_out_m: float) -> None:
    """The line h = 0, as far as it lies within the map: a wide vehicle's may not at all."""
    inside = radius[radius + keep_out_m <= distance[-1]]
    if len(inside):
        axes.plot(inside + keep_out_m, inside, color="white", linestyle="--", linewidth=1.2)
        end = (inside[-1] + keep_out_m, inside[-1])
        axes.annotate("h = 0", end, (4, -10), textcoords="offset points", color="white", fontsize=8)
