"""The plain way from a scan to clusters: what one writes first, the libraries one after the other.

Crop, Patchwork++ at its published settings, the means of 0.1 m cubes, and scikit-learn's HDBSCAN on
all of them at once.
"""

from __future__ import annotations

import numpy as np
import pypatchworkpp
from sklearn.cluster import HDBSCAN

from adcbf_cli.core.timing import RecordingTimer
from adcbf_cli.core.types import NO_ID, FloatArray, Frame, IntArray

CELL_M = 0.1


def whole_cloud(points_m: FloatArray, *, min_gap_m: float = 0.0) -> IntArray:
    """scikit-learn's HDBSCAN labels of all points at once."""
    if len(points_m) < 5:
        return np.full(len(points_m), NO_ID)
    found = HDBSCAN(min_cluster_size=5, min_samples=3, cluster_selection_epsilon=min_gap_m, copy=True).fit(points_m)
    return found.labels_.astype(np.int64)


class PlainPipeline:
    """What one writes first: the libraries one after the other."""

    def __init__(self, range_m: float) -> None:
        self._range_m = range_m
        parameters = pypatchworkpp.Parameters()
        parameters.enable_RNR = False
        self._patchwork = pypatchworkpp.patchworkpp(parameters)

    def __call__(self, frame: Frame, timer: RecordingTimer) -> tuple[FloatArray, IntArray]:
        """Obstacle points (n, 3) in the sensor's frame, and their labels."""
        with timer("crop"):
            points = frame.points_m[(np.abs(frame.points_m[:, :2]) <= self._range_m).all(axis=1)]
        with timer("ground"):
            self._patchwork.estimateGround(points.astype(np.float32))
            points = points[self._patchwork.getNongroundIndices()]
            points = points[points[:, 2] < 0.8]
        with timer("grid"):
            cell = np.floor(points / CELL_M).astype(np.int64)
            _, owner, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
            means = np.stack([np.bincount(owner, points[:, axis]) / count for axis in range(3)], axis=1)
        with timer("cluster"):
            label = whole_cloud(means)
        with timer("obstacles"):
            for cluster in range(label.max(initial=NO_ID) + 1):
                own = means[label == cluster]
                np.hypot(*(own[:, :2] - own[:, :2].mean(axis=0)).T).max()
        return points, label[owner]
