"""Pieces of long walls are known as such; pieces of cars are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.structures import wall_pieces
from adcbf_cli.core.tracking.tracker import Tracker
from adcbf_cli.core.types import Clusters, Notes


def test_length_decides(make_clusters: Callable[..., Clusters]) -> None:
    wall = [[x, 3.0] for x in (-3.0, -1.5, 0.0, 1.5, 3.0)]
    car = [[8.0, y] for y in (0.0, 1.5, 3.0)]
    clusters = make_clusters(0.0, [*wall, *car, [5, 5]], 0.75, split_from=[7] * 5 + [9] * 3 + [-1])
    piece, spread = wall_pieces(clusters, 6.0)
    assert piece.tolist() == [True] * 5 + [False] * 4
    assert np.abs(spread[:5]) == pytest.approx(np.tile([0.75, 0, 0], (5, 1))), "along the wall"
    assert not spread[5:].any()


def test_pieces_that_slide_along_a_wall_stand_still(make_clusters: Callable[..., Clusters]) -> None:
    """Under an ego at 1 m/s the crop, and with it every piece of an endless wall, moves at 1 m/s."""
    tracker = Tracker(TrackingConfig(), Notes())
    for k in range(40):
        pose = np.eye(4)
        pose[0, 3] = 0.1 * k
        centres = [[0.1 * k + x, 3.0] for x in (-3.0, -1.5, 0.0, 1.5, 3.0)]
        tracks = tracker(make_clusters(0.1 * k, centres, 0.75, world_from_sensor=pose, split_from=[1] * 5))
    seen = tracks.hits > 10
    assert seen.sum() >= 3
    assert tracks.is_static[seen].all()
    assert np.abs(tracks.state[seen, 3:5]).max() < 0.2


def test_pieces_of_a_car_move_with_it(make_clusters: Callable[..., Clusters]) -> None:
    tracker = Tracker(TrackingConfig(), Notes())
    for k in range(30):
        centres = [[5 * 0.1 * k + x, 3.0] for x in (0.0, 1.5, 3.0)]
        tracks = tracker(make_clusters(0.1 * k, centres, 0.8, split_from=[1] * 3))
    assert not tracks.is_static.any()
    assert tracks.state[:, 3] == pytest.approx([5, 5, 5], abs=0.2)
