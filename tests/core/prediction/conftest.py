"""Hand-made tracks for the prediction tests."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from adcbf_cli.core.types import NO_ID, Tracks, TrackStatus


def build_tracks(
    time_s: float,
    state: object,
    covariance: object = None,
    *,
    model: str = "cv",
    track_id: object = None,
    status: object = None,
    is_static: object = False,
    seen: object = True,
    manoeuvre: object = None,
    index: int = 0,
) -> Tracks:
    """A frame of n tracks with these states (n, d)."""
    states = np.atleast_2d(np.asarray(state, dtype=np.float64))
    n, d = states.shape
    covariances = np.tile(0.01 * np.eye(d), (n, 1, 1)) if covariance is None else np.asarray(covariance)
    return Tracks(
        frame_index=index,
        stamp_ns=10**18 + round(time_s * 1e9),
        world_from_sensor=np.eye(4),
        model=model,
        track_id=np.arange(n) if track_id is None else np.asarray(track_id, dtype=np.int64),
        status=np.full(n, TrackStatus.CONFIRMED) if status is None else np.asarray(status, dtype=np.int64),
        state=states,
        covariance=covariances,
        radius_m=np.full(n, 0.3),
        height_m=np.full(n, 1.0),
        is_static=np.broadcast_to(np.asarray(is_static), (n,)).copy(),
        cluster_id=np.where(np.broadcast_to(np.asarray(seen), (n,)), np.arange(n), NO_ID),
        age_s=np.full(n, 1.0),
        hits=np.full(n, 10),
        misses=np.zeros(n, dtype=np.int64),
        nis=np.full(n, np.nan),
        manoeuvre=None if manoeuvre is None else np.broadcast_to(np.asarray(manoeuvre, float), (n,)).copy(),
    )


@pytest.fixture(scope="session")
def make_tracks() -> Callable[..., Tracks]:
    return build_tracks
