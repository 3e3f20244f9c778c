"""What drawing needs, against arithmetic of another kind."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adcbf_cli.core.types import NO_ID
from adcbf_cli.io.viz.drives import drive_topics
from adcbf_cli.io.viz.items import shown_steps
from adcbf_cli.io.viz.records import LabelledCloud
from adcbf_cli.io.viz.shapes import POINT, Floor, Trail, ellipse, label_points, packed_cloud, track_rgb
from tests.records import make_clusters


def test_an_ellipse_holds_its_share_of_a_gaussian() -> None:
    covariance = np.array([[0.5, 0.3], [0.3, 0.4]])
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(2), covariance, 200_000)
    for probability in (0.5, 0.95):
        found = ellipse(covariance, probability)
        cos, sin = np.cos(found.yaw_rad), np.sin(found.yaw_rad)
        own = draws @ np.array([[cos, -sin], [sin, cos]])
        inside = (own[:, 0] / found.half_m[0]) ** 2 + (own[:, 1] / found.half_m[1]) ** 2 <= 1
        assert inside.mean() == pytest.approx(probability, abs=0.005)
        assert found.half_m[0] >= found.half_m[1]


def test_an_ellipse_of_nothing_uncertain_is_next_to_nothing() -> None:
    assert ellipse(np.zeros((2, 2)), 0.95).half_m == (0.001, 0.001)


def test_points_are_labelled_by_the_rectangle_that_they_lie_in() -> None:
    """Against a loop over all points and clusters; overlapping ones go to the nearer centre."""
    rng = np.random.default_rng(1)
    clusters = make_clusters(0, 12, rng)
    clusters = replace(clusters, centre_m=rng.uniform(-2, 2, (12, 3)))
    sensor_from_world = np.linalg.inv(clusters.world_from_sensor)
    world = rng.uniform(-2, 2, (4000, 3))
    points = world @ sensor_from_world[:3, :3].T + sensor_from_world[:3, 3]
    want = np.full(len(world), NO_ID)
    for k, point in enumerate(world):
        nearest = np.inf
        for i in range(12):
            dx, dy, dz = point - clusters.centre_m[i]
            turned = complex(dx, dy) * np.exp(-1j * clusters.yaw_rad[i])
            within = (
                abs(turned.real) <= clusters.length_m[i] / 2 + 0.01
                and abs(turned.imag) <= clusters.width_m[i] / 2 + 0.01
                and abs(dz) <= clusters.height_m[i] / 2 + 0.01
            )
            if within and abs(turned) < nearest:
                nearest, want[k] = abs(turned), i
    got = label_points(points, clusters.world_from_sensor, clusters)
    assert (got >= 0).sum() > 300
    np.testing.assert_array_equal(got, want)


def test_no_clusters_label_nothing() -> None:
    nothing = make_clusters(0, 0, np.random.default_rng(0))
    assert (label_points(np.zeros((5, 3)), np.eye(4), nothing) == NO_ID).all()


def test_a_trail_stays_small_and_holds_its_ends() -> None:
    trail = Trail(most=64)
    for k in range(10_000):
        trail.add(np.array([float(k), 0.0, 0.0]))
        poses = trail.poses()
        assert len(poses) <= 66
        assert poses[0, 0] == 0.0
        assert poses[-1, 0] == k
        assert (np.diff(poses[:, 0]) > 0).all()
    steps = np.diff(poses[:-1, 0])
    assert steps.min() == steps.max(), "what is kept is evenly spread"


def test_a_short_trail_is_whole() -> None:
    trail = Trail()
    for k in range(500):
        trail.add(np.array([float(k), 0.0, 0.0]))
    np.testing.assert_array_equal(trail.poses()[:, 0], np.arange(500))


def test_the_floor_is_where_obstacles_stand() -> None:
    clusters = make_clusters(0, 4, np.random.default_rng(0))
    standing = replace(clusters, centre_m=np.tile([1.0, 2.0, -0.5], (4, 1)), height_m=np.full(4, 1.0))
    floor = Floor()
    assert floor.at(standing) == pytest.approx(-1.0)
    above = replace(standing, centre_m=np.tile([1.0, 2.0, 9.5], (4, 1)))
    assert -1.0 < floor.at(above) < 9.0, "it does not jump"
    planar = replace(standing, planar=True)
    assert floor.at(planar) == pytest.approx(planar.world_from_sensor[2, 3])


def test_neighbouring_tracks_differ_in_colour() -> None:
    for first in range(200):
        distance = np.abs(np.subtract(track_rgb(first), track_rgb(first + 1))).sum()
        assert distance > 60


def test_a_points_last_bytes_are_ros_rgb() -> None:
    cloud = LabelledCloud(np.ones((1, 3)), np.array([0]), np.array([4]))
    rows = packed_cloud(cloud)
    red, green, blue = track_rgb(4)
    assert rows.view(np.uint8).view("<u4").reshape(1, -1)[0, POINT.itemsize // 4 - 1] == (
        255 << 24 | red << 16 | green << 8 | blue
    )


@pytest.mark.parametrize(("steps", "shown"), [(30, [10, 20, 30]), (50, [17, 33, 50]), (2, [1, 2]), (1, [1])])
def test_some_steps_become_cylinders_and_the_last_always(steps: int, shown: list[int]) -> None:
    assert shown_steps(steps).tolist() == shown


def test_a_planners_topic_is_a_ros_name() -> None:
    assert drive_topics("replay", ["my planner-2.0/x"]) == ["/replay/my_planner_2_0_x"]
    assert drive_topics("replay", ["my-mpc", "my_mpc", "my.mpc"]) == [
        "/replay/my_mpc",
        "/replay/my_mpc_2",
        "/replay/my_mpc_3",
    ]
