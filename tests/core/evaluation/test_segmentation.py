"""Segmentation scores on hand-made frames."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.evaluation.segmentation import Segmentation, inflated_area, points_in_box, segmentation
from adcbf_cli.core.types import NO_ID


def test_every_kind_of_outcome() -> None:
    """Object 0 whole; 1 in three thirds (over); 2 swallowed by a cluster four times its size (under);
    3 in no cluster (missed); 4 half in noise and still half together (right)."""
    label = [0] * 4 + [1, 2, 3] + [4] * 2 + [4] * 6 + [NO_ID] * 3 + [5, 5, NO_ID, NO_ID]
    belongs = [0] * 4 + [1, 1, 1] + [2] * 2 + [NO_ID] * 6 + [3] * 3 + [4, 4, 4, 4]
    score = segmentation(np.array(label), np.array(belongs))
    assert score == Segmentation(objects=5, missed=1, over=1, under=1)
    assert score + score == Segmentation(10, 2, 2, 2)


def test_without_objects_or_clusters() -> None:
    nothing = np.zeros(0, dtype=np.int64)
    assert segmentation(nothing, nothing) == Segmentation()
    assert segmentation(np.full(3, NO_ID), np.zeros(3, dtype=np.int64)) == Segmentation(objects=1, missed=1)


def test_points_in_a_turned_box() -> None:
    points = np.array([[1.0, 1.0], [2.0, 2.0], [0.0, 2.0], [2.5, 2.5]])
    inside = points_in_box(points, np.array([1.0, 1.0]), np.pi / 4, 3.0, 1.0)
    np.testing.assert_array_equal(inside, [True, True, False, False])
    grown = points_in_box(points, np.array([1.0, 1.0]), np.pi / 4, 3.0, 1.0, margin_m=1.0)
    np.testing.assert_array_equal(grown, [True, True, True, True])


def test_inflated_area_is_the_union_without_the_footprint() -> None:
    circles = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [3.0, 0.0, 0.0]])
    radius = np.array([1.0, 1.0, 0.5])
    whole = inflated_area(circles, radius, np.zeros((0, 2)), 0.05, 5.0)
    assert whole == pytest.approx(np.pi * 1.25, rel=0.01)
    footprint = np.array([[0.01, 0.01], [0.02, 0.02], [0.31, 0.01], [4.0, 4.0]])
    assert inflated_area(circles, radius, footprint, 0.05, 5.0) == pytest.approx(whole - 2 * 0.05**2)
    outside = inflated_area(np.array([[5.0, 0.0]]), np.array([1.0]), np.zeros((0, 2)), 0.05, 5.0)
    assert outside == pytest.approx(np.pi / 2, rel=0.02)
