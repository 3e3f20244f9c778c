"""Fig. 6: the scene from above, with the five planners' ways through it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from adcbf_cli.io.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, VERMILION, new_figure

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

COLOURS = {"mpc-dc": VERMILION, "mpc-cbf": BLUE, "d-cbf-mpc": GREEN, "a-cbf-mpc": BLACK, "ad-cbf-mpc": PURPLE}
"""The paper's: red, blue, green, black, purple."""

MARGIN_M = 3.0
"""Shown around the ways."""

END_SIZE = 15.0
"""Of the first planner's mark, where it failed, in points; each next one's is smaller, so that marks on one another
can be told apart."""


def draw(document: dict[str, Any]) -> Figure:
    drawn = document["drawn"]
    route = np.array(drawn["route_m"])
    ways = {way["planner"]: way for way in drawn["ways"]}
    places = np.concatenate([route, *(np.array(way["path_m"]) for way in ways.values())])
    low, high = places.min(axis=0) - MARGIN_M, places.max(axis=0) + MARGIN_M
    width, height = high - low
    figure = new_figure(10.0, 1.1 + 9.3 * height / width)
    axes = figure.add_subplot()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal")
    axes.plot(*route.T, color=GREY, linewidth=5, alpha=0.3, label="reference", solid_capstyle="butt", zorder=1)
    for thing in drawn["standing"]:
        axes.add_patch(_outline(thing, facecolor="#c9c2b0", edgecolor="#6d6552", linewidth=0.8, zorder=2))
    for mover in drawn["movers"]:
        _mover(axes, mover)
    for number, (planner, way) in enumerate(ways.items()):
        _way(axes, planner, way, END_SIZE - 2 * number)
    _ends(axes, route, drawn["goal_tolerance_m"])
    handles = [*axes.get_legend_handles_labels()[0], *_explained(document["met_by"])]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), fontsize=7.5, handlelength=1.4)
    return figure


def _explained(met_by: str) -> list[Artist]:
    """Legend entries of what belongs to no single planner."""
    from matplotlib.lines import Line2D

    grey: dict[str, Any] = {"color": GREY, "linestyle": "", "markeredgecolor": "white"}
    return [
        Line2D(
            [],
            [],
            marker="o",
            markersize=7,
            color=ORANGE,
            markeredgecolor=BLACK,
            linestyle="",
            label=f"mover, {met_by} nearest",
        ),
        Line2D([], [], marker="X", markersize=9, label="collision", **grey),
    ]


def _outline(thing: dict[str, Any], **look: Any) -> Patch:
    """A circle, a rectangle, or the ellipse in it."""
    from matplotlib.patches import Circle, Ellipse, Rectangle

    x, y = thing["centre_m"]
    box = thing["box"]
    if box is None:
        return Circle((x, y), thing["radius_m"], **look)
    corner = (x - box["length_m"] / 2, y - box["width_m"] / 2)
    angle = float(np.rad2deg(box["yaw_rad"]))
    if thing.get("ellipse"):
        return Ellipse((x, y), box["length_m"], box["width_m"], angle=angle, **look)
    return Rectangle(corner, box["length_m"], box["width_m"], angle=angle, rotation_point="center", **look)


def _mover(axes: Axes, mover: dict[str, Any]) -> None:
    """Its way as a dashed arrow, its outline where it was met, and a line to where the vehicle was then."""
    from matplotlib.patches import FancyArrowPatch

    start, end = mover["way_m"]
    look: dict[str, Any] = {
        "color": ORANGE,
        "linewidth": 1.1,
        "linestyle": "--",
        "shrinkA": 0,
        "shrinkB": 0,
        "mutation_scale": 10,
    }
    axes.add_patch(FancyArrowPatch(tuple(start), tuple(end), arrowstyle="-|>", **look))
    if mover["met"]:
        axes.add_patch(_outline(mover, facecolor=ORANGE, edgecolor=BLACK, linewidth=0.6, alpha=0.8, zorder=3))
        joined = np.array([mover["centre_m"], mover["ego_m"]])
        axes.plot(*joined.T, color=BLACK, linewidth=0.6, zorder=3)


def _way(axes: Axes, planner: str, way: dict[str, Any], end_size: float) -> None:
    colour = COLOURS[planner]
    path = np.array(way["path_m"])
    axes.plot(*path.T, color=colour, linewidth=1.3, label=planner, zorder=4)
    if way["result"] == "collision":
        axes.plot(*path[-1], "X", color=colour, markersize=end_size, markeredgecolor="white", zorder=6)
    elif way["result"] == "timeout":
        axes.plot(*path[-1], "s", color=colour, markersize=0.7 * end_size, markeredgecolor="white", zorder=6)


def _ends(axes: Axes, route: Any, tolerance_m: float) -> None:
    from matplotlib.patches import Circle

    axes.plot(*route[0], "o", color=BLACK, markersize=5, zorder=7)
    axes.annotate("start", route[0], (-6, 8), textcoords="offset points", ha="right", fontsize=8)
    axes.add_patch(Circle(tuple(route[-1]), tolerance_m, fill=False, edgecolor=BLACK, zorder=7))
    axes.annotate("goal", route[-1], (8, 6), textcoords="offset points", fontsize=8)
