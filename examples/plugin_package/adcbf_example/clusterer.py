"""`euclid`: Euclidean clustering. Cells nearer to each other than a gap are one obstacle."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from adcbf_cli.core.config import PerceptionConfig
from adcbf_cli.core.perception.clustering import Grouping
from adcbf_cli.core.types import NO_ID, FloatArray, IntArray


def euclid(cells_m: FloatArray, config: PerceptionConfig, min_cluster_size: int, returns: IntArray | None) -> Grouping:
    """Components of the graph of cells (k, 2) nearer than `perception.dbscan_eps_m`. One that holds fewer cells than
    the smallest obstacle, and fewer returns, is noise."""
    k = len(cells_m)
    first, second = cKDTree(cells_m).query_pairs(config.dbscan_eps_m, output_type="ndarray").T
    graph = coo_array((np.ones(len(first)), (first, second)), shape=(k, k))
    _, component = connected_components(graph, directed=False)
    size = np.bincount(component)
    if returns is not None:
        size = np.where(size > 1, np.bincount(component, returns), size)
    large = size[component] >= min_cluster_size
    return Grouping(np.where(large, component, NO_ID), large.astype(np.float64))
