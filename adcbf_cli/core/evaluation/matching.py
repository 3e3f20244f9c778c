"""Which track is which object: admissible pairs, and the assignment of CLEAR MOT."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.types import BoolArray, FloatArray, IntArray


def centre_distances(object_m: FloatArray, track_m: FloatArray) -> FloatArray:
    """(n, m) horizontal distances between (n, 2+) objects and (m, 2+) tracks, metres."""
    offset = object_m[:, None, :2] - track_m[None, :, :2]
    distance: FloatArray = np.hypot(offset[..., 0], offset[..., 1])
    return distance


def inside_boxes(
    object_m: FloatArray,
    yaw_rad: FloatArray,
    length_m: FloatArray,
    width_m: FloatArray,
    track_m: FloatArray,
    margin_m: float,
) -> BoolArray:
    """(n, m) whether each of m points lies in each of n upright boxes enlarged by `margin_m` on
    every side, seen from above. A box with an unknown side or yaw holds nothing."""
    offset = track_m[None, :, :2] - object_m[:, None, :2]
    cos, sin = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    along = cos * offset[..., 0] + sin * offset[..., 1]
    across = -sin * offset[..., 0] + cos * offset[..., 1]
    inside: BoolArray = (np.abs(along) <= length_m[:, None] / 2 + margin_m) & (
        np.abs(across) <= width_m[:, None] / 2 + margin_m
    )
    return inside


def assign(distance_m: FloatArray, admissible: BoolArray) -> tuple[IntArray, IntArray]:
    """One-to-one pairs (rows, columns): as many admissible ones as possible, then the least total
    distance. Pairs come in ascending row order."""
    from scipy.optimize import linear_sum_assignment

    if not admissible.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    forbidden = 1.0 + 2.0 * float(distance_m[admissible].sum())
    rows, columns = linear_sum_assignment(np.where(admissible, distance_m, forbidden))
    allowed = admissible[rows, columns]
    return rows[allowed], columns[allowed]


def match_frame(
    object_id: IntArray, track_id: IntArray, distance_m: FloatArray, admissible: BoolArray, previous: dict[int, int]
) -> tuple[IntArray, IntArray]:
    """CLEAR MOT's correspondence for one frame (Bernardin and Stiefelhagen 2008, section 2.2):
    pairs of the previous frame that are still admissible stay, `assign` finds the others.

    previous: object id -> track id in the frame before. Returns (rows, columns), ascending rows.
    """
    column_of = {int(t): j for j, t in enumerate(track_id)}
    kept = [(i, column_of[previous[int(o)]]) for i, o in enumerate(object_id) if previous.get(int(o)) in column_of]
    kept = [(i, j) for i, j in kept if admissible[i, j]]
    free = admissible.copy()
    for i, j in kept:
        free[i, :] = False
        free[:, j] = False
    rows, columns = assign(distance_m, free)
    all_rows = np.array([*(i for i, _ in kept), *rows], dtype=np.int64)
    all_columns = np.array([*(j for _, j in kept), *columns], dtype=np.int64)
    order = np.argsort(all_rows)
    return all_rows[order], all_columns[order]
