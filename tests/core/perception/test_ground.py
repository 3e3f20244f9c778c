"""Ground removal on level, sloping and rough ground, for low and high sensors."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.config import PerceptionConfig
from adcbf_cli.core.perception.ground import GroundRemoval, coarse_plane
from adcbf_cli.core.types import Notes
from tests.core.perception import lidar_scenes as scenes

LIDAR = scenes.Lidar()


def removal(**settings: object) -> GroundRemoval:
    return GroundRemoval(PerceptionConfig.model_validate({"range_m": 10.0, **settings}), Notes())


def rough(points: np.ndarray, amplitude_m: float) -> np.ndarray:
    """Move points up and down by a wavy surface: bumps of about 2 m across."""
    wave = np.sin(2.9 * points[:, 0]) * np.sin(2.3 * points[:, 1] + 0.7)
    moved = points.copy()
    moved[:, 2] += amplitude_m * wave
    return moved


def kept(heights: np.ndarray) -> np.ndarray:
    return heights > -np.inf


@pytest.mark.parametrize("height_m", [0.35, 0.6, 1.73])
@pytest.mark.parametrize("slope_deg", [0.0, 10.0, 20.0])
@pytest.mark.parametrize("method", ["patchwork", "plane"])
def test_slopes_are_ground_and_posts_on_them_are_not(height_m: float, slope_deg: float, method: str) -> None:
    rng = np.random.default_rng(3)
    slope = np.tan(np.radians(slope_deg))
    surfaces = [scenes.plane(height_m, slope_x=slope)]
    posts = [(3.0, 0.5), (-3.0, -1.0), (0.0, 5.0), (7.0, -2.0)]
    for x, y in posts:
        foot = slope * x - height_m
        surfaces.append(scenes.cylinder(x, y, 0.2, foot, foot + 1.2))
    points = LIDAR.scan(surfaces, rng)
    near = np.hypot(points[:, 0], points[:, 1]) < 15.0
    points = points[near]
    above = points[:, 2] - (slope * points[:, 0] - height_m)
    on_ground = above < 0.1
    high = above > 0.3
    assert on_ground.sum() > 500
    assert high.sum() > 20

    ground = removal(ground=method)
    for _ in range(3):
        heights = ground.heights(points)
    assert kept(heights)[on_ground].mean() < 0.005
    assert kept(heights)[high].mean() > 0.99
    error = np.abs(heights - above)[high & kept(heights)]
    assert error.mean() < 0.06
    assert error.max() < 0.3


@pytest.mark.parametrize("height_m", [0.7, 1.0])
@pytest.mark.parametrize("slope_deg", [0.0, 5.0])
def test_a_rock_where_no_ground_is_seen_is_not_ground(height_m: float, slope_deg: float) -> None:
    """The lowest beam, 15 degrees down, meets the ground 1.9 m and more away; a rock of half the sensor's height and
    more, nearer than that, is all that its patch holds."""
    rng = np.random.default_rng(7)
    lidar = scenes.Lidar(elevation_deg=np.linspace(-15.0, 15.0, 16))
    slope = np.tan(np.radians(slope_deg))
    bearing = np.radians(np.arange(0.0, 360.0, 30.0))
    seen_as_obstacle = []
    for x, y in 1.1 * np.column_stack([np.cos(bearing), np.sin(bearing)]):
        foot_m = slope * x - height_m
        steps = [
            scenes.cylinder(x, y, radius, foot_m, foot_m + share * height_m)  # a cone, more or less
            for radius, share in ((0.4, 0.6), (0.3, 0.7), (0.2, 0.75), (0.1, 0.8))
        ]
        points = lidar.scan([scenes.plane(height_m, slope_x=slope), *steps], rng)
        on_rock = np.hypot(points[:, 0] - x, points[:, 1] - y) < 0.45
        on_rock &= points[:, 2] - (slope * points[:, 0] - height_m) > 0.2
        if on_rock.sum() < 20:  # the lowest beam passes over it
            continue
        ground = removal()
        for _ in range(3):
            heights = ground.heights(points)
        seen_as_obstacle.append(kept(heights)[on_rock].mean() > 0.9)
    assert len(seen_as_obstacle) >= 9
    assert all(seen_as_obstacle)


def test_rough_ground_is_ground() -> None:
    rng = np.random.default_rng(4)
    flat = LIDAR.scan([scenes.plane(0.8)], rng)
    points = rough(flat[np.hypot(flat[:, 0], flat[:, 1]) < 12.0], 0.1)
    heights = removal().heights(points)
    assert kept(heights).mean() < 0.03


def test_a_ramp_ahead_of_level_ground_is_ground() -> None:
    rng = np.random.default_rng(5)
    slope = np.tan(np.radians(20.0))
    level = LIDAR.scan([scenes.plane(0.6)], rng)
    ramp = LIDAR.scan([scenes.plane(0.6 + 4.0 * slope, slope_x=slope)], rng)
    points = np.concatenate([level[level[:, 0] < 4.0], ramp[(ramp[:, 0] >= 4.0) & (ramp[:, 0] < 10.0)]])
    points = points[np.abs(points[:, 1]) < 8.0]
    ground = removal()
    for _ in range(3):
        heights = ground.heights(points)
    assert kept(heights)[points[:, 0] > 4.5].mean() < 0.1
    assert kept(heights)[points[:, 0] < 3.5].mean() < 0.01


def test_reflections_below_ground_are_no_obstacles_and_do_not_hide_any() -> None:
    rng = np.random.default_rng(6)
    surfaces = [scenes.plane(0.6), scenes.cylinder(4.0, 0.0, 0.3, -0.6, 0.8)]
    points = LIDAR.scan(surfaces, rng)
    points = points[np.hypot(points[:, 0], points[:, 1]) < 12.0]
    ghosts = np.column_stack([rng.uniform(3.0, 6.0, (60, 2)), rng.uniform(-4.0, -2.5, 60)])
    clean = removal().heights(points)
    haunted = removal().heights(np.concatenate([points, ghosts]))
    assert not kept(haunted)[len(points) :].any()
    assert (kept(haunted)[: len(points)] == kept(clean)).mean() > 0.995


def test_a_car_roof_is_not_ground() -> None:
    rng = np.random.default_rng(7)
    surfaces = [scenes.plane(1.73), scenes.box(12.0, 3.0, 4.4, 1.8, 0.3, -1.73, -0.3)]
    points = LIDAR.scan(surfaces, rng)
    points = points[np.hypot(points[:, 0], points[:, 1]) < 25.0]
    on_car = points[:, 2] > -1.3
    assert on_car.sum() > 30
    assert kept(removal(range_m=20.0).heights(points))[on_car].all()


@pytest.mark.parametrize("height_m", [0.3, 0.9, 1.9])
def test_the_coarse_plane_gives_slope_and_sensor_height(height_m: float) -> None:
    rng = np.random.default_rng(8)
    points = LIDAR.scan([scenes.plane(height_m, 0.1, -0.2), scenes.box(5.0, 0.0, 2.0, 4.0, 0.0, -3.0, 2.0)], rng)
    plane = coarse_plane(points, None)
    assert plane is not None
    np.testing.assert_allclose([plane.slope_x, plane.slope_y, plane.offset_m], [0.1, -0.2, -height_m], atol=0.03)


def test_band_takes_the_configured_height() -> None:
    points = np.array([[2.0, 0.0, -1.0], [2.0, 1.0, -0.9], [2.0, 2.0, -0.7], [3.0, 0.0, 0.5], [3.0, 1.0, -1.6]])
    heights = removal(ground="band", sensor_height_m=1.0, ground_clearance_m=0.2).heights(points)
    np.testing.assert_allclose(heights, [-np.inf, -np.inf, 0.3, 1.5, -np.inf])


def test_without_ground_a_warning_says_so() -> None:
    notes = Notes()
    ground = GroundRemoval(PerceptionConfig(), notes)
    points = np.array([[1.0, 0.0, 0.2], [1.1, 0.0, 0.4]])
    np.testing.assert_array_equal(ground.heights(points), points[:, 2])
    assert "sensor_height_m" in notes.warnings[0]


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    points = LIDAR.scan([scenes.plane(0.6)], np.random.default_rng(0))
    removal().heights(points)
    assert capfd.readouterr().out == ""
