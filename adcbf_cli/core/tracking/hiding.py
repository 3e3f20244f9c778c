"""Which places the LiDAR cannot see, since something nearer stands in the line of sight."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.frames import wrap_angle
from adcbf_cli.core.types import BoolArray, Clusters, FloatArray

NEAREST_M = 0.1


def is_hidden(place_m: FloatArray, clusters: Clusters) -> BoolArray:
    """(n,) which places (n, 3), world, lie behind a cluster's rectangle, and not above its shadow.

    A place is behind where its bearing from the sensor is between those of the rectangle's corners, and it is
    farther than the rectangle's centre. The shadow ends at the ray from the sensor over the cluster's top.
    """
    if not len(place_m) or not len(clusters):
        return np.zeros(len(place_m), dtype=np.bool_)
    sensor_m = clusters.world_from_sensor[:3, 3]
    offset = place_m - sensor_m
    far_m = np.hypot(offset[:, 0], offset[:, 1])[:, None]
    centre = clusters.centre_m - sensor_m
    near_m = np.maximum(np.hypot(centre[:, 0], centre[:, 1]), NEAREST_M)
    middle = np.arctan2(centre[:, 1], centre[:, 0])
    corners = centre[:, None, :2] + _corners(clusters)
    edges = wrap_angle(np.arctan2(corners[..., 1], corners[..., 0]) - middle[:, None])
    turn = wrap_angle(np.arctan2(offset[:, 1], offset[:, 0])[:, None] - middle)
    behind = (turn >= edges.min(axis=1)) & (turn <= edges.max(axis=1)) & (far_m > near_m)
    shadow_m = (centre[:, 2] + clusters.height_m / 2) * far_m / near_m
    hidden: BoolArray = np.any(behind & (offset[:, 2:] <= shadow_m), axis=1)
    return hidden


def _corners(clusters: Clusters) -> FloatArray:
    """(c, 4, 2) from each rectangle's centre to its corners, world axes."""
    c, s = np.cos(clusters.yaw_rad), np.sin(clusters.yaw_rad)
    along = np.stack([c, s], axis=-1) * clusters.length_m[:, None] / 2
    across = np.stack([-s, c], axis=-1) * clusters.width_m[:, None] / 2
    return np.stack([along + across, along - across, -along + across, -along - across], axis=1)
