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


def test_the_documented_example_is_valid():
    page = (Path(__file__).parents[3] / "docs" / "scenarios.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert parse_scenario(example).movers[0].kind == "person"
