"""Clusterers of other packages: what they are called with, and what is made sure of in what they return."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from adcbf_cli.core.config import CLUSTERERS, PerceptionConfig
from adcbf_cli.core.perception.clustering import Grouping, in_order_of_appearance
from adcbf_cli.core.plugins import Kind, Plugin, find_plugin, load_plugin, malformed
from adcbf_cli.core.types import NO_ID, FloatArray, IntArray


class Clusterer(Protocol):
    def __call__(
        self, cells_m: FloatArray, config: PerceptionConfig, min_cluster_size: int, returns: IntArray | None
    ) -> Grouping:
        """Groups one frame's occupied grid cells, at least one.

        cells_m: (k, 2) the mean of each cell's points, m, axes parallel to the world's, the sensor at the origin.
        min_cluster_size: cells (or returns in two or more cells) of the smallest obstacle, by the kind of LiDAR.
        returns: (k,) points in each cell; None for a 2-D laser.
        """
        ...


def plugin_clusterer(name: str) -> Clusterer:
    """The clusterer that an installed package offers under `name`, its results checked and renumbered.
    Raises UsageError where it cannot be had, and when called, for a result that is no grouping of the cells."""
    plugin = find_plugin(Kind.CLUSTERER, name, CLUSTERERS)
    made: Clusterer = load_plugin(plugin)

    def cluster(
        cells_m: FloatArray, config: PerceptionConfig, min_cluster_size: int, returns: IntArray | None
    ) -> Grouping:
        if len(cells_m) == 0:
            return Grouping(np.zeros(0, dtype=np.int64), np.zeros(0))
        return _checked(plugin, made(cells_m, config, min_cluster_size, returns), len(cells_m))

    return cluster


def _checked(plugin: Plugin, found: Grouping, cells: int) -> Grouping:
    label, probability = np.asarray(found.label), np.asarray(found.probability, dtype=np.float64)
    if label.shape != (cells,) or probability.shape != (cells,):
        raise malformed(plugin, f"labels {label.shape} and probabilities {probability.shape} of {cells} cells")
    if not np.issubdtype(label.dtype, np.integer) or (label < NO_ID).any():
        raise malformed(plugin, f"labels must be whole numbers from 0 on, or {NO_ID} for noise")
    if not ((probability >= 0) & (probability <= 1)).all():
        raise malformed(plugin, "probabilities must lie between 0 and 1")
    return Grouping(in_order_of_appearance(label.astype(np.int64)), np.where(label == NO_ID, 0.0, probability))
