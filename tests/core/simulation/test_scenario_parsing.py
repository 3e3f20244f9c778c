"""Scenario files: what is accepted, and the one line that a mistake gets."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.simulation.parsing import parse_scenario, scenario_keys
from adcbf_cli.core.simulation.scenario import CirclePath, SpinningLidar

MINIMAL = """
duration_s: 1
ego: {path: {kind: stand, at_m: [0, 0]}}
lidar: {kind: spinning}
"""

TWO_MOVERS = """
movers:
  - {kind: cylinder, path: {kind: circle, centre_m: [8.5, 2], radius_m: 2.5, frequency_hz: 0.015}}
  - {kind: person, path: {kind: line, from_m: [0, 1], to_m: [0, 5], %s}}
"""


def test_a_minimal_scenario_has_defaults():
    scenario = parse_scenario(MINIMAL)
    assert scenario.seed == 0
    assert isinstance(scenario.lidar, SpinningLidar)
    assert scenario.movers == ()


def test_movers_keep_their_kind():
    scenario = parse_scenario(MINIMAL + TWO_MOVERS % "speed_mps: 1")
    assert isinstance(scenario.movers[0].path, CirclePath)
    assert scenario.movers[1].kind == "person"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MINIMAL + TWO_MOVERS % "speed_mps: -1", "s.yaml: movers.1.path.speed_mps: must be > 0"),
        (
            MINIMAL + TWO_MOVERS % "speed_mps: 1, start: 2",
            "s.yaml: movers.1.path.start: unknown key; did you mean 'start_s'?",
        ),
        (MINIMAL + TWO_MOVERS % "start_s: 2", "s.yaml: movers.1.path.speed_mps: is missing"),
        (MINIMAL.replace("stand", "fly"), "s.yaml: ego.path: kind 'fly' is none of"),
        (MINIMAL.replace("kind: stand, ", ""), "s.yaml: ego.path: needs a 'kind'"),
        (MINIMAL.replace("duration_s: 1", "duration_s: .inf"), "s.yaml: duration_s: should be a finite number"),
        (MINIMAL.replace("duration_s: 1", "duration_s: 0.05"), "s.yaml: duration_s is shorter than one scan"),
        (MINIMAL.replace("duration_s: 1", "duration_s: long"), "s.yaml: duration_s: should be a valid number"),
        (MINIMAL + "terrain: {kind: bumps, wavelength_m: 0.5}", "s.yaml: terrain: cell_m must be at most a quarter"),
        (MINIMAL + "terrain: {kind: bumps, size_m: 1000, cell_m: 0.1}", "s.yaml: terrain: size_m / cell_m gives more"),
        (
            MINIMAL.replace("kind: spinning", "kind: spinning, channels: 256, azimuth_step_deg: 0.01"),
            "s.yaml: lidar: more than 500000 rays",
        ),
        (MINIMAL.replace("spinning", "planar, channels: 3"), "s.yaml: lidar.channels: unknown key"),
        (MINIMAL.replace("spinning", "planar, topics: a"), "s.yaml: lidar.topics: unknown key; did you mean 'topic'?"),
        (MINIMAL + "sed: 1", "s.yaml: sed: unknown key; did you mean 'seed'?"),
        (MINIMAL + "1: 2", "s.yaml: 1: a key must be text"),
        (MINIMAL + "terrain: 3", "s.yaml: terrain: must be a mapping of keys"),
        (MINIMAL + "objects: 3", "s.yaml: objects: must be a list"),
        (MINIMAL.replace("[0, 0]", "[0, 0, 0]"), "s.yaml: ego.path.at_m: must have at most 2 values, not 3"),
        ("- 1\n- 2", "s.yaml: a scenario is a mapping"),
        ("duration_s: [1", "s.yaml:1: not valid YAML"),
        ("x: !!python/object/apply:os.getcwd []", "s.yaml:1: not valid YAML"),
        ("#" * 1_000_001, "s.yaml: longer than 1000000 characters"),
    ],
)
def test_a_mistake_gets_one_line_that_names_the_key(text: str, message: str):
    with pytest.raises(UsageError) as raised:
        parse_scenario(text, "s.yaml")
    assert str(raised.value).startswith(message)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("points_m: [[0, 0], [1, 0]]", "give either times_s or speed_mps"),
        ("points_m: [[0, 0], [1, 0]], times_s: [0, 1], speed_mps: 1", "give either times_s or speed_mps"),
        ("points_m: [[0, 0], [0, 0]], speed_mps: 1", "same point twice"),
        ("points_m: [[0, 0], [1, 0]], times_s: [1, 1]", "times_s must increase"),
        ("points_m: [[0, 0], [1, 0]], times_s: [0, 1, 2]", "times_s has 3 values for 2 points"),
        ("points_m: [[0, 0], [1, 0]], speed_mps: 1, pauses_s: [1]", "pauses_s has 1 values for 2 points"),
        ("points_m: [[0, 0], [1, 0]], times_s: [0, 1], start_s: 1", "go with speed_mps"),
    ],
)
def test_waypoints_that_contradict_themselves_are_refused(path: str, message: str):
    text = MINIMAL + f"movers: [{{kind: person, path: {{kind: waypoints, {path}}}}}]"
    with pytest.raises(UsageError, match=message) as raised:
        parse_scenario(text, "s.yaml")
    assert str(raised.value).startswith("s.yaml: movers.0.path: ")


def test_every_key_is_described():
    page = (Path(__file__).parents[3] / "docs" / "scenarios.md").read_text(encoding="utf-8")
    words = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`\n]+)`", page))))
    assert scenario_keys() - words == set()


def test_the_documented_examples_are_valid():
    page = (Path(__file__).parents[3] / "docs" / "scenarios.md").read_text(encoding="utf-8")
    examples = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert len(examples) == 2
    for example in examples:
        assert parse_scenario(example).movers[0].kind == "person"


RELATIVE = MINIMAL + "route: {points_m: [[0, 0], [10, 0]]}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MINIMAL + "objects: [{kind: tree, beside_m: [1, 2]}]", "objects.0.beside_m: is relative to the route, and"),
        (RELATIVE + "objects: [{kind: tree, beside_m: [1, 2, 3]}]", "objects.0.beside_m: must be [along, aside]"),
        (
            RELATIVE + "objects: [{kind: tree, beside_m: [1, 2], at_m: [0, 1]}]",
            "objects.0: give either at_m or beside_m",
        ),
        (
            RELATIVE + "objects: [{kind: tree, besid_m: [1, 2]}]",
            "objects.0.besid_m: unknown key; did you mean 'beside_m'?",
        ),
        (RELATIVE.replace("[10, 0]", "[10, x]"), "route.points_m.1.1: should be a valid number"),
        (
            RELATIVE + "movers: [{kind: person, path: {kind: crossing, along_m: 5}}]",
            "movers.0.path.speed_mps: is missing",
        ),
        (
            RELATIVE + "movers: [{kind: person, path: {kind: crossing, along_m: 5, speed_mps: 1, aftr_m: 2}}]",
            "movers.0.path.aftr_m: unknown key; did you mean 'after_m'?",
        ),
        (
            RELATIVE
            + "movers: [{kind: person, path: {kind: crossing, along_m: 5, speed_mps: 1, early_s: 1, meets_s: 2}}]",
            "movers.0.path: give either meets_s or early_s",
        ),
        (RELATIVE + "movers: [{kind: person, path: {kind: fly}}]", "movers.0.path: kind 'fly' is none of"),
        (
            RELATIVE + "movers: [{repeat: 2, each: {kind: person, path: {kind: line, from_m: [1, 1], to_m: [2, 2]}}}]",
            "movers.0.each.path.speed_mps: is missing (and 1 more)",
        ),
        (
            RELATIVE + "objects: [{repeat: 2, each: {kind: tree, at_m: [4, 4]}, at: 1}]",
            "objects.0: an entry that repeats",
        ),
        (
            RELATIVE + "objects: [{repeat: -1, each: {kind: tree, at_m: [4, 4]}}]",
            "objects.0.repeat: must be a whole number",
        ),
        (
            RELATIVE + "objects: [{repeat: 1.5, each: {kind: tree, at_m: [4, 4]}}]",
            "objects.0.repeat: must be a whole number",
        ),
        (RELATIVE + "terrain: {slope_deg: {uniform: [3, 1]}}", "terrain.slope_deg: uniform takes [lowest, highest]"),
        (RELATIVE + "terrain: {slope_deg: {uniform: [0, .inf]}}", "terrain.slope_deg: uniform takes [lowest, highest]"),
        (
            RELATIVE + "terrain: {slope_deg: {integer: [0, 1.5]}}",
            "terrain.slope_deg: integer takes [lowest, highest], two w",
        ),
        (RELATIVE + "terrain: {kind: {choice: []}}", "terrain.kind: choice takes a list of at least one value"),
        (RELATIVE + "terrain: {slope_deg: {uniform: [-2, -1]}}", "terrain.slope_deg: must be >= 0"),
        (RELATIVE + "seed: {integer: [0, 9]}", "seed: should be a valid integer"),
        (
            RELATIVE + "objects: [{kind: tree, beside_m: [{uniform: [0, 0.5]}, 0]}]",
            "objects.0: no free place in 1000 draws",
        ),
        (RELATIVE + "objects: &a [*a]", "objects.0"),
        (
            "duration_s: 5\nlidar: {kind: spinning}\nroute: {points_m: [[1, 2], [1, 2]], length_m: 9}\n"
            "objects: [{kind: tree, beside_m: [1, 1]}]",
            "route: points_m are all the same place",
        ),
    ],
)
def test_a_mistake_in_a_drawn_scene_gets_one_line_that_names_the_key(text: str, message: str):
    with pytest.raises(UsageError) as raised:
        parse_scenario(text, "s.yaml")
    assert str(raised.value).startswith(f"s.yaml: {message}")
    assert "\n" not in str(raised.value)


def test_a_movers_path_may_also_cross_and_the_message_says_so():
    with pytest.raises(UsageError, match=r"'circle', 'crossing'$"):
        parse_scenario(RELATIVE + "movers: [{kind: person, path: {kind: fly}}]", "s.yaml")


def test_aliases_that_multiply_are_refused():
    bomb = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9))
    with pytest.raises(UsageError, match="holds too many values"):
        parse_scenario(f"a0: &a0 [1]\n{bomb}", "s.yaml")
