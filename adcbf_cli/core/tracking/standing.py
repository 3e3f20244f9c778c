"""What stands keeps its place: pieces of walls, and what fades from sight."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.tracking.bank import TrackBank
from adcbf_cli.core.tracking.modes import combine
from adcbf_cli.core.types import NO_ID, BoolArray, Clusters, FloatArray, IntArray

PARTIAL = 0.75
CONTAINED_M = 0.1
"""A cluster of less than this share of a standing track's radius, within its circle to this much, is a part of it and
says nothing of its centre."""

FADING_S = 0.5
"""What is seen in part for longer is no longer fading: it was taken for larger than it is."""

STANDING_VARIANCE = 1e-4
"""Of the velocity (m^2/s^2) and higher derivatives of what is held at rest."""


def hold_structures(bank: TrackBank) -> None:
    """Pieces of walls start each step at rest."""
    if bank.is_structure.any():
        _at_rest(bank, bank.is_structure)


def hold_faint(
    bank: TrackBank, clusters: Clusters, now_s: float, states: FloatArray, covariances: FloatArray
) -> BoolArray:
    """(n,) which tracks are held, where their sightings tell no more of them.

    Tracks that stand, end below the sensor and are seen only in small part where they are, stay for FADING_S as they
    were before this step, at (n, m, d), (n, m, d, d). What sinks below the lowest beam seems to move while less and
    less of it is seen; what rises above the sensor cannot sink there, and a person whose side is seen may walk."""
    result = np.zeros(len(bank), dtype=np.bool_)
    seen = np.flatnonzero(bank.cluster_id != NO_ID)
    if not len(seen):
        return result
    column = np.searchsorted(clusters.cluster_id, bank.cluster_id[seen])
    centre = combine(states[seen], covariances[seen], bank.modes[seen])[0][:, :2]
    off = np.hypot(*(clusters.centre_m[column, :2] - centre).T)
    part_m, whole_m = clusters.radius_m[column], bank.radius_m[seen]
    partial = (part_m < PARTIAL * whole_m) & (off + part_m <= whole_m + CONTAINED_M)
    bank.whole_s[seen[~partial]] = now_s
    is_low = clusters.centre_m[column, 2] + 0.5 * bank.height_m[seen] < clusters.world_from_sensor[2, 3]
    held = seen[partial & is_low & bank.is_static[seen] & (now_s - bank.whole_s[seen] <= FADING_S)]
    bank.states[held] = states[held]
    bank.covariances[held] = covariances[held]
    _at_rest(bank, held)
    result[held] = True
    return result


def _at_rest(bank: TrackBank, held: BoolArray | IntArray) -> None:
    bank.states[held, :, 3:] = 0.0
    bank.covariances[held, :, 3:, :] = 0.0
    bank.covariances[held, :, :, 3:] = 0.0
    for k in range(3, bank.states.shape[2]):
        bank.covariances[held, :, k, k] = STANDING_VARIANCE
