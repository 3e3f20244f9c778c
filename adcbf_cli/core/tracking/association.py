"""Which cluster belongs to which track: optimal assignment within gates.

A pair's cost is twice its negative log likelihood, up to constants: squared Mahalanobis distance of
the innovation, log determinant of its covariance, and how much the sizes disagree. A track may also
stay without a cluster, at a cost that no pair within the gates exceeds.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.linalg import inverted
from adcbf_cli.core.tracking.measurement import Measurement
from adcbf_cli.core.types import FloatArray, IntArray

MIN_RADIUS_M = 0.1
"""Radii below a grid cell are noise; they are compared as this."""

MAX_SIZE_COST = 9.0
"""Three sigma: what the worst disagreement in size adds to a pair's cost."""


def gate_chi2(dimension: int, probability: float) -> float:
    """The chi-square quantile that holds `probability` of a k-dimensional innovation's squared norm."""
    return float(chdtri(dimension, 1.0 - probability))


def assign(
    expected: FloatArray,
    innovation_covariance: FloatArray,
    track_radius_m: FloatArray,
    measured: FloatArray,
    cluster_radius_m: FloatArray,
    measurement: Measurement,
    config: TrackingConfig,
) -> tuple[IntArray, IntArray]:
    """Indices of the tracks and of the clusters that belong together, by ascending track.

    expected: (n, k); innovation_covariance: (n, k, k); measured: (n, c, k), or (c, k) where all tracks see
    a cluster alike; radii (n,) and (c,).
    """
    n, c = len(expected), len(cluster_radius_m)
    if n == 0 or c == 0:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    gate = gate_chi2(measurement.dimension, config.gate_probability)
    inverse = inverted(innovation_covariance)
    shape = (n, c, measurement.dimension)
    innovation = measurement.difference(np.broadcast_to(measured, shape), np.broadcast_to(expected[:, None, :], shape))
    distance = np.einsum("nck,nck->nc", innovation @ inverse, innovation)
    size_cost, size_fits = size_agreement(track_radius_m, cluster_radius_m, config)
    log_volume = np.linalg.slogdet(innovation_covariance)[1]
    log_volume -= log_volume.min()
    cost = distance + log_volume[:, None] + size_cost
    cost_alone = gate + float(log_volume.max()) + MAX_SIZE_COST
    return _solve(np.where(size_fits & (distance <= gate), cost, np.inf), cost_alone)


def size_agreement(
    track_radius_m: FloatArray, cluster_radius_m: FloatArray, config: TrackingConfig
) -> tuple[FloatArray, FloatArray]:
    """(n, c) the cost of different radii, and whether they may be the same obstacle at all.

    The log ratio of radii counts as normal with a third of the allowed ratio's log as its sigma;
    differences below `size_difference_m` are never ruled out, as views of a small obstacle vary.
    """
    ours = np.maximum(track_radius_m, MIN_RADIUS_M)[:, None]
    theirs = np.maximum(cluster_radius_m, MIN_RADIUS_M)[None, :]
    limit = np.log(config.size_ratio)
    log_ratio = np.abs(np.log(theirs / ours))
    fits = (log_ratio <= limit) | (np.abs(theirs - ours) <= config.size_difference_m)
    return np.minimum((3.0 * log_ratio / limit) ** 2, MAX_SIZE_COST), fits


def _solve(cost: FloatArray, cost_alone: float) -> tuple[IntArray, IntArray]:
    """Optimal assignment where each row may also stay alone; infinite cost means never."""
    rows = np.flatnonzero(np.isfinite(cost).any(axis=1))
    columns = np.flatnonzero(np.isfinite(cost).any(axis=0))
    forbidden = 1e6 + 10.0 * cost_alone
    table = np.full((len(rows), len(columns) + len(rows)), forbidden)
    table[:, : len(columns)] = np.where(np.isfinite(cost), cost, forbidden)[np.ix_(rows, columns)]
    table[np.arange(len(rows)), len(columns) + np.arange(len(rows))] = cost_alone
    row_choice, column_choice = linear_sum_assignment(table)
    paired = column_choice < len(columns)
    return rows[row_choice[paired]].astype(np.int64), columns[column_choice[paired]].astype(np.int64)
