"""HDBSCAN on the exact neighbour graph of a maximal gap, and DBSCAN to compare.

HDBSCAN* (Campello et al. 2013) builds the minimum spanning tree of the mutual reachability
distances of all pairs of points, condenses it into a tree of clusters, and takes the most stable
ones. Over all pairs that is quadratic. But obstacles that are `max_gap_m` apart are never one, so
no tree edge longer than that matters: all edges up to it come from a k-d tree, exactly, and the
spanning *forest* of that sparse graph holds precisely the edges of the full tree up to `max_gap_m`.

Each tree of the forest is a hierarchy of its own, whose root is born at the density 1 / max_gap_m
and may itself be taken: most trees are one object. This is where the result may differ from HDBSCAN
over the whole cloud, which never takes its root, and starts every other cluster's life where it
leaves its neighbours, however far away those are: there one far point makes all other clusters
longer-lived. Here an obstacle's clustering depends on nothing farther than `max_gap_m` from it. On a
single connected cloud both agree (with `allow_single_cluster` there, and a large gap here), which
the tests check against scikit-learn.

`min_gap_m` is the cluster selection epsilon of Malzer and Baum (2020): clusters that separate only
at a smaller distance are left together, since LiDAR density varies across one object. Between the
two gaps, density decides.

A few points beyond `min_gap_m`, too few for a cluster of their own, still belong to the cluster next
to them by the definition, with a low probability, and one of them can double an obstacle's radius.
`min_probability` makes them the noise that they would be on their own.

Small obstacles. Cells thin a cloud where it is dense; a post or a far trunk fills two or three of them,
however often it was hit. What is left as noise is therefore judged once more by its `returns`: a group
of noise cells, each within the lower gap (DBSCAN: eps) of another, is an obstacle if it holds
`min_cluster_size` returns in at least FEWEST_CELLS cells. Clusters that were found stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import NO_ID, FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MAX_PAIRS = 30_000_000
"""Neighbour pairs of one frame that are still worked on (about half a gigabyte)."""

FEW_POINTS = 300
"""Points of a frame whose spanning forest costs more by calls than by edges."""

FEWEST_CELLS = 2
"""Cells of the smallest obstacle that counts by its returns: one cell alone may be a flaw of the sensor's."""

SMALLEST_DISTANCE_M = 1e-9
"""Coincident points have a finite density, too."""


@dataclass(frozen=True, slots=True)
class Grouping:
    """label: (n,) a cluster from 0, in order of each one's first point, or NO_ID; probability: (n,)
    the strength of the membership in [0, 1], 0 for noise."""

    label: IntArray
    probability: FloatArray


def hdbscan(
    points_m: FloatArray,
    *,
    min_cluster_size: int,
    min_samples: int,
    min_gap_m: float,
    max_gap_m: float,
    min_probability: float = 0.0,
    returns: IntArray | None = None,
) -> Grouping:
    """Cluster points (n, d) by the hierarchy of densities within `max_gap_m`; see the module's text.

    Members with a probability below `min_probability` that join only beyond `min_gap_m` become noise.
    returns: (n,) LiDAR returns that each point stands for; None: small obstacles are not sought.
    Raises AdcbfError where the points are so dense that the graph would not fit in memory.
    """
    grouping = _by_density(points_m, min_cluster_size, min_samples, min_gap_m, max_gap_m, min_probability)
    return grouping if returns is None else _with_small(grouping, points_m, returns, min_gap_m, min_cluster_size)


def _by_density(
    points_m: FloatArray,
    min_cluster_size: int,
    min_samples: int,
    min_gap_m: float,
    max_gap_m: float,
    min_probability: float,
) -> Grouping:
    """`hdbscan` without small obstacles."""
    if len(points_m) < max(min_cluster_size, min_samples):
        return _all_noise(len(points_m))
    first, second, weight = _spanning_forest(points_m, min_samples, max_gap_m)
    if len(weight) == 0:
        return _all_noise(len(points_m))
    tree = _condense(len(points_m), first, second, 1.0 / weight, min_cluster_size, 1.0 / max_gap_m)
    selected = _most_stable(tree)
    if min_gap_m > 0:
        selected = _lift_to_gap(tree, selected, min_gap_m)
    grouping = _label(tree, selected)
    stray = (grouping.probability < min_probability) & (tree.point_lambda * max(min_gap_m, SMALLEST_DISTANCE_M) < 1.0)
    return Grouping(np.where(stray, NO_ID, grouping.label), np.where(stray, 0.0, grouping.probability))


def dbscan(
    points_m: FloatArray, *, eps_m: float, min_samples: int, min_cluster_size: int, returns: IntArray | None = None
) -> Grouping:
    """DBSCAN (Ester et al. 1996) of points (n, d), exactly. A border point goes to its nearest core
    point's cluster; clusters smaller than `min_cluster_size` are noise; members have probability 1.
    returns: as for `hdbscan`."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    n = len(points_m)
    if n == 0:
        return _all_noise(0)
    first, second = _pairs_within(cKDTree(points_m), eps_m)
    distance = _distance(points_m, first, second)
    neighbours = np.bincount(first, minlength=n) + np.bincount(second, minlength=n) + 1
    core = neighbours >= min_samples
    linked = core[first] & core[second]
    graph = coo_array((np.ones(int(linked.sum())), (first[linked], second[linked])), shape=(n, n))
    _, component = connected_components(graph, directed=False)
    label = np.where(core, component, NO_ID).astype(np.int64)

    border = np.concatenate([first, second])
    owner = np.concatenate([second, first])
    away = np.concatenate([distance, distance])
    reachable = ~core[border] & core[owner]
    border, owner, away = border[reachable], owner[reachable], away[reachable]
    order = np.lexsort((owner, away, border))
    nearest_of, where = np.unique(border[order], return_index=True)
    label[nearest_of] = component[owner[order][where]]

    sizes = np.bincount(label[label >= 0], minlength=n)
    label[(label >= 0) & (sizes[np.maximum(label, 0)] < min_cluster_size)] = NO_ID
    label = in_order_of_appearance(label)
    grouping = Grouping(label, (label != NO_ID).astype(np.float64))
    return grouping if returns is None else _with_small(grouping, points_m, returns, eps_m, min_cluster_size)


def _with_small(
    grouping: Grouping, points_m: FloatArray, returns: IntArray, gap_m: float, min_returns: int
) -> Grouping:
    """Also the small obstacles among the noise, with probability 1; see the module's text."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    noise = np.flatnonzero(grouping.label == NO_ID)
    n = len(noise)
    if n < FEWEST_CELLS:
        return grouping
    first, second = _pairs_within(cKDTree(points_m[noise]), gap_m)
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(n, n))
    count, group = connected_components(graph, directed=False)
    enough = np.bincount(group, returns[noise], minlength=count) >= min_returns
    enough &= np.bincount(group, minlength=count) >= FEWEST_CELLS
    label, probability = grouping.label.copy(), grouping.probability.copy()
    found = enough[group]
    label[noise[found]] = label.max() + 1 + group[found]
    probability[noise[found]] = 1.0
    return Grouping(in_order_of_appearance(label), probability)


def _all_noise(n: int) -> Grouping:
    return Grouping(np.full(n, NO_ID, dtype=np.int64), np.zeros(n))


def _pairs_within(tree: cKDTree, radius_m: float) -> tuple[IntArray, IntArray]:
    """All pairs of the tree's points up to `radius_m` apart, as two index arrays."""
    n = tree.n
    if n * (n - 1) // 2 > MAX_PAIRS and (tree.count_neighbors(tree, radius_m) - n) // 2 > MAX_PAIRS:
        raise AdcbfError(
            f"{n} grid cells of one frame have too many neighbours within {radius_m:g} m to cluster: "
            "raise perception.cell_m, or lower perception.max_gap_m or perception.range_m"
        )
    pairs = tree.query_pairs(radius_m, output_type="ndarray")
    return pairs[:, 0], pairs[:, 1]


def _distance(points_m: FloatArray, first: IntArray, second: IntArray) -> FloatArray:
    difference = points_m[first] - points_m[second]
    distance: FloatArray = np.sqrt(np.einsum("ij,ij->i", difference, difference))
    return distance


def _spanning_forest(points_m: FloatArray, min_samples: int, max_gap_m: float) -> tuple[IntArray, IntArray, FloatArray]:
    """The minimum spanning forest's edges by rising mutual reachability distance, all <= max_gap_m.

    Kruskal's order in two steps: the forest of the short edges first, whose components then leave
    out nearly all of the long ones, since an edge within a component that shorter edges already
    connect is never needed. Few points are joined in one step.
    """
    from scipy.sparse import coo_array, csr_array
    from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
    from scipy.spatial import cKDTree

    n = len(points_m)
    tree = cKDTree(points_m)
    core = tree.query(points_m, k=[min_samples])[0][:, 0]
    kept = coo_array((n, n))
    for reach_m in (max_gap_m / 3, max_gap_m) if n > FEW_POINTS else (max_gap_m,):
        first, second = _pairs_within(tree, reach_m)
        if kept.nnz:
            _, component = connected_components(kept, directed=False)
            apart = component[first] != component[second]
            first, second = first[apart], second[apart]
        weight = np.maximum(core[first], core[second])
        weight = np.maximum(weight, np.maximum(_distance(points_m, first, second), SMALLEST_DISTANCE_M))
        near = weight <= reach_m
        data = np.concatenate([kept.data, weight[near]])
        rows, columns = np.concatenate([kept.row, first[near]]), np.concatenate([kept.col, second[near]])
        ends = (rows.astype(np.int32), columns.astype(np.int32))  # older scipy takes no wider ones
        kept = minimum_spanning_tree(csr_array((data, ends), shape=(n, n))).tocoo()
    first, second, weight = kept.row, kept.col, kept.data
    order = np.lexsort((second, first, weight))
    return first[order], second[order], weight[order]


@dataclass(slots=True)
class _CondensedTree:
    """The clusters of the hierarchy, children before parents, density lambda = 1 / distance.

    parent: NO_ID for a root; birth: the lambda at which it leaves its parent; death: the largest
    lambda at which it still held together; mass: the sum of lambda over its points as they leave;
    size: points. point_cluster, point_lambda: the smallest cluster of each point, and when it left.
    """

    point_cluster: IntArray
    point_lambda: FloatArray
    parent: list[int]
    birth: list[float]
    death: list[float]
    mass: list[float]
    size: list[int]

    def stability(self, cluster: int) -> float:
        """Excess of mass: the sum over its points of lambda as they leave minus lambda at birth."""
        return self.mass[cluster] - self.birth[cluster] * self.size[cluster]


def _condense(
    n: int, first: IntArray, second: IntArray, density: FloatArray, min_cluster_size: int, root_birth: float
) -> _CondensedTree:
    """The tree of a forest's edges, by falling density."""
    from adcbf_cli.core.perception.condensing import condense

    found = condense(first, second, density, n, min_cluster_size)
    birth = np.where(found.parent == NO_ID, root_birth, found.death[found.parent])
    return _CondensedTree(
        point_cluster=found.point_cluster,
        point_lambda=found.point_density,
        parent=found.parent.tolist(),
        birth=birth.tolist(),
        death=found.death.tolist(),
        mass=found.mass.tolist(),
        size=found.size.tolist(),
    )


def _most_stable(tree: _CondensedTree) -> list[bool]:
    """Excess of mass: a cluster is taken unless the best choice among its descendants has more."""
    count = len(tree.parent)
    below = [0.0] * count
    takes_itself = [True] * count
    for cluster in range(count):
        own = tree.stability(cluster)
        takes_itself[cluster] = below[cluster] <= own
        if tree.parent[cluster] != NO_ID:
            below[tree.parent[cluster]] += max(own, below[cluster])
    selected = [False] * count
    covered = [False] * count
    for cluster in reversed(range(count)):
        parent = tree.parent[cluster]
        covered[cluster] = parent != NO_ID and (covered[parent] or selected[parent])
        selected[cluster] = takes_itself[cluster] and not covered[cluster]
    return selected


def _lift_to_gap(tree: _CondensedTree, selected: list[bool], min_gap_m: float) -> list[bool]:
    """Replace each taken cluster that left its sibling at a distance below `min_gap_m` by its nearest
    ancestor that did not, or the root."""
    lifted = [False] * len(selected)
    for cluster, taken in enumerate(selected):
        if not taken:
            continue
        ancestor = cluster
        while tree.parent[ancestor] != NO_ID and 1.0 / tree.birth[ancestor] < min_gap_m:
            ancestor = tree.parent[ancestor]
        lifted[ancestor] = True
    return lifted


def _label(tree: _CondensedTree, selected: list[bool]) -> Grouping:
    """Points of the taken clusters; probability = lambda as it leaves / the cluster's largest lambda."""
    count = len(selected)
    owner = np.full(count + 1, NO_ID, dtype=np.int64)
    for cluster in reversed(range(count)):
        owner[cluster] = cluster if selected[cluster] else owner[tree.parent[cluster]]
    taken_by = owner[tree.point_cluster]
    death = np.array([*tree.death, 1.0])[taken_by]
    probability = np.minimum(tree.point_lambda / death, 1.0)
    return Grouping(in_order_of_appearance(taken_by), np.where(taken_by == NO_ID, 0.0, probability))


def in_order_of_appearance(label: IntArray) -> IntArray:
    """Clusters renumbered from 0 by their first point."""
    found, where = np.unique(label[label != NO_ID], return_index=True)
    rank = np.empty(len(found), dtype=np.int64)
    rank[np.argsort(where)] = np.arange(len(found))
    renumbered = np.full(len(label), NO_ID, dtype=np.int64)
    members = label != NO_ID
    renumbered[members] = rank[np.searchsorted(found, label[members])]
    return renumbered
