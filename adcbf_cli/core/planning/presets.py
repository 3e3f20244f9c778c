"""The planners by name."""

from __future__ import annotations

import difflib
from collections.abc import Callable

from adcbf_cli.core.config import PlanningConfig
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.planning.dynamic_window import DynamicWindow
from adcbf_cli.core.planning.planner import Planner
from adcbf_cli.core.planning.potential_field import PotentialField
from adcbf_cli.core.planning.pure_pursuit import PurePursuit
from adcbf_cli.core.types import Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle

Factory = Callable[[str, Vehicle, PlanningConfig, Notes], Planner]


PLANNERS: dict[str, Factory] = {
    "dwa": lambda name, vehicle, planning, notes: DynamicWindow(name, vehicle, planning),
    "apf": lambda name, vehicle, planning, notes: PotentialField(name, vehicle, planning),
    "pure-pursuit": lambda name, vehicle, planning, notes: PurePursuit(name, vehicle, planning),
}


def make_planner(name: str, vehicle: Vehicle, planning: PlanningConfig, notes: Notes) -> Planner:
    """A new planner called `name`, without memory of any drive.

    Raises UsageError for an unknown name, and for settings that its barrier cannot have.
    """
    if name not in PLANNERS:
        close = difflib.get_close_matches(name, PLANNERS, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise UsageError(f"no planner is called {name!r}{hint} There are: {', '.join(PLANNERS)}")
    return PLANNERS[name](name, vehicle, planning, notes)
