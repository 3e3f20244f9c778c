"""Fig. 2: the same cells twice, in the colours of DBSCAN's and of HDBSCAN's clusters, with one circle a cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from adcbf_cli.io.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, label_panel, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = (BLUE, ORANGE, SKY, PURPLE, BLACK)
NOISE = -1


def draw(document: dict[str, Any]) -> Figure:
    from matplotlib.lines import Line2D

    figure = new_figure(10.0, 5.6)
    drawn = document["drawn"]
    grid = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, letter, panel in zip(grid, "ab", drawn["panels"], strict=True):
        _panel(axes, panel, drawn)
        counts = {name: panel["outcomes"].count(name) for name in ("found", "merged", "split", "missed")}
        told = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
        label_panel(axes, letter, f"{panel['name']}: {told}")
    grid[0].set_ylabel("y [m]")
    marks = [
        Line2D([], [], color=GREEN, linewidth=1.6, label="circle of a cluster"),
        Line2D([], [], color=VERMILION, linewidth=2.2, linestyle="--", label="... that merges obstacles"),
        Line2D([], [], color=BLUE, marker="o", linestyle="", markersize=4, label="cells, a colour a cluster"),
        Line2D([], [], color=GREY, marker="x", linestyle="", markersize=4, label="noise"),
        Line2D([], [], color=BLACK, marker="^", linestyle="", label="LiDAR"),
    ]
    figure.legend(handles=marks, loc="outside lower center", ncols=5)
    return figure


def _panel(axes: Axes, panel: dict[str, Any], drawn: dict[str, Any]) -> None:
    from matplotlib.patches import Circle

    x, y = zip(*drawn["cells_m"], strict=True)
    label = panel["label"]
    for cluster in range(max(label, default=NOISE) + 1):
        mine = [k for k, own in enumerate(label) if own == cluster]
        axes.plot(
            [x[k] for k in mine], [y[k] for k in mine], "o", markersize=2.6, color=COLOURS[cluster % len(COLOURS)]
        )
    loose = [k for k, own in enumerate(label) if own == NOISE]
    axes.plot([x[k] for k in loose], [y[k] for k in loose], "x", markersize=4, color=GREY)
    for number, (centre_x, centre_y, radius) in enumerate(panel["circles_m"]):
        merged = number in panel["merged"]
        look = {"edgecolor": VERMILION, "linestyle": "--", "linewidth": 2.2} if merged else {"edgecolor": GREEN}
        axes.add_patch(Circle((centre_x, centre_y), radius, fill=False, **{"linewidth": 1.6, **look}))
    axes.plot(0, 0, "^", color=BLACK)
    reach = drawn["range_m"]
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="x [m]")
