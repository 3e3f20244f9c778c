"""Table II: the paper's five planners through the world of its section 4.1, from the LiDAR's rays to the wheels.

A seed draws a scene (`unstructured`), and each planner drives it. What it knows comes from its own simulated scans:
clustered, tracked and predicted. The same seed is the same scene, so that planners are compared in pairs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from adcbf_cli.core.config import CLOSED_LOOP
from adcbf_cli.core.evaluation.comparison import Difference
from adcbf_cli.core.evaluation.monte_carlo import MonteCarlo, study
from adcbf_cli.core.evaluation.scene_runs import SceneTask
from adcbf_cli.core.reproduction.drives import (
    OURS,
    PLANNERS,
    collisions,
    drive,
    mean_cell,
    number_cell,
    rate_cell,
)
from adcbf_cli.core.reproduction.part import Document, Part, Row, seed_text, table
from adcbf_cli.core.reproduction.table2_claims import MEASURES, PAPER, claims_table, comparisons_table, judge
from adcbf_cli.scenarios import scenario_text

SCENE = "unstructured"
ENDS = ("success", "collision", "avoidable_collision", "timeout", "freeze")


def tasks(seeds: Sequence[int]) -> dict[str, SceneTask]:
    """Seed by seed, so that runs that stop half-way have all planners of the scenes that they had."""
    text = scenario_text(SCENE)
    made = [SceneTask(text, SCENE, seed, planner, CLOSED_LOOP) for seed in seeds for planner in PLANNERS]
    return {task.run_id: task for task in made}


def summarise(rows: Sequence[Row]) -> Document:
    there = [planner for planner in PLANNERS if any(row["planner"] == planner for row in rows)]
    studies = {planner: study(rows, planner) for planner in there}
    return {
        "scene": SCENE,
        "seeds": sorted({row["seed"] for row in rows}),
        "planners": {planner: _planner(planner, studies) for planner in there},
        "claims": judge(lambda mine, other, measure: _difference(studies, mine, other, measure)),
        "collisions": collisions(rows),
        "scenes": _scenes(rows),
        "config": _settings(),
    }


def _difference(studies: Mapping[str, MonteCarlo], mine: str, other: str, measure: str) -> Difference | None:
    if mine not in studies or other not in studies:
        return None
    return studies[other].planners[mine].differences[measure]


def _planner(planner: str, studies: Mapping[str, MonteCarlo]) -> dict[str, Any]:
    runs = studies[planner].planners[planner]
    differences = {}
    if OURS in studies and planner != OURS:
        found = studies[OURS].planners[planner].differences
        differences = {name: found[name].to_dict() for name in (*MEASURES, *ENDS)}
    return {
        "paper": PAPER[planner],
        "runs": runs.runs,
        "here": {name: runs.aggregates[name].to_dict() for name in (*MEASURES, *ENDS)},
        f"minus {OURS}": differences,
    }


def _scenes(rows: Sequence[Row]) -> dict[str, list[float]]:
    """From what to what the scenes' features go."""
    names = rows[0]["scene"] if rows else ()
    return {name: [pick(row["scene"][name] for row in rows) for pick in (min, max)] for name in names}


def _settings() -> dict[str, Any]:
    """What the runs are made with: the package's defaults."""
    config = CLOSED_LOOP.model_dump(mode="json")
    return {stage: config[stage] for stage in ("perception", "tracking", "prediction", "vehicle", "planning", "replay")}


def markdown(document: Document) -> str:
    planners, seeds = document["planners"], document["seeds"]
    blocks = [
        _measured(planners),
        f"Here: means over {seed_text(seeds)}, with 95 % intervals (bootstrap over runs; none with fewer than five), "
        "and in brackets how many runs have the value where not all do. The paper's values are of one run each, "
        "without an interval. Runs that do not arrive have no Nav-time and no Path-len, so that these two favour "
        "planners that fail in the hard scenes; Min-dist, Ref-time and Vel-var count failed runs up to their end.",
        "The paper names its measures in one line each; docs/driving-metrics.md says what they are here. Ref-time is "
        "from when keeping to the reference would, by what is known, come nearer than r_s within the horizon, to when "
        "the vehicle itself departs from what it did before; Vel-var is of the speed within 2 m of an obstacle.",
        "## How the runs ended",
        _ended(planners),
        "Events of runs, per cent, and 95 % score intervals (Wilson). A collision is avoidable where a search with "
        "full knowledge found a way around it from the moment at which the planner knew of the obstacle; a collision "
        "with what was never known is not judged. Freezing is standing still for more than 5 s in sum.",
        f"## Differences to {OURS}, scene by scene",
        _differences(planners),
        f"Each planner minus `{OURS}` over the seeds in which both have a value (n pairs), 95 % bootstrap interval "
        "over pairs; success in points of a hundred, with a paired score interval (Tango).",
        "## What the paper claims",
        "A comparison holds where the whole 95 % interval of the paired difference is on the claimed side, does not "
        "hold where it is on the other, and cannot be told where the interval contains 0 or there are too few pairs "
        f"for one. A claim holds where it holds against every planner that it names. Of {len(document['claims'])} "
        "comparisons one or two are expected to miss 0 by chance alone.",
        claims_table(document["claims"]),
        f"{_of_the_first(document)} {_shares(planners)}",
        comparisons_table(document["claims"]),
        *_collided(document["collisions"]),
        _text_of_settings(document),
    ]
    return "\n\n".join(blocks)


def _measured(planners: Mapping[str, Any]) -> str:
    rows = []
    for name, found in planners.items():
        paper = found["paper"]
        printed = ["-" if paper[key] is None else f"{paper[key]:.{digits}f}" for key, (_, digits) in MEASURES.items()]
        here = [mean_cell(found["here"][key], digits) for key, (_, digits) in MEASURES.items()]
        rows += [(f"`{name}`, paper", *printed), (f"`{name}`, here", *here)]
    return table(("", *(title for title, _ in MEASURES.values())), rows)


def _ended(planners: Mapping[str, Any]) -> str:
    rows = [
        (f"`{name}`", str(found["runs"]), *(rate_cell(found["here"][end]) for end in ENDS))
        for name, found in planners.items()
    ]
    return table(("", "runs", *(end.replace("_", " ") for end in ENDS)), rows)


def _differences(planners: Mapping[str, Any]) -> str:
    rows = []
    for name, found in planners.items():
        differences = found[f"minus {OURS}"]
        if differences:
            cells = [_difference_cell(differences[key], digits) for key, (_, digits) in MEASURES.items()]
            rows.append((f"`{name}`", _difference_cell(differences["success"], 0, 100.0), *cells))
    return table(("", "success, points", *(title for title, _ in MEASURES.values())), rows)


def _difference_cell(found: Mapping[str, Any], digits: int, scale: float = 1.0) -> str:
    if found["value"] is None:
        return "-"
    return f"{number_cell(found['value'], found['interval_95'], digits, scale)} (n = {found['n_pairs']})"


def _of_the_first(document: Document) -> str:
    """What became of MPC-DC, which the paper says collides with the first moving obstacle."""
    hit = [one for one in document["collisions"] if one["planner"] == "mpc-dc"]
    runs = document["planners"].get("mpc-dc", {"runs": 0})["runs"]
    return (
        f"`mpc-dc` collided in {len(hit)} of its {runs} runs, {sum(one['moving'] for one in hit)} times with a mover."
    )


def _shares(planners: Mapping[str, Any]) -> str:
    """The two figures of the paper's conclusion that are shares of D-CBF-MPC's values."""
    baseline = planners.get("d-cbf-mpc")
    if baseline is None or OURS not in planners:
        return "The paper's shares of D-CBF-MPC's values cannot be told: a planner has no run."
    found = []
    for key, stated in (("min_dist_m", "13 % more Min-dist"), ("vel_var", "41 % less Vel-var")):
        difference, mean = baseline[f"minus {OURS}"][key], baseline["here"][key]["value"]
        known = difference["value"] is not None and mean
        found.append(f"{stated} (here {-100 * difference['value'] / mean:+.0f} %)" if known else f"{stated} (here: -)")
    return (
        f"The paper's conclusion gives `{OURS}`, against `d-cbf-mpc`, {' and '.join(found)}; these are ratios of means."
    )


def _collided(found: Sequence[Mapping[str, Any]]) -> list[str]:
    if not found:
        return []
    judged = {True: "yes", False: "no", None: "not judged"}
    rows = [
        (
            f"`{one['planner']}`, seed {one['seed']}",
            f"{one['kind']}, {'moving' if one['moving'] else 'standing'}",
            f"{one['at_s']:.1f}",
            "never" if one["known_since_s"] is None else f"{one['known_since_s']:.1f}",
            f"{one['speed_mps']:.2f}",
            judged[one["avoidable"]],
            "-" if one["avoidable_until_s"] is None else f"{one['avoidable_until_s']:.1f}",
        )
        for one in found
    ]
    head = ("collision", "with", "at, s", "known since, s", "own speed, m/s", "avoidable", "a way until, s")
    return ["## Collisions", table(head, rows)]


def _text_of_settings(document: Document) -> str:
    config, scenes = document["config"], document["scenes"]
    planning, vehicle, perception = config["planning"], config["vehicle"], config["perception"]
    low, high = scenes["fastest_mps"]
    return (
        "Settings: the scene `unstructured` of this package, with a reference path of 35.869 m as in the paper; its "
        f"shape, the ground (bumps of up to {scenes['bumps_m'][0]:.2f} to {scenes['bumps_m'][1]:.2f} m), what stands "
        f"({scenes['standing'][0]:g} things) and what moves ({scenes['movers'][0]:g} to {scenes['movers'][1]:g} "
        f"movers, the fastest of a scene at {low:.2f} to {high:.2f} m/s) are not in the paper: they are chosen, and "
        "drawn anew by each seed. Movers keep their course whatever the robot does. "
        f"Unicycle of {vehicle['body_radius_m']:g} m radius, at most {vehicle['max_speed_mps']:g} m/s, reference speed "
        f"{planning['reference_speed_mps'] or 0.75:g} m/s; the paper gives neither. r_s = "
        f"{planning['safety_distance_m']:g} m, N = {planning['steps']} steps of {planning['step_s']:g} s, planned at "
        f"{planning['rate_hz']:g} Hz; scans at 10 Hz, cropped to {2 * perception['range_m']:g} x "
        f"{2 * perception['range_m']:g} m; gamma = {planning['gamma_fixed']:g} where it is fixed, from "
        f"{planning['gamma_floor']:g} on where it is adaptive. Not in the paper: the fallback ladder and up to "
        f"{planning['starts']} starts for all five, and, for the two that predict, margins of up to "
        f"{planning['max_margin_m']:g} m for the prediction's uncertainty (`{planning['uncertainty']}`) and stepping "
        "aside where a plan would be run over. Everything else is at the package's defaults. "
        "What was tried out while this package was made was tried on seeds from 100000 up."
    )


PART = Part(
    name="table2",
    title="Table II: five planners in the world of section 4.1",
    tasks=tasks,
    run=drive,
    summarise=summarise,
    markdown=markdown,
    settings={"scene": scenario_text(SCENE), "config": _settings()},
)
