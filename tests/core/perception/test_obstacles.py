"""Obstacle parameters and the splitting of over-long clusters."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from adcbf_cli.core.config import PerceptionConfig
from adcbf_cli.core.perception.grid import occupied_cells
from adcbf_cli.core.perception.obstacles import Shapes, split_over_long
from adcbf_cli.core.types import NO_ID

CONFIG = PerceptionConfig()


def obstacles(points: np.ndarray, config: PerceptionConfig = CONFIG) -> tuple[Shapes, np.ndarray, np.ndarray]:
    """One cluster of all points: shapes, each point's final group, and each group's origin."""
    cells = occupied_cells(points[:, :2], 0.1)
    group = np.zeros(len(cells), dtype=np.int64)
    shapes, cell_group, origin = split_over_long(points, cells.point_cell, cells.mean_m, group, config)
    return shapes, cell_group[cells.point_cell], origin


def polyline(*corners: tuple[float, float], step: float = 0.03) -> np.ndarray:
    pieces = []
    for begin, end in itertools.pairwise(corners):
        length = np.hypot(end[0] - begin[0], end[1] - begin[1])
        share = np.linspace(0.0, 1.0, int(length / step) + 1)[:, None]
        pieces.append(np.array(begin) + share * (np.array(end) - np.array(begin)))
    xy = np.concatenate(pieces)
    return np.column_stack([xy, np.linspace(0.0, 1.0, len(xy))])


def filled(length: float, width: float) -> np.ndarray:
    x, y = np.meshgrid(np.arange(-length / 2, length / 2, 0.05), np.arange(-width / 2, width / 2, 0.05))
    return np.column_stack([x.ravel() + 8.0, y.ravel(), np.zeros(x.size)])


WALLS = {
    "straight": polyline((3.0, -4.0), (3.0, 4.0)),
    "short and thin": polyline((3.0, -1.5), (3.0, 1.5)),
    "L": polyline((3.0, -4.0), (3.0, 4.0), (-3.0, 4.0)),
    "U": polyline((3.0, -4.0), (3.0, 4.0), (-3.0, 4.0), (-3.0, -4.0)),
    "zigzag": polyline((2.0, -4.0), (3.0, -2.0), (2.0, 0.0), (3.0, 2.0), (2.0, 4.0)),
    "bank": filled(9.0, 3.0),
}


@pytest.mark.parametrize("name", list(WALLS))
@pytest.mark.parametrize("max_radius", [0.4, 1.0])
def test_walls_become_small_circles_that_cover_them(name: str, max_radius: float) -> None:
    points = WALLS[name]
    config = PerceptionConfig(max_radius_m=max_radius)
    shapes, group, origin = obstacles(points, config)
    assert len(origin) > 1
    assert (origin == 0).all()
    assert (shapes.radius_m <= max_radius).all()
    assert (group != NO_ID).all()
    away = np.hypot(*(points[:, :2] - shapes.centre_m[group, :2]).T)
    assert (away <= shapes.radius_m[group] + 1e-9).all()
    assert set(group.tolist()) == set(range(len(origin)))


def test_a_straight_wall_is_not_cut_more_often_than_needed() -> None:
    shapes, _, _ = obstacles(WALLS["straight"])
    assert 4 <= len(shapes.radius_m) <= 5
    assert (shapes.width_m < 0.01).all()


@pytest.mark.parametrize(("length", "width"), [(4.4, 1.8), (5.5, 2.0), (1.8, 0.6), (3.0, 3.0)])
def test_cars_and_groups_stay_whole(length: float, width: float) -> None:
    shapes, _, origin = obstacles(filled(length, width))
    np.testing.assert_array_equal(origin, [NO_ID])
    np.testing.assert_allclose(shapes.centre_m[0, :2], [8.0, 0.0], atol=0.05)
    assert shapes.radius_m[0] == pytest.approx(np.hypot(length, width) / 2, abs=0.06)


def seen_cylinder(x: float, y: float, radius: float, noise: float, rng: np.random.Generator) -> np.ndarray:
    """200 points on the half that faces the sensor."""
    facing = np.arctan2(-y, -x)
    angle = facing + np.arcsin(rng.uniform(-0.97, 0.97, 200))
    away = radius + rng.normal(0.0, noise, 200)
    return np.column_stack([x + away * np.cos(angle), y + away * np.sin(angle), rng.uniform(-0.3, 0.6, 200)])


@pytest.mark.parametrize("radius", [0.15, 0.48, 0.8])
def test_a_cylinders_centre_is_where_it_is(radius: float) -> None:
    rng = np.random.default_rng(0)
    errors, mean_errors = [], []
    for _ in range(30):
        points = seen_cylinder(5.0, 2.0, radius, 0.02, rng)
        shapes, _, _ = obstacles(points)
        errors.append(shapes.centre_m[0, :2] - [5.0, 2.0])
        mean = obstacles(points, PerceptionConfig(centre="mean"))[0]
        mean_errors.append(mean.centre_m[0, :2] - [5.0, 2.0])
        assert radius - 0.01 <= shapes.radius_m[0] <= radius + 0.1
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.012
    towards_sensor = -np.mean(mean_errors, axis=0) @ [5.0, 2.0] / np.hypot(5.0, 2.0)
    assert towards_sensor == pytest.approx(0.75 * radius, rel=0.15)


def test_a_corner_of_a_big_box_is_no_circle() -> None:
    rng = np.random.default_rng(1)
    corner = polyline((4.0, 2.0), (4.0, 0.0), (6.0, 0.0)) + rng.normal(0.0, 0.01, 3)
    shapes, _, _ = obstacles(corner)
    np.testing.assert_allclose(shapes.centre_m[0, :2], [5.0, 1.0], atol=0.06)


def test_a_hollow_corner_is_no_circle_around_the_robot() -> None:
    """A quarter of a round wall, seen from inside: its centre must not be placed at the sensor."""
    angle = np.linspace(-1.0, 1.0, 100)
    points = np.column_stack([0.9 * np.cos(angle), 0.9 * np.sin(angle), np.zeros(100)])
    shapes, _, _ = obstacles(points)
    assert np.hypot(*shapes.centre_m[0, :2]) > 0.5


@pytest.mark.parametrize("turn", [0.0, 1.0, 2.5, -2.0])
def test_the_corner_of_a_room_is_split_and_the_corner_of_a_car_is_not(turn: float) -> None:
    """The same two sides, seen from inside (beams passed where a circle's centre would be) and from outside."""
    inside = polyline((2.0, 3.0), (5.0, 3.0), (5.0, 0.0))
    outside = polyline((5.0, 3.0), (5.0, 0.0), (8.0, 0.0))
    rotate = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    shapes, _, origin = obstacles(inside @ rotate)
    assert len(origin) > 1
    assert shapes.radius_m.max() <= CONFIG.max_radius_m
    assert len(obstacles(outside @ rotate)[2]) == 1


def test_no_obstacle_holds_the_sensor() -> None:
    shapes, _, _ = obstacles(polyline((-1.5, 1.0), (1.5, 1.0), (1.5, -1.5)))
    assert (np.hypot(*shapes.centre_m[:, :2].T) > shapes.radius_m - 0.1).all()


def test_height_and_rectangle_by_hand() -> None:
    points = polyline((2.0, 0.0), (2.0, 1.0), (2.5, 1.0), (2.5, 0.0), (2.0, 0.0), step=0.05)
    points[:, 2] = np.linspace(-0.4, 0.8, len(points))
    shapes, _, _ = obstacles(points)
    assert shapes.height_m[0] == pytest.approx(1.2)
    np.testing.assert_allclose(shapes.centre_m[0], [2.25, 0.5, 0.2])
    np.testing.assert_allclose([shapes.length_m[0], shapes.width_m[0]], [1.0, 0.5])
    assert shapes.yaw_rad[0] == pytest.approx(np.pi / 2)
    assert shapes.radius_m[0] == pytest.approx(np.hypot(0.25, 0.5))


@pytest.mark.parametrize("points", [np.zeros((1, 3)), np.zeros((30, 3)), np.full((9, 3), 4.0)])
def test_points_without_extent(points: np.ndarray) -> None:
    shapes, group, origin = obstacles(points)
    np.testing.assert_array_equal(group, 0)
    np.testing.assert_array_equal(origin, [NO_ID])
    np.testing.assert_allclose(shapes.radius_m, 0.0, atol=1e-12)
    np.testing.assert_allclose(shapes.centre_m[0], points[0], atol=1e-12)
    assert np.isfinite(shapes.yaw_rad).all()


def test_a_limit_below_the_cell_ends_at_single_cells() -> None:
    shapes, group, _ = obstacles(WALLS["short and thin"], PerceptionConfig(max_radius_m=0.01))
    assert (shapes.radius_m <= 0.08).all()
    assert (group != NO_ID).all()
