"""Ray casting against distances computed by hand; the truth against the meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.simulation import shapes
from adcbf_cli.core.simulation.objects import build_mover, build_static
from adcbf_cli.core.simulation.poses import poses
from adcbf_cli.core.simulation.randomness import Purpose, generator
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.terrain import build_terrain
from adcbf_cli.core.simulation.world import World
from adcbf_cli.core.types import NO_ID, FloatArray

SECOND_NS = 1_000_000_000


def scenario(**changes: Any) -> Scenario:
    values: dict[str, Any] = {
        "duration_s": 10,
        "start_time_s": 100,
        "ego": {"path": {"kind": "stand", "at_m": [0, 0]}},
        "lidar": {"kind": "spinning"},
    }
    return Scenario.model_validate(values | changes)


def cast(world: World, origin: list[float], aims: FloatArray, time_s: float | FloatArray = 0.0, far_m: float = 200.0):
    """One ray a column from one place, at one time or at each column's own."""
    count = len(aims)
    pose = poses(*(np.full(count, value) for value in (*origin, 0.0, 0.0, 0.0)))
    time_ns = world.start_ns + np.round(np.broadcast_to(time_s, count) * SECOND_NS).astype(np.int64)
    return world.cast(time_ns, pose, (aims / np.linalg.norm(aims, axis=1, keepdims=True))[:, None, :], far_m)


def down_cone(count: int = 400) -> FloatArray:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(-1, 1, count), rng.uniform(-1, 1, count), rng.uniform(-1, -0.2, count)])


@pytest.mark.parametrize(("slope_deg", "uphill_deg"), [(0, 0), (6, 0), (12, 250)])
def test_rays_to_a_plane(slope_deg: float, uphill_deg: float):
    """Distance to the plane n . p = 0 from height h along u is -n . o / n . u."""
    world = World(scenario(terrain={"slope_deg": slope_deg, "uphill_deg": uphill_deg, "size_m": 200}), 0)
    aims = down_cone()
    hits = cast(world, [1.0, 2.0, 3.0], aims)
    rise = np.tan(np.deg2rad(slope_deg))
    normal = np.array([-rise * np.cos(np.deg2rad(uphill_deg)), -rise * np.sin(np.deg2rad(uphill_deg)), 1.0])
    unit = aims / np.linalg.norm(aims, axis=1, keepdims=True)
    expected = -(normal @ [1.0, 2.0, 3.0]) / (unit @ normal)
    met = (expected > 0) & (expected < 80)
    assert met.sum() > 300
    np.testing.assert_allclose(hits.range_m[met, 0], expected[met], rtol=1e-6, atol=1e-5)
    assert np.isinf(hits.range_m[expected < 0]).all()
    assert (hits.object_id == NO_ID).all()


def test_rays_to_a_cylinder():
    """Horizontal rays to a circle of radius r at distance d: d cos(a) - sqrt(r^2 - d^2 sin(a)^2)."""
    stand = {"kind": "stand", "at_m": [8.5, 2.0]}
    world = World(scenario(movers=[{"kind": "cylinder", "radius_m": 0.48, "path": stand}]), 0)
    distance, bearing = np.hypot(8.5, 2.0), np.arctan2(2.0, 8.5)
    half = np.arcsin(0.48 / distance)
    angle = np.linspace(-0.98, 0.98, 81) * half
    aims = np.column_stack([np.cos(bearing + angle), np.sin(bearing + angle), 0 * angle])
    hits = cast(world, [0, 0, 0.8], aims)
    expected = distance * np.cos(angle) - np.sqrt(0.48**2 - (distance * np.sin(angle)) ** 2)
    np.testing.assert_allclose(hits.range_m[:, 0], expected, atol=0.003)
    middle = np.abs(angle) < half / 2
    np.testing.assert_allclose(hits.range_m[middle, 0], expected[middle], atol=0.0005)
    assert (hits.object_id == 0).all()


def test_rays_past_a_cylinder_miss():
    stand = {"kind": "stand", "at_m": [8.0, 0.0]}
    world = World(scenario(movers=[{"kind": "cylinder", "radius_m": 0.48, "path": stand}]), 0)
    angle = np.arcsin(0.48 / 8.0) * np.array([-1.01, 1.01, -20, 20])
    hits = cast(world, [0, 0, 0.8], np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]))
    assert np.isinf(hits.range_m).all()
    assert (hits.object_id == NO_ID).all()


def test_rays_to_a_sphere():
    """A crown with equal semi-axes is a sphere of radius 1.5 m around (6, 0, 5)."""
    tree = {"kind": "tree", "at_m": [6, 0], "trunk_height_m": 3.5, "crown_radius_m": 1.5, "crown_height_m": 3.0}
    world = World(scenario(objects=[tree]), 0)
    rng = np.random.default_rng(3)
    spots = rng.normal(size=(300, 3))
    spots = np.array([6.0, 0.0, 5.0]) + 1.2 * spots / np.linalg.norm(spots, axis=1, keepdims=True)
    origin = np.array([-2.0, 1.0, 5.5])
    hits = cast(world, origin.tolist(), spots - origin)
    unit = (spots - origin) / np.linalg.norm(spots - origin, axis=1, keepdims=True)
    offset = origin - [6.0, 0.0, 5.0]
    along = unit @ offset
    expected = -along - np.sqrt(along**2 - offset @ offset + 1.5**2)
    np.testing.assert_allclose(hits.range_m[:, 0], expected, atol=0.03)
    assert np.abs(hits.range_m[:, 0] - expected).mean() < 0.006


def test_the_nearest_thing_is_hit():
    things = [{"kind": "box", "at_m": [x, 0], "size_m": [1, 4, 2]} for x in (9, 5)]
    mover = {"kind": "vehicle", "size_m": [1, 4, 2], "path": {"kind": "stand", "at_m": [7, 0]}}
    world = World(scenario(objects=things, movers=[mover]), 0)
    hits = cast(world, [0, 0, 1], np.array([[1.0, 0, 0], [-1.0, 0, 0]]))
    assert hits.range_m[0, 0] == pytest.approx(4.5, abs=1e-6)
    assert hits.object_id[0, 0] == 2
    behind = cast(world, [6, 0, 1], np.array([[1.0, 0, 0]]))
    assert behind.range_m[0, 0] == pytest.approx(0.5, abs=1e-6)
    assert behind.object_id[0, 0] == 0


def test_the_maximal_range_cuts():
    world = World(scenario(objects=[{"kind": "box", "at_m": [9, 0], "size_m": [1, 4, 2]}]), 0)
    ahead = np.array([[1.0, 0, 0]])
    assert np.isfinite(cast(world, [0, 0, 1], ahead, far_m=8.6).range_m).all()
    assert np.isinf(cast(world, [0, 0, 1], ahead, far_m=8.4).range_m).all()


def test_movers_move_from_column_to_column():
    """A box that comes nearer at 2 m/s is met where it is at each column's own time."""
    path = {"kind": "line", "from_m": [20, 0], "to_m": [2, 0], "speed_mps": 2.0}
    world = World(scenario(movers=[{"kind": "vehicle", "size_m": [4, 2, 2], "path": path}]), 0)
    time_s = np.linspace(0, 5, 51)
    hits = cast(world, [0, 0, 1], np.tile([1.0, 0, 0], (51, 1)), time_s)
    np.testing.assert_allclose(hits.range_m[:, 0], 18 - 2 * time_s, atol=1e-6)


def test_legs_swing_only_while_walking():
    def leg_angles(speed: float) -> FloatArray:
        path = {"kind": "line", "from_m": [0, 0], "to_m": [20, 0], "speed_mps": speed, "start_s": 2.0}
        spec = scenario(movers=[{"kind": "person", "path": path}]).movers[0]
        ground = build_terrain(scenario().terrain, generator(0, Purpose.TERRAIN))
        body, left, right = build_mover(spec, ground).world_from_part(np.linspace(0, 5, 101))
        assert np.allclose(body[:, 2, 2], 1.0)
        np.testing.assert_allclose(left[:, 0, 2], -right[:, 0, 2], atol=1e-12)
        return np.arcsin(left[:, 0, 2])

    walking = leg_angles(1.4)
    np.testing.assert_allclose(walking[:40], 0.0, atol=1e-12)
    assert np.abs(walking).max() == pytest.approx(0.4, abs=0.01)
    crossings = np.count_nonzero(np.diff(np.sign(walking[41:])) != 0)
    assert crossings in (5, 6)


STATIC = [
    {"kind": "tree", "at_m": [3, 4], "trunk_radius_m": 0.2},
    {"kind": "rock", "at_m": [-3, 4], "size_m": [1.2, 0.7, 0.5], "yaw_deg": 30},
    {"kind": "wall", "from_m": [-5, -6], "to_m": [4, -3], "height_m": 1.7, "thickness_m": 0.3},
    {"kind": "box", "at_m": [6, 0], "size_m": [2.0, 1.0, 0.8], "yaw_deg": -50},
]


@pytest.mark.parametrize("spec", STATIC, ids=lambda spec: spec["kind"])
def test_static_truth_is_the_meshs_box_above_ground(spec: dict[str, Any]):
    """On flat ground, the mesh turned into its truth's axes spans the truth's length, width and height."""
    ground = build_terrain(scenario().terrain, generator(0, Purpose.TERRAIN))
    thing = build_static(scenario(objects=[spec]).objects[0], ground, generator(5, Purpose.SHAPES))
    mesh = thing.mesh.vertices_m
    if spec["kind"] == "tree":
        mesh = mesh[mesh[:, 2] < 0.5]  # the box is the trunk's
    cos, sin = np.cos(thing.yaw_rad), np.sin(thing.yaw_rad)
    local = (mesh[:, :2] - thing.centre_m[:2]) @ np.array([[cos, -sin], [sin, cos]])
    shown = local if spec["kind"] != "rock" else local[mesh[:, 2] >= 0]
    np.testing.assert_allclose(shown.max(axis=0), np.array(thing.size_m[:2]) / 2, atol=1e-3)
    np.testing.assert_allclose(shown.min(axis=0), -np.array(thing.size_m[:2]) / 2, atol=1e-3)
    assert thing.centre_m[2] == pytest.approx(thing.size_m[2] / 2)
    assert thing.mesh.vertices_m[:, 2].max() == pytest.approx(thing.size_m[2], abs=2e-6)


@pytest.mark.parametrize("kind", ["person", "vehicle", "cylinder"])
def test_mover_truth_is_where_its_mesh_is(kind: str):
    path = {"kind": "line", "from_m": [2, 1], "to_m": [-9, 9], "speed_mps": 1.0, "start_s": 5.0}
    spec = scenario(movers=[{"kind": kind, "path": path}]).movers[0]
    ground = build_terrain(scenario().terrain, generator(0, Purpose.TERRAIN))
    mover = build_mover(spec, ground)
    truth = mover.truth(np.array([0.0]))
    world = np.concatenate(
        [
            part.mesh.vertices_m @ pose[0, :3, :3].T + pose[0, :3, 3]
            for part, pose in zip(mover.parts, mover.world_from_part(np.array([0.0])), strict=True)
        ]
    )
    cos, sin = np.cos(truth.yaw_rad[0]), np.sin(truth.yaw_rad[0])
    local = (world[:, :2] - [truth.x_m[0], truth.y_m[0]]) @ np.array([[cos, -sin], [sin, cos]])
    np.testing.assert_allclose(np.ptp(local, axis=0), [truth.length_m, truth.width_m], atol=2e-3)
    np.testing.assert_allclose(local.max(axis=0) + local.min(axis=0), 0, atol=2e-3)
    assert world[:, 2].max() == pytest.approx(truth.height_m, abs=1e-3)
    assert truth.z_m[0] == pytest.approx(truth.height_m / 2, abs=1e-6)


@pytest.mark.parametrize(
    "mesh",
    [
        shapes.box(2, 1, 0, 1),
        shapes.cylinder(0.5, 0, 2),
        shapes.capsule(0.2, 0, 1.5, depth_ratio=0.6),
        shapes.ellipsoid((1, 2, 3), (0, 0, 1)),
        shapes.rock((1.0, 0.6, 0.4), np.random.default_rng(1)),
    ],
    ids=["box", "cylinder", "capsule", "ellipsoid", "rock"],
)
def test_meshes_are_closed_and_face_outwards(mesh: shapes.Mesh):
    """Each edge is shared by two triangles that run along it in opposite directions; volume is positive."""
    edges = np.concatenate([mesh.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    forth = {tuple(edge) for edge in edges.tolist()}
    assert len(forth) == len(edges)
    assert forth == {(b, a) for a, b in forth}
    corners = mesh.vertices_m[mesh.triangles]
    assert np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() > 0


def test_a_cylinders_volume_is_right():
    mesh = shapes.cylinder(0.48, -0.5, 1.5)
    corners = mesh.vertices_m[mesh.triangles]
    volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(np.pi * 0.48**2 * 2, rel=1e-3)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"ego": {"path": {"kind": "stand", "at_m": [60, 0]}}}, "ego.path"),
        (
            {
                "movers": [
                    {
                        "kind": "person",
                        "path": {"kind": "line", "from_m": [45, 0], "to_m": [80, 0], "speed_mps": 2},
                    }
                ]
            },
            "movers.0.path",
        ),
        ({"objects": [{"kind": "wall", "from_m": [0, 5], "to_m": [0, 70]}]}, "objects.0"),
        ({"route": {"points_m": [[0, 0], [60, 0]]}}, "route"),
    ],
)
def test_what_leaves_the_terrain_is_refused(changes: dict[str, Any], key: str):
    with pytest.raises(UsageError, match=key):
        World(scenario(**changes), 0)
