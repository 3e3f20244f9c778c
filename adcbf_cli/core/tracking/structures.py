"""Pieces of walls and hedges: long clusters that perception splits into circles along their length.

Where a piece lies along its wall is a matter of the view (of the crop's edge, of where the split
began): the pieces slide along a wall that stands still, at the ego's own speed. So a piece of a
cluster longer than any car is taken to stand still, and its place along the wall as uncertain.
Pieces of shorter clusters (a car cut in three) are tracked like any other obstacle.
"""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.types import NO_ID, BoolArray, Clusters, FloatArray

SPREAD_SHARE = 0.5
"""Standard deviation of a piece's place along its wall, as a share of the piece's length."""


def wall_pieces(clusters: Clusters, structure_length_m: float) -> tuple[BoolArray, FloatArray]:
    """(c,) which clusters are pieces of a structure, and (c, 3) one standard deviation of their
    place as a vector along the wall, world frame; zero for all others."""
    is_piece = np.zeros(len(clusters), dtype=np.bool_)
    spread_m = np.zeros((len(clusters), 3))
    for parent in np.unique(clusters.split_from[clusters.split_from != NO_ID]):
        rows = np.flatnonzero(clusters.split_from == parent)
        centres = clusters.centre_m[rows, :2]
        distance = np.linalg.norm(centres[:, None] - centres[None, :], axis=-1)
        reach = distance + clusters.radius_m[rows][:, None] + clusters.radius_m[rows][None, :]
        i, j = np.unravel_index(np.argmax(reach), reach.shape)
        if reach[i, j] <= structure_length_m or distance[i, j] == 0.0:
            continue
        along = (centres[j] - centres[i]) / distance[i, j]
        is_piece[rows] = True
        spread_m[rows, :2] = SPREAD_SHARE * 2.0 * clusters.radius_m[rows][:, None] * along
    return is_piece, spread_m
