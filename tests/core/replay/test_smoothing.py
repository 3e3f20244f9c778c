"""The smoother against filterpy's, and which of a track's rows it keeps."""

from __future__ import annotations

import numpy as np
from filterpy.kalman import KalmanFilter

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.replay.smoothing import rts_means, smooth_tracks
from adcbf_cli.core.tracking.motion import build_motion_model
from adcbf_cli.core.types import NO_ID, Tracks, TrackStatus

STEP_NS = 100_000_000


def filtered(stamps_ns: np.ndarray, factor: np.ndarray, seed: int = 100) -> tuple[np.ndarray, np.ndarray, list]:
    """A constant-velocity filter over noisy positions, with filterpy; and its F and Q of each step."""
    rng = np.random.default_rng(seed)
    model = build_motion_model(TrackingConfig(), planar=False)
    kalman = KalmanFilter(dim_x=6, dim_z=3)
    kalman.H = np.eye(3, 6)
    kalman.R = 0.01 * np.eye(3)
    kalman.P = np.diag(np.concatenate([np.full(3, 0.01), np.full(3, 4.0)]))
    means, covariances, steps = [], [], []
    for k, stamp in enumerate(stamps_ns):
        if k:
            dt = float(stamp - stamps_ns[k - 1]) / 1e9
            steps.append((model.jacobian(kalman.x.T, dt), factor[k - 1] * model.process_noise(dt)))
            kalman.predict(F=steps[-1][0], Q=steps[-1][1])
        time_s = stamp / 1e9
        kalman.update(np.array([time_s, np.sin(time_s), 0.5]) + rng.normal(0, 0.1, 3))
        means.append(kalman.x[:, 0].copy())
        covariances.append(kalman.P.copy())
    return np.array(means), np.array(covariances), steps


def test_means_are_filterpys() -> None:
    stamps = np.cumsum(np.tile([STEP_NS, 2 * STEP_NS, STEP_NS // 3], 12)).astype(np.int64)
    factor = np.random.default_rng(101).uniform(0.001, 1.0, len(stamps) - 1)
    means, covariances, steps = filtered(stamps, factor)
    ours = rts_means(stamps, means, covariances, factor, build_motion_model(TrackingConfig(), planar=False))
    # filterpy takes F and Q of the step into a time at that time's index.
    jacobians = [np.eye(6), *[f for f, _ in steps]]
    noises = [np.eye(6), *[q for _, q in steps]]
    reference = KalmanFilter(dim_x=6, dim_z=3).rts_smoother(means, covariances, Fs=jacobians, Qs=noises)[0]
    np.testing.assert_allclose(ours, reference, atol=1e-9)


def test_smoothing_brings_means_nearer_to_the_truth() -> None:
    stamps = (STEP_NS * np.arange(60)).astype(np.int64)
    factor = np.full(59, 0.5)
    means, covariances, _ = filtered(stamps, factor)
    ours = rts_means(stamps, means, covariances, factor, build_motion_model(TrackingConfig(), planar=False))
    truth = np.column_stack([stamps / 1e9, np.sin(stamps / 1e9)])
    before, after = (np.sqrt(np.mean((m[:, :2] - truth) ** 2)) for m in (means, ours))
    assert after < 0.8 * before
    np.testing.assert_array_equal(ours[-1], means[-1])


def record(
    k: int, ids: list[int], seen: list[bool], status: list[TrackStatus], still: list[bool] | None = None
) -> Tracks:
    """Track i at x = 10 i + t, 1 m/s."""
    n = len(ids)
    state = np.zeros((n, 6))
    state[:, 0] = 10.0 * np.array(ids) + 0.1 * k
    state[:, 3] = 1.0
    pose = np.eye(4)
    pose[0, 3] = 0.5 * k
    return Tracks(
        frame_index=k,
        stamp_ns=k * STEP_NS,
        world_from_sensor=pose,
        model="cv",
        track_id=np.array(ids, dtype=np.int64),
        status=np.array(status, dtype=np.int64),
        state=state,
        covariance=np.tile(np.diag([0.01] * 3 + [0.1] * 3), (n, 1, 1)),
        radius_m=np.full(n, 0.4),
        height_m=np.full(n, 1.7),
        is_static=np.zeros(n, dtype=bool) if still is None else np.array(still),
        cluster_id=np.where(seen, 5, NO_ID).astype(np.int64),
        age_s=np.zeros(n),
        hits=np.zeros(n, dtype=np.int64),
        misses=np.zeros(n, dtype=np.int64),
        nis=np.zeros(n),
    )


def test_from_first_to_last_sighting_of_confirmed_tracks() -> None:
    tentative, confirmed, coasting = TrackStatus.TENTATIVE, TrackStatus.CONFIRMED, TrackStatus.COASTING
    frames = [
        record(0, [1, 2], [True, True], [tentative, tentative]),
        record(1, [1, 2], [True, True], [confirmed, tentative]),
        record(2, [1], [False], [coasting]),
        record(3, [1], [True], [confirmed]),
        record(4, [1], [False], [coasting]),
        record(5, [1], [False], [TrackStatus.ENDED]),
    ]
    (track,) = smooth_tracks(frames, TrackingConfig())
    assert track.track_id == 1
    assert (track.stamp_ns // STEP_NS).tolist() == [0, 1, 2, 3]
    np.testing.assert_allclose(track.position_m, [[10, 0], [10.1, 0], [10.2, 0], [10.3, 0]], atol=1e-9)
    np.testing.assert_allclose(track.velocity_mps, [[1, 0]] * 4, atol=1e-9)
    np.testing.assert_allclose(track.sensor_m[:, 0], [0, 0.5, 1.0, 1.5])


def test_no_tracks_at_all() -> None:
    assert smooth_tracks([], TrackingConfig()) == []
    assert smooth_tracks([record(0, [], [], [])], TrackingConfig()) == []


def test_the_order_of_ids_within_a_frame_does_not_matter() -> None:
    confirmed = TrackStatus.CONFIRMED
    one = [record(k, [3, 1], [True, True], [confirmed, confirmed]) for k in range(4)]
    other = [record(k, [1, 3], [True, True], [confirmed, confirmed]) for k in range(4)]
    for a, b in zip(smooth_tracks(one, TrackingConfig()), smooth_tracks(other, TrackingConfig()), strict=True):
        assert a.track_id == b.track_id
        np.testing.assert_array_equal(a.position_m, b.position_m)
