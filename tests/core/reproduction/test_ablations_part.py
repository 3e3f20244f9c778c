"""The ablations: what is varied, that shared runs are shared, and the arithmetic against the base."""

from __future__ import annotations

import pickle
from typing import Any

import pytest
import yaml

from adcbf_cli.core.config import CLOSED_LOOP
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.reproduction import ablations, load_part
from adcbf_cli.core.reproduction.ablations_cases import (
    GROUPS,
    SPEEDS_MPS,
    Variant,
    all_variants,
    at_one_speed,
    at_speeds,
    tasks_of,
)
from adcbf_cli.core.reproduction.drives import PLANNERS
from adcbf_cli.core.simulation.parsing import parse_scenario
from adcbf_cli.core.types import Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle
from adcbf_cli.scenarios import scenario_text
from tests.core.reproduction.runs_of_scenes import a_run

SEED = 100_000
BASE = Variant("ad-cbf-mpc")


def test_one_speed_is_all_that_changes():
    text = scenario_text("crossings")
    drawn, slow = (parse_scenario(each, "crossings", SEED) for each in (text, at_one_speed(text, 0.3)))
    assert {mover.path.speed_mps for mover in slow.movers} == {0.3}
    assert len({mover.path.speed_mps for mover in drawn.movers}) > 1
    assert slow.objects == drawn.objects
    assert [mover.kind for mover in slow.movers] == [mover.kind for mover in drawn.movers]
    assert slow.route == drawn.route
    changed = [
        key for key in yaml.safe_load(text) if yaml.safe_load(at_one_speed(text, 0.3))[key] != yaml.safe_load(text)[key]
    ]
    assert changed == ["movers"]


def test_a_scene_that_says_no_speed_is_refused():
    with pytest.raises(ValueError, match="speed_mps"):
        at_one_speed("movers: []", 0.3)


def test_every_variant_is_a_planner_that_can_be_built():
    for variant in all_variants():
        config = variant.task(SEED).config
        assert make_planner(variant.planner, Vehicle.from_config(config.vehicle), config.planning, Notes())


def test_variants_differ_from_their_base_in_one_way_only():
    for group in GROUPS:
        for variant, base in group.variants.values():
            if variant != base:
                differs = (variant.settings != base.settings) + (variant.knowledge != base.knowledge)
                assert (variant.planner, variant.speed_mps, differs) == (base.planner, base.speed_mps, 1)


def test_what_a_variant_sets_is_not_the_default_already():
    for group in GROUPS:
        for variant, base in group.variants.values():
            if variant.settings != base.settings:
                assert variant.task(0).config != base.task(0).config


def test_shared_runs_are_run_once():
    variants = all_variants()
    asked = [one for group in GROUPS for pair in group.variants.values() for one in pair]
    assert len({variant.name for variant in variants}) == len(variants) < len(asked)
    tasks = tasks_of(variants, (0, 1))
    assert len(tasks) == 2 * len(variants)
    assert list(tasks)[len(variants)].endswith("seed 1")
    name, task = tasks["ad-cbf-mpc perfect seed 1"]
    assert (name, task.planner, task.seed, task.config) == (BASE.name, "ad-cbf-mpc", 1, CLOSED_LOOP)


@pytest.mark.parametrize("name", ["table2", "fig6", "ablations"])
def test_runs_can_go_to_other_processes(name: str):
    part = load_part(name)
    task = next(iter(part.tasks([SEED]).values()))
    assert pickle.loads(pickle.dumps((part.run, task))) == (part.run, task)


@pytest.mark.parametrize(("asked", "driven"), [(3, 3), (10, 10), (12, 10), (20, 10), (100, 50)])
def test_variants_get_a_share_of_the_seeds_and_ten_at_least(asked: int, driven: int):
    seeds = {task.seed for _, task in ablations.tasks(range(asked)).values()}
    assert seeds == set(range(driven))


def rows_of(variant: Variant, gain_m: float, collides: range = range(0)) -> list[dict[str, Any]]:
    return [
        {"variant": variant.name}
        | a_run(variant.planner, seed, "collision" if seed in collides else "success", min_dist_m=0.1 * seed + gain_m)
        for seed in range(8)
    ]


def test_differences_are_to_the_base_scene_by_scene():
    other = next(variant for label, (variant, _) in GROUPS[2].variants.items() if label == "0.2")
    document = ablations.summarise([*rows_of(BASE, 0.0), *rows_of(other, -0.05, range(2))])
    base, *_, last = document["groups"][2]["variants"]
    assert base["differences"] is None
    assert base["n"] == last["n"] == 8
    assert last["differences"]["min_dist_m"]["value"] == pytest.approx(-0.05)
    assert last["differences"]["min_dist_m"]["interval_95"] == pytest.approx([-0.05, -0.05])
    assert last["differences"]["collision"]["value"] == pytest.approx(0.25)
    assert last["here"]["collision_despite_way"]["value"] == pytest.approx(0.25)
    text = ablations.markdown(document)
    assert "2/8: 25 % [7, 59]" in text
    assert "-0.05 [-0.05, -0.05] (n = 8)" in text
    missing = next(line for line in text.splitlines() if line.startswith("| 0.1 |"))
    assert missing.split("|")[2:4] == [" 0 ", " - "]


def test_a_planner_breaks_where_more_than_half_of_its_runs_collide():
    speeds = at_speeds()
    collided = dict(zip(SPEEDS_MPS, (0, 1, 4, 5, 8), strict=True))
    rows = [
        row
        for planner in PLANNERS
        for speed, count in collided.items()
        for row in rows_of(speeds[planner, speed], 0.0, range(count if planner == "mpc-dc" else 0))
    ]
    document = ablations.summarise(rows)
    found = document["speeds"]["mpc-dc"]
    assert (found["first_collision_mps"], found["breaks_mps"]) == (0.5, 1.1)
    assert [point["n"] for point in found["points"]] == [8] * len(SPEEDS_MPS)
    line = next(line for line in ablations.markdown(document).splitlines() if line.startswith("| `a-cbf-mpc` | 0/8"))
    assert line.endswith("| never | never |")
    assert "In 18 of the 18 collisions" in ablations.markdown(document)


def test_a_run_keeps_its_variant_and_no_way():
    """A run of the shortest kind: the scene's own drive, cut to a metre."""
    text = (
        scenario_text("crossings")
        .replace("length_m: {uniform: [9, 10]}", "length_m: 2.5")
        .replace("- repeat: {integer: [1, 5]}", "- repeat: 0")
    )
    name, task = next(iter(tasks_of([BASE], [SEED]).values()))
    row = ablations.run((name, type(task)(text, "short", SEED, task.planner, task.config, task.knowledge)))
    assert row["variant"] == "ad-cbf-mpc perfect"
    assert row["result"] == "success"
    assert "path" not in row
