"""Circles and rectangles fitted to groups of points."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from adcbf_cli.core.perception.shapes import algebraic_circles, farthest, fit_circles, fit_yaw, rectangles_at

ONE = np.array([0])


def arc(x: float, y: float, radius: float, begin: float, end: float, n: int = 40) -> np.ndarray:
    angle = np.linspace(begin, end, n)
    return np.array([x, y]) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


@settings(max_examples=50, deadline=None)
@given(
    st.floats(-50, 50), st.floats(-50, 50), st.floats(0.05, 3.0), st.floats(-np.pi, np.pi), st.floats(0.6, 2 * np.pi)
)
def test_an_exact_arc_gives_its_circle(x: float, y: float, radius: float, begin: float, span: float) -> None:
    circle = fit_circles(arc(x, y, radius, begin, begin + span), ONE)
    np.testing.assert_allclose([*circle.centre_m[0], circle.radius_m[0]], [x, y, radius], atol=1e-6)
    assert circle.rms_m[0] < 1e-7
    expected = min(span, 2 * np.pi * 39 / 40)
    assert circle.arc_rad[0] == pytest.approx(expected, abs=0.16)


def test_noisy_half_circles_have_no_bias_to_speak_of() -> None:
    """A 0.48 m cylinder seen over 150 degrees with 0.03 m noise: below 3 mm on average, where the
    algebraic fit shrinks by far more than the geometric one."""
    rng = np.random.default_rng(0)
    clean = arc(6.0, 0.0, 0.48, np.pi - 1.3, np.pi + 1.3, 60)
    trials = [clean + rng.normal(0.0, 0.03, clean.shape) for _ in range(400)]
    start = 60 * np.arange(400)
    fitted = fit_circles(np.concatenate(trials), start)
    rough = algebraic_circles(np.concatenate(trials), start)
    bias = fitted.centre_m.mean(axis=0) - [6.0, 0.0]
    assert np.abs(bias).max() < 3e-3
    assert abs(fitted.radius_m.mean() - 0.48) < 3e-3
    assert abs(rough.radius_m.mean() - 0.48) > 2 * abs(fitted.radius_m.mean() - 0.48)


def test_the_fit_minimises_the_distance_to_the_circle() -> None:
    rng = np.random.default_rng(1)
    points = arc(2.0, 1.0, 0.7, 0.0, 2.0) + rng.normal(0.0, 0.02, (40, 2))
    found = least_squares(lambda p: np.hypot(*(points - p[:2]).T) - p[2], [2.0, 1.0, 0.7])
    circle = fit_circles(points, ONE)
    np.testing.assert_allclose([*circle.centre_m[0], circle.radius_m[0]], found.x, atol=1e-5)
    assert circle.rms_m[0] == pytest.approx(np.sqrt(np.mean(found.fun**2)), rel=1e-6)


def test_groups_do_not_mix_and_lines_have_no_circle() -> None:
    line = np.column_stack([np.linspace(0.0, 1.0, 10), np.zeros(10)])
    points = np.concatenate([arc(1.0, 2.0, 0.3, 0.0, 2.0), line, arc(-5.0, 0.0, 1.5, 1.0, 3.0), np.zeros((1, 2))])
    circle = fit_circles(points, np.array([0, 40, 50, 90]))
    np.testing.assert_allclose(circle.radius_m[[0, 2]], [0.3, 1.5], atol=1e-6)
    assert np.isnan(circle.radius_m[[1, 3]]).all()
    assert np.isnan(circle.centre_m[[1, 3]]).all()


@pytest.mark.parametrize("yaw_deg", [0.0, 17.0, 45.0, 80.0, 100.0, 163.0])
def test_two_sides_of_a_car_give_its_rectangle(yaw_deg: float) -> None:
    rng = np.random.default_rng(2)
    long_side = np.column_stack([np.linspace(-2.2, 2.2, 80), np.full(80, -0.9)])
    short_side = np.column_stack([np.full(30, -2.2), np.linspace(-0.9, 0.9, 30)])
    yaw = np.radians(yaw_deg)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    points = np.concatenate([long_side, short_side]) + rng.normal(0.0, 0.01, (110, 2))
    points = points @ turn.T + [12.0, 5.0]
    box = rectangles_at(points, ONE, fit_yaw(points, ONE, 0.05))
    np.testing.assert_allclose(box.centre_m[0], [12.0, 5.0], atol=0.06)
    np.testing.assert_allclose([box.length_m[0], box.width_m[0]], [4.4, 1.8], atol=0.12)
    assert abs((box.yaw_rad[0] - yaw + np.pi / 2) % np.pi - np.pi / 2) < np.radians(1.5)
    assert -np.pi / 2 < box.yaw_rad[0] <= np.pi / 2
    assert box.rms_m[0] < 0.03


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.floats(-np.pi, np.pi))
def test_rectangles_and_radii_enclose_all_points(seed: int, yaw: float) -> None:
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 30, 4)
    points = rng.normal(0.0, 3.0, (sizes.sum(), 2))
    start = np.cumsum(sizes) - sizes
    box = rectangles_at(points, start, np.full(4, yaw))
    radius = farthest(points, start, box.centre_m)
    for group, (begin, size) in enumerate(zip(start, sizes, strict=True)):
        offset = points[begin : begin + size] - box.centre_m[group]
        direction = np.array([np.cos(box.yaw_rad[group]), np.sin(box.yaw_rad[group])])
        along, across = offset @ direction, offset @ [-direction[1], direction[0]]
        assert np.abs(along).max() == pytest.approx(box.length_m[group] / 2, abs=1e-9)
        assert np.abs(across).max() == pytest.approx(box.width_m[group] / 2, abs=1e-9)
        assert radius[group] == pytest.approx(np.hypot(*offset.T).max())
    assert (box.length_m >= box.width_m).all()
