"""What the paper does not show: the five planners and their parts, one changed at a time, on short random scenes.

Each variant drives the scenes that its base drives, and is compared with it scene by scene. Perception takes most of a
run's time: where it is not what is asked for, planners know what is within range as it is, with its true future.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from adcbf_cli.core.config import CLOSED_LOOP
from adcbf_cli.core.evaluation.monte_carlo import study
from adcbf_cli.core.evaluation.scene_runs import SceneTask
from adcbf_cli.core.reproduction.ablations_cases import (
    GROUPS,
    SCENE,
    SPEEDS_MPS,
    Group,
    Variant,
    all_variants,
    at_speeds,
    tasks_of,
)
from adcbf_cli.core.reproduction.ablations_text import markdown
from adcbf_cli.core.reproduction.drives import PLANNERS, drive
from adcbf_cli.core.reproduction.part import Document, Part, Row
from adcbf_cli.scenarios import scenario_text

MEASURES = (
    "success",
    "collision",
    "collision_despite_way",
    "timeout",
    "freeze",
    "min_dist_m",
    "nav_time_s",
    "vel_var",
    "relaxed_rate",
)
"""Those that the document keeps of each variant, and of its difference from its base."""

SHARE = 0.5
FEWEST = 10
"""Variants are many: they get the first SHARE of the seeds asked for, and FEWEST at least where there are as many.
With 20 seeds all parts together then take less than half an hour on two cores."""

BREAKS_AT = 0.5
"""A planner breaks at the lowest speed at which more than this share of its runs end in a collision."""

Rows = Mapping[str, Sequence[Row]]
"""Finished runs by the variant's name."""


def tasks(seeds: Sequence[int]) -> dict[str, tuple[str, SceneTask]]:
    return tasks_of(all_variants(), seeds[: max(FEWEST, math.ceil(SHARE * len(seeds)))])


def run(task: tuple[str, SceneTask]) -> Row:
    """One run, with its variant's name; the way that was driven is not kept."""
    name, scene = task
    row = drive(scene)
    del row["path"]
    return {"variant": name} | row


def summarise(rows: Sequence[Row]) -> Document:
    by_variant: dict[str, list[Row]] = {}
    for row in rows:
        by_variant.setdefault(row["variant"], []).append(row)
    return {
        "scene": SCENE,
        "seeds": sorted({row["seed"] for row in rows}),
        "runs": len(rows),
        "groups": [_group(group, by_variant) for group in GROUPS],
        "speeds": {planner: _along_speeds(planner, by_variant) for planner in PLANNERS},
    }


def _group(group: Group, rows: Rows) -> dict[str, Any]:
    return {
        "title": group.title,
        "note": group.note,
        "variants": [_variant(label, *pair, rows) for label, pair in group.variants.items()],
    }


def _variant(label: str, variant: Variant, base: Variant, rows: Rows) -> dict[str, Any]:
    """The variant's aggregates, and its differences from its base; those are None for the base itself, and
    where either of the two has no finished run."""
    about: dict[str, Any] = {"label": label, "runs": variant.name, "base": base.name, "differences": None}
    mine, others = (_called(one.name, rows.get(one.name, ())) for one in (variant, base))
    compared = variant.name != base.name and mine and others
    found = study([*mine, *others] if compared else mine, base.name if compared else None).planners
    if not mine:
        return about | {"n": 0, "here": None}
    of_variant = found[variant.name]
    about |= {"n": of_variant.runs, "here": {name: of_variant.aggregates[name].to_dict() for name in MEASURES}}
    if compared:
        about["differences"] = {name: of_variant.differences[name].to_dict() for name in MEASURES}
    return about


def _called(name: str, rows: Sequence[Row]) -> list[Row]:
    """The rows as those of a planner of this name: a study compares by planner."""
    return [{**row, "planner": name} for row in rows]


def _along_speeds(planner: str, rows: Rows) -> dict[str, Any]:
    """One planner among movers of each speed, and the speeds at which it first collides, and breaks."""
    variants = at_speeds()
    points = []
    for speed in SPEEDS_MPS:
        variant = variants[planner, speed]
        point = _variant(f"{speed:g}", variant, variant, rows)
        points.append({"speed_mps": speed, "n": point["n"], "here": point["here"]})
    rates = [(p["speed_mps"], p["here"]["collision"]["value"]) for p in points if p["here"] is not None]
    return {
        "points": points,
        "first_collision_mps": next((speed for speed, rate in rates if rate > 0), None),
        "breaks_mps": next((speed for speed, rate in rates if rate > BREAKS_AT), None),
    }


PART = Part(
    name="ablations",
    title="Ablations: what perception, the ladder, gamma, the printed forms, the horizon and speed do",
    tasks=tasks,
    run=run,
    summarise=summarise,
    markdown=markdown,
    figure=True,
    settings={"scene": scenario_text(SCENE), "config": CLOSED_LOOP.model_dump(mode="json")},
)
