"""The plan-view grid and outlier removal."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.perception.grid import not_outlying, occupied_cells


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 300))
def test_cells_partition_the_points_and_hold_their_means(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points, origin = rng.normal(0.0, 1.0, (n, 2)), rng.uniform(-1e3, 1e3, 2)
    cells = occupied_cells(points, 0.25, origin)
    keys = [tuple(key) for key in np.floor((points + np.mod(origin, 0.25)) / 0.25).astype(int).tolist()]
    assert len(set(keys)) == len(cells)
    for key in set(keys):
        members = np.array([other == key for other in keys])
        own = np.unique(cells.point_cell[members])
        assert len(own) == 1
        np.testing.assert_allclose(cells.mean_m[own[0]], points[members].mean(axis=0), atol=1e-12)


def test_a_stray_cell_goes_and_the_ends_of_a_wall_stay() -> None:
    wall = np.column_stack([np.arange(200) * 0.1, np.zeros(200)])
    stray = np.array([[10.0, 6.0]])
    keep = not_outlying(np.concatenate([wall, stray]), 4, 2.0, 0.1)
    assert keep[:200].all()
    assert not keep[200]


def test_a_cell_that_was_hit_several_times_is_no_stray() -> None:
    """Alone, and far from the wall: with five returns its four nearest others are its own. With four, the
    fourth is in the wall 6 m away, on average 1.5 m; with three, two are, on average 3 m. The limit is 0.5 m."""
    wall = np.column_stack([np.arange(400) * 0.1, np.zeros(400)])
    cells = np.concatenate([wall, np.array([[20.0, 6.0]])])
    for hits, stays in ((1, False), (3, False), (4, False), (5, True), (50, True)):
        returns = np.ones(401, dtype=np.int64)
        returns[400] = hits
        keep = not_outlying(cells, 4, 0.0, 0.1, returns)
        assert keep[:400].all()
        assert keep[400] == stays


def test_single_returns_are_judged_as_cells_are() -> None:
    cells = np.random.default_rng(0).uniform(0.0, 8.0, (200, 2))
    ones = np.ones(200, dtype=np.int64)
    kept = not_outlying(cells, 4, 1.0, 0.1)
    assert 0 < kept.sum() < 200
    np.testing.assert_array_equal(not_outlying(cells, 4, 1.0, 0.1, ones), kept)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000))
def test_more_returns_never_make_a_stray(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells, returns = rng.uniform(0.0, 8.0, (150, 2)), rng.integers(1, 6, 150)
    fewer, more = (not_outlying(cells, 4, 1.0, 0.1, some) for some in (returns, returns + rng.integers(0, 4, 150)))
    assert not (fewer & ~more).any()


def test_returns_count_the_points_of_each_cell() -> None:
    cells = occupied_cells(np.array([[0.05, 0.05], [0.55, 0.05], [0.06, 0.01], [0.02, 0.09]]), 0.1)
    np.testing.assert_array_equal(cells.returns(), [3, 1])


def test_few_cells_all_stay() -> None:
    assert not_outlying(np.array([[0.0, 0.0], [50.0, 0.0]]), 4, 2.0, 0.1).all()
    assert len(occupied_cells(np.zeros((0, 2)), 0.1)) == 0
