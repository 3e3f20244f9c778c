"""How all pictures look, and how they are written: the same document gives the same bytes."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from adcbf_cli.io.atomic import atomic_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which stay apart under every kind of colour blindness.
BLACK, GREY = "#000000", "#767676"
BLUE, ORANGE, GREEN, VERMILION, SKY, PURPLE = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#56b4e9", "#cc79a7"

FORMATS = ("png", "svg")
_NO_DATES: dict[str, dict[str, Any]] = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}

_STYLE: dict[str, Any] = {
    "figure.dpi": 150,
    "savefig.dpi": 150,
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "svg.hashsalt": "adcbf",
}


@contextmanager
def styled() -> Iterator[None]:
    """Inside, figures look as above, whatever the user's own matplotlib settings are."""
    import matplotlib.style

    with matplotlib.style.context(["default", _STYLE]):
        yield


def write_figure(name: str, document: dict[str, Any], folder: Path) -> list[Path]:
    """Draws the figure of this name as `<name>.png` and `<name>.svg`; returns their paths."""
    draw = importlib.import_module(f"adcbf_cli.io.figures.{name}").draw
    paths = []
    with styled():
        figure: Figure = draw(document)
        for kind in FORMATS:
            path = folder / f"{name}.{kind}"
            with atomic_path(path) as temporary:
                figure.savefig(temporary, format=kind, metadata=_NO_DATES[kind])
            paths.append(path)
    return paths


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure that no window system and no global state knows of."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in))


def label_panel(axes: Axes, letter: str, text: str) -> None:
    """`(a) text` above a panel."""
    axes.set_title(f"({letter}) {text}")
