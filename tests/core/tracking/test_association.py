"""Assignment within gates: optimal, size-consistent, deterministic."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.association import assign, gate_chi2, size_agreement
from adcbf_cli.core.tracking.measurement import Cartesian

PLANE = Cartesian(planar=True)
CONFIG = TrackingConfig(filter="kf")


def pairs(expected: object, measured: object, sigma: object = 1.0, radius: object = 0.3) -> list[tuple[int, int]]:
    tracks, clusters = np.asarray(expected, float).reshape(-1, 2), np.asarray(measured, float).reshape(-1, 2)
    variance = np.broadcast_to(np.asarray(sigma, float), (len(tracks),)) ** 2
    rows, columns = assign(
        tracks,
        variance[:, None, None] * np.eye(2),
        np.broadcast_to(np.asarray(radius, float), (len(tracks),)),
        clusters,
        np.full(len(clusters), 0.3),
        PLANE,
        CONFIG,
    )
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True)]


def test_gate_is_the_chi_square_quantile() -> None:
    """Two degrees of freedom: -2 ln(1 - p)."""
    assert gate_chi2(2, 0.99) == pytest.approx(-2 * np.log(0.01))
    assert gate_chi2(3, 0.95) == pytest.approx(7.814728, abs=1e-6)


def test_a_greedy_choice_would_be_wrong() -> None:
    """The closest pair (track 0, cluster 1) would leave track 1 alone."""
    assert pairs([[0, 0], [2.5, 0]], [[-1.5, 0], [1.0, 0]]) == [(0, 0), (1, 1)]


@pytest.mark.parametrize("seed", range(8))
def test_cost_is_the_least_of_all_assignments(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tracks, clusters = rng.uniform(0, 2, (4, 2)), rng.uniform(0, 2, (4, 2))
    chosen = pairs(tracks, clusters)
    squared = ((tracks[:, None] - clusters[None]) ** 2).sum(-1)
    best = min(sum(squared[i, p[i]] for i in range(4)) for p in itertools.permutations(range(4)))
    assert len(chosen) == 4
    assert sum(squared[i, j] for i, j in chosen) == pytest.approx(best)


def test_nothing_beyond_the_gate() -> None:
    edge = np.sqrt(gate_chi2(2, CONFIG.gate_probability))
    assert pairs([[0, 0]], [[edge - 1e-6, 0]]) == [(0, 0)]
    assert pairs([[0, 0]], [[edge + 1e-6, 0]]) == []


def test_two_tracks_one_cluster_the_likelier_takes_it() -> None:
    """At equal distance the sure track's density is higher: 1 / sigma^2 counts."""
    assert pairs([[-0.5, 0], [0.5, 0]], [[0, 0]], sigma=[0.5, 3.0]) == [(0, 0)]
    assert pairs([[-0.5, 0], [0.5, 0]], [[0, 0]], sigma=[3.0, 0.5]) == [(1, 0)]


def test_a_much_larger_cluster_is_another_obstacle() -> None:
    """0.3 m against 1.2 m differs by the factor 4 and by 0.9 m; 0.1 against 0.35 by a factor only."""
    assert pairs([[0, 0]], [[0, 0]], radius=1.2) == []
    assert pairs([[0, 0]], [[0, 0]], radius=0.05) == [(0, 0)]
    cost, fits = size_agreement(np.array([0.3]), np.array([0.3, 0.9, 0.91, 5.0]), CONFIG)
    assert fits[0].tolist() == [True, True, False, False]
    assert cost[0] == pytest.approx([0.0, 9.0, 9.0, 9.0])


def test_ties_are_broken_alike_every_time() -> None:
    tracks, clusters = [[0, 0], [0, 0], [2, 0]], [[1, 0], [1, 0], [1, 0]]
    assert len({tuple(pairs(tracks, clusters)) for _ in range(5)}) == 1


def test_nothing_to_assign() -> None:
    assert pairs(np.zeros((0, 2)), [[0, 0]]) == []
    assert pairs([[0, 0]], np.zeros((0, 2))) == []
