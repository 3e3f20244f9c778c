"""The condensed tree of a spanning forest, bottom up: join along its edges, the densest first, and note each
time that groups of at least a smallest cluster's size meet. It equals the usual top-down reading.

Mutual reachability distances tie often (one point's core distance is the weight of several edges). All
groups that meet at one density meet at once, so that neither the points' order nor the choice among equal
spanning trees changes the result.

Large scans' points are joined by this very code compiled, which takes a tenth of the time. Small ones do not
pay for loading the compiler: there it runs as it stands, on lists.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from adcbf_cli.core.types import FloatArray, IntArray

NONE = -1
COMPILED_FROM = 4000
"""Points of the smallest scan that is worth it: fewer take less than 10 ms as it stands, and the compiler takes
0.4 s and 100 MB to load."""

# While points are joined, each of the columns below may as well be a list.


class Condensed(NamedTuple):
    """point_cluster, point_density (n,): the smallest cluster of each point, and the density at which the
    point left it. parent, death, mass, size (c,): each cluster's parent or NONE, children before parents;
    the density up to which it held together; the sum of densities at which its points leave; its points."""

    point_cluster: IntArray
    point_density: FloatArray
    parent: IntArray
    death: FloatArray
    mass: FloatArray
    size: IntArray


class _Edges(NamedTuple):
    """Edges (m,) between two points each, sorted by falling density. Tops take the points' places."""

    first: IntArray
    second: IntArray
    density: FloatArray


class _Groups(NamedTuple):
    """The points joined so far, (n,) each: disjoint sets, named by one of their points, the top.

    up: the way to the top. cluster: of a top, or NONE, and then its set is a chain of loose points that
    begins at the top: next_point, and of tops last_point and loose_size.
    """

    up: IntArray
    cluster: IntArray
    next_point: IntArray
    last_point: IntArray
    loose_size: IntArray


class _Meetings(NamedTuple):
    """Tops that become one at the density in hand, (n,) each, named by the first of them.

    up: the way to that one. next_top: the chain of tops that begins there. last_top: its end, or NONE as
    soon as they have become one.
    """

    up: IntArray
    next_top: IntArray
    last_top: IntArray


def condense(first: IntArray, second: IntArray, density: FloatArray, n: int, min_cluster_size: int) -> Condensed:
    """Joins n points along a forest's edges (first, second) (m,), sorted by falling density (m,)."""
    join, held = (_join, _as_lists) if n < COMPILED_FROM else (_compiled_join(), _as_arrays)
    none, itself, zero = np.full(n, NONE), np.arange(n), np.zeros(n)
    edges = _Edges(*held(first.astype(np.int64), second.astype(np.int64), density))
    groups = _Groups(*held(itself, none, none, itself, np.ones(n, dtype=np.int64)))
    meetings = _Meetings(*held(none, none, none))
    found = Condensed(*held(none, zero, none, zero, zero, none))
    count = join(edges, groups, meetings, found, min_cluster_size)
    return Condensed(
        np.asarray(found.point_cluster),
        np.asarray(found.point_density),
        np.asarray(found.parent[:count], dtype=np.int64),
        np.asarray(found.death[:count], dtype=np.float64),
        np.asarray(found.mass[:count], dtype=np.float64),
        np.asarray(found.size[:count], dtype=np.int64),
    )


def _as_lists(*columns: IntArray | FloatArray) -> list[Any]:
    return [column.tolist() for column in columns]


def _as_arrays(*columns: IntArray | FloatArray) -> list[Any]:
    return [column.copy() for column in columns]


@cache
def _compiled_join() -> Callable[..., int]:
    """`_join`, compiled when first called, and kept on disk if there is a place for it."""
    from numba import njit
    from numba.extending import register_jitable

    for part in (_top, _call_together, _unite, _found_cluster, _meet):
        register_jitable(part)
    try:
        join: Callable[..., int] = njit(cache=True)(_join)
    except RuntimeError:  # neither the module's folder nor the user's cache can be written to
        join = njit()(_join)
    return join


def _top(up: IntArray, point: int) -> int:
    while up[point] != point:
        up[point] = up[up[point]]
        point = up[point]
    return point


def _call_together(groups: _Groups, meetings: _Meetings, edges: _Edges, start: int, stop: int) -> None:
    """Turns edges of one density into edges between tops, and those into meetings."""
    meeting_up, next_top, last_top = meetings.up, meetings.next_top, meetings.last_top
    first, second = edges.first, edges.second
    for edge in range(start, stop):
        one, other = _top(groups.up, first[edge]), _top(groups.up, second[edge])
        first[edge], second[edge] = one, other
        meeting_up[one], last_top[one], next_top[one] = one, one, NONE
        meeting_up[other], last_top[other], next_top[other] = other, other, NONE
    for edge in range(start, stop):
        one, other = _top(meeting_up, first[edge]), _top(meeting_up, second[edge])
        if one != other:
            meeting_up[other] = one
            next_top[last_top[one]] = other
            last_top[one] = last_top[other]


def _unite(groups: _Groups, next_top: IntArray, name: int) -> tuple[int, int, int]:
    """Makes one set of the chain of tops that begins at `name`, its name; its loose points become one chain.

    Returns how many clusters have met, one of them or NONE, and the loose chain's first point or NONE.
    """
    up, cluster, loose_size, last_point = groups.up, groups.cluster, groups.loose_size, groups.last_point
    met, one, loose, begin, end = 0, NONE, 0, NONE, NONE
    top = name
    while top != NONE:
        up[top] = name
        if cluster[top] != NONE:
            met += 1
            one = cluster[top]
        else:
            loose += loose_size[top]
            if begin == NONE:
                begin = top
            else:
                groups.next_point[end] = top
            end = last_point[top]
        top = next_top[top]
    loose_size[name], last_point[name] = loose, end
    return met, one, begin


def _found_cluster(groups: _Groups, next_top: IntArray, top: int, found: Condensed, count: int, at: float) -> None:
    """Enters cluster number `count`, which begins with the clusters and the loose points that have met."""
    cluster, size = groups.cluster, groups.loose_size[top]
    while top != NONE:
        child = cluster[top]
        if child != NONE:
            found.parent[child] = count
            size += found.size[child]
        top = next_top[top]
    found.size[count] = size
    found.mass[count] = size * at
    found.death[count] = at


def _meet(
    groups: _Groups, next_top: IntArray, top: int, found: Condensed, count: int, at: float, min_cluster_size: int
) -> int:
    """Tops become one set at density `at`: two clusters or more a new one, a single cluster gains the loose
    points, and loose points stay loose or are a cluster's first. Returns the new number of clusters."""
    met, cluster, point = _unite(groups, next_top, top)
    loose = groups.loose_size[top]
    if met == 1:
        found.size[cluster] += loose
        found.mass[cluster] += loose * at
    elif met > 1 or loose >= min_cluster_size:
        cluster = count
        _found_cluster(groups, next_top, top, found, cluster, at)
        count += 1
    else:
        return count
    groups.cluster[top] = cluster
    while point != NONE:
        found.point_cluster[point], found.point_density[point] = cluster, at
        point = groups.next_point[point]
    return count


def _join(edges: _Edges, groups: _Groups, meetings: _Meetings, found: Condensed, min_cluster_size: int) -> int:
    """Fills `found`; returns the number of clusters."""
    first, second, density = edges.first, edges.second, edges.density
    next_top, last_top = meetings.next_top, meetings.last_top
    count, start, m = 0, 0, len(density)
    while start < m:
        at = density[start]
        stop = start + 1
        if stop == m or density[stop] != at:
            one, other = _top(groups.up, first[start]), _top(groups.up, second[start])
            next_top[one], next_top[other] = other, NONE
            count = _meet(groups, next_top, one, found, count, at, min_cluster_size)
            start = stop
            continue
        while stop < m and density[stop] == at:
            stop += 1
        _call_together(groups, meetings, edges, start, stop)
        for edge in range(start, stop):
            top = _top(meetings.up, first[edge])
            if last_top[top] != NONE:
                last_top[top] = NONE
                count = _meet(groups, next_top, top, found, count, at, min_cluster_size)
        start = stop
    return count
