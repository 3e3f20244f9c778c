"""Clearance, barrier and gamma over time, planner by planner."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from adcbf_cli.io.figures.of_run import drawn_drives, seconds, values
from adcbf_cli.io.figures.style import BLACK, label_panel, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANELS = (
    ("clearance_mm", 1e-3, "clearance [m]", "clearance to the nearest true obstacle"),
    ("barrier_cm2", 1e-4, "h [m$^2$]", "smallest barrier over the known obstacles, now"),
    ("gamma_e4", 1e-4, "gamma [-]", "gamma of that obstacle"),
)


def draw(document: dict[str, Any]) -> Figure:
    drawn = drawn_drives(document)
    if drawn is None:
        raise ValueError("no drives to draw")
    figure = new_figure(7.0, 6.2)
    panels = figure.subplots(3, 1, sharex=True)
    for axes, letter, (name, scale, unit, title) in zip(panels, "abc", PANELS, strict=True):
        for drive in drawn.drives:
            look = drawn.look(drive["planner"])
            axes.plot(seconds(drive), values(drive[name], scale), **look, label=drive["planner"])
        axes.set_ylabel(unit)
        label_panel(axes, letter, title)
        if name != "gamma_e4":
            axes.axhline(0, color=BLACK, linewidth=0.8)
    panels[2].set_ylim(-0.05, 1.05)
    panels[2].set_xlabel("time since the first scan [s]")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=5, fontsize=8)
    return figure
