"""The paper's tables and figures, computed anew: one module a part, found by name.

A module holds `PART`, a `Part`; a part with a picture also has a module of its name in `io.figures`.
"""

from __future__ import annotations

import importlib

from adcbf_cli.core.reproduction.part import Part

PARTS = ("table1", "fig2", "fig3", "fig4", "table2", "fig6", "ablations")
"""In the order in which `all` runs them and joins their texts."""


def load_part(name: str) -> Part:
    """The part of this name, one of PARTS."""
    part: Part = importlib.import_module(f"{__name__}.{name}").PART
    return part
