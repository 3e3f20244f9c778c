"""The planners by name: the MPC ones are rows of a table, not classes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from adcbf_cli.core.config import PlanningConfig
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.planning.barrier import AdaptiveGamma, Barrier, FixedGamma, check_barrier
from adcbf_cli.core.planning.dynamic_window import DynamicWindow
from adcbf_cli.core.planning.mpc import MpcPlanner
from adcbf_cli.core.planning.planner import Plan, Planner, Situation
from adcbf_cli.core.planning.potential_field import PotentialField
from adcbf_cli.core.planning.pure_pursuit import PurePursuit
from adcbf_cli.core.types import Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle

Factory = Callable[[str, Vehicle, PlanningConfig, Notes], Planner]


@dataclass(frozen=True, slots=True)
class MpcPreset:
    """gamma: 1 ("distance"), planning.gamma_fixed, or eq. 14. predicts: the obstacles move as predicted
    (planning.obstacle_set), else they are held where they are. decay: optimal decay."""

    gamma: Literal["distance", "fixed", "adaptive"]
    predicts: bool
    decay: bool = False

    def __call__(self, name: str, vehicle: Vehicle, planning: PlanningConfig, notes: Notes) -> Planner:
        """The planner; UsageError where the settings make a barrier that is none."""
        barrier = self.barrier(planning)
        if not planning.accept_invalid_barrier:
            check_barrier(barrier, vehicle.body_radius_m, planning.safety_distance_m)
        obstacle_set = planning.obstacle_set if self.predicts else "held"
        return MpcPlanner(name, vehicle, planning, barrier, obstacle_set, notes)

    def barrier(self, planning: PlanningConfig) -> Barrier:
        return Barrier(
            gamma=self._gamma(planning),
            decay_weight=planning.decay_weight if self.decay else None,
            steps=planning.barrier_steps,
            form="product" if self.gamma == "distance" else planning.barrier_form,
            frozen=self.gamma == "adaptive" and planning.gamma_at == "previous",
        )

    def _gamma(self, planning: PlanningConfig) -> FixedGamma | AdaptiveGamma:
        if self.gamma == "distance":
            return FixedGamma(1.0)
        if self.gamma == "fixed":
            return FixedGamma(planning.gamma_fixed)
        return AdaptiveGamma(
            amplitude=planning.gamma_amplitude,
            distance_m=planning.gamma_distance_m,
            radius_m=planning.gamma_radius_m,
            distance_sigma_m=planning.gamma_distance_sigma_m,
            radius_sigma_m=planning.gamma_radius_sigma_m,
            form=planning.gamma_form,
            floor=planning.gamma_floor,
            ceiling=planning.gamma_ceiling,
        )


PLANNERS: dict[str, Factory] = {
    "mpc-dc": MpcPreset("distance", predicts=False),
    "mpc-cbf": MpcPreset("fixed", predicts=False),
    "d-cbf-mpc": MpcPreset("fixed", predicts=True),
    "a-cbf-mpc": MpcPreset("adaptive", predicts=False),
    "ad-cbf-mpc": MpcPreset("adaptive", predicts=True),
    "od-ad-cbf-mpc": MpcPreset("adaptive", predicts=True, decay=True),
    "dwa": lambda name, vehicle, planning, notes: DynamicWindow(name, vehicle, planning),
    "apf": lambda name, vehicle, planning, notes: PotentialField(name, vehicle, planning),
    "pure-pursuit": lambda name, vehicle, planning, notes: PurePursuit(name, vehicle, planning),
}
"""Every planner by its name. A factory makes one that remembers nothing yet."""

RESERVED = (*PLANNERS, "all", "logged")
"""Names that a package's planner cannot have: `all` stands for those above, `logged` for the log's own driver."""


def make_planner(name: str, vehicle: Vehicle, planning: PlanningConfig, notes: Notes) -> Planner:
    """A new planner called `name`, built in or of an installed package, without memory of any drive.

    Raises UsageError for an unknown name, and for settings that its barrier cannot have.
    """
    if name not in PLANNERS:
        return _plugin_planner(name, vehicle, planning, notes)
    return PLANNERS[name](name, vehicle, planning, notes)


def _plugin_planner(name: str, vehicle: Vehicle, planning: PlanningConfig, notes: Notes) -> Planner:
    from adcbf_cli.core.plugins import Kind, find_plugin, guarded, load_plugin, malformed

    if name in RESERVED:
        raise UsageError(f"no planner is called {name!r}; there are {', '.join(PLANNERS)}")
    plugin = find_plugin(Kind.PLANNER, name, PLANNERS)
    planner: Planner = load_plugin(plugin)(name, vehicle, planning, notes)
    if not callable(getattr(planner, "plan", None)):
        raise malformed(plugin, "what it makes has no method `plan`")
    if getattr(planner, "name", None) != name:
        raise malformed(plugin, f"what it makes does not say `name` {name!r}, which results are kept under")
    plan = guarded(plugin, planner.plan)

    def checked(situation: Situation) -> Plan:
        found = plan(situation)
        if not isinstance(found, Plan):
            raise malformed(plugin, f"its `plan` returns a {type(found).__name__}, where a Plan is wanted")
        return found

    return _Guest(name, checked)


@dataclass(frozen=True, slots=True)
class _Guest:
    """A package's planner, with whatever goes wrong in it told as its own."""

    name: str
    plan: Callable[[Situation], Plan]
