"""Track life in synthetic scenes: ids, occlusion, birth, death, sizes, time, standing still."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.frames import pose_matrix
from adcbf_cli.core.tracking.tracker import Tracker, track_clusters
from adcbf_cli.core.types import NO_ID, Clusters, FloatArray, Notes, Tracks, TrackStatus

Make = Callable[..., Clusters]


def run(frames: Sequence[Clusters], config: TrackingConfig | None = None, notes: Notes | None = None) -> list[Tracks]:
    return list(track_clusters(frames, config or TrackingConfig(), notes if notes is not None else Notes()))


def ids_of(tracks: Tracks, cluster_id: int) -> list[int]:
    return tracks.track_id[tracks.cluster_id == cluster_id].tolist()


def check_sound(tracks: Tracks) -> None:
    """No NaN outside `nis`, covariances positive definite, ids unique and ascending."""
    for array in (tracks.state, tracks.covariance, tracks.radius_m, tracks.height_m, tracks.age_s):
        assert np.isfinite(array).all()
    assert np.array_equal(np.isnan(tracks.nis), (tracks.cluster_id == NO_ID) | (tracks.hits == 1))
    if len(tracks):
        assert np.linalg.eigvalsh(tracks.covariance).min() > 0
        assert np.array_equal(tracks.covariance, np.swapaxes(tracks.covariance, 1, 2))
    assert (np.diff(tracks.track_id) > 0).all()


def test_a_track_is_confirmed_by_three_hits_and_follows(make_clusters: Make) -> None:
    frames = [make_clusters(0.1 * k, [[5 + 0.1 * k, 2.0, 0.3]], index=k) for k in range(20)]
    history = run(frames)
    assert [t.status[0] for t in history[:4]] == [0, 0, 1, 1]
    last = history[-1]
    assert last.state[0] == pytest.approx([6.9, 2.0, 0.3, 1.0, 0.0, 0.0], abs=0.02)
    assert last.age_s[0] == pytest.approx(1.9)
    assert last.hits[0] == 20
    assert last.frame_index == 19
    assert last.stamp_ns == frames[-1].stamp_ns
    for tracks in history:
        check_sound(tracks)


def test_crossing_targets_keep_their_ids(make_clusters: Make) -> None:
    """Two walkers cross at right angles, 0.6 m apart at the closest."""
    history = []
    tracker = Tracker(TrackingConfig(), Notes())
    rng = np.random.default_rng(0)
    for k in range(60):
        t = 0.1 * k
        centres = np.array([[2 + 1.2 * t, 3.0, 0.5], [5.6, 6.6 - 1.2 * t + 0.85, 0.5]]) + rng.normal(0, 0.02, (2, 3))
        tracks = tracker(make_clusters(t, centres))
        history.append((ids_of(tracks, 0), ids_of(tracks, 1)))
    assert set(map(str, history)) == {str(([0], [1]))}


def test_walkers_who_meet_and_pass_keep_their_ids(make_clusters: Make) -> None:
    tracker = Tracker(TrackingConfig(), Notes())
    for k in range(60):
        t = 0.1 * k
        centres = [[3 + 1.2 * t, 4.0, 0.5], [10 - 1.2 * t, 4.7, 0.5]]
        tracks = tracker(make_clusters(t, centres[:: 1 if k % 2 else -1]))
    assert tracks.track_id.tolist() == [0, 1]
    assert sorted(tracks.state[:, 3]) == pytest.approx([-1.2, 1.2], abs=0.05)


def test_coasting_bridges_an_occlusion(make_clusters: Make) -> None:
    """Behind a pillar for 0.8 s: the track goes on alone and takes its cluster up again."""
    tracker = Tracker(TrackingConfig(), Notes())
    for k in range(40):
        hidden = 20 <= k < 28
        tracks = tracker(make_clusters(0.1 * k, np.zeros((0, 3)) if hidden else [[2 + 0.12 * k, 3.0, 0.5]]))
        assert tracks.track_id.tolist() == [0]
        if hidden:
            assert tracks.status[0] == TrackStatus.COASTING
            assert tracks.misses[0] == k - 19
            assert tracks.state[0, 0] == pytest.approx(2 + 0.12 * k, abs=0.05)
    assert tracks.status[0] == TrackStatus.CONFIRMED
    assert tracks.misses[0] == 0


def test_what_stands_and_fades_away_stays_where_it_was(make_clusters: Make) -> None:
    """A rock that sinks below the lowest beam: less and less of it is seen, ever farther to one side, then nothing."""

    def rock(time_s: float, y: float, radius_m: float) -> Clusters:
        return make_clusters(time_s, [[2.0, y, -0.3]], radius_m=radius_m, height_m=0.4)

    frames = [rock(0.1 * k, 0.0, 0.35) for k in range(30)]
    fading = enumerate(zip((0.08, 0.16, 0.3), (0.3, 0.26, 0.15), strict=True), start=30)
    frames += [rock(0.1 * k, -shift, radius) for k, (shift, radius) in fading]
    frames += [make_clusters(0.1 * k, np.empty((0, 3))) for k in range(33, 40)]
    history = run(frames)
    seen, unseen = history[32], history[39]
    assert unseen.is_static.tolist() == [True]
    assert np.hypot(*(unseen.state[0, :2] - [2.0, 0.0])) < 0.1
    np.testing.assert_allclose(unseen.state[0, :2], seen.state[0, :2], atol=1e-3)
    np.testing.assert_array_equal(unseen.state[0, 3:], 0.0)
    check_sound(unseen)


def test_what_stood_still_stands_while_it_is_not_seen(make_clusters: Make) -> None:
    """The last sightings of a rock drift; what they would prove once older ones are forgotten, they did not before."""
    rng = np.random.default_rng(3)
    x = np.concatenate([rng.normal(2.0, 0.02, 30), [1.92, 1.96, 2.0, 2.04, 2.08]])
    frames = [make_clusters(0.1 * k, [[place, 0.0, 0.2]], radius_m=0.38) for k, place in enumerate(x)]
    frames += [make_clusters(0.1 * k, np.zeros((0, 3))) for k in range(35, 44)]
    history = run(frames)
    assert [tracks.is_static.tolist() for tracks in history[29:]] == [[True]] * 15


def test_what_stays_small_was_taken_for_larger_than_it_is(make_clusters: Make) -> None:
    """A cluster of 0.45 m stands, and is one of 0.28 m at its side from then on: no fading takes that long."""
    rng = np.random.default_rng(0)

    def seen(y: float) -> FloatArray:
        return np.column_stack([2.0 + rng.normal(0.0, 0.03, 1), y + rng.normal(0.0, 0.03, 1), [-0.3]])

    frames = [make_clusters(0.1 * k, seen(0.0), radius_m=0.45, height_m=0.4) for k in range(30)]
    frames += [make_clusters(0.1 * k, seen(0.12), radius_m=0.28, height_m=0.4) for k in range(30, 60)]
    history = run(frames)
    assert [tracks.track_id.tolist() for tracks in history[::10]] == [[0]] * 6
    assert history[33].state[0, 1] == pytest.approx(0.0, abs=0.03)
    assert history[59].state[0, 1] == pytest.approx(0.12, abs=0.05)


@pytest.mark.parametrize(("top_m", "held"), [(-0.1, True), (0.8, False)])
def test_only_what_ends_below_the_sensor_can_sink(make_clusters: Make, top_m: float, held: bool) -> None:
    """What rises above it does not sink below its lowest beam, however narrow it is seen: it may walk."""

    def seen(k: int, x: float, radius_m: float) -> Clusters:
        return make_clusters(0.1 * k, [[x, 0.0, top_m - 0.2]], radius_m=radius_m, height_m=0.4)

    frames = [seen(k, 3.0, 0.4) for k in range(30)]
    frames += [seen(k, 3.0 - 0.03 * (k - 29), 0.25) for k in range(30, 34)]
    assert (run(frames)[-1].state[0, 3] == 0.0) == held


def test_uncertainty_grows_while_coasting(make_clusters: Make) -> None:
    frames = [make_clusters(0.1 * k, [[5.0, 2.0, 0.3]] if k < 20 else np.zeros((0, 3))) for k in range(28)]
    sizes = [t.covariance[0, 0, 0] for t in run(frames)][19:]
    assert (np.diff(sizes) > 0).all()


def test_a_track_ends_once_and_is_then_gone(make_clusters: Make) -> None:
    frames = [make_clusters(0.1 * k, [[5.0, 2.0, 0.3]] if k < 15 else np.zeros((0, 3))) for k in range(30)]
    status = [t.status.tolist() for t in run(frames)]
    assert status[24] == [TrackStatus.COASTING], "unseen for exactly 1.0 s"
    assert status[25] == [TrackStatus.ENDED]
    assert status[26:] == [[]] * 4


def test_a_track_coasts_no_longer_than_it_was_followed(make_clusters: Make) -> None:
    frames = [make_clusters(0.1 * k, [[5.0, 2.0, 0.3]] if k < 4 else np.zeros((0, 3))) for k in range(10)]
    status = [t.status.tolist() for t in run(frames)]
    assert status[6] == [TrackStatus.COASTING], "followed for 0.3 s, unseen for 0.3 s"
    assert status[7] == [TrackStatus.ENDED]


def test_a_flicker_is_never_confirmed(make_clusters: Make) -> None:
    frames = [make_clusters(0.1 * k, [[5.0, 2.0, 0.3]] if k in (0, 4) else np.zeros((0, 3))) for k in range(12)]
    history = run(frames)
    assert not any((t.status == TrackStatus.CONFIRMED).any() for t in history)
    assert len(history[-1]) == 0


def test_ids_are_never_used_twice(make_clusters: Make) -> None:
    frames = [make_clusters(0.1 * k, [[5.0 + 3 * (k // 20), 2.0, 0.3]] * (k % 20 < 8)) for k in range(60)]
    seen = [i for t in run(frames) for i in t.track_id[t.hits == 1].tolist()]
    assert len(set(seen)) == 3


def test_a_person_who_merges_with_a_wall_is_not_taken_for_it(make_clusters: Make) -> None:
    """Where the person's cluster is swallowed, the track coasts rather than jump onto the wall's."""
    tracker = Tracker(TrackingConfig(), Notes())
    for k in range(40):
        merged = 20 <= k < 26
        person = [2 + 0.1 * k, 3.0, 0.5]
        if merged:
            tracks = tracker(make_clusters(0.1 * k, [[2 + 0.1 * k, 3.3, 0.5]], [1.5]))
            assert tracks.status[0] == TrackStatus.COASTING
            assert tracks.radius_m[0] == pytest.approx(0.3)
        else:
            tracks = tracker(make_clusters(0.1 * k, [person], [0.3]))
    assert tracks.track_id[tracks.status == TrackStatus.CONFIRMED].tolist() == [0]
    assert tracks.state[0, :2] == pytest.approx([5.9, 3.0], abs=0.05)


def test_a_partial_view_hardly_moves_the_track(make_clusters: Make) -> None:
    """A car of 2 m radius is partly hidden for 0.5 s: the centre of what is left lies 0.5 m off."""
    errors = {}
    for partial_radius in (1.5, 2.0):
        tracker = Tracker(TrackingConfig(), Notes())
        worst = 0.0
        for k in range(40):
            hidden = 25 <= k < 30
            x = 10 + 0.4 * k
            centre = [x + 0.5 * hidden, 3.0, 0.5]
            tracks = tracker(make_clusters(0.1 * k, [centre], partial_radius if hidden else 2.0))
            row = tracks.track_id == 0
            worst = max(worst, abs(float(tracks.state[row, 0][0]) - x)) if k >= 20 else 0.0
        errors[partial_radius] = worst
    assert errors[1.5] < 0.25
    assert errors[1.5] < 0.6 * errors[2.0], "the size tells that the view is partial"


def test_stop_and_go(make_clusters: Make) -> None:
    """Walks, stands for 3 s (recognised as standing), walks on (recognised within a second)."""
    tracker = Tracker(TrackingConfig(), Notes())
    rng = np.random.default_rng(1)
    x, static = 2.0, []
    for k in range(120):
        walking = k < 40 or k >= 75
        x += 0.13 * walking
        tracks = tracker(make_clusters(0.1 * k, np.array([[x, 3.0, 0.5]]) + rng.normal(0, 0.02, (1, 3))))
        static.append(bool(tracks.is_static[0]))
        assert tracks.track_id.tolist() == [0]
        assert abs(tracks.state[0, 0] - x) < 0.15, "stopping dead overshoots by a step or so"
    assert not any(static[10:41])
    assert all(static[62:75])
    assert not any(static[85:])
    assert tracks.state[0, 3] == pytest.approx(1.3, abs=0.15)


def test_standing_obstacles_seen_from_a_moving_ego(make_clusters: Make) -> None:
    """A noisy standing disc whose visible side turns as the ego drives by, tilting: static, in place."""
    tracker = Tracker(TrackingConfig(), Notes())
    rng = np.random.default_rng(2)
    discs = np.array([[8.0, 4.0, 0.5], [10.0, -3.0, 0.5]])
    for k in range(60):
        half = 0.01 * np.sin(k / 5)
        pose = pose_matrix(np.array([0.2 * k, 0, 1.0]), np.array([half, half, 0.05, 1.0]))
        towards = pose[:2, 3] - discs[:, :2]
        seen = discs.copy()
        seen[:, :2] += 0.3 * towards / np.linalg.norm(towards, axis=1, keepdims=True)
        tracks = tracker(make_clusters(0.1 * k, seen + rng.normal(0, 0.02, (2, 3)), 0.8, world_from_sensor=pose))
        if k > 15:
            assert tracks.is_static.all()
    assert tracks.track_id.tolist() == [0, 1]
    assert np.linalg.norm(tracks.state[:, :2] - discs[:, :2], axis=1).max() < 0.5


@pytest.mark.parametrize("kind", ["ukf", "ekf", "kf"])
def test_ego_motion_does_not_become_the_obstacles(make_clusters: Make, kind: str) -> None:
    """Seen exactly, from a sensor that drives and turns: no velocity is left."""
    tracker = Tracker(TrackingConfig(filter=kind), Notes())
    for k in range(40):
        angle = 0.03 * k
        pose = pose_matrix(np.array([0.3 * k, 0.1 * k, 1.0]), np.array([0, 0, np.sin(angle), np.cos(angle)]))
        tracks = tracker(make_clusters(0.1 * k, [[9.0, 6.0, 0.5]], world_from_sensor=pose))
    assert tracks.state[0] == pytest.approx([9, 6, 0.5, 0, 0, 0], abs=2e-3)


def test_irregular_stamps(make_clusters: Make) -> None:
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.03, 0.4, 60))
    tracks = run([make_clusters(t, [[3 + 0.8 * t, 2 - 0.5 * t, 0.4]]) for t in times])[-1]
    assert tracks.track_id.tolist() == [0]
    assert tracks.state[0, 3:5] == pytest.approx([0.8, -0.5], abs=0.01)


def test_repeated_and_backward_stamps_are_skipped_with_a_warning(make_clusters: Make) -> None:
    notes = Notes()
    times = [0.0, 0.1, 0.2, 0.3, 0.3, 0.25, 0.4, 0.5]
    history = run([make_clusters(t, [[5 + t, 2.0, 0.3]], index=i) for i, t in enumerate(times)], notes=notes)
    assert notes.counters == {"frames_out_of_order": 2}
    assert len(notes.warnings) == 1
    assert "stamp" in notes.warnings[0]
    assert [t.frame_index for t in history] == list(range(8))
    assert (np.diff([t.stamp_ns for t in history]) >= 0).all()
    assert history[4].state[0] == pytest.approx(history[3].state[0])
    assert history[4].cluster_id[0] == NO_ID
    without = run([make_clusters(t, [[5 + t, 2.0, 0.3]]) for t in sorted(set(times) - {0.25})])
    assert np.array_equal(history[-1].state, without[-1].state)


def test_a_long_gap_ends_every_track(make_clusters: Make) -> None:
    notes = Notes()
    times = [0.0, 0.1, 0.2, 0.3, 5.0, 5.1, 5.2]
    history = run([make_clusters(t, [[5.0, 2.0, 0.3]]) for t in times], notes=notes)
    assert history[-1].track_id.tolist() == [1]
    assert notes.counters == {"tracking_gaps": 1}


def test_empty_frames_and_a_single_frame(make_clusters: Make) -> None:
    history = run([make_clusters(0.1 * k, np.zeros((0, 3))) for k in range(5)])
    assert [len(t) for t in history] == [0] * 5
    assert history[0].state.shape == (0, 6)
    assert history[0].covariance.shape == (0, 6, 6)
    single = run([make_clusters(0.0, [[5.0, 2.0, 0.3], [1, 1, 1]])])[0]
    assert single.status.tolist() == [TrackStatus.TENTATIVE] * 2
    assert single.state[:, :3] == pytest.approx(np.array([[5.0, 2.0, 0.3], [1, 1, 1]]))
    check_sound(single)


def test_clusters_without_a_finite_centre_are_dropped_and_counted(make_clusters: Make) -> None:
    notes = Notes()
    frames = [make_clusters(0.1 * k, [[np.nan, 0, 0], [5, 2, 0.3]]) for k in range(5)]
    last = run(frames, notes=notes)[-1]
    assert notes.counters == {"clusters_without_finite_centre": 5}
    assert last.cluster_id.tolist() == [1]


@pytest.mark.parametrize("model", ["cv", "ca", "ct"])
@pytest.mark.parametrize("planar", [False, True])
def test_every_model_follows_a_walker(make_clusters: Make, model: str, planar: bool) -> None:
    config = TrackingConfig(model=model)
    frames = [make_clusters(0.1 * k, [[3 + 0.12 * k, 2.0]], planar=planar) for k in range(50)]
    history = run(frames, config)
    last = history[-1]
    assert last.model == model
    assert last.state.shape[1] == {"cv": 6, "ca": 9, "ct": 7}[model]
    assert last.state[0, :5] == pytest.approx([8.88, 2.0, 0.0, 1.2, 0.0], abs=0.03)
    for tracks in history:
        check_sound(tracks)


@pytest.mark.parametrize("kind", ["ukf", "ekf", "kf"])
def test_turning_and_shifting_the_world_turns_and_shifts_the_tracks(make_clusters: Make, kind: str) -> None:
    rng = np.random.default_rng(5)
    angle = 2.1
    world = pose_matrix(np.array([30.0, -20.0, 4.0]), np.array([0, 0, np.sin(angle / 2), np.cos(angle / 2)]))
    plain, moved = (Tracker(TrackingConfig(filter=kind), Notes()) for _ in range(2))
    for k in range(30):
        pose = pose_matrix(np.array([0.1 * k, 0.0, 1.0]), np.array([0.01, 0.02, 0.01 * k, 1.0]))
        centres = np.array([[6 + 0.1 * k, 2, 0.5], [5, -3 + 0.05 * k, 0.4]]) + rng.normal(0, 0.02, (2, 3))
        a = plain(make_clusters(0.1 * k, centres, world_from_sensor=pose))
        turned = centres @ world[:3, :3].T + world[:3, 3]
        b = moved(make_clusters(0.1 * k, turned, world_from_sensor=world @ pose))
    rotation = world[:3, :3]
    assert b.state[:, :3] == pytest.approx(a.state[:, :3] @ rotation.T + world[:3, 3], abs=1e-6)
    assert b.state[:, 3:] == pytest.approx(a.state[:, 3:] @ rotation.T, abs=1e-6)
    block = np.kron(np.eye(2), rotation)
    assert b.covariance == pytest.approx(block @ a.covariance @ block.T, rel=1e-5, abs=1e-8)
    assert np.array_equal(a.track_id, b.track_id)


def test_the_same_input_gives_the_same_bytes(make_clusters: Make) -> None:
    rng = np.random.default_rng(6)
    frames = [make_clusters(0.1 * k, rng.uniform(-8, 8, (12, 3))) for k in range(20)]
    first, second = run(frames), run(frames)
    assert all(a.state.tobytes() == b.state.tobytes() for a, b in zip(first, second, strict=True))


def test_covariances_stay_sound_over_thousands_of_frames(make_clusters: Make) -> None:
    """Obstacles at the sensor, above it, on the azimuth's seam, jumping; gaps and near-equal stamps."""
    rng = np.random.default_rng(7)
    tracker, t = Tracker(TrackingConfig(), Notes()), 0.0
    base = np.array([[0, 0, 0.0], [0, 0, 2.0], [-6, 0, 0.3], [0.02, 0, 0], [500, 500, 3], [4, 4, -1]])
    for _ in range(1200):
        t += float(rng.choice([1e-9, 1e-3, 0.1, 0.9]))
        jump = rng.normal(0, rng.choice([0.0, 1e-6, 0.05, 1.0]), base.shape)
        tracks = tracker(make_clusters(t, (base + jump)[rng.random(6) < 0.8], rng.choice([0.0, 0.3, 3.0])))
        check_sound(tracks)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0.0, 1e-6, 0.1, 0.7, 3.0]),
            st.lists(
                st.tuples(*[st.floats(-1e4, 1e4)] * 3, st.floats(0, 50)),
                max_size=4,
            ),
        ),
        min_size=1,
        max_size=12,
    ),
    st.sampled_from(["ukf", "ekf", "kf"]),
    st.sampled_from(["cv", "ca"]),
    st.booleans(),
)
def test_no_input_breaks_the_tracker(
    make_clusters: Make, script: list[tuple[float, list[tuple[float, ...]]]], kind: str, model: str, planar: bool
) -> None:
    tracker, t = Tracker(TrackingConfig(filter=kind, model=model), Notes()), 0.0
    for dt, rows in script:
        t += dt
        values = np.array(rows, dtype=np.float64).reshape(-1, 4)
        check_sound(tracker(make_clusters(t, values[:, :3], values[:, 3], planar=planar)))


def test_paper_table_one_circle_is_tracked_within_15_mm(make_clusters: Make) -> None:
    """Equation 11's circle with 10 mm of noise on the centre: RMSE per axis, and not called standing."""
    rng = np.random.default_rng(8)
    tracker, errors = Tracker(TrackingConfig(), Notes()), []
    for k in range(667):
        angle = 2 * np.pi * 0.015 * 0.1 * k
        truth = np.array([8.5 + 2.5 * np.cos(angle), 2 + 2.5 * np.sin(angle), 0.3])
        tracks = tracker(make_clusters(0.1 * k, truth + rng.normal(0, 0.01, 3), 0.48))
        if k >= 10:
            errors.append(tracks.state[0, :2] - truth[:2])
            assert not tracks.is_static[0]
    assert (np.sqrt(np.mean(np.square(errors), axis=0)) < [0.010, 0.010]).all()


def test_consistency_on_white_acceleration(make_clusters: Make) -> None:
    """Truth that follows the model with one noise level: NEES near the state's 4 plane components."""
    rng = np.random.default_rng(9)
    config = TrackingConfig(
        cruise_ratio=1.0,
        adaptive_noise=False,
        sigma_extent_ratio=0.0,
        sigma_range_m=0.05,
        sigma_azimuth_rad=1e-4,
        sigma_elevation_rad=1e-4,
        filter="kf",
    )
    root = np.linalg.cholesky(np.array([[0.1**3 / 3, 0.1**2 / 2], [0.1**2 / 2, 0.1]]) * config.sigma_accel_mps2**2)
    nees = []
    for _ in range(12):
        tracker, state = Tracker(config, Notes()), np.array([[20.0, 20.0], [0.5, -0.5]])
        for k in range(60):
            state = np.array([[1, 0.1], [0, 1]]) @ state + root @ rng.normal(size=(2, 2))
            measured = np.array([*state[0], 0.0]) + rng.normal(0, 0.05, 3)
            tracks = tracker(make_clusters(0.1 * k, measured))
            if k >= 20 and len(tracks):
                plane = np.ix_([0, 1, 3, 4], [0, 1, 3, 4])
                error = tracks.state[0, [0, 1, 3, 4]] - state.ravel()
                nees.append(error @ np.linalg.solve(tracks.covariance[0][plane], error))
    assert np.mean(nees) == pytest.approx(4.0, rel=0.2)
