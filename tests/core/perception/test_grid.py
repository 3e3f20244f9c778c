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


def test_few_cells_all_stay() -> None:
    assert not_outlying(np.array([[0.0, 0.0], [50.0, 0.0]]), 4, 2.0, 0.1).all()
    assert len(occupied_cells(np.zeros((0, 2)), 0.1)) == 0
