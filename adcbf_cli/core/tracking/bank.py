"""The tracks alive, as one structure of arrays, and what is known of each besides its state."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from adcbf_cli.core.tracking.bodies import Bodies
from adcbf_cli.core.tracking.stillness import Sightings
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

NOISE_SCALE_BOUNDS = (0.1**2, 5.0**2)
CALMEST_VERTICAL_SCALE = 1.0
"""The vertical noise is never taken as smaller than configured: the seen height jumps when a ring of
the LiDAR comes to lie on the obstacle or leaves it, and calm scans before say nothing of that."""
"""How far a track's measurement noise may depart from the nominal variance."""
NOISE_PRIOR_HITS = 10.0
"""The nominal noise counts as much as this many innovations."""
NOISE_MEMORY_HITS = 50.0
"""Innovations that the noise estimate remembers: a few seconds, as views change slowly."""
GROWING_GAIN = 0.3
SHRINKING_GAIN = 0.05
IDENTITY = ("track_id", "status", "born_s", "hits", "misses", "frames", "nis")
"""What a track keeps that begins anew."""


@dataclass(slots=True)
class TrackBank:
    """n tracks with m modes of dimension d.

    states (n, m, d), covariances (n, m, d, d), modes (n, m) probabilities; noise_scale (n, 3)
    factors on the nominal measurement variance; spread_m (n, 3) the along-the-wall noise of a piece
    of a wall, world frame; seen_s and born_s: times of the last and first hit;
    whole_s: when more than a small part of it was last seen; hidden_s: how long, since its last hit, something
    nearer hid it; seen_at_m (n, 2) where
    the body's centre was measured at the last hit, world frame.
    """

    track_id: IntArray
    status: IntArray
    states: FloatArray
    covariances: FloatArray
    modes: FloatArray
    noise_scale: FloatArray
    spread_m: FloatArray
    radius_m: FloatArray
    height_m: FloatArray
    is_static: BoolArray
    is_structure: BoolArray
    cluster_id: IntArray
    born_s: FloatArray
    seen_s: FloatArray
    whole_s: FloatArray
    hidden_s: FloatArray
    hits: IntArray
    misses: IntArray
    frames: IntArray
    nis: FloatArray
    bodies: Bodies
    seen_at_m: FloatArray
    sightings: Sightings

    @classmethod
    def empty(cls, modes: int, dimension: int) -> TrackBank:
        def zeros(*shape: int) -> FloatArray:
            return np.zeros((0, *shape))

        def integers() -> IntArray:
            return np.zeros(0, dtype=np.int64)

        return cls(
            track_id=integers(),
            status=integers(),
            states=zeros(modes, dimension),
            covariances=zeros(modes, dimension, dimension),
            modes=zeros(modes),
            noise_scale=zeros(3),
            spread_m=zeros(3),
            radius_m=zeros(),
            height_m=zeros(),
            is_static=np.zeros(0, dtype=np.bool_),
            is_structure=np.zeros(0, dtype=np.bool_),
            cluster_id=integers(),
            born_s=zeros(),
            seen_s=zeros(),
            whole_s=zeros(),
            hidden_s=zeros(),
            hits=integers(),
            misses=integers(),
            frames=integers(),
            nis=zeros(),
            bodies=Bodies.empty(),
            seen_at_m=zeros(2),
            sightings=Sightings.empty(0),
        )

    def __len__(self) -> int:
        return len(self.track_id)

    def keep(self, rows: BoolArray) -> None:
        """Drops all tracks but these."""
        if rows.all():
            return
        for field in fields(self):
            value = getattr(self, field.name)
            setattr(self, field.name, value[rows] if isinstance(value, np.ndarray) else value.select(rows))

    def append(self, other: TrackBank) -> None:
        """Adds new tracks, whose sightings are still empty."""
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, Sightings):
                setattr(self, field.name, value.grow(len(other)))
            elif isinstance(value, Bodies):
                setattr(self, field.name, value.joined(other.bodies))
            else:
                setattr(self, field.name, np.concatenate([value, getattr(other, field.name)]))

    def restart(self, rows: IntArray, other: TrackBank) -> None:
        """Tracks `rows` (k,) are from now on the k new ones of `other`, under their old identifiers."""
        for field in fields(self):
            if field.name in IDENTITY:
                continue
            value, new = getattr(self, field.name), getattr(other, field.name)
            if isinstance(value, np.ndarray):
                value[rows] = new
            else:
                value.put(rows, new)


def smoothed_size(old: FloatArray, seen: FloatArray) -> FloatArray:
    """A slow, one-sided average: a partial view hardly shrinks an obstacle, a single merged view
    does not inflate it at once. It settles near the upper sixth of what is seen (an expectile)."""
    return old + np.where(seen > old, GROWING_GAIN, SHRINKING_GAIN) * (seen - old)


def adapted_noise(
    scale: FloatArray,
    hits: IntArray,
    innovation: FloatArray,
    total: FloatArray,
    noise: FloatArray,
) -> FloatArray:
    """The noise scales (n, 3) after one more innovation (n, k) of covariance `total` (n, k, k).

    An online EM step on the diagonal of R: given the innovation v of covariance S, the expected
    noise is R + R S^-1 (v v^T - S) S^-1 R, which is R itself on average where R is right. It is
    followed with a falling gain, and bounded. Components not measured (k < 3) keep their scale.
    """
    k = innovation.shape[1]
    solved = np.linalg.solve(total, noise)
    smoothed = np.einsum("nij,ni->nj", solved, innovation)
    diagonal = np.diagonal(noise, axis1=1, axis2=2)
    expected = np.diagonal(noise @ solved, axis1=1, axis2=2)
    change = (smoothed**2 - expected) / diagonal
    gain = 1.0 / np.minimum(NOISE_PRIOR_HITS + hits, NOISE_MEMORY_HITS)
    result = scale.copy()
    # One wild innovation must not undo what many have shown.
    result[:, :k] *= 1.0 + gain[:, None] * np.minimum(change, 9.0)
    result = np.clip(result, *NOISE_SCALE_BOUNDS)
    result[:, 2] = np.maximum(result[:, 2], CALMEST_VERTICAL_SCALE)
    return result
