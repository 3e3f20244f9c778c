"""Clusters that hold more than one tracked obstacle: a car passes a post, and the two are seen as one.

The cluster's size and direction are then those of both together. A track that takes it must not
learn its body from it, and what the cluster has beyond the body is on the other obstacle's side.

Each track has at most one home: the smallest cluster whose rectangle holds the place where the track's
visible part is expected. A cluster is shared where a track that stands still and one that moves are both
at home in it, or two that move differently beyond doubt and are both smaller than it. Tracks that move
alike are more likely parts of one body that was seen in pieces before, and so are those of which one is
as large as the cluster.

What was one cluster from the first sight on is one track, until it comes apart: its size and velocity were those of
both together, and say nothing of either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.tracking.linalg import inverted, quadratic_form
from adcbf_cli.core.types import NO_ID, BoolArray, Clusters, FloatArray, IntArray

PARTING_MPS = 0.5
PARTING_SIGMAS = 2.45
"""Two tracks move differently where their velocities differ by more than both, and 95 % of equal ones do not."""
LARGER = 1.2
"""Times a track's radius, that a cluster which holds more than its body has at least."""
PIECE = 0.7
YOUNG_S = 1.5
"""Two clusters of less than this share of the radius of a track that is no older than this, are what it was made of.
Not before a planar laser, where a walker's legs are one cluster and two by turns."""


@dataclass(frozen=True, slots=True)
class Sharing:
    """Of n tracks. home: (n,) the cluster that each would share with others, a row of the frame's
    clusters, NO_ID for none; others_m: (n, 2) the mean of where those others are expected, world."""

    home: IntArray
    others_m: FloatArray

    def pairs(self, clusters: int) -> BoolArray:
        """(n, c) which of c clusters each track would share."""
        shared: BoolArray = self.home[:, None] == np.arange(clusters)[None, :]
        return shared


def share_clusters(home: IntArray, visible_m: FloatArray, unlike: BoolArray) -> Sharing:
    """Which cluster each of n tracks shares with others.

    home: (n,) as from `homes`; visible_m: (n, 2) where the tracks' visible parts are expected, world;
    unlike: (n, n) which tracks are not parts of one body.
    """
    others = (unlike & (home[:, None] == home[None, :]) & (home != NO_ID)[:, None]).astype(np.float64)
    count = others.sum(axis=1)
    return Sharing(np.where(count > 0, home, NO_ID), others @ visible_m / np.maximum(count, 1.0)[:, None])


def stand_and_move(is_static: BoolArray, is_moving: BoolArray) -> BoolArray:
    """(n, n) of which tracks one is known to stand still and the other to move, both (n,); neither: unknown."""
    return np.asarray((is_static[:, None] & is_moving[None, :]) | (is_moving[:, None] & is_static[None, :]))


def part_company(
    home: IntArray,
    velocity_mps: FloatArray,
    covariance: FloatArray,
    radius_m: FloatArray,
    clusters: Clusters,
) -> BoolArray:
    """(n, n) which tracks move differently, and are smaller than their homes.

    velocity_mps: (n, 2), its covariance (n, 2, 2) and radius_m (n,), as the tracks were before this frame.
    """
    result = np.zeros((len(home), len(home)), dtype=np.bool_)
    small = np.flatnonzero(home != NO_ID)
    small = small[clusters.radius_m[home[small]] > LARGER * radius_m[small]]
    between = velocity_mps[small, None] - velocity_mps[small]
    precision = inverted(covariance[small, None] + covariance[small])
    beyond_doubt = quadratic_form(between, precision) > PARTING_SIGMAS**2
    result[np.ix_(small, small)] = beyond_doubt & (np.linalg.norm(between, axis=-1) > PARTING_MPS)
    return result


def homes(visible_m: FloatArray, eligible: BoolArray, clusters: Clusters, margin_m: FloatArray) -> IntArray:
    """(n,) each track's home, a row of `clusters`, or NO_ID. Pieces of a split cluster are nobody's.

    visible_m: (n, 2) where the tracks' visible parts are expected, world; eligible: (n,) which tracks may
    have a home at all. Rectangles are grown on each side by margin_m (n,).
    """
    n = len(visible_m)
    if n == 0 or len(clusters) == 0:
        return np.full(n, NO_ID, dtype=np.int64)
    offset = visible_m[:, None, :] - clusters.centre_m[None, :, :2]
    cosine, sine = np.cos(clusters.yaw_rad), np.sin(clusters.yaw_rad)
    along = np.abs(offset[..., 0] * cosine + offset[..., 1] * sine)
    across = np.abs(offset[..., 1] * cosine - offset[..., 0] * sine)
    inside = (along <= clusters.length_m / 2 + margin_m[:, None]) & (across <= clusters.width_m / 2 + margin_m[:, None])
    inside &= eligible[:, None] & (clusters.split_from == NO_ID)[None, :]
    size = np.where(inside, clusters.radius_m, np.inf)
    smallest = np.argmin(size, axis=1)
    found: IntArray = np.where(inside.any(axis=1), smallest, NO_ID)
    return found


def come_apart(
    place_m: FloatArray, radius_m: FloatArray, age_s: FloatArray, columns: IntArray, clusters: Clusters, free: BoolArray
) -> BoolArray:
    """(k,) which young tracks, expected at place_m (k, 2) with radii (k,), turn out to have been two things: the
    cluster that each took, `columns` (k,), and another that is `free` (c,) reach into its circle, both much smaller."""
    if clusters.planar:
        return np.zeros(len(columns), dtype=np.bool_)
    gap = np.linalg.norm(clusters.centre_m[:, :2] - place_m[:, None], axis=-1) - radius_m[:, None]
    is_piece = (gap < clusters.radius_m) & (clusters.radius_m < PIECE * radius_m[:, None])
    is_piece &= clusters.split_from == NO_ID
    result: BoolArray = is_piece[np.arange(len(columns)), columns] & (is_piece & free).any(axis=1)
    return result & (age_s <= YOUNG_S)
