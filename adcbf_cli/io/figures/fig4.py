"""Fig. 4: gamma as a map over distance and radius; along two cases, gamma and the approach that it permits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from adcbf_cli.io.figures.style import BLACK, BLUE, GREY, VERMILION, label_panel, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEVELS = (0.06, 0.1, 0.25, 0.5, 0.75, 0.95)
CASE_COLOURS = (BLUE, VERMILION)
FASTEST_MPS = 4.0
"""Far obstacles may come much faster; what matters is where the permitted speed crosses the real one."""

_BESIDE: dict[str, Any] = {
    "xycoords": ("axes fraction", "data"),
    "xytext": (4, 0),
    "textcoords": "offset points",
    "va": "center",
    "fontsize": 7.5,
}


def draw(document: dict[str, Any]) -> Figure:
    figure = new_figure(10.0, 5.2)
    grid = figure.add_gridspec(2, 2, width_ratios=[1.1, 1])
    _map(figure.add_subplot(grid[:, 0]), document["drawn"])
    gamma, speed = figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1])
    speed.sharex(gamma)
    steps = list(range(1, document["steps"] + 1))
    for case, colour in zip(document["drawn"]["cases"], CASE_COLOURS, strict=True):
        curves, permitted = case["gamma"], case["permitted_mps"]
        gamma.plot(steps, curves["adaptive"], color=colour, linewidth=2, label=f"AD-CBF, {case['name'].split(',')[0]}")
        gamma.plot(steps, curves["printed"], color=colour, linestyle=":", label="..., eq. 14 as printed")
        speed.plot(steps, permitted["adaptive"], color=colour, linewidth=2)
        speed.plot(steps, permitted["fixed"], color=colour, linestyle="--")
        speed.axhline(-case["speed_mps"], color=colour, linewidth=0.8, alpha=0.7)
        speed.annotate(_way(case), (1.0, -case["speed_mps"]), **_BESIDE, color=colour)
    fixed = document["fixed_gamma"]
    gamma.axhline(fixed, color=GREY, linestyle="--", label=f"fixed gamma = {fixed:g}")
    gamma.set_ylabel("gamma [-]")
    gamma.set_ylim(0, 1.2)
    gamma.legend(fontsize=7.5, loc=(0.02, 0.25))
    label_panel(gamma, "b", "gamma along the two cases")
    _speed_panel(speed, fixed, document["step_s"])
    return figure


def _map(axes: Axes, drawn: dict[str, Any]) -> None:
    """Gamma over distance and radius, with the two cases as lines across it."""
    distance, radius = drawn["distance_m"], drawn["radius_m"]
    values = list(zip(*drawn["gamma"], strict=True))
    look = {"cmap": _light_greys(), "vmin": 0, "vmax": 1}
    shown = axes.pcolormesh(distance, radius, values, shading="gouraud", rasterized=True, **look)
    lines = axes.contour(distance, radius, values, levels=LEVELS, colors=BLACK, linewidths=0.7)
    axes.clabel(lines, fmt="%g", fontsize=7.5)
    touching = [r + drawn["keep_out_beyond_radius_m"] for r in radius]
    axes.plot(touching, radius, color=BLACK, linestyle="--", linewidth=1.2)
    axes.annotate("h = 0", (touching[-3], radius[-3]), (-32, 2), textcoords="offset points", fontsize=8)
    for number, (case, colour) in enumerate(zip(drawn["cases"], CASE_COLOURS, strict=True), start=1):
        ends = case["distance_m"][0], case["distance_m"][-1]
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 2, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (ends[1], case["radius_m"]), (ends[0], case["radius_m"]), arrowprops=arrow)
        axes.plot(ends[0], case["radius_m"], "o", color=colour, markersize=5)
        at = (max(ends), case["radius_m"])
        axes.annotate(f"obstacle {number}", at, (6, -3), textcoords="offset points", color=colour)
    axes.set(xlabel="distance between centres d [m]", ylabel="obstacle's radius r [m]")
    axes.grid(False)
    scale = axes.inset_axes((0.45, 0.9, 0.5, 0.03))
    axes.figure.colorbar(shown, cax=scale, label="gamma [-]", orientation="horizontal")
    label_panel(axes, "a", "gamma(d, r), equation 14 as configured")


def _light_greys() -> Any:
    """From white to a grey on which lines and words can be read."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["Greys"]([0.38 * step / 255 for step in range(256)]))


def _speed_panel(axes: Axes, fixed: float, step_s: float) -> None:
    from matplotlib.lines import Line2D

    kinds = [
        Line2D([], [], color=BLACK, linewidth=2, label="AD-CBF permits"),
        Line2D([], [], color=BLACK, linestyle="--", label=f"gamma = {fixed:g} permits"),
        Line2D([], [], color=BLACK, linewidth=0.8, alpha=0.7, label="real"),
    ]
    axes.legend(handles=kinds, fontsize=7.5, loc="upper left")
    axes.set_ylim(-1.0, FASTEST_MPS)
    axes.set(xlabel=f"step [-], {step_s:g} s each", ylabel="speed of approach [m/s]")
    label_panel(axes, "c", f"approach within one step (shown up to {FASTEST_MPS:g} m/s)")


def _way(case: dict[str, Any]) -> str:
    name, _, way = case["name"].partition(", ")
    return f"{name}\n{way},\n{abs(case['speed_mps']):g} m/s"
