"""What the figures of a run share: one look a planner, and the page's numbers in metres and seconds.

A figure's document is `{"run": ..., "comparisons": ...}`: the data of one run as a report's page holds it, and its
planners' means and intervals by kind of driving.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from adcbf_cli.core.replay.records import LOGGED
from adcbf_cli.core.types import FloatArray
from adcbf_cli.io.figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION

COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
DASHES = ("-", "--", ":", "-.")


@dataclass(frozen=True)
class Drawn:
    """The drives that a figure shows: of one kind and seed, the log's own last."""

    group: dict[str, Any]
    drives: list[dict[str, Any]]

    @property
    def planners(self) -> list[str]:
        return [name for name in self.group["planners"] if name != LOGGED]

    @property
    def driven(self) -> list[dict[str, Any]]:
        """Without the log's own."""
        return [drive for drive in self.drives if drive["planner"] != LOGGED]

    def look(self, planner: str) -> dict[str, Any]:
        """A planner's colour and dash: beyond the colours, dashes tell them apart."""
        return planner_look(planner, self.planners)


def planner_look(planner: str, planners: list[str]) -> dict[str, Any]:
    if planner == LOGGED:
        return {"color": GREY, "linestyle": "--"}
    number = planners.index(planner)
    return {"color": COLOURS[number % len(COLOURS)], "linestyle": DASHES[number // len(COLOURS) % len(DASHES)]}


def drawn_drives(document: dict[str, Any]) -> Drawn | None:
    """The first kind of driving there is (closed loop before open loop), its first seed; None without drives."""
    for group in document["run"]["drives"]:
        seed = next(iter(group["shown_seeds"]), None)
        mine = [drive for drive in group["drives"] if drive["planner"] != LOGGED and drive["seed"] == seed]
        logged = [drive for drive in group["drives"] if drive["planner"] == LOGGED]
        if mine:
            return Drawn(group, mine + logged)
    return None


def values(numbers: list[int | None] | None, scale: float) -> FloatArray:
    """A page's integers times `scale`, NaN where one is null."""
    return np.array([np.nan if number is None else number for number in numbers or []], dtype=float) * scale


def seconds(drive: dict[str, Any]) -> FloatArray:
    return values(drive["t_ms"], 1e-3)
