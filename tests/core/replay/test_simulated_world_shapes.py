"""What a closed loop can hit: the true outlines of a scene's things, against outlines drawn point by point."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.config import VehicleConfig
from adcbf_cli.core.replay.simulated_world import ROCK_DISCS, SimulatedWorld
from adcbf_cli.core.replay.world import WorldObjects
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.world import World
from adcbf_cli.core.types import NO_ID, FloatArray

SECOND = 1_000_000_000
START_S = 100
BODY_M = VehicleConfig().body_radius_m

MOVERS: list[dict[str, Any]] = [
    {
        "kind": "cylinder",
        "radius_m": 0.4,
        "path": {"kind": "line", "from_m": [-6, -6], "to_m": [-6, 6], "speed_mps": 2},
    },
    {
        "kind": "person",
        "path": {"kind": "line", "from_m": [6, 0], "to_m": [6, 5], "speed_mps": 1, "start_s": 2},
    },
    {"kind": "vehicle", "size_m": [4, 2, 1.5], "path": {"kind": "stand", "at_m": [0, 8], "yaw_deg": 30}},
]
OBJECTS: list[dict[str, Any]] = [
    {"kind": "tree", "at_m": [3, 3], "trunk_radius_m": 0.2},
    {"kind": "rock", "at_m": [0, 0], "size_m": [1.0, 0.6, 0.5], "yaw_deg": 20},
    {"kind": "wall", "from_m": [-3, -4], "to_m": [3, -4], "thickness_m": 0.2},
    {"kind": "rock", "at_m": [-3, 2], "size_m": [0.4, 0.8, 0.5], "yaw_deg": -70},
    {"kind": "box", "at_m": [3, 0], "size_m": [0.8, 0.4, 1.0], "yaw_deg": 45},
]
"""By id: 0 cylinder, 1 person, 2 vehicle, 3 tree, 4 rock, 5 wall, 6 rock, 7 box."""


def worlds(movers: list[dict[str, Any]] = MOVERS, objects: list[dict[str, Any]] = OBJECTS) -> tuple[World, Any]:
    scenario = Scenario.model_validate(
        {
            "duration_s": 10,
            "start_time_s": START_S,
            "terrain": {"size_m": 60},
            "ego": {"path": {"kind": "stand", "at_m": [0, -10]}},
            "lidar": {"kind": "spinning"},
            "movers": movers,
            "objects": objects,
        }
    )
    world = World(scenario, 0)
    return world, SimulatedWorld(world)


def at(time_s: float) -> int:
    return START_S * SECOND + round(time_s * SECOND)


def outline_distance(outline_m: FloatArray, points_m: FloatArray) -> FloatArray:
    """Signed distances of points (k, 2) to a convex outline (n, 2), counter-clockwise and finely sampled."""
    gap = points_m[:, None] - outline_m
    edge = np.roll(outline_m, -1, axis=0) - outline_m
    inside = (edge[:, 0] * gap[..., 1] - edge[:, 1] * gap[..., 0] > 0).all(axis=1)
    return np.where(inside, -1.0, 1.0) * np.hypot(gap[..., 0], gap[..., 1]).min(axis=1)


def turned(shape_m: FloatArray, yaw_deg: float, at_m: list[float]) -> FloatArray:
    c, s = np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg))
    return shape_m @ np.array([[c, s], [-s, c]]) + at_m


def ellipse(length_m: float, width_m: float, yaw_deg: float, at_m: list[float]) -> FloatArray:
    angle = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    return turned(0.5 * np.column_stack([length_m * np.cos(angle), width_m * np.sin(angle)]), yaw_deg, at_m)


def rectangle(length_m: float, width_m: float, yaw_deg: float, at_m: list[float]) -> FloatArray:
    corners = 0.5 * np.array([[-length_m, -width_m], [length_m, -width_m], [length_m, width_m], [-length_m, width_m]])
    share = np.linspace(0, 1, 2000, endpoint=False)[:, None]
    sides = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return turned(np.concatenate(sides), yaw_deg, at_m)


OUTLINES: dict[int, FloatArray] = {
    0: ellipse(0.8, 0.8, 0, [-6, 0]),
    1: rectangle(0.3, 0.5, 90, [6, 1]),
    2: rectangle(4, 2, 30, [0, 8]),
    3: ellipse(0.4, 0.4, 0, [3, 3]),
    5: rectangle(6, 0.2, 0, [0, -4]),
    7: rectangle(0.8, 0.4, 45, [3, 0]),
}
"""Three seconds after the start: the cylinder has gone 6 m, the person, who waited for two seconds, 1 m."""


def around(outline_m: FloatArray, count: int = 150) -> FloatArray:
    low, high = outline_m.min(axis=0) - 0.5, outline_m.max(axis=0) + 0.5
    return np.random.default_rng(1).uniform(low, high, (count, 2))


@pytest.mark.parametrize("thing", sorted(OUTLINES))
def test_surfaces_are_the_outlines(thing: int) -> None:
    _, simulated = worlds()
    points = around(OUTLINES[thing])
    objects = simulated.at(at(3))
    (column,) = np.flatnonzero(objects.id == thing)
    expected = outline_distance(OUTLINES[thing], points)
    assert (expected < 0).any()
    np.testing.assert_allclose(objects.clearance(points, 0.0)[:, column], expected, atol=2e-3)


@pytest.mark.parametrize("length_m", [0.4, 0.6, 0.8, 1.0])
@pytest.mark.parametrize("width_m", [0.4, 0.6, 0.8])
def test_a_rocks_discs_lie_in_its_ellipse_and_leave_little_out(length_m: float, width_m: float) -> None:
    rock = {"kind": "rock", "at_m": [1, -2], "size_m": [length_m, width_m, 0.5], "yaw_deg": 25}
    objects = worlds([], [rock])[1].at(at(0))
    outline = ellipse(length_m, width_m, 25, [1, -2])
    points = around(outline, 300)
    expected = outline_distance(outline, points)
    found = objects.clearance(points, 0.0).min(axis=1)
    outside = expected > 0
    assert (found[outside] >= expected[outside] - 1e-4).all(), "no disc reaches out of the ellipse"
    chord = np.roll(outline, -1, axis=0) - np.roll(outline, 1, axis=0)
    outwards = np.column_stack([chord[:, 1], -chord[:, 0]]) / np.hypot(*chord.T)[:, None]
    touching = objects.clearance(outline + BODY_M * outwards, BODY_M).min(axis=1)
    assert touching.min() > -1e-6
    assert touching.max() < 0.03, "so far a body may reach into the ellipse before it counts"
    assert len(objects) == ROCK_DISCS


def test_a_rocks_corners_are_free() -> None:
    """Where its rectangle has a corner a body of 15 cm stands free; in the middle of its side it would not."""
    _, simulated = worlds()
    corner = turned(np.array([[0.5 + 0.05, 0.3 + 0.05]]), 20, [0, 0])[0]
    side = turned(np.array([[0.0, 0.3 + 0.10]]), 20, [0, 0])[0]
    assert simulated.nearest(corner, 0.15, at(0))[0] > 0
    boxes = simulated.as_boxes(at(0))
    assert boxes.clearance(corner[None], 0.15)[0, boxes.id == 4] < 0
    clearance, thing = simulated.nearest(side, 0.15, at(0))
    assert clearance == pytest.approx(-0.05, abs=1e-6)
    assert thing == 4


def test_every_disc_of_a_rock_is_that_rock() -> None:
    world, simulated = worlds()
    objects = simulated.at(at(0))
    ids = objects.id.tolist()
    assert len(set(ids)) == len(ids) == 8 + 2 * (ROCK_DISCS - 1)
    owners = [simulated.thing_of(thing) for thing in ids]
    assert {thing: owners.count(thing) for thing in range(8)} == {
        thing: ROCK_DISCS if thing in (4, 6) else 1 for thing in range(8)
    }
    truth = world.truth(np.array([at(0)]))
    for row, owner in enumerate(owners):
        box = truth[owner]
        reach = 0.5 * np.hypot(box.length_m, box.width_m)
        assert np.hypot(*(objects.centre_m[row] - (box.x_m[0], box.y_m[0]))) <= reach


def test_the_nearest_is_told_by_the_truths_id_from_any_side() -> None:
    """From around the second rock, which stands alone, it is always the one that is near."""
    _, simulated = worlds()
    angle = np.linspace(0, 2 * np.pi, 24)
    for point in np.column_stack([-3 + 0.8 * np.cos(angle), 2 + 0.8 * np.sin(angle)]):
        assert simulated.nearest(point, 0.1, at(0))[1] == 6


@pytest.mark.parametrize("time_s", [0.0, 1.0, 3.5, 9.0, 20.0])
def test_places_and_velocities_are_those_of_the_truth(time_s: float) -> None:
    world, simulated = worlds()
    truth = world.truth(np.array([at(time_s)]))
    boxes = simulated.as_boxes(at(time_s))
    order = np.argsort(boxes.id)
    np.testing.assert_array_equal(boxes.id[order], np.arange(8))
    np.testing.assert_allclose(boxes.centre_m[order], [(box.x_m[0], box.y_m[0]) for box in truth])
    np.testing.assert_allclose(boxes.velocity_mps[order], [(box.vx_mps[0], box.vy_mps[0]) for box in truth])
    flat = [thing for thing in range(8) if thing not in (0, 3)]
    expected = [(truth[k].length_m, truth[k].width_m, truth[k].yaw_rad[0]) for k in flat]
    found = np.column_stack([boxes.length_m, boxes.width_m, boxes.yaw_rad])[order]
    np.testing.assert_allclose(found[flat], expected)
    assert np.isnan(found[[0, 3]]).all(), "the cylinder and the trunk are circles"
    centre, velocity = simulated.along(np.array([at(0), at(time_s)]))
    np.testing.assert_allclose(centre[:, 1], boxes.centre_m[order])
    np.testing.assert_allclose(velocity[:, 1], boxes.velocity_mps[order])


def test_who_waits_and_who_has_arrived_stands() -> None:
    _, simulated = worlds()
    speed = {time_s: np.hypot(*simulated.at(at(time_s)).velocity_mps[:2].T) for time_s in (1.0, 3.0, 9.0)}
    np.testing.assert_allclose(speed[1.0], [2, 0])
    np.testing.assert_allclose(speed[3.0], [2, 1])
    np.testing.assert_allclose(speed[9.0], [0, 0])


def test_moments_that_are_kept_are_the_right_ones() -> None:
    """Asked for in any order, again and again, as drives side by side do."""
    _, simulated = worlds()
    for time_s in (0, 1, 2, 0, 3, 4, 5, 1, 0, 5):
        assert simulated.at(at(time_s)).centre_m[0, 1] == pytest.approx(-6 + 2 * time_s)


def test_an_empty_world_has_nothing_near() -> None:
    _, simulated = worlds([], [])
    assert len(simulated.at(at(0))) == 0
    assert simulated.nearest(np.zeros(2), 0.3, at(0))[1] == NO_ID


def test_moments_named_before_are_the_same_to_the_bit() -> None:
    world, plain = worlds()
    moments = np.array([at(0.1 * k) for k in range(60)])
    ahead = SimulatedWorld(world, moments)
    for stamp in (*moments.tolist(), at(0.05), at(7.0)):
        one, other = plain.at(stamp), ahead.at(stamp)
        for name in WorldObjects.__dataclass_fields__:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
