"""What the sensor cannot see since something nearer stands before it, and tracks that walk there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.frames import pose_matrix, transform_points
from adcbf_cli.core.tracking.hiding import is_hidden
from adcbf_cli.core.tracking.tracker import Tracker
from adcbf_cli.core.types import Clusters, FloatArray, Notes, Tracks, TrackStatus

Make = Callable[..., Clusters]

VAN = np.array([4.0, 0.0, 0.0])
"""Before a sensor in the origin: 2 m across the line of sight, 1 m deep."""


def van(make_clusters: Make, top_m: float = 1.0, yaw_rad: float = np.pi / 2) -> Clusters:
    clusters = make_clusters(0.0, [VAN], [1.1], height_m=2 * top_m)
    return replace(clusters, length_m=np.array([2.0]), width_m=np.array([1.0]), yaw_rad=np.array([yaw_rad]))


@pytest.mark.parametrize(
    ("place_m", "hidden"),
    [
        ([6.0, 0.0, 0.0], True),
        ([6.0, 1.4, 0.0], True),  # the nearer corner is at (3.5, 1)
        ([6.0, 1.8, 0.0], False),
        ([2.0, 0.0, 0.0], False),
        ([-6.0, 0.0, 0.0], False),
        ([6.0, 0.0, 1.4], True),  # the shadow is 1.5 m high there
        ([6.0, 0.0, 1.6], False),
    ],
)
def test_what_is_behind_and_in_the_shadow_is_hidden(make_clusters: Make, place_m: list[float], hidden: bool) -> None:
    assert is_hidden(np.array([place_m]), van(make_clusters)).tolist() == [hidden]


def test_a_shadow_falls_behind_what_ends_below_the_sensor(make_clusters: Make) -> None:
    kerb = make_clusters(0.0, [[4.0, 0.0, -0.7]], [1.0], height_m=0.2)
    assert is_hidden(np.array([[6.0, 0.0, -0.95], [6.0, 0.0, -0.5]]), kerb).tolist() == [True, False]


def test_the_rectangles_direction_counts(make_clusters: Make) -> None:
    """Seen end on, the same van hides less."""
    beside = np.array([[6.0, 1.2, 0.0]])
    assert is_hidden(beside, van(make_clusters)).tolist() == [True]
    assert is_hidden(beside, van(make_clusters, yaw_rad=0.0)).tolist() == [False]


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, np.pi, -2.5])
def test_it_does_not_matter_where_the_world_has_its_origin(make_clusters: Make, heading_rad: float) -> None:
    """Behind the sensor too, where bearings wrap."""
    pose = pose_matrix(
        np.array([30.0, -7.0, 2.0]), np.array([0.0, 0.0, np.sin(heading_rad / 2), np.cos(heading_rad / 2)])
    )
    places = np.random.default_rng(0).uniform([3.0, -3.0, -1.0], [8.0, 3.0, 2.0], (200, 3))
    plain = van(make_clusters)
    turned = replace(
        plain,
        world_from_sensor=pose,
        centre_m=transform_points(pose, plain.centre_m),
        yaw_rad=plain.yaw_rad + heading_rad,
    )
    expected = is_hidden(places, plain)
    assert 40 < np.count_nonzero(expected) < 160
    assert np.array_equal(is_hidden(transform_points(pose, places), turned), expected)


def test_nothing_hides_nothing(make_clusters: Make) -> None:
    assert is_hidden(np.zeros((0, 3)), van(make_clusters)).shape == (0,)
    assert is_hidden(np.zeros((2, 3)), make_clusters(0.0, np.zeros((0, 3)))).tolist() == [False, False]


def walked(make_clusters: Make, unseen: range, post: list[float] | None, frames: int) -> list[Tracks]:
    """A walker along y = 6 m at 1 m/s, unseen in some frames; and what stands 3 m before the sensor."""
    tracker, history = Tracker(TrackingConfig(), Notes()), []
    for k in range(frames):
        walker: list[FloatArray] = [] if k in unseen else [np.array([-2.0 + 0.1 * k, 6.0, 0.0])]
        stands = [] if post is None else [np.array(post)]
        radii = [0.25] * len(walker) + [0.6] * len(stands)
        history.append(tracker(make_clusters(0.1 * k, np.array(walker + stands).reshape(-1, 3), radii, index=k)))
    return history


POST = [0.0, 3.0, 0.0]


def test_who_walks_behind_something_is_the_same_when_seen_again(make_clusters: Make) -> None:
    """1.8 s behind it, longer than an unseen track goes on: same id, velocity known at once."""
    history = walked(make_clusters, range(11, 29), POST, 31)
    walker = history[10].track_id[np.argmax(history[10].state[:, 1])]
    back = history[29]
    row = int(np.flatnonzero(back.track_id == walker)[0])
    assert back.status[row] == TrackStatus.CONFIRMED
    assert back.state[row, 3:5] == pytest.approx([1.0, 0.0], abs=0.1)


@pytest.mark.parametrize("post", [None, [0.0, 3.0, -1.5]])
def test_who_is_not_hidden_has_gone_as_soon_as_ever(make_clusters: Make, post: list[float] | None) -> None:
    """With nothing before it, or what is too low to hide it."""
    history = walked(make_clusters, range(11, 40), post, 31)
    walker = history[10].track_id[np.argmax(history[10].state[:, 1])]
    assert walker in history[20].track_id
    assert walker not in history[22].track_id


def test_who_stays_hidden_is_given_up(make_clusters: Make) -> None:
    """A second as without a post, and two more."""
    tracker = Tracker(TrackingConfig(), Notes())
    alive = []
    for k in range(80):
        things = [[0.0, 6.0, 0.0], POST] if k < 15 else [POST]
        tracks = tracker(make_clusters(0.1 * k, things, [0.25, 0.6][-len(things) :]))
        alive.append(bool(((tracks.state[:, 1] > 5) & (tracks.status != TrackStatus.ENDED)).any()))
    last_s = 0.1 * (np.flatnonzero(alive)[-1] - 14)
    assert last_s == pytest.approx(3.0, abs=0.11)
