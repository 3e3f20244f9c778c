"""Fig. 6: the ways of the five planners over the scene of the first seed, from the runs of Table II.

What stands is drawn as it is; a mover as its way, and where it was when the paper's planner came nearest to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from adcbf_cli.core.config import CLOSED_LOOP
from adcbf_cli.core.evaluation.scene_runs import PATH_STEP_S, SceneTask
from adcbf_cli.core.replay.simulated_world import SimulatedWorld
from adcbf_cli.core.replay.world import WorldObjects
from adcbf_cli.core.reproduction import table2
from adcbf_cli.core.reproduction.drives import OURS, drive
from adcbf_cli.core.reproduction.part import Document, Part, Row, table
from adcbf_cli.core.simulation.parsing import parse_scenario
from adcbf_cli.core.simulation.paths import route_points
from adcbf_cli.core.simulation.world import NS_PER_S, World
from adcbf_cli.core.types import FloatArray
from adcbf_cli.scenarios import scenario_text

MET_M = 2.0
"""A mover that the drawn planner never came nearer to than this, surface to surface, is drawn where it ends."""


def tasks(seeds: Sequence[int]) -> dict[str, SceneTask]:
    """Those of Table II with the first seed."""
    return table2.tasks(seeds[:1])


def summarise(rows: Sequence[Row]) -> Document:
    seed = int(rows[0]["seed"])
    scenario = parse_scenario(scenario_text(table2.SCENE), table2.SCENE, seed)
    world = SimulatedWorld(World(scenario, seed))
    assert scenario.route is not None
    route = route_points(scenario.route)
    start_ns = scenario.start_time_s * NS_PER_S
    shown = next((row for row in rows if row["planner"] == OURS), rows[0])
    return {
        "scene": table2.SCENE,
        "seed": seed,
        "runs": [_of_run(row) for row in rows],
        "met_by": shown["planner"],
        "drawn": {
            "route_m": _rounded(route),
            "goal_tolerance_m": CLOSED_LOOP.replay.goal_tolerance_m,
            "body_radius_m": CLOSED_LOOP.vehicle.body_radius_m,
            "standing": [
                shape | {"ellipse": thing.kind == "rock"}
                for shape, thing in zip(
                    _shapes(world.as_boxes(start_ns), len(scenario.movers), None), scenario.objects, strict=True
                )
            ],
            "movers": _movers(world, len(scenario.movers), shown, start_ns, max(row["duration_s"] for row in rows)),
            "ways": [{"planner": row["planner"], "result": row["result"], "path_m": row["path"]} for row in rows],
        },
    }


def _of_run(row: Row) -> dict[str, Any]:
    collision = row["collision"]
    keys = ("nav_time_s", "min_dist_m", "path_length_m")
    return {
        "planner": row["planner"],
        "result": row["result"],
        "duration_s": row["duration_s"],
        **{key: row["metrics"][key] for key in keys},
        "collided_with": None if collision is None else collision["kind"],
    }


def _shapes(objects: WorldObjects, first: int, last: int | None) -> list[dict[str, Any]]:
    """Circles and rectangles, in the order of their ids, of the things from `first` to before `last`."""
    rows = np.flatnonzero((objects.id >= first) & (objects.id < (np.inf if last is None else last)))
    return [_shape(objects, int(row)) for row in rows]


def _shape(objects: WorldObjects, row: int) -> dict[str, Any]:
    shape: dict[str, Any] = {"centre_m": _rounded(objects.centre_m[row]), "radius_m": None, "box": None}
    if objects.is_box[row]:
        yaw = float(objects.yaw_rad[row])
        size = (float(objects.length_m[row]), float(objects.width_m[row]))
        shape["box"] = {"length_m": round(size[0], 4), "width_m": round(size[1], 4), "yaw_rad": round(yaw, 5)}
    else:
        shape["radius_m"] = round(float(objects.radius_m[row]), 4)
    return shape


def _movers(world: SimulatedWorld, count: int, shown: Row, start_ns: int, until_s: float) -> list[dict[str, Any]]:
    """Each mover's way while anybody drove, and its shape at the moment at which the shown planner was nearest."""
    path = np.array(shown["path"])
    time_s = np.minimum(PATH_STEP_S * np.arange(len(path)), shown["duration_s"])
    stamps = start_ns + np.round(time_s * NS_PER_S).astype(np.int64)
    gap = np.array(
        [
            world.at(int(stamp)).clearance(place[None], CLOSED_LOOP.vehicle.body_radius_m)[0, :count]
            for stamp, place in zip(stamps, path, strict=True)
        ]
    ).reshape(-1, count)
    ends = start_ns + np.array([0, round(until_s * NS_PER_S)])
    centre, _ = world.along(ends)
    movers = []
    for mover in range(count):
        nearest = int(gap[:, mover].argmin())
        met = bool(gap[nearest, mover] < MET_M)
        at = int(stamps[nearest]) if met else int(ends[1])
        movers.append(
            {
                "way_m": _rounded(centre[mover]),
                "met": met,
                "gap_m": round(float(gap[nearest, mover]), 3),
                "ego_m": _rounded(path[nearest]),
                **_shapes(world.at(at), mover, mover + 1)[0],
            }
        )
    return movers


def _rounded(values: FloatArray) -> list[Any]:
    """To a millimetre, as JSON."""
    rounded: list[Any] = np.round(values, 3).tolist()
    return rounded


def markdown(document: Document) -> str:
    def cell(value: float | None, digits: int) -> str:
        return "-" if value is None else f"{value:.{digits}f}"

    rows = [
        (
            f"`{run['planner']}`",
            run["result"] if run["collided_with"] is None else f"{run['result']} ({run['collided_with']})",
            cell(run["duration_s"], 1),
            cell(run["min_dist_m"], 2),
            cell(run["path_length_m"], 2),
        )
        for run in document["runs"]
    ]
    return "\n\n".join(
        (
            f"The runs of Table II with seed {document['seed']}: one scene, from which nothing follows for others. "
            f"Movers are drawn with their ways, and where they were when `{document['met_by']}` was nearest to them, "
            f"if it came nearer than {MET_M:g} m; a thin line leads to where it was then. A cross is a collision. The "
            "paper's figure is of a world that it does not describe, so that only the kind of picture can be compared.",
            table(("", "ended in", "after, s", "Min-dist, m", "Path-len, m"), rows),
        )
    )


PART = Part(
    name="fig6",
    title="Fig. 6: the ways of the five planners",
    tasks=tasks,
    run=drive,
    summarise=summarise,
    markdown=markdown,
    figure=True,
    settings=table2.PART.settings,
    runs_of="table2",
)
