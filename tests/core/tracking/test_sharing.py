"""A cluster that holds a moving and a standing obstacle teaches neither the other's size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.frames import invert, transform_points
from adcbf_cli.core.tracking.bodies import cut_surplus
from adcbf_cli.core.tracking.sharing import come_apart, homes, part_company, share_clusters, stand_and_move
from adcbf_cli.core.tracking.tracker import Tracker
from adcbf_cli.core.types import NO_ID, Clusters, Notes, PointCounts, Tracks, TrackStatus

POSE = np.eye(4)
POSE[:2, 3] = 0.0, -3.0


def boxes(time_s: float, spans: list[tuple[float, float, float, float]], pose: np.ndarray = POSE) -> Clusters:
    """One cluster for each axis-parallel span (low x, low y, high x, high y)."""
    low, high = np.array(spans).reshape(-1, 2, 2)[:, 0], np.array(spans).reshape(-1, 2, 2)[:, 1]
    n, size = len(spans), high - low
    centre = np.column_stack([(low + high) / 2, np.zeros(n)])
    return Clusters(
        frame_index=round(time_s * 10),
        stamp_ns=10**18 + round(time_s * 1e9),
        world_from_sensor=pose,
        planar=True,
        pose_known=True,
        counts=PointCounts(0, 0, 0, 0, 0),
        cluster_id=np.arange(n),
        centre_m=centre,
        centre_sensor_m=transform_points(invert(pose), centre),
        radius_m=np.hypot(size[:, 0], size[:, 1]) / 2,
        height_m=np.zeros(n),
        length_m=size.max(axis=1),
        width_m=size.min(axis=1),
        yaw_rad=np.where(size[:, 1] > size[:, 0], np.pi / 2, 0.0),
        points=np.full(n, 20),
        probability=np.ones(n),
        split_from=np.full(n, NO_ID),
    )


def test_the_home_is_the_smallest_rectangle_around_the_place() -> None:
    clusters = boxes(0.0, [(-2, -2, 2, 2), (0, 0, 1, 0.4)])
    places = np.array([[0.5, 0.2], [-1.0, 1.0], [1.05, 0.2], [5.0, 5.0], [0.5, 0.2]])
    eligible = np.array([True, True, True, True, False])
    assert homes(places, eligible, clusters, np.full(5, 0.1)).tolist() == [1, 0, 1, NO_ID, NO_ID]
    assert homes(places, eligible, clusters, np.zeros(5)).tolist() == [1, 0, 0, NO_ID, NO_ID]


def test_without_clusters_nobody_has_a_home() -> None:
    assert homes(np.zeros((2, 2)), np.ones(2, bool), boxes(0.0, []), np.ones(2)).tolist() == [NO_ID, NO_ID]


def test_only_a_standing_and_a_moving_track_share() -> None:
    home = np.array([0, 0, 0, 1, NO_ID])
    place = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [9.0, 9.0], [0.0, 0.0]])
    static = np.array([False, True, False, True, True])
    moving = np.array([True, False, False, False, False])
    sharing = share_clusters(home, place, stand_and_move(static, moving))
    assert sharing.home.tolist() == [0, 0, NO_ID, NO_ID, NO_ID]
    assert sharing.others_m[:2].tolist() == [[1.0, 0.0], [0.0, 0.0]]
    assert sharing.pairs(2).sum() == 2


def test_tracks_that_move_differently_part_company_in_what_is_larger_than_both() -> None:
    clusters = boxes(0.0, [(0, 0, 1.2, 0.5), (5, 0, 6.2, 0.5)])  # radius 0.65 m
    home = np.array([0, 0, 0, 1, NO_ID, 0])
    velocity = np.array([[1.0, 0.0], [-0.2, 0.0], [1.1, 0.1], [-1.0, 0.0], [-1.0, 0.0], [-1.0, 0.0]])
    radius = np.array([0.3, 0.2, 0.3, 0.3, 0.3, 0.6])
    sure, unsure = np.tile(0.1**2 * np.eye(2), (6, 1, 1)), np.tile(0.5**2 * np.eye(2), (6, 1, 1))
    apart = part_company(home, velocity, sure, radius, clusters)
    assert apart[0].tolist() == apart[2].tolist() == [False, True, False, True, False, False]
    assert not apart[4:].any()
    assert (apart == apart.T).all()
    assert not part_company(home, velocity, unsure, radius, clusters)[:3, :3].any()
    assert not part_company(np.full(6, NO_ID), velocity, sure, radius, clusters).any()


def test_two_that_meet_keep_their_speeds_and_sizes() -> None:
    """Known for half a second only, so that nobody knows of either that it moves, let alone stands."""
    tracker = Tracker(TrackingConfig(), Notes())
    for k in range(17):
        a, b = -1.0 + 0.12 * k, 1.0 - 0.12 * k
        both = [(a - 0.2, -0.2, a + 0.2, 0.2), (b - 0.2, 0.3, b + 0.2, 0.7)]
        if abs(a - b) < 0.8:
            both = [(min(a, b) - 0.2, -0.2, max(a, b) + 0.2, 0.7)]
        tracks = tracker(boxes(0.1 * k, both))
    for place, speed in (((a, 0.0), 1.2), ((b, 0.5), -1.2)):
        row = np.argmin(np.hypot(*(tracks.state[:, :2] - place).T))
        assert tracks.state[row, :2] == pytest.approx(place, abs=0.03)
        assert tracks.state[row, 3:5] == pytest.approx([speed, 0.0], abs=0.05)
        assert tracks.radius_m[row] < 0.33  # 0.28 m, and 0.6 m together


def test_a_track_comes_apart_into_two_much_smaller_clusters() -> None:
    large, small, far = (-0.5, -0.5, 0.5, 0.5), (-0.5, -0.2, -0.1, 0.2), (3.0, 3.0, 3.4, 3.4)
    beside = (0.2, -0.2, 0.6, 0.2)
    place, radius, took = np.zeros((1, 2)), np.array([0.7]), np.zeros(1, dtype=np.int64)

    def apart(
        spans: list[tuple[float, float, float, float]], free: list[bool], age_s: float = 1.0, planar: bool = False
    ) -> bool:
        clusters = replace(boxes(0.0, spans), planar=planar)
        return bool(come_apart(place, radius, np.array([age_s]), took, clusters, np.array(free))[0])

    assert apart([small, beside], [False, True])
    assert not apart([small, beside], [False, False])  # the other one is another track's
    assert not apart([small, far], [False, True])
    assert not apart([large, beside], [False, True])
    assert not apart([small, large], [False, True])
    assert not apart([small], [False])
    assert not apart([small, beside], [False, True], age_s=2.0)
    assert not apart([small, beside], [False, True], planar=True)


def test_a_young_track_that_comes_apart_begins_anew() -> None:
    """What walks away from a box beside it, after both were one cluster from the first sight on."""
    tracker, track_id = Tracker(TrackingConfig(), Notes()), -1
    for k in range(12):
        x = 0.5 - 0.1 * k
        walker, box = (x - 0.2, -0.2, x + 0.2, 0.2), (0.4, 0.3, 0.9, 0.8)
        both = [(min(x - 0.2, 0.4), -0.2, max(x + 0.2, 0.9), 0.8)]
        tracks = tracker(replace(boxes(0.1 * k, both if k < 8 else [walker, box]), planar=False))
        row = int(np.argmin(np.hypot(*(tracks.state[:, :2] - (x, 0.0)).T)))
        if k == 7:
            track_id = int(tracks.track_id[row])
        if k >= 8:
            assert tracks.status[row] == TrackStatus.CONFIRMED
            assert tracks.radius_m[row] == pytest.approx(0.28, abs=0.01)
            assert tracks.state[row, :2] == pytest.approx([x, 0.0], abs=0.06)
    assert tracks.state[row, 3:5] == pytest.approx([-1.0, 0.0], abs=0.2)
    assert track_id in tracks.track_id


def test_what_is_beyond_the_body_is_on_the_others_side() -> None:
    extent, seen = np.array([2.0, 1.0]), np.array([3.0, 1.0])
    assert cut_surplus(extent, seen, np.array([1.0, 0.0]), np.array(1.0)).tolist() == [-0.5, 0.0]
    assert cut_surplus(extent, seen, np.array([-1.0, 0.5]), np.array(0.5)).tolist() == [0.25, 0.0]


def drive_past_a_post(step_m: float, merge_m: float = 0.5) -> tuple[np.ndarray, list[Tracks]]:
    """A box of 1.0 x 0.5 m drives 10 step_m a second past a post; both are one cluster while nearer than merge_m.
    Returns the box's true centres (n, 2) and each frame's tracks."""
    tracker, truth, history = Tracker(TrackingConfig(), Notes()), [], []
    post = (-0.05, 0.7, 0.05, 0.8)
    for k in range(round(9.0 / step_m)):
        x = -5.0 + step_m * k
        box = (x - 0.5, -0.25, x + 0.5, 0.25)
        gap = np.hypot(max(abs(x) - 0.55, 0.0), 0.45)
        both = (min(box[0], post[0]), box[1], max(box[2], post[2]), post[3])
        history.append(tracker(boxes(0.1 * k, [both] if gap < merge_m else [box, post])))
        truth.append((x, 0.0))
    return np.array(truth), history


@pytest.mark.parametrize("step_m", [0.2, 0.1])  # the slower one hides the post for longer than a track coasts
def test_a_vehicle_that_passes_a_post_stays_where_it_is_and_as_large(step_m: float) -> None:
    truth, history = drive_past_a_post(step_m)
    box = history[20].track_id[np.argmin(np.linalg.norm(history[20].state[:, :2] - truth[20], axis=1))]
    for frame, place in zip(history[20:], truth[20:], strict=True):
        row = np.flatnonzero(frame.track_id == box)
        assert len(row) == 1
        assert frame.status[row[0]] == TrackStatus.CONFIRMED
        assert frame.state[row[0], :2] == pytest.approx(place, abs=0.1)
        assert frame.radius_m[row[0]] < 0.57
    post = next(i for i in history[20].track_id if i != box)
    assert post in history[-1].track_id


def test_a_new_track_near_the_sensor_is_not_drawn_towards_it() -> None:
    """Its speed is unknown, so it may be as far off as it is away: no excuse for leaving where it is seen."""
    pose = np.eye(4)
    pose[:2, 3] = 0.0, -0.32
    rng = np.random.default_rng(100)
    for config in (TrackingConfig(), TrackingConfig(model="ct"), TrackingConfig(filter="ekf")):
        tracker = Tracker(config, Notes())
        for k in range(12):
            dx, dy = rng.normal(0.0, 0.005, 2)
            tracks = tracker(boxes(0.08 * k, [(dx - 0.19, dy, dx + 0.19, dy + 0.01)], pose))
            assert tracks.state[0, :2] == pytest.approx([0.0, 0.005], abs=0.03)


def test_a_new_track_soon_forgets_what_its_first_views_feigned() -> None:
    """Only a part of it is seen at first, as it comes out from behind something: its centre goes aside by 0.2 m."""
    tracker = Tracker(TrackingConfig(), Notes())
    for k in range(8):
        x, off = 0.1 * k, 0.2 * max(3 - k, 0) / 3
        seen = boxes(0.1 * k, [(x - 0.2, off - 0.2, x + 0.2, off + 0.2)])
        tracks = tracker(replace(seen, planar=False))
    assert tracks.state[0, 3:5] == pytest.approx([1.0, 0.0], abs=0.12)  # 0.22 m/s where it counts as keeping its course
    assert tracks.manoeuvre[0] < 0.3


def test_what_fades_away_does_not_start_to_move() -> None:
    """A low box sinks below the lowest beam: its last sightings go aside by 0.8 m a second, and it stands."""
    shifts = (0.01, 0.02, 0.03, 0.04, 0.12, 0.2, 0.28, 0.36)
    radii = (0.58, 0.55, 0.52, 0.49, 0.36, 0.3, 0.24, 0.21)
    tracker = Tracker(TrackingConfig(), Notes())
    for k, (shift, radius) in enumerate([(0.0, 0.6)] * 30 + list(zip(shifts, radii, strict=True))):
        half = radius / np.sqrt(2)
        seen = boxes(0.1 * k, [(2.0 - half, -shift - half, 2.0 + half, -shift + half)], np.eye(4))
        low = np.array([[2.0, -shift, -0.3]])
        seen = replace(seen, planar=False, centre_m=low, centre_sensor_m=low, height_m=np.array([0.4]))
        tracks = tracker(seen)
        assert tracks.is_static[0] or k < 29
    assert np.hypot(*(tracks.state[0, :2] - [2.0, 0.0])) < 0.1
