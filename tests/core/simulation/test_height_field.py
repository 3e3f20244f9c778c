"""The ground: slopes, bumps, the mesh and its heights, and bodies that rest on it."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.simulation.poses import compose, poses
from adcbf_cli.core.simulation.randomness import Purpose, generator
from adcbf_cli.core.simulation.scenario import Terrain
from adcbf_cli.core.simulation.terrain import HeightField, build_terrain, rest_on_wheels


def bumps(seed: int = 0, **changes: float) -> HeightField:
    terrain = Terrain(kind="bumps", size_m=40, amplitude_m=0.2, wavelength_m=2, cell_m=0.25)
    return build_terrain(terrain.model_copy(update=changes), generator(seed, Purpose.TERRAIN))


def slope(slope_deg: float, uphill_deg: float) -> HeightField:
    terrain = Terrain(kind="flat", size_m=60, slope_deg=slope_deg, uphill_deg=uphill_deg)
    return build_terrain(terrain, generator(0, Purpose.TERRAIN))


def test_a_slope_rises_towards_uphill():
    ground = slope(10, 30)
    along = np.array([np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30))])
    x, y = 12.0 * along[0] + 3.0 * -along[1], 12.0 * along[1] + 3.0 * along[0]
    height = ground.height_m(np.array([0.0, x]), np.array([0.0, y]))
    np.testing.assert_allclose(height, [0.0, 12 * np.tan(np.deg2rad(10))], atol=1e-5)


def test_bumps_reach_their_amplitude_and_stay_within_their_band():
    ground = bumps()
    heights = ground.heights_m
    assert np.abs(heights).max() == pytest.approx(0.2, abs=1e-5)
    window = np.hanning(len(heights))
    power = np.abs(np.fft.fft2((heights - heights.mean()) * window[:, None] * window[None, :])) ** 2
    frequency = np.fft.fftfreq(len(heights), ground.cell_m)
    radial = np.hypot(frequency[:, None], frequency[None, :])
    margin = 3 / 40
    beyond = power[(radial > 1 / 2 + margin) | (radial < 1 / 8 - margin)].sum()
    assert beyond / power.sum() < 0.01


def test_bumps_depend_on_the_seed_alone():
    np.testing.assert_array_equal(bumps(3).heights_m, bumps(3).heights_m)
    assert np.abs(bumps(3).heights_m - bumps(4).heights_m).max() > 0.05


def test_the_height_is_the_meshs_own():
    """Random points inside random triangles of the mesh lie at the height that is looked up there."""
    ground = bumps()
    mesh = ground.mesh()
    rng = np.random.default_rng(1)
    corners = mesh.vertices_m[mesh.triangles[rng.integers(len(mesh.triangles), size=500)]]
    inside = np.einsum("nk,nkj->nj", rng.dirichlet(np.ones(3), size=500), corners)
    np.testing.assert_allclose(ground.height_m(inside[:, 0], inside[:, 1]), inside[:, 2], atol=1e-9)


def test_the_meshs_triangles_face_up():
    mesh = bumps().mesh()
    corners = mesh.vertices_m[mesh.triangles]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()


def test_a_body_on_a_slope_lies_in_the_plane():
    """On a plane, the body's z axis is the plane's normal, whatever way the body faces."""
    ground = slope(8, 0)
    yaw = np.linspace(-3, 3, 13)
    pose = rest_on_wheels(ground, np.full(13, 2.0), np.full(13, 1.0), yaw, 0.6, 0.4)
    np.testing.assert_allclose(pose[:, 2, 3], 2 * np.tan(np.deg2rad(8)), atol=1e-5)
    forward, leftward = pose[:, :3, 0], pose[:, :3, 1]
    rise = np.tan(np.deg2rad(8))
    np.testing.assert_allclose(forward[:, 2] / np.hypot(forward[:, 0], forward[:, 1]), rise * np.cos(yaw), atol=1e-5)
    assert np.abs(np.cross(forward, leftward) @ [-np.sin(np.deg2rad(8)), 0, np.cos(np.deg2rad(8))] - 1).max() < 1e-3


def test_uphill_is_nose_up_and_left_high_is_positive_roll():
    up = rest_on_wheels(slope(10, 0), np.zeros(1), np.zeros(1), np.zeros(1), 0.5, 0.5)[0]
    assert up[2, 0] == pytest.approx(np.sin(np.deg2rad(10)), abs=1e-6)
    left_high = rest_on_wheels(slope(10, 90), np.zeros(1), np.zeros(1), np.zeros(1), 0.5, 0.5)[0]
    assert left_high[2, 1] == pytest.approx(np.sin(np.deg2rad(10)), abs=1e-6)


def test_poses_compose_as_matrices():
    rng = np.random.default_rng(0)
    first, second = (poses(*rng.normal(size=(6, 5))) for _ in range(2))
    np.testing.assert_allclose(compose(first, second), first @ second, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(first[:, :3, :3]), 1.0)
    np.testing.assert_allclose(
        first[:, :3, :3] @ np.swapaxes(first[:, :3, :3], 1, 2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12
    )
