"""One frame's road from points to obstacles: range crop, ground removal, grid, outlier removal,
clustering, obstacle parameters.

The work is done in the *local* frame: origin at the sensor, axes parallel to the world's. Nothing is
lost to large world coordinates there, and rectangles and grid cells are the world's.

The statistical outlier removal comes after the grid, not before: there it sees an even spacing and
judges stray points, where on the raw cloud it would mostly judge how far away a thing is; and it
costs a tenth of the time. The judged neighbours are fewer than a smallest cluster has, so that it
cannot remove what the clusterer would have kept whole.

A 3-D LiDAR's smallest obstacle is counted in returns, by outlier removal and clusterer alike: several
rings fall into one cell. A 2-D laser has one ring, and its smallest obstacle is counted in cells.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from adcbf_cli.core.config import CLUSTERERS, PerceptionConfig
from adcbf_cli.core.frames import level_rotation, transform_points
from adcbf_cli.core.perception.clusterers import plugin_clusterer
from adcbf_cli.core.perception.clustering import Grouping, dbscan, hdbscan
from adcbf_cli.core.perception.grid import Cells, not_outlying, occupied_cells
from adcbf_cli.core.perception.ground import GroundRemoval
from adcbf_cli.core.perception.obstacles import Shapes, split_over_long
from adcbf_cli.core.timing import Timer, no_timer
from adcbf_cli.core.types import NO_ID, Clusters, FloatArray, Frame, IntArray, Notes, PointCounts, PointLabels


class Perception:
    """Clusters frame after frame. What it keeps between frames is the ground removal's state, so that
    its result is a function of the sequence of frames."""

    def __init__(self, config: PerceptionConfig, notes: Notes, timer: Timer = no_timer) -> None:
        self._config = config
        self._timer = timer
        self._ground = GroundRemoval(config, notes)
        self._plugin = None if config.clusterer in CLUSTERERS else plugin_clusterer(config.clusterer)

    def __call__(self, frame: Frame) -> Clusters:
        """The frame's obstacles, nearest first."""
        timer = self._timer
        points, in_range = self._obstacle_points(frame)
        with timer("grid"):
            cells = occupied_cells(points[:, :2], self._config.cell_m, frame.world_from_sensor[:2, 3])
        above_ground = len(points)
        with timer("smooth"):
            points, cells = self._smooth(points, cells, frame.planar)
        with timer("cluster"):
            grouping = self._cluster(cells, frame.planar)
        with timer("obstacles"):
            shapes, cell_group, origin = split_over_long(
                points, cells.point_cell, cells.mean_m, grouping.label, self._config
            )
            counts = PointCounts(
                read=len(frame.points_m),
                in_range=in_range,
                smoothed=len(points),
                above_ground=above_ground,
                clustered=len(cells),
            )
            return self._assemble(frame, counts, shapes, cell_group, origin, grouping, points, cells)

    def _obstacle_points(self, frame: Frame) -> tuple[FloatArray, int]:
        """Points in the crop that are no ground, local frame (n, 3), and how many were in the crop."""
        config = self._config
        surroundings = config.range_m if frame.planar else self._ground.fit_radius_m
        with self._timer("crop"):
            points = _within(frame.points_m, 2.0 * max(config.range_m, surroundings))
            levelled = level_rotation(frame.world_from_sensor) @ points.T
            x, y = levelled[0], levelled[1]
            distance = np.sqrt(x * x + y * y)
            away = distance >= config.min_range_m
            inside = away & (np.abs(x) <= config.range_m) & (np.abs(y) <= config.range_m)
        if not frame.planar:
            with self._timer("ground"):
                around = away & (distance <= surroundings)
                height = np.full(len(points), -np.inf)
                height[around] = self._ground.heights(levelled[:, around].T)
                kept = inside & (height > -np.inf) & (height <= config.max_height_m)
        else:
            kept = inside
        return points[kept] @ frame.world_from_sensor[:3, :3].T, int(inside.sum())

    def _smooth(self, points: FloatArray, cells: Cells, planar: bool) -> tuple[FloatArray, Cells]:
        """Leave out the cells that stand alone, and their points."""
        config = self._config
        if not config.smoothing or len(cells) == 0:
            return points, cells
        neighbours = min(config.smoothing_neighbours, self._min_cluster_size(planar) - 1)
        returns = None if planar else cells.returns()
        keep = not_outlying(cells.mean_m, neighbours, config.smoothing_std_ratio, config.cell_m, returns)
        number = np.cumsum(keep) - 1
        stays = keep[cells.point_cell]
        return points[stays], Cells(cells.mean_m[keep], number[cells.point_cell[stays]])

    def _min_cluster_size(self, planar: bool) -> int:
        return self._config.planar_min_cluster_size if planar else self._config.min_cluster_size

    def _cluster(self, cells: Cells, planar: bool) -> Grouping:
        config = self._config
        smallest = self._min_cluster_size(planar)
        returns = None if planar else cells.returns()
        if self._plugin is not None:
            return self._plugin(cells.mean_m, config, smallest, returns)
        if config.clusterer == "dbscan":
            return dbscan(
                cells.mean_m,
                eps_m=config.dbscan_eps_m,
                min_samples=config.min_samples,
                min_cluster_size=smallest,
                returns=returns,
            )
        return hdbscan(
            cells.mean_m,
            min_cluster_size=smallest,
            min_samples=config.min_samples,
            min_gap_m=config.min_gap_m,
            max_gap_m=config.max_gap_m,
            min_probability=config.min_probability,
            returns=returns,
        )

    def _assemble(
        self,
        frame: Frame,
        counts: PointCounts,
        shapes: Shapes,
        cell_group: IntArray,
        origin: IntArray,
        grouping: Grouping,
        points: FloatArray,
        cells: Cells,
    ) -> Clusters:
        """The record, with clusters numbered from the nearest on."""
        n = len(shapes.radius_m)
        distance = np.hypot(shapes.centre_m[:, 0], shapes.centre_m[:, 1])
        order = np.lexsort((shapes.centre_m[:, 1], shapes.centre_m[:, 0], distance))
        rank = np.full(n + 1, NO_ID, dtype=np.int64)
        rank[order] = np.arange(n)
        cell_id = rank[cell_group]
        member = cell_id != NO_ID
        size = np.bincount(cell_id[member], minlength=n)
        probability = np.bincount(cell_id[member], grouping.probability[member], minlength=n) / np.maximum(size, 1)
        rotation = frame.world_from_sensor[:3, :3]
        centre = shapes.centre_m[order]
        return Clusters(
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            world_from_sensor=frame.world_from_sensor,
            planar=frame.planar,
            pose_known=frame.pose_known,
            counts=counts,
            cluster_id=np.arange(n, dtype=np.int64),
            centre_m=centre + frame.world_from_sensor[:3, 3],
            centre_sensor_m=centre @ rotation,
            radius_m=shapes.radius_m[order],
            height_m=shapes.height_m[order],
            length_m=shapes.length_m[order],
            width_m=shapes.width_m[order],
            yaw_rad=shapes.yaw_rad[order],
            points=size.astype(np.int64),
            probability=probability,
            split_from=_nearest_piece(origin[order]),
            labels=self._point_labels(frame, points, cell_id[cells.point_cell]),
        )

    def _point_labels(self, frame: Frame, points: FloatArray, cluster_id: IntArray) -> PointLabels | None:
        if not self._config.point_labels:
            return None
        shift = np.eye(4)
        shift[:3, 3] = frame.world_from_sensor[:3, 3]
        return PointLabels(transform_points(shift, points), cluster_id)


def _within(points_m: FloatArray, limit_m: float) -> FloatArray:
    """Points with all coordinates up to `limit_m`: a cheap crop that keeps all that may matter, and
    drops what is not finite or so far that its square is not."""
    x, y, z = np.abs(points_m).T
    near: FloatArray = points_m[(x <= limit_m) & (y <= limit_m) & (z <= limit_m)]
    return near


def _nearest_piece(origin: IntArray) -> IntArray:
    """For each piece, the smallest cluster id among the pieces of the same origin; NO_ID stays."""
    named = np.full(len(origin), NO_ID, dtype=np.int64)
    pieces = np.flatnonzero(origin != NO_ID)
    _, first, inverse = np.unique(origin[pieces], return_index=True, return_inverse=True)
    named[pieces] = pieces[first][inverse]
    return named


def cluster_frames(
    frames: Iterable[Frame], config: PerceptionConfig, notes: Notes, timer: Timer = no_timer
) -> Iterator[Clusters]:
    """The obstacles of each frame, in order."""
    perception = Perception(config, notes, timer)
    for frame in frames:
        yield perception(frame)
