"""Random values, places beside the route and movers over it: against hand-computed places, and as
properties that hold for every seed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.simulation.drawing import Drawing
from adcbf_cli.core.simulation.footprints import Footprint, footprint, mover_radius_m
from adcbf_cli.core.simulation.parsing import parse_scenario, scenario_yaml
from adcbf_cli.core.simulation.paths import beside, motion_along, route_points
from adcbf_cli.core.simulation.scenario import Cylinder, LinePath, Scenario, StandPath, Tree, Wall
from adcbf_cli.io.scenarios import read_scenario, scenario_names

LIDAR = "lidar: {kind: spinning}\n"
STRAIGHT = "duration_s: 20\nroute: {points_m: [[0, 0], [10, 0]]}\n" + LIDAR
NORTHWARD = "duration_s: 20\nroute: {points_m: [[2, 1], [2, 11]]}\n" + LIDAR
SEEDS = range(200_000, 200_020)


def one_mover(path: str, base: str = STRAIGHT) -> LinePath | StandPath:
    scenario = parse_scenario(base + f"movers: [{{kind: cylinder, radius_m: 0.3, path: {{kind: crossing, {path}}}}}]")
    found = scenario.movers[0].path
    assert isinstance(found, LinePath | StandPath)
    return found


# --- values ---------------------------------------------------------------------------------------


def draws(node: object, count: int = 3000) -> list[object]:
    return [Drawing(seed).value(node, ("a",)) for seed in range(200_000, 200_000 + count)]


def test_uniform_fills_its_range_evenly():
    values = np.array(draws({"uniform": [-1, 3]}), dtype=float)
    assert values.min() >= -1
    assert values.max() <= 3
    counts = np.histogram(values, bins=8, range=(-1, 3))[0]
    assert np.abs(counts - 375).max() < 5 * np.sqrt(375)


def test_integer_includes_both_ends_and_choice_everything():
    values, counts = np.unique(np.array(draws({"integer": [2, 5]}), dtype=int), return_counts=True)
    assert values.tolist() == [2, 3, 4, 5]
    assert np.abs(counts - 750).max() < 5 * np.sqrt(750)
    assert set(map(str, draws({"choice": ["a", {"b": 1}]}, 50))) == {"a", "{'b': 1}"}


def test_values_at_different_places_are_independent():
    node = [{"uniform": [0, 1]}, {"uniform": [0, 1]}]
    pairs = np.array([Drawing(seed).value(node, ("a",)) for seed in range(200_000, 202_000)])
    assert abs(np.corrcoef(pairs.T)[0, 1]) < 0.1
    repeated = np.array(
        [[Drawing(7).value(node, ("a",), copy, attempt) for copy in range(20)] for attempt in range(20)]
    )
    assert len(np.unique(repeated)) == repeated.size


def test_a_scene_is_the_same_in_every_version():
    """Published figures name seeds: what a seed draws must never change."""
    node = {"x": {"uniform": [0, 1]}, "n": {"integer": [0, 1000]}, "c": {"choice": ["a", "b", "c"]}}
    assert Drawing(3).value(node, ("terrain",)) == PINNED


PINNED = {"x": 0.2702345, "n": 679, "c": "c"}


def test_one_change_leaves_the_other_values_as_they_were():
    before = {"a": {"uniform": [0, 1]}, "b": [{"integer": [0, 100]}, {"uniform": [0, 9]}]}
    after = {"new": {"uniform": [0, 1]}, "b": [{"integer": [0, 100]}, 4], "a": {"uniform": [0, 1]}}
    old, new = Drawing(5).value(before, ()), Drawing(5).value(after, ())
    assert (new["a"], new["b"][0]) == (old["a"], old["b"][0])
    assert new["b"][1] == 4


def test_more_copies_leave_the_first_ones_where_they_are():
    text = STRAIGHT + "objects: [{repeat: %d, each: {kind: tree, beside_m: [{uniform: [0, 9]}, {uniform: [2, 9]}]}}]"
    few, many = (parse_scenario(text % count, seed=1).objects for count in (3, 6))
    assert len(many) == 6
    assert many[:3] == few
    assert len({tree.at_m for tree in many}) == 6


def test_only_the_choice_that_is_taken_is_drawn():
    node = {"choice": [{"uniform": [0, 1]}, {"uniform": [1, 0]}]}  # the second one is no range
    first = next(seed for seed in SEEDS if Drawing(seed).value({"choice": [0, 1]}, ("a",)) == 0)
    second = next(seed for seed in SEEDS if Drawing(seed).value({"choice": [0, 1]}, ("a",)) == 1)
    assert 0 <= Drawing(first).value(node, ("a",)) <= 1
    with pytest.raises(UsageError, match=r"^a\.choice\.1: uniform takes"):
        Drawing(second).value(node, ("a",))


# --- scenarios ------------------------------------------------------------------------------------


def test_a_scenario_without_random_values_is_the_same_for_every_seed():
    text = (Path(__file__).parents[3] / "sample_data" / "scenario.yaml").read_text(encoding="utf-8")
    plain = Scenario.model_validate(yaml.safe_load(text))
    assert parse_scenario(text) == plain
    assert parse_scenario(text, seed=9) == plain.model_copy(update={"seed": 9})


@pytest.mark.parametrize("name", scenario_names())
def test_a_drawn_scene_is_written_and_read_back(name: str):
    text, _ = read_scenario(name)
    scenes = [parse_scenario(text, name, seed) for seed in SEEDS[:3]]
    assert scenes[0] == parse_scenario(text, name, SEEDS[0])
    assert len({scenario_yaml(scene) for scene in scenes}) == 3
    for seed, scene in zip(SEEDS, scenes, strict=False):
        written = scenario_yaml(scene)
        assert scene.seed == seed
        assert not Drawing(0).varies(yaml.safe_load(written), ())
        assert parse_scenario(written) == scene


def test_the_files_own_seed_is_the_default():
    text = STRAIGHT + "seed: 4\nterrain: {slope_deg: {uniform: [0, 5]}}\n"
    assert parse_scenario(text) == parse_scenario(text, seed=4)
    assert parse_scenario(text) != parse_scenario(text, seed=0)


# --- the route ------------------------------------------------------------------------------------


def test_places_beside_a_bent_route():
    way = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 0.0], [4.0, 3.0]])
    for along, aside, point, ahead in [
        (1.0, 0.5, (1.0, 0.5), (1, 0)),
        (5.0, 0.5, (3.5, 1.0), (0, 1)),
        (9.0, -1.0, (5.0, 5.0), (0, 1)),
        (-2.0, 0.0, (-2.0, 0.0), (1, 0)),
    ]:
        at, direction = beside(way, along, aside)
        np.testing.assert_allclose(at, point, atol=1e-12)
        np.testing.assert_allclose(direction, ahead, atol=1e-12)


def test_an_object_beside_the_route_lies_to_its_left():
    scenario = parse_scenario(NORTHWARD + "objects: [{kind: tree, beside_m: [4, 1.5], trunk_radius_m: 0.3}]")
    assert scenario.objects[0] == Tree(kind="tree", at_m=(0.5, 5.0), trunk_radius_m=0.3)


def test_a_crossing_meets_the_ego():
    line = one_mover("along_m: 6, speed_mps: 0.5, before_m: 2, after_m: 3")  # the ego is there after 8 s
    assert line == LinePath(kind="line", from_m=(6, -2), to_m=(6, 3), speed_mps=0.5, start_s=4.0)
    early = one_mover("along_m: 6, speed_mps: 0.5, before_m: 2, after_m: 3, early_s: 1.5")
    assert early == line.model_copy(update={"start_s": 2.5})
    timed = one_mover("along_m: 6, speed_mps: 0.5, before_m: 2, after_m: 3, meets_s: 9")
    assert timed == line.model_copy(update={"start_s": 5.0})


@pytest.mark.parametrize(
    ("angle", "start", "end"),
    [(90, (4, 6), (-1, 6)), (-90, (0, 6), (5, 6)), (180, (2, 8), (2, 3)), (0, (2, 4), (2, 9))],
)
def test_a_crossings_angle_is_from_the_routes_direction(angle: int, start: tuple[int, int], end: tuple[int, int]):
    line = one_mover(f"along_m: 5, angle_deg: {angle}, speed_mps: 1, before_m: 2, after_m: 3", NORTHWARD)
    assert isinstance(line, LinePath)
    np.testing.assert_allclose([line.from_m, line.to_m], [start, end], atol=1e-6)


def test_a_crossing_that_began_before_the_scenario_is_on_its_way():
    line = one_mover("along_m: 6, speed_mps: 0.5, before_m: 10, after_m: 3")
    assert line == LinePath(kind="line", from_m=(6, -4), to_m=(6, 3), speed_mps=0.5, start_s=0)
    past = one_mover("along_m: 6, speed_mps: 0.5, before_m: 10, after_m: 3, early_s: 10")
    assert past == LinePath(kind="line", from_m=(6, 1), to_m=(6, 3), speed_mps=0.5, start_s=0)
    gone = one_mover("along_m: 6, speed_mps: 0.5, before_m: 10, after_m: 3, early_s: 14")
    assert gone == StandPath(kind="stand", at_m=(6, 3), yaw_deg=90)


@settings(max_examples=60, deadline=None)
@given(
    along=st.floats(0, 30), angle=st.floats(-180, 180), speed=st.floats(0.1, 2), early=st.floats(-5, 5),
    before=st.floats(0.5, 20), after=st.floats(0.5, 20),
)  # fmt: skip
def test_every_crossing_is_on_the_route_at_its_time(
    along: float, angle: float, speed: float, early: float, before: float, after: float
):
    meets = along / 0.75 - early
    if meets < 0:
        return
    text = f"along_m: {along}, angle_deg: {angle}, speed_mps: {speed}, early_s: {early}"
    bent = STRAIGHT.replace("[10, 0]]", "[10, 0], [20, 15]], smooth: true")
    path = one_mover(f"{text}, before_m: {before}, after_m: {after}", bent)
    scenario = parse_scenario(bent)
    assert scenario.route is not None
    point, ahead = beside(route_points(scenario.route), along)
    motion = motion_along(path, np.array([meets, meets + after / speed / 2]))
    np.testing.assert_allclose([motion.x_m[0], motion.y_m[0]], point, atol=1e-5)
    direction = np.arctan2(motion.y_m[1] - motion.y_m[0], motion.x_m[1] - motion.x_m[0])
    expected = np.arctan2(ahead[1], ahead[0]) + np.deg2rad(angle)
    assert np.cos(direction - expected) == pytest.approx(1, abs=1e-6)


# --- what is kept free ----------------------------------------------------------------------------


def test_what_is_random_keeps_clear_of_start_and_goal():
    text = STRAIGHT.replace("]]}", "]], keep_free_m: 3}") + (
        "objects: [{repeat: 5, each: {kind: box, size_m: [1, 0.4, 1], yaw_deg: {uniform: [0, 90]},"
        " beside_m: [{uniform: [-1, 11]}, 0]}}]\n"
        "movers: [{repeat: 5, each: {kind: cylinder, radius_m: 0.4,"
        " path: {kind: stand, at_m: [{uniform: [0, 10]}, {uniform: [-2, 2]}]}}}]\n"
    )
    for seed in SEEDS[:5]:
        scenario = parse_scenario(text, seed=seed)
        for thing in scenario.objects:
            assert footprint(thing).distance_m(np.array([[0.0, 0.0], [10.0, 0.0]])).min() >= 3
        for mover in scenario.movers:
            assert isinstance(mover.path, StandPath)
            assert min(np.hypot(*mover.path.at_m), np.hypot(mover.path.at_m[0] - 10, mover.path.at_m[1])) >= 3.4


def test_what_is_not_random_stays_where_the_file_says():
    text = STRAIGHT + "objects: [{kind: tree, at_m: [0.1, 0]}, {kind: tree, at_m: [0.2, 0]}]\n"
    assert [thing.at_m for thing in parse_scenario(text, seed=2).objects] == [(0.1, 0.0), (0.2, 0.0)]


def test_what_is_random_goes_around_what_is_not_wherever_that_is_listed():
    text = STRAIGHT.replace("]]}", "]], passage_m: 1}") + (
        "objects:\n- {kind: tree, at_m: [{uniform: [3, 7]}, 3], trunk_radius_m: 0.2}\n"
        "- {kind: tree, at_m: [5, 3], trunk_radius_m: 0.2}\n"
    )
    for seed in SEEDS:
        drawn, fixed = parse_scenario(text, seed=seed).objects
        assert isinstance(drawn, Tree)
        assert fixed == Tree(kind="tree", at_m=(5.0, 3.0), trunk_radius_m=0.2)
        assert abs(drawn.at_m[0] - 5) >= 1.4


def test_a_random_object_stands_in_no_fixed_movers_way():
    mover = (
        "movers: [{kind: cylinder, radius_m: 0.3, path: {kind: line, from_m: [5, -5], to_m: [5, 5], speed_mps: 1}}]\n"
    )
    for seed in SEEDS:
        text = STRAIGHT + mover + "objects: [{kind: tree, at_m: [{uniform: [4, 6]}, 2], trunk_radius_m: 0.2}]"
        (tree,) = parse_scenario(text, seed=seed).objects
        assert isinstance(tree, Tree)
        assert abs(tree.at_m[0] - 5) >= 0.49


def test_nothing_random_starts_at_a_scripted_ego():
    ego = "duration_s: 1\nego: {path: {kind: line, from_m: [1, 1], to_m: [5, 1], speed_mps: 1}}\n" + LIDAR
    for seed in SEEDS:
        (tree,) = parse_scenario(ego + "objects: [{kind: tree, at_m: [{uniform: [0, 2]}, 1]}]", seed=seed).objects
        assert isinstance(tree, Tree)
        assert abs(tree.at_m[0] - 1) >= 0.65


def test_a_random_mover_walks_through_nothing():
    wall = "objects: [{kind: wall, from_m: [2, 2], to_m: [8, 2]}]\n"
    mover = (
        "{kind: cylinder, radius_m: 0.3, path: {kind: line, from_m: [{uniform: [1, 9]}, 4],"
        " to_m: [{uniform: [1, 9]}, -4], speed_mps: 1}}"
    )
    for seed in SEEDS[:5]:
        scenario = parse_scenario(STRAIGHT + wall + f"movers: [{mover}, {mover}]", seed=seed)
        tracks = [motion_along(one.path, np.arange(0, 20, 0.1)) for one in scenario.movers]
        for track in tracks:
            points = np.column_stack([track.x_m, track.y_m])
            assert footprint(scenario.objects[0]).distance_m(points).min() >= 0.3 - 1e-3
        gap = np.hypot(tracks[0].x_m - tracks[1].x_m, tracks[0].y_m - tracks[1].y_m)
        assert gap.min() >= 0.6 - 1e-3


def test_the_distance_from_a_footprint():
    turned = Footprint(np.array([1.0, 2.0]), np.deg2rad(90), np.array([2.0, 0.5]), 0.0)  # 1 wide in x, 4 long in y
    points = np.array([[1.0, 3.9], [2.5, 2.0], [1.0, 5.0], [2.5, 6.0]])
    np.testing.assert_allclose(turned.distance_m(points), [0, 1, 1, np.hypot(1, 2)], atol=1e-12)
    disc = footprint(Tree(kind="tree", at_m=(3.0, 2.0), trunk_radius_m=0.5))
    assert turned.leaves(0.999, disc)
    assert not turned.leaves(1.001, disc)
    across = footprint(Wall(kind="wall", from_m=(-3, 2), to_m=(6, 2.01)))
    assert not turned.leaves(0.01, across)


# --- the scenarios that come with the package -----------------------------------------------------


@pytest.mark.parametrize("name", scenario_names())
def test_packaged_scenes_are_fair(name: str):
    """Every gap between two standing things lets a disc of 0.5 m radius through, nothing stands or starts near
    the start or blocks the goal, and everything stays on the ground."""
    text, _ = read_scenario(name)
    for seed in SEEDS:
        scene = parse_scenario(text, name, seed)
        assert scene.route is not None
        way = route_points(scene.route)
        shapes = [footprint(thing) for thing in scene.objects]
        for index, shape in enumerate(shapes):
            assert shape.distance_m(way[[0, -1]]).min() >= 1.5
            assert all(shape.leaves(1.0, other) for other in shapes[:index])
        edge = scene.terrain.size_m / 2
        for mover in scene.movers:
            motion = motion_along(mover.path, np.linspace(0, scene.duration_s, 500))
            track = np.column_stack([motion.x_m, motion.y_m])
            assert np.abs(track - scene.terrain.centre_m).max() < edge - mover_radius_m(mover)
            assert np.hypot(*(track[0] - way[0])) >= 1.5 + mover_radius_m(mover)
            assert np.hypot(*(track[-1] - way[-1])) >= 1.5 + mover_radius_m(mover)


def test_the_papers_world_has_the_papers_path():
    text, _ = read_scenario("unstructured")
    for seed in SEEDS[:3]:
        scene = parse_scenario(text, seed=seed)
        assert scene.route is not None
        steps = np.diff(route_points(scene.route), axis=0)
        assert np.hypot(steps[:, 0], steps[:, 1]).sum() == pytest.approx(35.869, abs=1e-9)
        heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        assert np.abs(np.diff(heading)).max() < 0.02  # smooth
        assert scene.terrain.kind == "bumps"
        assert scene.lidar.rate_hz == 10


def test_the_monte_carlo_scenes_differ_as_they_should():
    text, _ = read_scenario("crossings")
    scenes = [parse_scenario(text, seed=seed) for seed in range(200_000, 200_060)]
    assert {len(scene.movers) for scene in scenes} == {1, 2, 3, 4, 5}
    assert {len(scene.objects) for scene in scenes} == {0, 1, 2, 3, 4, 5, 6}
    assert {mover.kind for scene in scenes for mover in scene.movers} == {"person", "cylinder"}
    lines = [mover.path for scene in scenes for mover in scene.movers if isinstance(mover.path, LinePath)]
    speeds = np.array([line.speed_mps for line in lines])
    assert 0.2 <= speeds.min() < 0.4
    assert 1.3 < speeds.max() <= 1.5
    headings = np.array([np.arctan2(b.to_m[1] - b.from_m[1], b.to_m[0] - b.from_m[0]) for b in lines])
    assert (np.histogram(headings, bins=8, range=(-np.pi, np.pi))[0] > 5).all()
    radii = [mover.radius_m for scene in scenes for mover in scene.movers if isinstance(mover, Cylinder)]
    assert 0.2 <= min(radii) < max(radii) <= 0.5
