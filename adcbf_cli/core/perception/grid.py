"""Thin a cloud to one point a cell of a plan-view grid, and drop the cells that stand alone.

Why in plan: the obstacle that leaves this stage is a circle on the ground with a height, so two
points above one another are the same obstacle. A spinning LiDAR's rings are much farther apart
vertically (2 degrees are 0.35 m at 10 m) than its points along a ring; in three dimensions every
ring would be a cluster of its own. In plan the rings of one object fall together, and the number
of points that reach the clusterer is halved. What it costs: a thing that hangs over another below
`max_height_m` is one with it, as it is for a ground vehicle.

The grid is fixed in the world, so that a standing object keeps its cells while the robot moves. A
cell is represented by the mean of its points, not by its centre, which would move edges by half a
cell.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Cells:
    """The occupied cells: mean_m (k, 2), and for each of the n points its cell, point_cell (n,)."""

    mean_m: FloatArray
    point_cell: IntArray

    def __len__(self) -> int:
        return len(self.mean_m)

    def returns(self) -> IntArray:
        """How many points each cell holds, (k,)."""
        return np.bincount(self.point_cell, minlength=len(self.mean_m))


def cell_numbers(x_m: FloatArray, y_m: FloatArray, cell_m: float) -> tuple[IntArray, tuple[int, int]]:
    """Each point's cell (n,) in a grid of square cells over all of them, counted row by row, and the
    grid's shape. At least one point."""
    column, row = np.floor(x_m / cell_m).astype(np.int64), np.floor(y_m / cell_m).astype(np.int64)
    column -= column.min()
    row -= row.min()
    shape = int(column.max()) + 1, int(row.max()) + 1
    return column * shape[1] + row, shape


def occupied_cells(xy_m: FloatArray, cell_m: float, origin_m: FloatArray | None = None) -> Cells:
    """The occupied cells of points (n, 2), in order of their column and row.

    origin_m: (2,) where the points' own origin lies in the frame that the grid is fixed in.
    """
    if len(xy_m) == 0:
        return Cells(np.zeros((0, 2)), np.zeros(0, dtype=np.int64))
    phase = np.zeros(2) if origin_m is None else np.mod(origin_m, cell_m)
    number, _ = cell_numbers(xy_m[:, 0] + phase[0], xy_m[:, 1] + phase[1], cell_m)
    _, point_cell, count = np.unique(number, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(point_cell, xy_m[:, axis]) / count for axis in range(2)], axis=1)
    return Cells(mean, point_cell.astype(np.int64))


def not_outlying(
    cells_m: FloatArray, neighbours: int, std_ratio: float, cell_m: float, returns: IntArray | None = None
) -> BoolArray:
    """Statistical outlier removal (Rusu et al., Towards 3D point cloud based object maps, 2008).

    A cell (k, 2) stays when the mean distance to its nearest `neighbours` is at most the cloud's mean
    of that figure plus `std_ratio` standard deviations. On a grid that figure varies little, and the
    rule alone would cut off the ends of walls: so a cell stays also where the mean distance is at most
    that of the last cell of a row of which every second one is empty, (neighbours + 1) * cell_m. With
    no more cells than neighbours, all stay.

    returns: (k,), where given, a cell is judged by its nearest `neighbours` other returns, its own among
    them, against the same limit: a cell that was hit several times is no stray.
    """
    from scipy.spatial import cKDTree

    if len(cells_m) <= neighbours:
        return np.ones(len(cells_m), dtype=bool)
    distance, nearest = cKDTree(cells_m).query(cells_m, k=neighbours + 1)
    mean = distance[:, 1:].mean(axis=1)
    limit_m = max(mean.mean() + std_ratio * mean.std(), (neighbours + 1) * cell_m)
    if returns is not None:
        mean = _mean_distance_to_returns(distance, returns[nearest])
    keep: BoolArray = mean <= limit_m
    return keep


def _mean_distance_to_returns(distance: FloatArray, returns: IntArray) -> FloatArray:
    """Mean distance (k,) from one return of each cell to its m nearest others, each taken to lie at its cell's
    mean. distance, returns: (k, m + 1), of the nearest cells, the nearest first: the cell itself."""
    wanted = distance.shape[1]
    nearer = np.cumsum(returns, axis=1) - returns
    taken = np.clip(wanted - nearer, 0, returns)
    mean: FloatArray = (taken * distance).sum(axis=1) / (wanted - 1)
    return mean
