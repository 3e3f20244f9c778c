"""Fig. 4: gamma of eq. 14 over distance and radius, and along the paper's two cases of 50 steps.

The cases are those of section 3.3: the vehicle stands; obstacle 1 (r = 0.4 m) comes from 4.0 m away, obstacle 2
(r = 0.6 m) goes away from 1.0 m. The paper gives neither their speed nor the length of a step: here 0.6 m/s and the
horizon's 0.1 s, with which both pass nearly all distances from 1 to 4 m, and distances are between centres.

What a gamma permits is the speed at which a distance may shrink within one step: the obstacle at distance d, with
h = d^2 - R^2, may come as near as the d' of h' = (1 - gamma) h (eq. 13). It is negative, a speed at which to part,
where h is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from adcbf_cli.core.config import PlanningConfig, VehicleConfig
from adcbf_cli.core.planning.barrier import AdaptiveGamma, FixedGamma, gamma_at
from adcbf_cli.core.planning.planner import Outcome, Situation
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.planning.problem import Obstacles
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.reproduction.part import Document, Part, Row, table
from adcbf_cli.core.types import FloatArray, Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle

DISTANCE_M = np.linspace(0.0, 5.0, 126)
RADIUS_M = np.linspace(0.1, 1.2, 56)

STEPS = 50
STEP_S = 0.1
SPEED_MPS = 0.6
PLANNERS = ("ad-cbf-mpc", "d-cbf-mpc")
"""Adaptive and fixed gamma; otherwise the same planner."""

PRINTED = AdaptiveGamma(form="printed", floor=None, ceiling=None)
UNCLIPPED = AdaptiveGamma(floor=None, ceiling=None)


@dataclass(frozen=True)
class Case:
    """An obstacle of a radius that begins at a distance and moves away at a speed (negative: it comes)."""

    name: str
    radius_m: float
    start_m: float
    speed_mps: float

    def distance_m(self) -> FloatArray:
        """(STEPS,) centre distances."""
        return np.asarray(self.start_m + self.speed_mps * STEP_S * np.arange(STEPS))


CASES = (Case("obstacle 1, approaching", 0.4, 4.0, -SPEED_MPS), Case("obstacle 2, leaving", 0.6, 1.0, SPEED_MPS))


def tasks(_seeds: Sequence[int]) -> dict[str, Case]:
    """Nothing is random here."""
    return {case.name: case for case in CASES}


def run(case: Case) -> Row:
    planning, vehicle = PlanningConfig(), VehicleConfig()
    keep_out_m = vehicle.body_radius_m + case.radius_m + planning.safety_distance_m
    distance = case.distance_m()
    gammas = gamma_forms(distance, np.array(case.radius_m), planning)
    allowed = {
        name: permitted_mps(distance, gammas[name], keep_out_m, STEP_S).tolist() for name in ("adaptive", "fixed")
    }
    return {
        **asdict(case),
        "keep_out_m": round(keep_out_m, 6),
        "distance_m": distance.tolist(),
        "barrier_m2": (distance**2 - keep_out_m**2).tolist(),
        "gamma": {name: values.tolist() for name, values in gammas.items()},
        "permitted_mps": allowed,
        "plans": {name: plan_standing(name, case, planning, vehicle) for name in PLANNERS},
    }


def gamma_forms(distance_m: FloatArray, radius_m: FloatArray, planning: PlanningConfig) -> dict[str, FloatArray]:
    """Gamma at distances and radii (broadcast together): as configured, eq. 14 without its clip, eq. 14 as printed,
    and the fixed one."""
    adaptive = AdaptiveGamma(floor=planning.gamma_floor, ceiling=planning.gamma_ceiling)
    return {
        "adaptive": gamma_at(adaptive, distance_m, radius_m),
        "unclipped": gamma_at(UNCLIPPED, distance_m, radius_m),
        "printed": gamma_at(PRINTED, distance_m, radius_m),
        "fixed": gamma_at(FixedGamma(planning.gamma_fixed), distance_m, radius_m),
    }


def permitted_mps(distance_m: FloatArray, gamma: FloatArray, keep_out_m: float, step_s: float) -> FloatArray:
    """How fast a centre distance may shrink over the next step under h' >= (1 - gamma) h."""
    barrier = distance_m**2 - keep_out_m**2
    nearest = np.sqrt(keep_out_m**2 + (1.0 - gamma) * barrier)
    return np.asarray((distance_m - nearest) / step_s)


def plan_standing(name: str, case: Case, planning: PlanningConfig, vehicle: VehicleConfig) -> Row:
    """What a planner plans at each step for the vehicle that stands at the origin, is asked to go along +x,
    and knows the obstacle on that line with its velocity. The plans are not driven."""
    planner = make_planner(name, Vehicle.from_config(vehicle), planning, Notes())
    path = ReferencePath(np.array([[0.0, 0.0], [20.0, 0.0]]), 0.75)
    ahead_s = planning.step_s * np.arange(planning.steps + 1)
    outcomes, nearest_m, reach_m, gammas = [], [], [], []
    for step, distance in enumerate(case.distance_m()):
        centre = np.column_stack([distance + case.speed_mps * ahead_s, np.zeros(len(ahead_s))])
        known = Obstacles(
            track_id=np.array([1]),
            position_m=centre[None],
            radius_m=np.array([case.radius_m]),
            margin_m=np.zeros((1, len(ahead_s))),
            velocity_mps=np.array([[case.speed_mps, 0.0]]),
            is_static=np.array([False]),
        )
        plan = planner.plan(Situation(round(step * STEP_S * 1e9), np.zeros(3), np.zeros(2), path, known))
        outcomes.append(plan.outcome)
        gap = np.hypot(*(plan.poses[:, :2] - centre).T) - case.radius_m - vehicle.body_radius_m
        nearest_m.append(float(gap.min()))
        reach_m.append(float(np.hypot(*plan.poses[-1, :2])))
        details = plan.details
        gammas.append(float(details.gamma[0, 0]) if details is not None and details.gamma.size else None)
    return {
        "outcomes": {outcome.value: outcomes.count(outcome) for outcome in Outcome},
        "nearest_m": nearest_m,
        "reach_m": reach_m,
        "gamma_first_stage": gammas,
    }


def summarise(rows: Sequence[Row]) -> Document:
    planning = PlanningConfig()
    forms = gamma_forms(DISTANCE_M[:, None], RADIUS_M[None, :], planning)
    values = forms["adaptive"]
    return {
        "paper": "no number is given; the curves are a figure",
        "map": {
            "distance_m": [float(DISTANCE_M[0]), float(DISTANCE_M[-1])],
            "radius_m": [float(RADIUS_M[0]), float(RADIUS_M[-1])],
            "as_configured": _range(values),
            "unclipped": _range(forms["unclipped"]),
            "printed": _range(forms["printed"]),
            "rises_with_distance": bool((np.diff(values, axis=0) >= 0).all()),
            "falls_with_radius": bool((np.diff(values, axis=1) <= 0).all()),
        },
        "fixed_gamma": planning.gamma_fixed,
        "step_s": STEP_S,
        "steps": STEPS,
        "cases": [_of_case(row) for row in rows],
        "drawn": {
            "distance_m": DISTANCE_M.round(4).tolist(),
            "radius_m": RADIUS_M.round(4).tolist(),
            "gamma": values.round(5).tolist(),
            "keep_out_beyond_radius_m": VehicleConfig().body_radius_m + planning.safety_distance_m,
            "cases": list(rows),
        },
    }


def _of_case(row: Row) -> dict[str, Any]:
    """A case's numbers without its curves."""
    approach = -row["speed_mps"]
    permitted = {name: np.array(values) for name, values in row["permitted_mps"].items()}
    keys = ("name", "radius_m", "start_m", "speed_mps", "keep_out_m")
    return {key: row[key] for key in keys} | {
        "end_m": row["distance_m"][-1],
        "first_barrier_m2": row["barrier_m2"][0],
        "steps_inside_keep_out": int((np.array(row["barrier_m2"]) < 0).sum()),
        "gamma": {name: {"first": values[0], "last": values[-1]} for name, values in row["gamma"].items()},
        "steps_that_standing_satisfies": {name: int((values >= approach).sum()) for name, values in permitted.items()},
        "plans": {
            name: {
                "outcomes": plans["outcomes"],
                "nearest_m": min(plans["nearest_m"]),
                "mean_reach_m": float(np.mean(plans["reach_m"])),
            }
            for name, plans in row["plans"].items()
        },
    }


def _range(values: FloatArray) -> list[float]:
    return [float(values.min()), float(values.max())]


def markdown(document: Document) -> str:
    cases, ranges = document["cases"], document["map"]
    duration_s = document["steps"] * document["step_s"]
    names = [case["name"] for case in cases]
    form = {
        "adaptive": "gamma, as configured",
        "unclipped": "gamma, without the clip",
        "printed": "gamma, eq. 14 as printed",
    }
    rows = [
        (text, *(f"{case['gamma'][key]['first']:.3f} to {case['gamma'][key]['last']:.3f}" for case in cases))
        for key, text in form.items()
    ]
    rows.append(("fixed gamma of `d-cbf-mpc`", *(f"{document['fixed_gamma']:g}" for _ in cases)))
    rows.append(("h at the first step, m^2", *(f"{case['first_barrier_m2']:.2f}" for case in cases)))
    for key, text in (("adaptive", "adaptive"), ("fixed", "fixed")):
        kept = (f"{case['steps_that_standing_satisfies'][key]} of {document['steps']}" for case in cases)
        rows.append((f"steps at which standing keeps eq. 13, {text}", *kept))
    for planner in PLANNERS:
        rows.append((f"plans of `{planner}`: solved / relaxed / braked", *(_outcomes(c, planner) for c in cases)))
        rows.append(("..., mean way in 3 s, m", *(f"{c['plans'][planner]['mean_reach_m']:.2f}" for c in cases)))
    return "\n\n".join(
        (
            f"(a) gamma as configured; (b) gamma at the {document['steps']} steps; (c) how fast an obstacle may come "
            "nearer under each gamma, and how fast it does. The paper gives its figure and no number.",
            table(("first to last step", *names), rows),
            f"Chosen here, as the paper does not say: {SPEED_MPS:g} m/s, steps of {document['step_s']:g} s "
            f"({duration_s:g} s in all), distances between centres. The plans are of a standing vehicle that is asked "
            "to go along the line on which the obstacle is; none is driven.",
            _findings(cases, ranges),
        )
    )


def _outcomes(case: dict[str, Any], planner: str) -> str:
    counts = case["plans"][planner]["outcomes"]
    return f"{counts['solved']} / {counts['relaxed']} / {counts['braked'] + counts['stopped']}"


def _findings(cases: Sequence[dict[str, Any]], ranges: dict[str, Any]) -> str:
    """What of section 3.3 holds, each line from the numbers."""

    def held(yes: bool) -> str:
        return "reproduced" if yes else "NOT reproduced"

    first, second = cases
    printed, unclipped, configured = (ranges[key] for key in ("printed", "unclipped", "as_configured"))
    standing = first["steps_that_standing_satisfies"]
    inside = "outside" if second["first_barrier_m2"] < 0 else "inside"
    lines = [
        f"- gamma falls as the obstacle comes nearer: {held(ranges['rises_with_distance'])}, over the whole map.",
        f"- gamma is smaller for a larger obstacle: {held(ranges['falls_with_radius'])}, over the whole map.",
        f"- 0 < gamma <= 1, as section 3.3 asks: with the clip, from {configured[0]:g} to {configured[1]:g}. Without "
        f"it eq. 14 goes over the map from {printed[0]:.2f} to {printed[1]:.2f} as printed, and from "
        f"{unclipped[0]:.1g} to {unclipped[1]:.2f} as the Gaussian distribution function; as printed it is "
        f"{first['gamma']['printed']['first']:.3f} at the first step of the paper's own first case.",
        f"- Obstacle 2 begins {inside} the safe set: with centres {second['start_m']:g} m apart and r_c + r + r_s = "
        f"{second['keep_out_m']:g} m, h = {second['first_barrier_m2']:.2f} m^2. The paper does not say between what "
        "its distances are; between surfaces, 1.0 m would be inside.",
        '- "Higher gamma values increase stability": not by eq. 13, under which a higher gamma lets an obstacle come '
        "nearer faster, as panel (c) shows.",
        f'- "The UGV was kept stationary": standing keeps eq. 13 at {standing["adaptive"]} of the {STEPS} steps of '
        f"obstacle 1 with the adaptive gamma, and at {standing['fixed']} with the fixed one. At the others a plan that "
        "keeps it has to give way.",
    ]
    return "\n".join(lines)


PART = Part(
    name="fig4",
    title="Fig. 4: gamma over distance and radius, and in two cases of 50 steps",
    tasks=tasks,
    run=run,
    summarise=summarise,
    markdown=markdown,
    figure=True,
    settings={"planning": PlanningConfig().model_dump(mode="json"), "vehicle": VehicleConfig().model_dump(mode="json")},
)
