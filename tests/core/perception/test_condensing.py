"""The condensed tree by hand, against its definition from the top down, and compiled against as it stands."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.perception import condensing
from adcbf_cli.core.perception.condensing import NONE, Condensed, condense

Edge = tuple[int, int, float]


def tree_of(edges: list[Edge], n: int, smallest: int) -> Condensed:
    ordered = sorted(edges, key=lambda edge: -edge[2])
    first, second = (np.array([edge[k] for edge in ordered], dtype=np.int64) for k in (0, 1))
    return condense(first, second, np.array([edge[2] for edge in ordered]), n, smallest)


def random_forest(seed: int) -> tuple[list[Edge], int]:
    """A forest with many equal densities."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 60))
    name = rng.permutation(n).tolist()
    edges = [
        (name[k], name[int(rng.integers(0, k))], float(rng.integers(1, 9))) for k in range(1, n) if rng.random() < 0.9
    ]
    return edges, n


def parts_of(points: set[int], edges: list[Edge]) -> list[set[int]]:
    """The connected parts of some points."""
    parts = [{point} for point in points]
    for a, b, _ in edges:
        if a in points and b in points:
            joined = [part for part in parts if a in part or b in part]
            parts = [part for part in parts if part not in joined] + [set().union(*joined)]
    return parts


def definition(edges: list[Edge], n: int, smallest: int) -> set[tuple[frozenset[int], float, float]]:
    """Campello et al. from the top down: as density rises, edges break, all of one density at once. A cluster
    ends where less than one part of it is still a cluster, or more than one; else it is the same, shrunk.
    Returns each one's points, the density at which it ends, and the sum of those at which its points leave."""
    levels = sorted({density for *_, density in edges})
    result = set()
    todo = [part for part in parts_of(set(range(n)), edges) if len(part) >= smallest]
    while todo:
        points = todo.pop()
        mass, alive = 0.0, points
        for level in levels:
            parts = parts_of(alive, [edge for edge in edges if edge[2] > level])
            large = [part for part in parts if len(part) >= smallest]
            if len(large) != 1:
                result.add((frozenset(points), level, mass + level * len(alive)))
                todo += large
                break
            mass += level * (len(alive) - len(large[0]))
            alive = large[0]
    return result


def clusters_of(tree: Condensed) -> set[tuple[frozenset[int], float, float]]:
    members: list[set[int]] = [set() for _ in tree.parent]
    for point, owner in enumerate(tree.point_cluster.tolist()):
        while owner != NONE:
            members[owner].add(point)
            owner = int(tree.parent[owner])
    assert [len(points) for points in members] == tree.size.tolist()
    return {(frozenset(p), d, m) for p, d, m in zip(members, tree.death.tolist(), tree.mass.tolist(), strict=True)}


def test_two_clusters_and_a_straggler_by_hand() -> None:
    """0-1-2 and 3-4-5 are dense, meet at density 2, and 6 joins at 1."""
    edges = [(0, 1, 9.0), (1, 2, 8.0), (3, 4, 7.0), (4, 5, 7.0), (2, 3, 2.0), (6, 0, 1.0)]
    tree = tree_of(edges, 7, 3)
    assert tree.parent.tolist() == [2, 2, NONE]
    assert tree.death.tolist() == [8.0, 7.0, 2.0]
    assert tree.size.tolist() == [3, 3, 7]
    assert tree.mass.tolist() == [24.0, 21.0, 13.0]
    assert tree.point_cluster.tolist() == [0, 0, 0, 1, 1, 1, 2]
    assert tree.point_density.tolist() == [8.0, 8.0, 8.0, 7.0, 7.0, 7.0, 1.0]


@pytest.mark.parametrize("smallest", [2, 3, 5])
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_bottom_up_is_the_top_down_definition(smallest: int, seed: int) -> None:
    edges, n = random_forest(seed)
    assert clusters_of(tree_of(edges, n, smallest)) == definition(edges, n, smallest)


def test_compiled_and_as_it_stands_it_is_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = [tree_of(*random_forest(seed), 4) for seed in range(40)]
    monkeypatch.setattr(condensing, "COMPILED_FROM", 0)
    for seed, expected in enumerate(plain):
        for ours, theirs in zip(tree_of(*random_forest(seed), 4), expected, strict=True):
            assert ours.dtype == theirs.dtype
            assert np.array_equal(ours, theirs)
