"""Tracks, smoothed with what was seen later: where the obstacles of a log really were.

A Rauch-Tung-Striebel smoother (Rauch, Tung, Striebel 1965; Bar-Shalom, Li, Kirubarajan 2001, sec.
8.6) over each track's stored states and covariances, with the tracker's own motion model and process
noise. Only means are computed. The tracker mixes two levels of process noise; here each step takes
their average at the track's probability of manoeuvring.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.modes import ModeChain
from adcbf_cli.core.tracking.motion import MotionModel, build_motion_model
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, IntArray, Tracks, TrackStatus


@dataclass(frozen=True, slots=True)
class SmoothTrack:
    """One track from its first to its last sighting, T rows in time.

    position_m, velocity_mps, sensor_m: (T, 2) world xy; sensor_m is where it was seen from.
    radius_m: (T,); is_static: (T,) as the tracker said then.
    """

    track_id: int
    stamp_ns: IntArray
    position_m: FloatArray
    velocity_mps: FloatArray
    radius_m: FloatArray
    is_static: BoolArray
    sensor_m: FloatArray


@dataclass(frozen=True, slots=True)
class _Rows:
    """All tracks' rows of a log, by track, then time."""

    track_id: IntArray
    stamp_ns: IntArray
    state: FloatArray
    covariance: FloatArray
    manoeuvre: FloatArray
    radius_m: FloatArray
    is_static: BoolArray
    seen: BoolArray
    confirmed: BoolArray
    sensor_m: FloatArray


def smooth_tracks(frames: Iterable[Tracks], config: TrackingConfig) -> list[SmoothTrack]:
    """Every track that was ever confirmed, by id. Before its first and after its last sighting a track
    is the tracker's guess, and left out."""
    records = list(frames)
    chain = ModeChain.from_config(config)
    rows = _gathered(records, float(chain.stationary[-1]))
    if rows is None:
        return []
    model = build_motion_model(config.model_copy(update={"model": records[0].model}), planar=False)
    # All tracks make the same steps in time.
    model = replace(model, process_noise=cache(model.process_noise))
    bounds = np.flatnonzero(np.diff(rows.track_id)) + 1
    smoothed = []
    for first, last in zip([0, *bounds], [*bounds, len(rows.track_id)], strict=True):
        seen = np.flatnonzero(rows.seen[first:last])
        if rows.confirmed[first:last].any() and len(seen):
            smoothed.append(_smoothed(rows, slice(int(first + seen[0]), int(first + seen[-1] + 1)), model, chain))
    return smoothed


def _gathered(records: list[Tracks], usual_manoeuvre: float) -> _Rows | None:
    filled = [t for t in records if len(t)]
    if not filled:
        return None
    ids = np.concatenate([t.track_id for t in filled])
    stamps = np.concatenate([np.full(len(t), t.stamp_ns, dtype=np.int64) for t in filled])
    order = np.lexsort((stamps, ids))
    # The same frame twice (a frame out of order is recorded at the last one's stamp): the first counts.
    order = order[np.concatenate([[True], (np.diff(ids[order]) != 0) | (np.diff(stamps[order]) != 0)])]
    manoeuvre = [np.full(len(t), usual_manoeuvre) if t.manoeuvre is None else t.manoeuvre for t in filled]

    def gather(values: list[np.ndarray]) -> np.ndarray:
        return np.asarray(np.concatenate(values)[order])

    return _Rows(
        track_id=ids[order],
        stamp_ns=stamps[order],
        state=gather([t.state for t in filled]),
        covariance=gather([t.covariance for t in filled]),
        manoeuvre=gather(manoeuvre),
        radius_m=gather([t.radius_m for t in filled]),
        is_static=gather([t.is_static for t in filled]),
        seen=gather([t.cluster_id != NO_ID for t in filled]),
        confirmed=gather([t.status == TrackStatus.CONFIRMED for t in filled]),
        sensor_m=gather([np.broadcast_to(t.world_from_sensor[:2, 3], (len(t), 2)) for t in filled]),
    )


def _smoothed(rows: _Rows, part: slice, model: MotionModel, chain: ModeChain) -> SmoothTrack:
    states = rts_means(
        rows.stamp_ns[part], rows.state[part], rows.covariance[part], noise_factors(rows, part, chain), model
    )
    return SmoothTrack(
        track_id=int(rows.track_id[part.start]),
        stamp_ns=rows.stamp_ns[part],
        position_m=states[:, :2],
        velocity_mps=states[:, 3:5],
        radius_m=rows.radius_m[part],
        is_static=rows.is_static[part],
        sensor_m=rows.sensor_m[part],
    )


def noise_factors(rows: _Rows, part: slice, chain: ModeChain) -> FloatArray:
    """(T - 1,) the factor on the manoeuvring process noise for each step of a track."""
    steps_s = np.diff(rows.stamp_ns[part]) / 1e9
    if len(chain.noise_factor) == 1:
        return np.ones(len(steps_s))
    now = rows.manoeuvre[part][:-1]
    modes = np.stack([1.0 - now, now], axis=1)
    moved = np.array([mode @ chain.transition(dt) for mode, dt in zip(modes, steps_s, strict=True)]).reshape(-1, 2)
    return np.asarray(moved @ chain.noise_factor)


def rts_means(
    stamp_ns: IntArray, states: FloatArray, covariances: FloatArray, noise_factor: FloatArray, model: MotionModel
) -> FloatArray:
    """Smoothed means (T, d) of filtered states (T, d) and covariances (T, d, d) at ascending stamps (T,).

    noise_factor: (T - 1,) on `model.process_noise` of each step. A model that is not linear is taken at
    its Jacobian, as an extended Kalman filter does.
    """
    smoothed = states.copy()
    for k in range(len(states) - 2, -1, -1):
        dt = float(stamp_ns[k + 1] - stamp_ns[k]) / 1e9
        ahead = model.propagate(states[k : k + 1], dt)[0]
        jacobian = model.jacobian(states[k : k + 1], dt).reshape(states.shape[1], -1)
        cross = jacobian @ covariances[k]
        predicted = cross @ jacobian.T + noise_factor[k] * model.process_noise(dt)
        smoothed[k] += np.linalg.solve(predicted, cross).T @ (smoothed[k + 1] - ahead)
    return smoothed
