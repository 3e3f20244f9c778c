"""How well clusters separate labelled objects, and how much free space their circles take.

Over- and under-segmentation follow Held et al., "A Probabilistic Framework for Real-time 3D
Segmentation using Spatial, Temporal, and Semantic Cues", RSS 2016, section V: each labelled object is
compared with the cluster that holds most of its points,

    over-segmented:  |cluster and object| / |object|  < 0.5   (less than half of it in one cluster)
    under-segmented: |cluster and object| / |cluster| < 0.5   (most of that cluster is something else)

with points counted. An object whose points are in no cluster is missed, and is neither.

Pieces of a split cluster count as clusters of their own, as they leave the stage as obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, IntArray

HALF = 0.5


@dataclass(frozen=True, slots=True)
class Segmentation:
    """Counts over `objects` labelled objects that had points at all; add them up over frames."""

    objects: int = 0
    missed: int = 0
    over: int = 0
    under: int = 0

    def __add__(self, other: Segmentation) -> Segmentation:
        return Segmentation(
            self.objects + other.objects,
            self.missed + other.missed,
            self.over + other.over,
            self.under + other.under,
        )


def points_in_box(
    xy_m: FloatArray, centre_m: FloatArray, yaw_rad: float, length_m: float, width_m: float, margin_m: float = 0.0
) -> BoolArray:
    """Which points (n, 2) lie in the oriented rectangle, grown by `margin_m` on every side."""
    offset = xy_m - centre_m
    along = offset[:, 0] * np.cos(yaw_rad) + offset[:, 1] * np.sin(yaw_rad)
    across = offset[:, 1] * np.cos(yaw_rad) - offset[:, 0] * np.sin(yaw_rad)
    inside: BoolArray = (np.abs(along) <= length_m / 2 + margin_m) & (np.abs(across) <= width_m / 2 + margin_m)
    return inside


def segmentation(label: IntArray, object_of: IntArray) -> Segmentation:
    """Score one frame. label: (n,) each point's cluster or NO_ID; object_of: (n,) its labelled object
    or NO_ID."""
    total = Segmentation()
    sizes = np.bincount(label[label != NO_ID], minlength=1)
    for labelled in np.unique(object_of[object_of != NO_ID]):
        own = label[object_of == labelled]
        shares = np.bincount(own[own != NO_ID], minlength=1)
        best = int(np.argmax(shares))
        common = int(shares[best])
        total += Segmentation(
            objects=1,
            missed=int(common == 0),
            over=int(0 < common < HALF * len(own)),
            under=int(0 < common < HALF * sizes[best]),
        )
    return total


def inflated_area(
    centre_m: FloatArray, radius_m: FloatArray, occupied_xy_m: FloatArray, cell_m: float, range_m: float
) -> float:
    """Area in m^2 that obstacle circles take beyond the points' own footprint.

    Counted on cells of side `cell_m` of the square up to `range_m` around the origin: cells whose
    centre some circle covers, and that hold no point of `occupied_xy_m` (n, 2). It includes the
    unseen inside of solid things: only differences between methods on the same scan mean something.
    """
    side = int(np.ceil(2 * range_m / cell_m))
    axis = -range_m + cell_m * (np.arange(side) + 0.5)
    covered = np.zeros((side, side), dtype=bool)
    for (x, y), radius in zip(centre_m[:, :2], radius_m, strict=True):
        columns = slice(*np.searchsorted(axis, (x - radius, x + radius)))
        rows = slice(*np.searchsorted(axis, (y - radius, y + radius)))
        square = (axis[columns, None] - x) ** 2 + (axis[None, rows] - y) ** 2
        covered[columns, rows] |= square <= radius**2
    cell = np.floor((occupied_xy_m + range_m) / cell_m).astype(np.int64)
    cell = cell[((cell >= 0) & (cell < side)).all(axis=1)]
    covered[cell[:, 0], cell[:, 1]] = False
    return float(covered.sum()) * cell_m**2
