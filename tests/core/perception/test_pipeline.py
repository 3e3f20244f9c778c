"""Whole frames: scenes with known obstacles, invariances, odd input, and a real log."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from adcbf_cli.core.config import PerceptionConfig, ReadConfig
from adcbf_cli.core.frames import invert, pose_matrix, transform_points
from adcbf_cli.core.perception.pipeline import Perception, cluster_frames
from adcbf_cli.core.types import NO_ID, Clusters, Notes
from adcbf_cli.io.frame_reader import FrameReader
from tests.core.perception import lidar_scenes as scenes

CONFIG = PerceptionConfig(range_m=10.0)
POST, TRUNK, CAR = (4.0, 1.0, 0.15), (-3.0, 4.0, 0.4), (6.0, -4.0, 4.2, 1.8, 0.4)


def scene(seed: int = 0, lidar: scenes.Lidar | None = None) -> np.ndarray:
    """A post, a trunk and a car on level ground 0.6 m below the sensor, and an overhang."""
    surfaces = [
        scenes.plane(0.6),
        scenes.cylinder(*POST, -0.6, 0.6),
        scenes.cylinder(*TRUNK, -0.6, 2.0),
        scenes.box(*CAR, -0.6, 0.9),
        scenes.box(0.0, -6.0, 2.0, 2.0, 0.0, 2.2, 2.4),
    ]
    return (lidar or scenes.Lidar()).scan(surfaces, np.random.default_rng(seed))


def run(points: np.ndarray, config: PerceptionConfig = CONFIG, pose: np.ndarray | None = None) -> Clusters:
    return Perception(config, Notes())(scenes.frame(points, pose))


def equal(one: Clusters, other: Clusters) -> bool:
    return all(
        np.array_equal(getattr(one, item.name), getattr(other, item.name))
        for item in fields(one)
        if isinstance(getattr(one, item.name), np.ndarray)
    )


def test_the_scene_gives_its_three_obstacles() -> None:
    points = scene()
    clusters = run(points)
    assert len(clusters) == 3
    np.testing.assert_array_equal(clusters.cluster_id, [0, 1, 2])
    np.testing.assert_allclose(clusters.centre_m[0, :2], POST[:2], atol=0.03)
    np.testing.assert_allclose(clusters.centre_m[1, :2], TRUNK[:2], atol=0.03)
    np.testing.assert_allclose(clusters.centre_m[2, :2], CAR[:2], atol=0.15)
    assert clusters.radius_m[0] == pytest.approx(0.15, abs=0.07)
    assert clusters.radius_m[1] == pytest.approx(0.4, abs=0.08)
    np.testing.assert_allclose([clusters.length_m[2], clusters.width_m[2]], [4.2, 1.8], atol=0.25)
    assert clusters.yaw_rad[2] == pytest.approx(0.4, abs=0.05)
    assert clusters.height_m[0] == pytest.approx(1.05, abs=0.2)
    assert (clusters.split_from == NO_ID).all()
    assert (clusters.probability > 0.5).all()
    counts = clusters.counts
    assert len(points) == counts.read > counts.in_range > counts.above_ground >= counts.smoothed > counts.clustered
    assert clusters.points.sum() <= counts.clustered


@pytest.mark.parametrize("clusterer", ["hdbscan", "dbscan"])
@pytest.mark.parametrize("ground", ["patchwork", "plane", "band"])
def test_every_ground_method_and_clusterer_finds_them(ground: str, clusterer: str) -> None:
    config = PerceptionConfig.model_validate({"range_m": 10.0, "ground": ground, "clusterer": clusterer})
    clusters = run(scene(), config)
    assert len(clusters) == 3
    np.testing.assert_allclose(clusters.centre_m[:2, :2], [POST[:2], TRUNK[:2]], atol=0.05)


def test_centre_in_sensor_and_world_agree() -> None:
    pose = pose_matrix(np.array([300.0, -20.0, 4.0]), np.array([0.02, -0.03, 0.6, 0.8]))
    clusters = run(scene() @ np.eye(3), CONFIG, pose)
    np.testing.assert_allclose(transform_points(pose, clusters.centre_sensor_m), clusters.centre_m, atol=1e-9)


@pytest.mark.parametrize("tilt_deg", [5.0, 20.0])
def test_a_tilted_mount_changes_little(tilt_deg: float) -> None:
    """The same points, seen by a sensor that is pitched and rolled: the pose takes it out."""
    level = scene()
    half = np.radians(tilt_deg) / 2
    pose = pose_matrix(np.zeros(3), np.array([0.5 * np.sin(half), np.sin(half), 0.0, np.cos(half)]))
    tilted = run(transform_points(invert(pose), level), CONFIG, pose)
    straight = run(level)
    assert len(tilted) == len(straight)
    np.testing.assert_allclose(tilted.centre_m, straight.centre_m, atol=0.05)
    np.testing.assert_allclose(tilted.radius_m, straight.radius_m, atol=0.02)


@pytest.mark.parametrize("shift_m", [np.array([3.7, -11.2, 0.8]), np.array([4.6e5, 5.8e6, 120.0])])
@pytest.mark.parametrize("turn_rad", [0.0, 0.3, 2.0, -1.2])
def test_moving_the_world_moves_the_result(shift_m: np.ndarray, turn_rad: float) -> None:
    pose = pose_matrix(shift_m, np.array([0.0, 0.0, np.sin(turn_rad / 2), np.cos(turn_rad / 2)]))
    moved, still = run(scene(), CONFIG, pose), run(scene())
    assert len(moved) == len(still)
    np.testing.assert_allclose(moved.centre_sensor_m, still.centre_sensor_m, atol=0.03)
    np.testing.assert_allclose(moved.radius_m, still.radius_m, atol=0.03)
    turned = moved.yaw_rad[2] - still.yaw_rad[2] - turn_rad
    assert abs((turned + np.pi / 2) % np.pi - np.pi / 2) < 0.04


def test_a_shift_by_whole_cells_changes_nothing_but_the_place() -> None:
    pose = np.eye(4)
    pose[:3, 3] = [64.0, -32.0, 0.0]
    config = PerceptionConfig(range_m=10.0, cell_m=0.125)
    moved, still = run(scene(), config, pose), run(scene(), config)
    np.testing.assert_array_equal(moved.centre_sensor_m, still.centre_sensor_m)
    np.testing.assert_array_equal(moved.radius_m, still.radius_m)
    np.testing.assert_allclose(moved.centre_m - still.centre_m, np.tile(pose[:3, 3], (3, 1)), atol=1e-12)


def test_the_same_frames_give_the_same_clusters() -> None:
    frames = [scenes.frame(scene(seed), index=seed) for seed in range(4)]
    one = list(cluster_frames(frames, CONFIG, Notes()))
    other = list(cluster_frames(frames, CONFIG, Notes()))
    assert all(equal(a, b) for a, b in zip(one, other, strict=True))


def test_point_labels_are_the_points_of_the_obstacles() -> None:
    clusters = run(scene(), PerceptionConfig(range_m=10.0, point_labels=True))
    labels = clusters.labels
    assert labels is not None
    assert len(labels.points_m) == clusters.counts.smoothed
    for cluster in clusters.cluster_id:
        own = labels.points_m[labels.cluster_id == cluster]
        away = np.hypot(*(own[:, :2] - clusters.centre_m[cluster, :2]).T)
        assert len(own) >= clusters.points[cluster]
        assert away.max() <= clusters.radius_m[cluster] + 1e-9
        assert np.ptp(own[:, 2]) == pytest.approx(clusters.height_m[cluster])
    assert run(scene()).labels is None


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.array([[2.0, 0.0, 0.1]]),
        np.zeros((50, 3)),
        np.full((50, 3), 2.0),
        np.full((50, 3), 1e200),
        np.array([[2.0, 0.0, 0.1]] * 20 + [[1e9, -1e12, 1e300]] * 5),
        np.column_stack([np.linspace(1.0, 3.0, 40), np.zeros((40, 2))]),
    ],
)
@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("far_away", [0.0, 1e15])
def test_odd_frames_give_finite_records(points: np.ndarray, planar: bool, far_away: float) -> None:
    pose = np.eye(4)
    pose[0, 3] = far_away
    for clusterer in ("hdbscan", "dbscan"):
        config = PerceptionConfig.model_validate({"clusterer": clusterer, "point_labels": True})
        clusters = Perception(config, Notes())(scenes.frame(points, pose, planar=planar))
        for item in fields(clusters):
            value = getattr(clusters, item.name)
            if isinstance(value, np.ndarray):
                assert np.isfinite(value).all()
        assert len(clusters.radius_m) == len(clusters.centre_m) == len(clusters)


def test_a_laser_sees_two_legs_as_one_person_and_a_wall_as_pieces() -> None:
    legs = [(2.0, 0.85), (2.0, 1.15)]
    surfaces = [scenes.cylinder(x, y, 0.06, -1.0, 1.0) for x, y in legs]
    surfaces.append(scenes.box(0.0, -3.0, 6.0, 0.2, 0.0, -1.0, 1.0))
    lidar = scenes.Lidar(elevation_deg=np.zeros(1), azimuth_step_deg=0.5, noise_m=0.01)
    points = lidar.scan(surfaces, np.random.default_rng(0))
    clusters = Perception(PerceptionConfig(), Notes())(scenes.frame(points, planar=True))
    person = np.flatnonzero(np.hypot(*(clusters.centre_m[:, :2] - [2.0, 1.0]).T) < 0.15)
    assert len(person) == 1
    assert 0.15 < clusters.radius_m[person[0]] < 0.35
    pieces = np.delete(np.arange(len(clusters)), person)
    assert len(pieces) >= 3
    assert (clusters.split_from[pieces] == pieces.min()).all()
    assert (clusters.radius_m[pieces] <= 1.0).all()
    assert (clusters.height_m == 0.0).all()


SPARSE = scenes.Lidar(elevation_deg=np.linspace(-16.0, 14.0, 16), azimuth_step_deg=1.0)


@pytest.mark.parametrize("clusterer", ["hdbscan", "dbscan"])
def test_a_few_beams_on_far_posts_are_obstacles_and_single_returns_are_not(clusterer: str) -> None:
    """Posts of 0.3 m seen at 8 to 11 m by 16 rings at 1 degree: two or three cells each."""
    posts = [(8.0, 2.0), (-9.0, 3.0), (1.0, -10.0), (-7.0, -8.0)]
    surfaces = [scenes.plane(0.9), scenes.box(5.0, 5.0, 1.5, 1.0, 0.3, -0.9, 0.5)]
    surfaces += [scenes.cylinder(x, y, 0.15, -0.9, 1.2) for x, y in posts]
    rng = np.random.default_rng(3)
    points = SPARSE.scan(surfaces, rng)
    around, away = rng.uniform(-np.pi, np.pi, 12), rng.uniform(3.0, 11.0, 12)
    strays = np.column_stack([away * np.cos(around), away * np.sin(around), rng.uniform(-0.3, 0.8, 12)])
    config = PerceptionConfig.model_validate({"range_m": 12.0, "clusterer": clusterer})
    clusters = run(np.concatenate([points, strays]), config)
    distance = np.linalg.norm(clusters.centre_m[:, None, :2] - np.array(posts), axis=2)
    assert (distance.min(axis=0) < 0.2).all()  # of a post this small, the near side is all there is
    assert clusters.points[distance.argmin(axis=0)].max() < config.min_cluster_size
    assert len(clusters) == len(posts) + 1


def test_a_laser_counts_cells_not_returns() -> None:
    """Two cells 0.1 m apart are a leg, with one return each; one cell is none, with thirty."""
    leg = np.array([[2.0, 0.02, 0.0], [2.0, 0.12, 0.0]])
    flaw = np.tile([[1.0, -2.0, 0.0]], (30, 1))
    clusters = Perception(PerceptionConfig(), Notes())(scenes.frame(np.concatenate([leg, flaw]), planar=True))
    assert len(clusters) == 1
    np.testing.assert_allclose(clusters.centre_m[0, :2], [2.0, 0.07], atol=0.05)


def test_a_circling_cylinder_is_measured_without_bias() -> None:
    """The paper's Table I obstacle, r = 0.48 m on a circle 4 to 9 m away, before any filter."""
    lidar, rng = scenes.Lidar(), np.random.default_rng(0)
    perception = Perception(CONFIG, Notes())
    errors = []
    for step in range(12):
        angle = 2 * np.pi * step / 12
        x, y = 6.5 + 2.0 * np.cos(angle), 1.0 + 2.0 * np.sin(angle)
        points = lidar.scan([scenes.plane(0.6), scenes.cylinder(x, y, 0.48, -0.6, 0.9)], rng)
        clusters = perception(scenes.frame(points, index=step))
        assert len(clusters) == 1
        errors.append(clusters.centre_m[0, :2] - [x, y])
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.012


def test_labelled_road_users_are_found_in_a_real_street(real_data: Callable[[str], Path]) -> None:
    log = real_data("kitti0000/kitti0000_a.mcap")
    with real_data("kitti0000/kitti0000_a_gt_tracks.csv").open() as table:
        rows = [row for row in csv.DictReader(table) if row["class"] != "DontCare"]
    found = total = 0
    perception = Perception(PerceptionConfig(range_m=25.0), Notes())
    with FrameReader(log, ReadConfig(), Notes()) as frames:
        for frame in frames:
            if frame.index % 4:
                continue
            clusters = perception(frame)
            for row in rows:
                place = np.array([float(row["x_velo"]), float(row["y_velo"])])
                if int(row["frame"]) != frame.index or np.hypot(*place) > 20.0:
                    continue
                total += 1
                found += bool((np.hypot(*(clusters.centre_sensor_m[:, :2] - place).T) < 1.0).any())
    assert total > 30
    assert found / total > 0.9
