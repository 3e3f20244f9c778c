"""A run from above: where tracks went, the reference, and what each planner drove."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from adcbf_cli.core.types import FloatArray
from adcbf_cli.io.figures.of_run import Drawn, drawn_drives, values
from adcbf_cli.io.figures.style import BLACK, GREY, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH_IN = 7.0
TALLEST_IN = 8.0
MARGIN_M = 1.0
STANDING, MOVING = "#c9c2b0", "#b8860b"
MOVING_STATE = 1


def draw(document: dict[str, Any]) -> Figure:
    run = document["run"]
    origin = np.array(run["scene"]["origin_m"], dtype=float)
    drawn = drawn_drives(document)
    sensor = _sensor(run["scene"], origin)
    ways = [_way(drive, origin) for drive in drawn.driven] if drawn else []
    low, high = _limits([sensor, *ways, *_track_ways(run["scene"], origin).values()])
    height = min(TALLEST_IN, 0.9 + (WIDTH_IN - 0.8) * (high[1] - low[1]) / (high[0] - low[0]))
    figure = new_figure(WIDTH_IN, max(2.5, height))
    axes = figure.add_subplot()
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal")
    _tracks(axes, run["scene"], origin)
    axes.plot(*sensor.T, color=GREY, linewidth=1.2, label="log's vehicle")
    if drawn:
        _drives(axes, drawn, ways, origin)
    figure.legend(loc="outside upper center", ncols=4, fontsize=8)
    return figure


def _limits(ways: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    places = np.concatenate([np.zeros((0, 2)), *ways])
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        return np.array([-5.0, -5.0]), np.array([5.0, 5.0])
    low, high = places.min(axis=0) - MARGIN_M, places.max(axis=0) + MARGIN_M
    return low, high


def _sensor(scene: dict[str, Any], origin: FloatArray) -> FloatArray:
    known = [frame["sensor"][:2] for frame in scene["shown"] if frame["sensor"]]
    return np.array(known, dtype=float).reshape(-1, 2) / 1000 + origin


def _way(drive: dict[str, Any], origin: FloatArray) -> FloatArray:
    return np.column_stack([values(drive["x_mm"], 1e-3), values(drive["y_mm"], 1e-3)]) + origin


def _track_ways(scene: dict[str, Any], origin: FloatArray) -> dict[int, FloatArray]:
    """Where each track went while it moved, by its id."""
    ways: dict[int, list[list[int]]] = {}
    for frame in scene["shown"]:
        for number, state, x, y, *_ in frame.get("tracks", ()):
            if state == MOVING_STATE:
                ways.setdefault(number, []).append([x, y])
    return {number: np.array(way, dtype=float) / 1000 + origin for number, way in ways.items()}


def _tracks(axes: Axes, scene: dict[str, Any], origin: FloatArray) -> None:
    """Standing tracks as they were last seen, moving ones as the ways they took."""
    from matplotlib.patches import Circle

    standing: dict[int, tuple[float, float, float]] = {}
    for frame in scene["shown"]:
        for number, state, x, y, *_, radius in frame.get("tracks", ()):
            if state == 2:
                standing[number] = (x / 1000 + origin[0], y / 1000 + origin[1], radius / 1000)
    for number, (x, y, radius) in enumerate(standing.values()):
        label = "standing tracks" if number == 0 else None
        axes.add_patch(Circle((x, y), radius, facecolor=STANDING, edgecolor="none", alpha=0.8, label=label, zorder=1))
    for number, way in enumerate(_track_ways(scene, origin).values()):
        label = "moving tracks" if number == 0 else None
        axes.plot(*way.T, color=MOVING, linewidth=0.9, marker=".", markersize=1.5, label=label, zorder=2)


def _drives(axes: Axes, drawn: Drawn, ways: list[FloatArray], origin: FloatArray) -> None:
    route = np.reshape(values(drawn.group["route"]["xy_mm"], 1e-3), (-1, 2)) + origin
    axes.plot(*route.T, color=BLACK, linestyle=(0, (5, 4)), linewidth=0.9, label="reference", zorder=2)
    for drive, way in zip(drawn.driven, ways, strict=True):
        axes.plot(*way.T, **drawn.look(drive["planner"]), linewidth=1.8, label=drive["planner"], zorder=3)
        if drive["result"] not in (None, "success"):
            axes.plot(
                *way[-1], marker="x", markersize=9, markeredgewidth=2, color=drawn.look(drive["planner"])["color"]
            )
