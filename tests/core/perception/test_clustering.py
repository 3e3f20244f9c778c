"""HDBSCAN and DBSCAN against scikit-learn and against the textbook definition."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.cluster import DBSCAN, HDBSCAN

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.perception import clustering
from adcbf_cli.core.perception.clustering import dbscan, hdbscan
from adcbf_cli.core.types import NO_ID

ALL = 1e6
"""A gap that joins everything."""


def blobs(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.concatenate(
        [
            rng.normal(rng.uniform(-3, 3, 2), rng.uniform(0.1, 1.0), (rng.integers(10, 60), 2))
            for _ in range(rng.integers(1, 5))
        ]
    )


def same_partition(one: np.ndarray, other: np.ndarray) -> bool:
    """Equal up to the clusters' names; noise is noise in both."""
    pairs = set(zip(one.tolist(), other.tolist(), strict=True))
    noise_agrees = bool(((one == NO_ID) == (other == NO_ID)).all())
    return noise_agrees and len(pairs) == len(set(one.tolist())) == len(set(other.tolist()))


def by_definition(points: np.ndarray, smallest: int, samples: int, max_gap: float) -> tuple[np.ndarray, np.ndarray]:
    """HDBSCAN* from its definition, slowly: the connected components of the mutual reachability graph
    at every distance, from the widest to the narrowest, are the hierarchy."""
    n = len(points)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    core = np.sort(distance, axis=1)[:, samples - 1]
    reach = np.maximum(distance, np.maximum(core[:, None], core[None]))
    np.fill_diagonal(reach, 0.0)

    def components(members: np.ndarray, below: float, inclusive: bool) -> list[np.ndarray]:
        left, found = set(members.tolist()), []
        while left:
            stack, seen = [min(left)], {min(left)}
            while stack:
                here = stack.pop()
                for there in left - seen:
                    if reach[here, there] < below or (inclusive and reach[here, there] == below):
                        seen.add(there)
                        stack.append(there)
            found.append(np.array(sorted(seen)))
            left -= seen
        return found

    label, probability = np.full(n, NO_ID), np.zeros(n)

    def grow(members: np.ndarray, birth: float) -> tuple[float, list[tuple[np.ndarray, np.ndarray]]]:
        """Best stability below and including this cluster, and the clusters that reach it."""
        left, mass, at_leave = members, 0.0, np.zeros(n)
        while True:
            inside = reach[np.ix_(left, left)]
            longest = next(w for w in np.unique(inside[inside > 0])[::-1] if len(components(left, w, False)) > 1)
            parts = components(left, longest, False)
            big = [part for part in parts if len(part) >= smallest]
            for part in parts:
                if len(big) != 1 or part is not big[0]:
                    mass += len(part) / longest
                    at_leave[part] = 1 / longest
            if len(big) == 1:
                left = big[0]
                continue
            own = mass - len(members) * birth
            below = [grow(part, 1 / longest) for part in big]
            lower = sum(score for score, _ in below)
            for part, (_, _) in zip(big, below, strict=True):
                at_leave[part] = 1 / longest
            if own >= lower:
                return own, [(members, np.minimum(at_leave[members] * longest, 1.0))]
            return lower, [taken for _, chosen in below for taken in chosen]

    name = 0
    for part in components(np.arange(n), max_gap, True):
        if len(part) >= smallest:
            for members, strength in grow(part, 1 / max_gap)[1]:
                label[members], probability[members] = name, strength
                name += 1
    return label, probability


@pytest.mark.parametrize("seed", range(40))
def test_equals_scikit_learn_on_one_connected_cloud(seed: int) -> None:
    """With min_samples 1 there are no ties, and both are defined to agree. Where scikit-learn takes
    the root it labels by a rule of its own, so that only the count of clusters is compared."""
    points = blobs(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        theirs = HDBSCAN(min_cluster_size=5, min_samples=1, allow_single_cluster=True).fit(points)
    ours = hdbscan(points, min_cluster_size=5, min_samples=1, min_gap_m=0.0, max_gap_m=ALL)
    if theirs.labels_.max() == 0:
        assert set(ours.label.tolist()) == {0}
    else:
        assert same_partition(ours.label, theirs.labels_)
        np.testing.assert_allclose(ours.probability, theirs.probabilities_, rtol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_lower_gap_is_scikit_learns_cluster_selection_epsilon(seed: int) -> None:
    half = blobs(seed)
    points = np.concatenate([half, half + np.array([50.0, 0.0])])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)
        try:
            theirs = HDBSCAN(min_cluster_size=5, min_samples=1, cluster_selection_epsilon=0.3).fit(points)
        except TypeError:
            pytest.skip("this scikit-learn fails on its own epsilon search with this numpy")
    ours = hdbscan(points, min_cluster_size=5, min_samples=1, min_gap_m=0.3, max_gap_m=ALL)
    assert same_partition(ours.label, theirs.labels_)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("samples", "max_gap"), [(1, 0.7), (3, 0.7), (3, 1.5), (4, ALL)])
def test_equals_the_definition(seed: int, samples: int, max_gap: float) -> None:
    points = blobs(seed)[::3]
    label, probability = by_definition(points, 5, samples, max_gap)
    ours = hdbscan(points, min_cluster_size=5, min_samples=samples, min_gap_m=0.0, max_gap_m=max_gap)
    assert same_partition(ours.label, label)
    np.testing.assert_allclose(ours.probability, probability, rtol=1e-9)


def test_far_points_change_nothing() -> None:
    near, far = blobs(1), blobs(2) + np.array([100.0, 0.0])
    settings_ = {"min_cluster_size": 5, "min_samples": 3, "min_gap_m": 0.3, "max_gap_m": 1.0}
    alone, together = hdbscan(near, **settings_), hdbscan(np.concatenate([near, far]), **settings_)
    np.testing.assert_array_equal(together.label[: len(near)], alone.label)
    np.testing.assert_array_equal(together.probability[: len(near)], alone.probability)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.floats(-3.0, 3.0), st.booleans())
def test_order_and_place_do_not_matter(seed: int, turn: float, use_dbscan: bool) -> None:
    points = blobs(seed)
    shuffled = np.random.default_rng(seed).permutation(len(points))
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def cluster(xy: np.ndarray) -> np.ndarray:
        if use_dbscan:
            return dbscan(xy, eps_m=0.4, min_samples=3, min_cluster_size=5).label
        return hdbscan(xy, min_cluster_size=5, min_samples=3, min_gap_m=0.3, max_gap_m=1.0).label

    moved = np.round(points, 4)[shuffled]
    assert same_partition(cluster(np.round(points, 4))[shuffled], cluster(moved))
    assert (cluster(moved) == NO_ID).sum() == (cluster(moved @ rotation.T + [5.0, -7.0]) == NO_ID).sum()


def test_gaps() -> None:
    """A row of five points each 0.1 m; the second row begins 0.25, 0.6 or 1.2 m after the first."""
    row = np.column_stack([np.arange(6) * 0.1, np.zeros(6)])
    settings_ = {"min_cluster_size": 5, "min_samples": 2, "min_gap_m": 0.3, "max_gap_m": 1.0}
    for gap, clusters in ((0.25, 1), (0.6, 2), (1.2, 2)):
        points = np.concatenate([row, row + np.array([0.5 + gap, 0.0])])
        assert hdbscan(points, **settings_).label.max() + 1 == clusters


def test_a_stray_beside_a_dense_obstacle_is_noise_and_one_within_the_lower_gap_is_not() -> None:
    row = np.column_stack([np.arange(10) * 0.1, np.zeros(10)])
    points = np.concatenate([row, np.array([[1.6, 0.0], [0.5, 0.25]])])
    settings_ = {"min_cluster_size": 5, "min_samples": 2, "min_gap_m": 0.3, "max_gap_m": 1.0}
    assert (hdbscan(points, **settings_).label == 0).all()
    grouping = hdbscan(points, **settings_, min_probability=0.3)
    np.testing.assert_array_equal(grouping.label, [0] * 10 + [NO_ID, 0])
    assert grouping.probability[10] == 0.0
    assert (hdbscan(3 * points, **{**settings_, "max_gap_m": 3.0}, min_probability=0.1).label == 0).all()


SMALL = {
    "hdbscan": lambda points, returns: hdbscan(
        points, min_cluster_size=5, min_samples=2, min_gap_m=0.3, max_gap_m=1.0, min_probability=0.3, returns=returns
    ),
    "dbscan": lambda points, returns: dbscan(points, eps_m=0.3, min_samples=2, min_cluster_size=5, returns=returns),
}


@pytest.mark.parametrize("method", SMALL)
@pytest.mark.parametrize(
    ("places", "returns", "found"),
    [
        ([0.0, 0.1], [3, 2], True),
        ([0.0, 0.1], [2, 2], False),
        ([0.0, 0.25, 0.5], [2, 1, 2], True),
        ([0.0, 0.4], [4, 4], False),
        ([0.0], [40], False),
    ],
)
def test_a_small_obstacle_is_five_returns_in_two_cells(
    method: str, places: list[float], returns: list[int], found: bool
) -> None:
    """Beside an obstacle of ten cells, at 0.8 m from it and at 8 m, and without it."""
    small = np.column_stack([np.array(places), np.zeros(len(places))])
    large = np.column_stack([np.arange(10) * 0.1, np.full(10, -0.8)])
    hits = np.array(returns)
    for away in (0.0, 7.2):
        points = np.concatenate([large - [0.0, away], small])
        grouping = SMALL[method](points, np.concatenate([np.ones(10, dtype=np.int64), hits]))
        np.testing.assert_array_equal(grouping.label, [0] * 10 + [1 if found else NO_ID] * len(small))
        np.testing.assert_array_equal(grouping.probability[10:], float(found))
    np.testing.assert_array_equal(SMALL[method](small, hits).label, 0 if found else NO_ID)


@pytest.mark.parametrize("method", SMALL)
@pytest.mark.parametrize("seed", range(20))
def test_small_obstacles_leave_the_others_as_they_are(method: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.concatenate([blobs(seed), rng.uniform(-5.0, 5.0, (40, 2))])
    plain = SMALL[method](points, None)
    by_returns = SMALL[method](points, rng.integers(1, 8, len(points)))
    before, after = plain.label != NO_ID, by_returns.label != NO_ID
    assert same_partition(plain.label[before], by_returns.label[before])
    assert not set(by_returns.label[before].tolist()) & set(by_returns.label[~before & after].tolist())
    np.testing.assert_array_equal(by_returns.probability[before], plain.probability[before])
    assert set(by_returns.label[after].tolist()) == set(range(by_returns.label.max() + 1))


@pytest.mark.parametrize("seed", range(20))
def test_dbscan_equals_scikit_learn(seed: int) -> None:
    points = blobs(seed)
    theirs = DBSCAN(eps=0.35, min_samples=4).fit(points)
    ours = dbscan(points, eps_m=0.35, min_samples=4, min_cluster_size=2)
    core = theirs.core_sample_indices_
    assert same_partition(ours.label[core], theirs.labels_[core])
    np.testing.assert_array_equal(ours.label == NO_ID, theirs.labels_ == NO_ID)
    border = np.setdiff1d(np.flatnonzero(ours.label != NO_ID), core)
    for point in border:
        nearest = core[np.argmin(np.linalg.norm(points[core] - points[point], axis=1))]
        assert ours.label[point] == ours.label[nearest]


@pytest.mark.parametrize("n", [0, 1, 4])
def test_too_few_points_are_noise(n: int) -> None:
    points = np.zeros((n, 2))
    assert (hdbscan(points, min_cluster_size=5, min_samples=3, min_gap_m=0.3, max_gap_m=1.0).label == NO_ID).all()
    assert (dbscan(points, eps_m=0.5, min_samples=3, min_cluster_size=5).label == NO_ID).all()


def test_coincident_points_are_one_cluster() -> None:
    grouping = hdbscan(np.zeros((20, 2)), min_cluster_size=5, min_samples=3, min_gap_m=0.0, max_gap_m=1.0)
    assert (grouping.label == 0).all()
    np.testing.assert_array_equal(grouping.probability, 1.0)


def test_a_cloud_too_dense_for_the_graph_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clustering, "MAX_PAIRS", 1000)
    with pytest.raises(AdcbfError, match="cell_m"):
        hdbscan(np.zeros((100, 2)), min_cluster_size=5, min_samples=3, min_gap_m=0.3, max_gap_m=1.0)


def test_points_that_are_all_apart_are_noise() -> None:
    points = 5.0 * np.arange(6.0)[:, None] * [1.0, 0.5]
    grouping = hdbscan(points, min_cluster_size=3, min_samples=3, min_gap_m=0.3, max_gap_m=1.0)
    assert (grouping.label == NO_ID).all()
    assert (grouping.probability == 0.0).all()
