"""Whole simulated scans: motion within a scan, labels, determinism, independence of the seeds' uses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.frames import transform_points
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.simulator import SimulatedScan, Simulator
from adcbf_cli.core.types import NO_ID

WORLD: dict[str, Any] = {
    "duration_s": 0.5,
    "seed": 5,
    "terrain": {"kind": "bumps", "size_m": 50, "amplitude_m": 0.15, "slope_deg": 3},
    "objects": [
        {"kind": "tree", "at_m": [6, 4]},
        {"kind": "rock", "at_m": [4, -2]},
        {"kind": "wall", "from_m": [1, 7], "to_m": [10, 8]},
    ],
    "movers": [
        {"kind": "person", "path": {"kind": "line", "from_m": [5, -1], "to_m": [5, 5], "speed_mps": 1.2}},
        {"kind": "vehicle", "path": {"kind": "line", "from_m": [-6, -6], "to_m": [9, -6], "speed_mps": 3}},
    ],
    "ego": {
        "path": {
            "kind": "waypoints",
            "points_m": [[0, 0], [2, 1], [5, 0]],
            "speed_mps": 2.0,
            "smooth": True,
        }
    },
    "lidar": {"kind": "spinning", "azimuth_step_deg": 1.0, "range_sigma_m": 0.02, "dropout_probability": 0.05},
}


def run(**changes: Any) -> list[SimulatedScan]:
    return list(Simulator(Scenario.model_validate(WORLD | changes)))


def clean_lidar(**changes: Any) -> dict[str, Any]:
    return WORLD["lidar"] | {"range_sigma_m": 0.0, "dropout_probability": 0.0} | changes


def assert_same(first: list[SimulatedScan], second: list[SimulatedScan]) -> None:
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.scan.points_m, b.scan.points_m)
        np.testing.assert_array_equal(a.scan.offset_ns, b.scan.offset_ns)
        np.testing.assert_array_equal(a.object_id, b.object_id)


def test_the_same_seed_gives_the_same_scans():
    assert_same(run(), run())


def test_another_seed_gives_other_scans():
    assert not np.array_equal(run()[0].scan.points_m, run(seed=6)[0].scan.points_m)


def test_a_longer_log_begins_as_the_shorter_one():
    assert_same(run(), run(duration_s=0.8)[:5])


def test_stamps_and_offsets():
    scans = run()
    assert [s.scan.stamp_ns for s in scans] == [1_700_000_000_000_000_000 + i * 100_000_000 for i in range(5)]
    offset = scans[0].scan.offset_ns
    assert offset is not None
    azimuth = np.arctan2(scans[0].scan.points_m[:, 1], scans[0].scan.points_m[:, 0])
    expected = ((azimuth + np.pi) % (2 * np.pi)) / (2 * np.pi) * 100e6
    wrap = (offset - expected + 50e6) % 100e6 - 50e6
    assert np.abs(wrap).max() < 1.0 / 360 * 100e6


def test_frames_undo_the_egos_motion_within_a_scan():
    """Seen from a moving robot, a standing wall's points lie on the wall once placed, and not before."""
    scan = run(lidar=clean_lidar())[-1]
    on_wall = scan.object_id == 4
    assert on_wall.sum() > 100
    direction = np.array([9, 1]) / np.hypot(9, 1)
    across = np.array([-direction[1], direction[0]])

    def distance(points_m: np.ndarray) -> np.ndarray:
        world = transform_points(scan.frame.world_from_sensor, points_m[on_wall])
        along = (world[:, :2] - [1, 7]) @ direction
        face = (world[:, 2] < world[:, 2].max() - 0.3) & (along > 0.3)  # neither the wall's top nor its end
        return (world[face, :2] - [1, 7]) @ across + 0.1

    assert np.abs(distance(scan.frame.points_m)).max() < 0.003
    assert np.abs(distance(scan.scan.points_m)).max() > 0.03


def test_ground_points_lie_on_the_height_field():
    simulator = Simulator(Scenario.model_validate(WORLD | {"lidar": clean_lidar()}))
    scan = list(simulator)[-1]
    ground = scan.object_id == NO_ID
    world = transform_points(scan.frame.world_from_sensor, scan.frame.points_m[ground])
    error = world[:, 2] - simulator.world.ground.height_m(world[:, 0], world[:, 1])
    assert ground.sum() > 500
    assert np.abs(error).max() < 0.004


def test_labelled_points_lie_in_the_truths_box_at_their_own_time():
    simulator = Simulator(Scenario.model_validate(WORLD | {"lidar": clean_lidar()}))
    scan = list(simulator)[-1]
    world = transform_points(scan.frame.world_from_sensor, scan.frame.points_m)
    offset = scan.scan.offset_ns
    assert offset is not None
    seen = 0
    for number in (0, 1, 3):
        mine = np.flatnonzero(scan.object_id == number)
        truth = simulator.truth(scan.scan.stamp_ns + offset[mine])[number]
        dx, dy = world[mine, 0] - truth.x_m, world[mine, 1] - truth.y_m
        along = np.cos(truth.yaw_rad) * dx + np.sin(truth.yaw_rad) * dy
        across = -np.sin(truth.yaw_rad) * dx + np.cos(truth.yaw_rad) * dy
        swing = 0.35 if truth.category == "person" else 0.0
        tilt = 0.15 if truth.category == "vehicle" else 0.005
        assert np.abs(along).max() < truth.length_m / 2 + swing + tilt
        assert np.abs(across).max() < truth.width_m / 2 + tilt
        seen += len(mine)
    assert seen > 100


def test_an_instantaneous_scan_has_no_times_and_needs_no_correction():
    scan = run(lidar=clean_lidar(instantaneous=True))[-1]
    assert scan.scan.offset_ns is None
    np.testing.assert_allclose(scan.frame.points_m, scan.scan.points_m, atol=1e-9)


def test_drift_moves_the_frame_and_not_the_scan():
    exact = run()
    drifting = run(odometry={"heading_sigma_rad_per_sqrt_m": 0.2, "translation_sigma_m_per_sqrt_m": 0.2})
    assert_same(exact, drifting)
    np.testing.assert_allclose(drifting[0].odom_from_base, drifting[0].world_from_base, atol=1e-9)
    assert np.abs(drifting[-1].odom_from_base - drifting[-1].world_from_base).max() > 0.01
    np.testing.assert_allclose(drifting[-1].world_from_base, exact[-1].world_from_base)


def test_the_ego_follows_the_ground():
    simulator = Simulator(Scenario.model_validate(WORLD))
    pose = simulator.world_from_base(simulator.stamps())
    height = simulator.world.ground.height_m(pose[:, 0, 3], pose[:, 1, 3])
    assert np.abs(pose[:, 2, 3] - height).max() < 0.03
    np.testing.assert_allclose(np.linalg.det(pose[:, :3, :3]), 1.0)


@pytest.mark.parametrize("first", [-135.0, -180.0])
def test_a_planar_laser_gives_planar_scans(first: float):
    laser = {"kind": "planar", "first_azimuth_deg": first, "last_azimuth_deg": 135, "azimuth_step_deg": 0.5}
    scan = run(lidar=laser, terrain={"kind": "flat"})[0]
    assert scan.scan.planar
    assert (scan.scan.points_m[:, 2] == 0).all()
    finite = np.isfinite(scan.range_m[:, 0])
    np.testing.assert_allclose(np.linalg.norm(scan.scan.points_m, axis=1), scan.range_m[finite, 0])
