"""The path to follow and the horizon taken from it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.types import FloatArray

CORNER = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]])

FIGURE_OF_EIGHT = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 4.0], [2.0, -4.0]])
"""Crosses itself at (2, 0): at 2 m and, coming down, at 14 m."""

points = st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=2, max_size=8).map(np.array)


def test_arc_lengths_and_places() -> None:
    path = ReferencePath(CORNER, 0.75)
    assert path.length_m == 7.0
    np.testing.assert_array_equal(path.goal_m, [3.0, 4.0])
    places = path.at(np.array([-1.0, 1.5, 3.0, 5.0, 9.0]))
    np.testing.assert_allclose(
        places,
        [[0, 0, 0], [1.5, 0, 0], [3, 0, np.pi / 2], [3, 2, np.pi / 2], [3, 4, np.pi / 2]],
        atol=1e-12,
    )


def test_points_too_close_are_left_out_and_the_last_that_is_kept_is_the_goal() -> None:
    path = ReferencePath(np.array([[0, 0], [0.01, 0], [0.015, 0.01], [1, 0], [1, 0.005]]), 0.75)
    np.testing.assert_array_equal(path.points_m, [[0, 0], [1, 0]])


BAD = {
    "one point": (np.array([[1.0, 2.0]]), "single point"),
    "none": (np.zeros((0, 2)), "single point"),
    "standing": (np.full((50, 2), 3.0), "single point"),
    "not finite": (np.array([[0.0, 0.0], [np.nan, 1.0]]), "not finite"),
}


@pytest.mark.parametrize(("given_points", "message"), BAD.values(), ids=BAD)
def test_what_is_no_path_is_refused(given_points: FloatArray, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        ReferencePath(given_points, 0.75)


def test_nearest() -> None:
    path = ReferencePath(CORNER, 0.75)
    assert path.nearest(np.array([1.2, -0.7])) == pytest.approx(1.2)
    assert path.nearest(np.array([2.5, 2.0])) == pytest.approx(5.0)
    assert path.nearest(np.array([-5.0, 1.0])) == 0.0
    assert path.nearest(np.array([3.3, 9.0])) == pytest.approx(7.0)
    assert path.nearest(np.array([3.5, -0.5])) == pytest.approx(3.0)


def test_a_crossing_is_not_a_short_cut() -> None:
    path = ReferencePath(FIGURE_OF_EIGHT, 0.75)
    beside = np.array([2.1, 0.15])
    assert path.nearest(beside) == pytest.approx(13.85)
    assert path.nearest(beside, around_m=1.8) == pytest.approx(2.1)
    assert path.nearest(beside, around_m=13.0) == pytest.approx(13.85)


def test_the_window_ends_within_a_leg() -> None:
    path = ReferencePath(np.array([[0.0, 0.0], [100.0, 0.0]]), 0.75)
    assert path.nearest(np.array([50.0, 1.0]), around_m=10.0, window_m=3.0) == pytest.approx(13.0)
    assert path.nearest(np.array([0.0, 1.0]), around_m=10.0, window_m=3.0) == pytest.approx(7.0)


@settings(max_examples=60, deadline=None)
@given(points, st.floats(-25, 25), st.floats(-25, 25))
def test_nearest_is_the_nearest(corners: FloatArray, x: float, y: float) -> None:
    if np.hypot(*np.diff(corners, axis=0).T).max() < 0.1:
        return
    path, point = ReferencePath(corners, 0.75), np.array([x, y])
    along = path.nearest(point)
    dense = path.at(np.linspace(0, path.length_m, 5001))[:, :2]
    here = path.at(np.array([along]))[0, :2]
    distance = np.hypot(*(here - point))
    assert distance <= np.hypot(*(dense - point).T).min() + 1e-9
    np.testing.assert_allclose(path.distance(point[None]), [distance], atol=1e-9)


@settings(max_examples=80, deadline=None)
@given(points, st.tuples(st.floats(-25, 25), st.floats(-25, 25)), st.floats(0, 1), st.floats(0.1, 30))
def test_nearest_within_a_window_is_the_nearest_there(
    corners: FloatArray, place: tuple[float, float], share: float, window_m: float
) -> None:
    if np.hypot(*np.diff(corners, axis=0).T).max() < 0.1:
        return
    path, point = ReferencePath(corners, 0.75), np.array(place)
    around_m = share * path.length_m
    low, high = max(around_m - window_m, 0.0), min(around_m + window_m, path.length_m)
    along = path.nearest(point, around_m, window_m)
    assert low - 1e-9 <= along <= high + 1e-9
    gap = path.at(np.append(np.linspace(low, high, 3001), along))[:, :2] - point
    distance = np.hypot(gap[:, 0], gap[:, 1])
    assert distance[-1] <= distance[:-1].min() + 1e-9


def test_a_horizon_goes_on_at_the_paths_speed() -> None:
    path = ReferencePath(np.array([[0.0, 0.0], [100.0, 0.0]]), 0.8)
    horizon = path.horizon(np.zeros(3), 10.0, 30, 0.1, brake_mps2=1.0)
    assert horizon.shape == (31, 5)
    np.testing.assert_allclose(horizon[:, 0], 10.0 + 0.08 * np.arange(31))
    np.testing.assert_allclose(horizon[:, 1:3], 0.0)
    np.testing.assert_allclose(horizon[:, 3], 0.8)
    np.testing.assert_array_equal(horizon[:, 4], 0.0)


def test_a_horizon_stands_at_the_paths_end() -> None:
    path = ReferencePath(CORNER, 0.75)
    horizon = path.horizon(np.zeros(3), 6.6, 60, 0.1, brake_mps2=0.5)
    assert (np.diff(horizon[:, 1]) >= 0).all()
    np.testing.assert_allclose(horizon[-1, :2], [3.0, 4.0], atol=1e-12)
    assert horizon[-1, 3] == 0.0
    left = 4.0 - horizon[:, 1]
    assert (horizon[:, 3] <= np.sqrt(2 * 0.5 * left) + 1e-9).all()
    np.testing.assert_allclose(path.horizon(np.zeros(3), 9.0, 5, 0.1, 0.5)[:, 3], 0.0)


@settings(max_examples=60, deadline=None)
@given(points, st.floats(-30, 30), st.floats(0, 1))
def test_a_horizons_yaw_is_continuous_and_begins_near_the_poses(corners: FloatArray, yaw: float, share: float) -> None:
    if np.hypot(*np.diff(corners, axis=0).T).max() < 0.1:
        return
    path = ReferencePath(corners, 1.0)
    horizon = path.horizon(np.array([0.0, 0.0, yaw]), share * path.length_m, 40, 0.2, 1.0)
    assert abs(horizon[0, 2] - yaw) <= np.pi + 1e-9
    assert (np.abs(np.diff(horizon[:, 2])) <= np.pi + 1e-9).all()
    tangent = path.at(share * path.length_m + np.zeros(1))[0, 2]
    assert np.cos(horizon[0, 2] - tangent) == pytest.approx(1.0)


def test_a_full_turn_keeps_counting() -> None:
    angle = np.linspace(0, 2 * np.pi, 200)
    path = ReferencePath(np.column_stack([np.sin(angle), 1 - np.cos(angle)]), 1.0)
    horizon = path.horizon(np.array([0.0, 0.0, 4 * np.pi]), 0.0, 70, 0.1, 100.0)
    assert horizon[0, 2] == pytest.approx(4 * np.pi, abs=0.05)
    assert horizon[60, 2] == pytest.approx(4 * np.pi + 6.0, abs=0.1)
