"""Fig. 3: x and y over time above, the differences from equation 11 below."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from adcbf_cli.io.figures.style import BLACK, BLUE, VERMILION, label_panel, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw(document: dict[str, Any]) -> Figure:
    drawn, horizon = document["drawn"], document["horizon_s"]
    lines = (("tracked", BLUE, "-", "tracked"), ("predicted", VERMILION, "--", f"predicted, {horizon:g} s ahead"))
    figure = new_figure(8.4, 4.8)
    grid = figure.subplots(2, 2, sharex=True, height_ratios=[2, 1])
    grid[1, 0].sharey(grid[1, 1])
    for k, axis in enumerate("xy"):
        above, below = grid[:, k]
        actual = drawn["actual"]
        above.plot(actual["time_s"], [p[k] for p in actual["place_m"]], color=BLACK, linewidth=3, alpha=0.25)
        for name, colour, dash, _ in lines:
            curve = drawn[name]
            above.plot(curve["time_s"], [p[k] for p in curve["place_m"]], color=colour, linestyle=dash)
            below.plot(curve["time_s"], [e[k] for e in curve["error_m"]], color=colour, linewidth=1)
        label_panel(above, "ab"[k], f"{axis} direction")
        above.set_ylabel(f"{axis} [m]")
        below.set_ylabel(f"error in {axis} [m]")
        below.set_xlabel("time [s]")
    handles = grid[0, 0].get_lines()
    figure.legend(handles, ["actual (equation 11)", *(text for *_, text in lines)], loc="outside upper center", ncols=3)
    return figure
