"""A body's centre must not wander over it as its visible side changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.frames import invert, transform_points
from adcbf_cli.core.tracking.bodies import (
    Bodies,
    axes_at,
    completion,
    extents_along,
    facing,
    followed_yaw,
    grown_bodies,
)
from adcbf_cli.core.tracking.tracker import Tracker
from adcbf_cli.core.types import NO_ID, Clusters, Notes, PointCounts, Tracks


def pose_at(x: float, y: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, 3] = x, y
    return pose


def rectangle_clusters(
    time_s: float, low_m: np.ndarray, high_m: np.ndarray, place_m: np.ndarray, yaw: float, pose: np.ndarray
) -> Clusters:
    """One cluster: the part from low_m to high_m (2,), body frame, of a body at place_m with this yaw."""
    axes = axes_at(np.array(yaw))
    centre = np.array([[*(place_m + (low_m + high_m) / 2 @ axes), 0.0]])
    size = high_m - low_m
    turned = bool(size[1] > size[0])
    direction = yaw + (np.pi / 2 if turned else 0.0)
    return Clusters(
        frame_index=round(time_s * 10),
        stamp_ns=10**18 + round(time_s * 1e9),
        world_from_sensor=pose,
        planar=True,
        pose_known=True,
        counts=PointCounts(0, 0, 0, 0, 0),
        cluster_id=np.zeros(1, dtype=np.int64),
        centre_m=centre,
        centre_sensor_m=transform_points(invert(pose), centre),
        radius_m=np.array([np.hypot(*size) / 2]),
        height_m=np.zeros(1),
        length_m=np.array([size.max()]),
        width_m=np.array([size.min()]),
        yaw_rad=np.array([np.pi / 2 - np.mod(np.pi / 2 - direction, np.pi)]),
        points=np.array([20], dtype=np.int64),
        probability=np.ones(1),
        split_from=np.array([NO_ID]),
    )


def seen_part(size_m: np.ndarray, to_sensor_m: np.ndarray, depth_m: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """The extent (low, high), body frame, of the faces of a box that look at the sensor (2,)."""
    half = size_m / 2
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for axis in range(2):
        if abs(to_sensor_m[axis]) > half[axis]:
            side = np.sign(to_sensor_m[axis])
            face_low, face_high = -half.copy(), half.copy()
            face_low[axis], face_high[axis] = sorted((side * half[axis], side * (half[axis] - depth_m)))
            low, high = np.minimum(low, face_low), np.maximum(high, face_high)
    return low, high


def drive_past(
    size_m: np.ndarray, yaw: float, velocity: np.ndarray, turn: float = 0.0
) -> tuple[np.ndarray, list[Tracks]]:
    """The errors (n, 2), body frame, of a track of a box that an ego passes and falls behind again."""
    tracker, errors, history = Tracker(TrackingConfig(), Notes()), [], []
    rotate = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    for k in range(240):
        time_s = 0.1 * k
        place = np.array([8.0, 3.0]) + velocity * time_s
        ego = velocity * time_s + np.array([16.0 * np.sin(0.05 * k / 2) ** 2, 0.0])
        axes = axes_at(np.array(yaw))
        low, high = seen_part(size_m, axes @ (ego - place))
        pose = pose_at(*(ego @ rotate))
        clusters = rectangle_clusters(time_s, low, high, place @ rotate, yaw + turn, pose)
        tracks = tracker(clusters)
        history.append(tracks)
        errors.append(axes @ (tracks.state[0, :2] @ rotate.T - place))
    return np.array(errors), history


@pytest.mark.parametrize("velocity", [(0.0, 0.0), (3.0, 0.0)])
def test_a_box_seen_from_changing_sides_keeps_its_centre(velocity: tuple[float, float]) -> None:
    size = np.array([4.2, 1.8])
    errors, history = drive_past(size, 0.0, np.array(velocity))
    assert {int(track) for tracks in history for track in tracks.track_id} == {0}
    # Both sides have been seen after the first pass; the ego then falls behind and passes again.
    assert np.abs(errors[80:]).max() < 0.25
    assert np.sqrt((errors[80:] ** 2).mean(axis=0)).max() < 0.1
    if velocity == (0.0, 0.0):
        assert all(tracks.is_static[0] for tracks in history[60:])
        speed = [np.linalg.norm(tracks.state[0, 3:5]) for tracks in history[60:]]
        assert max(speed) < 0.3


def test_a_turned_world_gives_turned_tracks() -> None:
    size, velocity = np.array([4.2, 1.8]), np.array([1.0, 0.0])
    straight, _ = drive_past(size, 0.2, velocity)
    turned, _ = drive_past(size, 0.2, velocity, turn=1.1)
    np.testing.assert_allclose(turned, straight, atol=1e-6)


def test_completion_keeps_the_end_that_faces_the_sensor() -> None:
    extent, trust = np.array([[4.0, 2.0]]), np.ones(1)
    seen = np.array([[0.5, 2.0]])
    ends = facing(axes_at(np.zeros(1)), extent, np.array([[-9.0, 0.0]]))
    np.testing.assert_allclose(ends, [[-1.0, 0.0]])
    # The rear end is at the seen centre - 0.25, the body's centre 2.0 ahead of that.
    np.testing.assert_allclose(completion(extent, seen, ends, trust, 1e-3), [[1.75, 0.0]], atol=1e-5)
    np.testing.assert_allclose(completion(extent, seen, ends, 0.0 * trust, 1e-3), 0.0)
    assert np.abs(completion(extent, extent - 0.02, ends, trust, 0.05)).max() < 0.003
    half_beside = facing(axes_at(np.zeros(1)), extent, np.array([[-1.0, 5.0]]))
    np.testing.assert_allclose(half_beside, [[-0.5, 1.0]])


def test_extents_along_an_axis() -> None:
    length, width = np.array([4.0]), np.array([2.0])
    for turn, expected in ((0.0, (4.0, 2.0)), (np.pi / 2, (2.0, 4.0)), (np.pi, (4.0, 2.0))):
        np.testing.assert_allclose(extents_along(length, width, np.array([0.3 + turn]), np.array([0.3])), [expected])
    round_one = extents_along(np.ones(9), np.ones(9), np.linspace(0, 3, 9), np.zeros(9))
    np.testing.assert_allclose(round_one, 1.0)


def test_axes_are_followed_modulo_a_quarter_turn() -> None:
    yaw, variance = followed_yaw(np.array([0.1]), np.array([0.04]), np.array([0.2 + np.pi / 2]), np.array([0.04]))
    np.testing.assert_allclose(yaw, 0.15)
    np.testing.assert_allclose(variance, 0.02)
    # What departs by more than both deviations allow is trusted no further than its departure.
    yaw, _ = followed_yaw(np.array([0.0]), np.array([0.01]), np.array([0.5]), np.array([0.0025]))
    np.testing.assert_allclose(yaw, 0.5 * 0.01 / 0.25)


def test_a_short_merge_does_not_grow_a_body_and_an_edge_on_view_does_not_shrink_it() -> None:
    config = TrackingConfig()
    body = Bodies.seen_first(np.zeros((1, 2)), np.array([4.0]), np.array([2.0]), np.zeros(1), config)
    behind = np.array([-10.0, 0.0])
    for extent in ([9.0, 2.0],) * 4 + ([0.3, 2.0],) * 50:
        body = grown_bodies(body, np.array([extent]), np.zeros((1, 2)), behind)
    np.testing.assert_allclose(body.extent_m, [[4.0, 2.0]])
    for _ in range(100):
        body = grown_bodies(body, np.array([[3.0, 0.1]]), np.zeros((1, 2)), np.array([0.0, 10.0]))
    assert body.extent_m[0, 0] == pytest.approx(3.0, abs=0.05)
    assert body.extent_m[0, 1] == pytest.approx(2.0)


def test_legs_that_open_and_close_are_not_completed() -> None:
    """A walker's extent along the course swings between 0.2 and 0.7 m around a centre that goes straight."""
    tracker, errors = Tracker(TrackingConfig(), Notes()), []
    for k in range(120):
        time_s, place = 0.1 * k, np.array([-6.0 + 0.12 * k, 3.0])
        half = np.array([0.225 + 0.125 * np.sin(2.0 * np.pi * 0.9 * time_s), 0.1])
        tracks = tracker(rectangle_clusters(time_s, -half, half, place, 0.0, np.eye(4)))
        errors.append(tracks.state[0, :2] - place)
    assert np.sqrt((np.array(errors[30:]) ** 2).mean(axis=0)).max() < 0.05


def test_pieces_of_a_split_cluster_are_not_completed() -> None:
    tracker = Tracker(TrackingConfig(), Notes())
    low, high = np.array([-2.0, -1.0]), np.array([2.0, 1.0])
    for k in range(30):
        clusters = rectangle_clusters(0.1 * k, low, high, np.array([9.0, 0.0]), 0.0, np.eye(4))
        tracker(clusters)
    part = rectangle_clusters(3.0, np.array([-2.0, -1.0]), np.array([1.0, 1.0]), np.array([9.0, 0.0]), 0.0, np.eye(4))
    completed = tracker(part).state[0, 0]
    tracker_of_pieces = Tracker(TrackingConfig(), Notes())
    for k in range(30):
        clusters = rectangle_clusters(0.1 * k, low, high, np.array([9.0, 0.0]), 0.0, np.eye(4))
        tracker_of_pieces(clusters)
    piece = replace(part, split_from=np.zeros(1, dtype=np.int64))
    assert tracker_of_pieces(piece).state[0, 0] < completed <= 9.02
