"""How each cluster of a frame would look as each track's body: where the body's centre would then be
and how sure that is; and what a track learns of its body from the cluster that it took."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.bank import TrackBank, smoothed_size
from adcbf_cli.core.tracking.bodies import (
    MAX_YAW_VARIANCE,
    Bodies,
    axes_at,
    carried_bodies,
    completion,
    completion_sigma,
    cut_surplus,
    extents_along,
    facing,
    followed_course,
    followed_yaw,
    grown_bodies,
    known,
    moved_bodies,
    rectangle_yaw_variance,
)
from adcbf_cli.core.tracking.sharing import Sharing
from adcbf_cli.core.types import NO_ID, BoolArray, Clusters, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Views:
    """n tracks by c clusters. yaw_rad, yaw_variance: (n, c) of the body, corrected by the cluster's
    rectangle; axes: (n, c, 2, 2); ends: (n, c, 2) as from `bodies.facing`; known, trust: (n, c) how far
    the axes hold, and how far to complete by them; seen_m: (n, c, 2) the cluster's extents along them;
    shift_m: (n, c, 3) from the cluster's centre to the body's, world; shared: (n, c) as from `Sharing`."""

    yaw_rad: FloatArray
    yaw_variance: FloatArray
    axes: FloatArray
    ends: FloatArray
    known: FloatArray
    trust: FloatArray
    seen_m: FloatArray
    shift_m: FloatArray
    shared: BoolArray

    def centre_sensor_m(self, clusters: Clusters) -> FloatArray:
        """(n, c, 3) the bodies' centres, sensor frame."""
        centres: FloatArray = clusters.centre_sensor_m + self.shift_m @ clusters.world_from_sensor[:3, :3]
        return centres

    def centre_m(self, clusters: Clusters, rows: IntArray, columns: IntArray) -> FloatArray:
        """(k, 2) the bodies' centres of these pairs, world."""
        centres: FloatArray = clusters.centre_m[columns, :2] + self.shift_m[rows, columns, :2]
        return centres


def view_bodies(
    bodies: Bodies,
    place_m: FloatArray,
    is_structure: BoolArray,
    clusters: Clusters,
    sharing: Sharing,
    config: TrackingConfig,
) -> Views:
    """All pairs of tracks, expected at place_m (n, 2), and clusters. Pieces of a split cluster have ends
    where they were cut, and tell nothing of a body. A shared cluster tells nothing of the body's direction
    or size, and what it has beyond the body belongs to the others."""
    whole = (clusters.split_from == NO_ID)[None, :] & ~is_structure[:, None]
    shared = sharing.pairs(len(clusters))
    rectangle_variance = np.where(shared, MAX_YAW_VARIANCE, rectangle_yaw_variance(clusters.length_m, config)[None, :])
    yaw, variance = followed_yaw(
        bodies.yaw_rad[:, None], bodies.yaw_variance[:, None], clusters.yaw_rad, rectangle_variance
    )
    axes = axes_at(yaw)
    to_sensor = np.broadcast_to((clusters.world_from_sensor[:2, 3] - place_m)[:, None, :], (*yaw.shape, 2))
    extent = bodies.extent_m[:, None, :]
    ends = facing(axes, extent, to_sensor)
    seen = extents_along(clusters.length_m, clusters.width_m, clusters.yaw_rad, yaw)
    sure = known(variance) * whole
    trust = sure * bodies.steadiness(config)[:, None]
    shift = np.zeros((*trust.shape, 3))
    offset = completion(extent, seen, ends, trust, config.sigma_range_m)
    to_others = facing(axes, extent, (sharing.others_m - place_m)[:, None, :])
    cut = cut_surplus(extent, seen, to_others, trust)
    offset = np.where(shared[:, :, None] & (seen > extent), cut, offset)
    shift[:, :, :2] = np.einsum("nci,ncij->ncj", offset, axes)
    return Views(yaw, variance, axes, ends, sure, trust, seen, shift, shared)


def size_doubt(
    bank: TrackBank, views: Views, clusters: Clusters, rows: IntArray, columns: IntArray
) -> tuple[FloatArray, FloatArray]:
    """How far the sizes of these pairs (k,) let their centres be off: one standard deviation along and
    across the line of sight (k,), and one along each body axis, (k, 2, 3), world.

    A cluster smaller than the obstacle is part of it, a larger one holds something else too. Where the
    body's axes are unknown, its centre may be off by as much as the radii differ, in any direction.
    """
    trust = views.trust[rows, columns]
    differs = (1.0 - trust) * (clusters.radius_m[columns] - bank.radius_m[rows])
    sigma = completion_sigma(bank.bodies.extent_m[rows], views.seen_m[rows, columns], views.ends[rows, columns], trust)
    along = np.zeros((len(rows), 2, 3))
    along[:, :, :2] = sigma[:, :, None] * views.axes[rows, columns]
    return differs, along


def learn_sizes(
    bank: TrackBank,
    views: Views,
    clusters: Clusters,
    rows: IntArray,
    columns: IntArray,
    since_s: FloatArray,
    config: TrackingConfig,
) -> FloatArray:
    """Bodies and circles of tracks `rows` after they took clusters `columns`, since_s (k,) after the last.

    Returns (k, 2), world: how far the bodies' centres move because their extents are now known better.
    The end that was seen stays where it is, so a body that turns out longer has its centre farther on;
    that is no motion of the body. A shared cluster teaches nothing; the body just goes on.
    """
    weights = bank.modes[rows]
    velocity = np.einsum("km,kmi->ki", weights, bank.states[rows, :, 3:5])
    shared = views.shared[rows, columns]
    bank.bodies.put(
        rows[shared], carried_bodies(bank.bodies.select(rows[shared]), (velocity * since_s[:, None])[shared])
    )
    moved = np.zeros((len(rows), 2))
    alone = ~shared
    moved[alone] = _learn_alone(bank, views, clusters, rows[alone], columns[alone], since_s[alone], config)
    return moved


def _learn_alone(
    bank: TrackBank,
    views: Views,
    clusters: Clusters,
    rows: IntArray,
    columns: IntArray,
    since_s: FloatArray,
    config: TrackingConfig,
) -> FloatArray:
    """`learn_sizes` where the clusters hold nothing else."""
    seen, ends, trust = views.seen_m[rows, columns], views.ends[rows, columns], views.trust[rows, columns]
    axes, sensor = views.axes[rows, columns], clusters.world_from_sensor[:2, 3]
    old = replace(
        bank.bodies.select(rows), yaw_rad=views.yaw_rad[rows, columns], yaw_variance=views.yaw_variance[rows, columns]
    )
    new = grown_bodies(old, seen, views.centre_m(clusters, rows, columns), sensor)
    # What full trust would have made of it: this decides how far to trust from now on.
    sure, noise_m = views.known[rows, columns], config.sigma_range_m
    before = np.einsum("ki,kij->kj", completion(old.extent_m, seen, ends, sure, noise_m), axes)
    after = np.einsum("ki,kij->kj", completion(new.extent_m, seen, ends, sure, noise_m), axes)
    weights = bank.modes[rows]
    velocity = np.einsum("km,kmi->ki", weights, bank.states[rows, :, 3:5])
    spread = np.einsum("km,kmij->kij", weights, bank.covariances[rows, :, 3:5, 3:5])
    centre = clusters.centre_m[columns, :2]
    new = moved_bodies(new, centre, centre + before, after - before, velocity * since_s[:, None], noise_m)
    new = followed_course(new, velocity, spread)
    whole = clusters.split_from[columns] == NO_ID
    bank.bodies.put(rows[whole], new.select(whole))
    moved: FloatArray = (trust / np.maximum(sure, 1e-6))[:, None] * (after - before)
    # Around the completed centre the circle has to cover the body, but no more than what was seen needs.
    reach = clusters.radius_m[columns] + np.linalg.norm(views.shift_m[rows, columns], axis=1)
    covering = np.minimum(reach, np.linalg.norm(new.extent_m, axis=1) / 2)
    radius = np.maximum(clusters.radius_m[columns], trust * covering)
    bank.radius_m[rows] = smoothed_size(bank.radius_m[rows], radius)
    bank.height_m[rows] = smoothed_size(bank.height_m[rows], clusters.height_m[columns])
    return np.where(whole[:, None], moved, 0.0)
