"""How often positions lay within the predicted ellipses, beside how often they should."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from adcbf_cli.io.figures.style import BLACK, BLUE, GREEN, GREY, VERMILION, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TITLES = {
    "prediction": "against ground truth",
    "later_seen": "against later sightings",
    "later_seen.moving": "later sightings, moving",
}
COLOURS = (BLUE, VERMILION, GREEN)
APART = 0.012
"""Horizons of one level stand this far apart, so that their intervals can be told apart."""


def draw(document: dict[str, Any]) -> Figure:
    points = [point for point in document["run"]["calibration"] if point["nominal"] is not None]
    references = [name for name in TITLES if any(point["reference"] == name for point in points)]
    ends = [end for point in points for end in (point["observed"], *(point["interval"] or ()))]
    lowest = min(0.4, np.floor(min(ends) * 10) / 10)
    figure = new_figure(3.0 * len(references) + 0.4, 3.4)
    panels = np.atleast_1d(figure.subplots(1, len(references), sharey=True))
    for axes, reference in zip(panels, references, strict=True):
        _panel(axes, [point for point in points if point["reference"] == reference])
        axes.set(xlabel="should lie within", title=TITLES[reference], xlim=(0.4, 1.02), ylim=(lowest, 1.02))
    panels[0].set_ylabel("did lie within")
    panels[-1].legend(loc="lower right", fontsize=7.5)
    return figure


def _panel(axes: Axes, points: list[dict[str, Any]]) -> None:
    axes.plot([0, 1], [0, 1], color=GREY, linewidth=0.8)
    horizons = sorted({point["horizon_s"] for point in points}, key=lambda horizon: (horizon is None, horizon or 0))
    for number, horizon in enumerate(horizons):
        mine = sorted((p for p in points if p["horizon_s"] == horizon), key=lambda point: float(point["nominal"]))
        place = np.array([p["nominal"] for p in mine]) + APART * (number - (len(horizons) - 1) / 2)
        observed = np.array([p["observed"] for p in mine])
        ends = np.array([p["interval"] or (p["observed"], p["observed"]) for p in mine], dtype=float)
        colour = BLACK if horizon is None else COLOURS[number % len(COLOURS)]
        label = "all steps" if horizon is None else f"{horizon:g} s ahead"
        around = np.abs(ends.T - observed)
        axes.errorbar(place, observed, yerr=around, fmt="o", markersize=3.5, color=colour, label=label, linewidth=1)
