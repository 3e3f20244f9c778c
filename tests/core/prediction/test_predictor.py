"""What is predicted, standing tracks, sigma and conformal radii, calibration files."""

from __future__ import annotations

import json
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.config import PredictionConfig, TrackingConfig
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.prediction.calibration import Calibration, ResidualPool, conformal_quantile
from adcbf_cli.core.prediction.predictor import Predictor, learn_calibration, predict_tracks, sigma_radius
from adcbf_cli.core.types import Notes, Predictions, Tracks, TrackStatus
from tests.core.prediction.conftest import build_tracks

Make = Callable[..., Tracks]
TRACKING = TrackingConfig()


def predict(tracks: Tracks, config: PredictionConfig | None = None) -> Predictions:
    return Predictor(config or PredictionConfig(), TRACKING, Notes())(tracks)


def test_confirmed_and_coasting_tracks_are_predicted(make_tracks: Make) -> None:
    states = np.zeros((4, 6))
    states[:, 3] = 1.0
    predictions = predict(make_tracks(0.0, states, status=list(TrackStatus), track_id=[3, 5, 8, 9]))
    assert predictions.track_id.tolist() == [5, 8]
    assert predictions.position_m.shape == (2, 30, 3)
    assert predictions.position_m[0, :, 0] == pytest.approx(0.1 * np.arange(1, 31))
    assert predictions.velocity_mps[0, -1] == pytest.approx([1.0, 0.0])
    assert np.isnan(predictions.conformal_radius_m).all()
    for array in (predictions.covariance_m2, predictions.sigma_radius_m):
        assert np.isfinite(array).all()


def test_standing_tracks_stay(make_tracks: Make) -> None:
    states = np.array([[5.0, 2, 0, 0.3, 0.1, 0], [5.0, 2, 0, 0.3, 0.1, 0]])
    predictions = predict(make_tracks(0.0, states, is_static=[True, False]))
    assert predictions.is_static.tolist() == [True, False]
    assert predictions.position_m[0] == pytest.approx(np.tile([5.0, 2, 0], (30, 1)))
    assert not predictions.velocity_mps[0].any()
    assert predictions.position_m[1, -1, :2] == pytest.approx([5.9, 2.3])
    assert predictions.sigma_radius_m[0, -1] < predictions.sigma_radius_m[1, -1]


@pytest.mark.parametrize(("filtered", "creep"), [(0.0, 0.1 / 3), (0.2, 0.2), (5.0, 0.3)])
def test_standing_is_as_uncertain_as_the_filter_bounded(make_tracks: Make, filtered: float, creep: float) -> None:
    predictions = predict(make_tracks(0.0, [[5.0, 2, 0, 0, filtered, 0]], is_static=True))
    assert predictions.covariance_m2[0, -1] == pytest.approx((0.01 + (creep * 3.0) ** 2) * np.eye(2))


def test_standing_tracks_wander_as_the_ego_passes(make_tracks: Make) -> None:
    """Ego at 2 m/s, 5 m away, radius 0.3 m: after 1 s the view has turned by 0.4 rad, so 0.06 m more."""
    predictor = Predictor(PredictionConfig(), TRACKING, Notes())
    frames = [make_tracks(0.1 * k, [[0.2 * k, 5.0, 0, 0, 0, 0]], is_static=True) for k in range(2)]
    still = predictor(frames[0]).covariance_m2[0, 9, 0, 0]
    frames[1].world_from_sensor[0, 3] = 0.2
    assert predictor(frames[1]).covariance_m2[0, 9, 0, 0] == pytest.approx(still + 0.06**2)


def test_a_manoeuvring_track_is_less_certain(make_tracks: Make) -> None:
    states = np.zeros((2, 6))
    predictions = predict(make_tracks(0.0, states, manoeuvre=[0.01, 0.99]))
    assert predictions.sigma_radius_m[1, 9] > 1.5 * predictions.sigma_radius_m[0, 9]


def test_no_tracks(make_tracks: Make) -> None:
    predictions = predict(make_tracks(0.0, np.zeros((1, 6)), status=[TrackStatus.TENTATIVE]))
    assert len(predictions) == 0
    assert predictions.position_m.shape == (0, 30, 3)
    assert predictions.covariance_m2.shape == (0, 30, 2, 2)
    assert predictions.conformal_radius_m.shape == (0, 30)


def test_tracks_tell_their_model(make_tracks: Make) -> None:
    turning = make_tracks(0.0, [[0.0, 0, 0, 1, 0, 0, 0.5]], 1e-6 * np.eye(7)[None], model="ct")
    assert predict(turning).position_m[0, -1, 1] > 1.0


def test_sigma_radius_by_hand() -> None:
    """sqrt(-2 ln 0.05) = 2.4477 sigmas of the ellipse's long axis, whichever way it points."""
    assert sigma_radius(np.diag([4.0, 1.0]), 0.95) == pytest.approx(2 * 2.447747, rel=1e-6)
    c, s = np.cos(0.7), np.sin(0.7)
    rotation = np.array([[c, -s], [s, c]])
    assert sigma_radius(rotation @ np.diag([4.0, 1.0]) @ rotation.T, 0.95) == pytest.approx(2 * 2.447747, rel=1e-6)


def test_sigma_radius_covers_at_least_its_probability() -> None:
    rng = np.random.default_rng(0)
    covariance = np.array([[1.0, 0.6], [0.6, 2.0]])
    samples = rng.multivariate_normal([0, 0], covariance, 40_000)
    radius = float(sigma_radius(covariance, 0.9))
    share = np.mean(np.linalg.norm(samples, axis=1) <= radius)
    assert 0.9 <= share < 0.97
    circle = float(sigma_radius(np.eye(2), 0.9))
    assert np.mean(np.linalg.norm(rng.normal(size=(40_000, 2)), axis=1) <= circle) == pytest.approx(0.9, abs=0.006)


@pytest.mark.parametrize(
    ("n", "probability", "rank"),
    [(19, 0.95, 19), (18, 0.95, None), (39, 0.95, 38), (1, 0.5, 1), (9, 0.9, 9), (0, 0.5, None)],
)
def test_conformal_rank(n: int, probability: float, rank: int | None) -> None:
    """Of n = 1..n the quantile is its own rank: ceil((n + 1) p), and nothing if that exceeds n."""
    quantile = conformal_quantile(np.random.default_rng(0).permutation(np.arange(1.0, n + 1)), probability)
    assert math.isnan(quantile) if rank is None else quantile == rank


@given(st.integers(1, 60), st.floats(0.05, 0.98), st.integers(0, 2**32 - 1))
def test_conformal_quantile_covers_exchangeable_samples(n: int, probability: float, seed: int) -> None:
    """Leave-one-out over n + 1 samples is exact: at least a share p lies within the others' radius."""
    values = np.random.default_rng(seed).exponential(size=n + 1)
    radii = [conformal_quantile(np.delete(values, i), probability) for i in range(n + 1)]
    if not math.isnan(radii[0]):
        assert np.mean(values <= np.array(radii)) >= probability - 1e-9


def test_pool_keeps_the_newest() -> None:
    pool = ResidualPool(steps=2, window=300)
    for value in range(1000):
        pool.add(0, 1, np.array([float(value)]))
    assert pool.samples.tolist() == [[0, 300], [0, 0]]
    assert pool.quantiles(0.5)[0, 1] == conformal_quantile(np.arange(700.0, 1000.0), 0.5)
    assert np.isnan(pool.quantiles(0.5)[0, 0])
    pool.add(1, 0, np.arange(5000.0))
    assert pool.quantiles(0.5)[1, 0] == conformal_quantile(np.arange(4700.0, 5000.0), 0.5)


@given(st.data())
def test_pools_quantiles_are_those_of_the_newest_residuals(data: st.DataObject) -> None:
    """Whatever comes in whichever portions, ties included: sorted lists are the oracle."""
    steps, window = 3, data.draw(st.integers(1, 40))
    probability = data.draw(st.sampled_from([0.5, 0.8, 0.95]))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    pool = ResidualPool(steps, window)
    came: list[list[float]] = [[] for _ in range(2 * steps)]
    for n in data.draw(st.lists(st.integers(0, 120), max_size=12)):
        group, step = rng.integers(0, 2, n), rng.integers(0, steps, n)
        residuals = rng.integers(0, 12, n) / 4.0 if rng.random() < 0.5 else rng.exponential(size=n)
        pool.add_all(group, step, residuals)
        for g, k, residual in zip(group.tolist(), step.tolist(), residuals.tolist(), strict=True):
            came[g * steps + k].append(residual)
        expected = [conformal_quantile(np.array(values[-window:]), probability) for values in came]
        assert np.array_equal(pool.quantiles(probability).ravel(), expected, equal_nan=True)
        assert pool.samples.ravel().tolist() == [min(len(values), window) for values in came]
    other = [conformal_quantile(np.array(values[-window:]), 0.3) for values in came]
    assert np.array_equal(pool.quantiles(0.3).ravel(), other, equal_nan=True)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_residuals_are_those_of_every_prediction_compared_by_itself(seed: int) -> None:
    """Tracks come, go and coast, ids in any order, frames at uneven times: each predicted time between two
    frames in both of which its track was seen gives one residual, in the order of the predictions."""
    rng = np.random.default_rng(seed)
    steps, step_s = 6, 0.1
    config = PredictionConfig(steps=steps, step_s=step_s, probability=0.5, calibration_window=10)
    predictor = Predictor(config, TRACKING, Notes())
    stamps = np.cumsum(rng.choice([0.02, 0.1, 0.1, 0.25, 0.9], 25))
    pool, made, last = ResidualPool(steps, 10), [], None
    for time_s in stamps.tolist():
        ids = rng.permutation(9)[: rng.integers(0, 7)]
        tracks = build_tracks(
            time_s,
            rng.normal(size=(len(ids), 6)),
            track_id=ids,
            seen=rng.random(len(ids)) < 0.8,
            is_static=rng.random(len(ids)) < 0.4,
        )
        seen = {i: at for i, at, c in zip(ids.tolist(), tracks.state[:, :2], tracks.cluster_id, strict=True) if c >= 0}
        for p in made if last is not None else []:
            for k in range(steps):
                share = (p.stamp_ns + (k + 1) * 10**8 - last[0]) / (tracks.stamp_ns - last[0])
                for row in np.argsort(p.track_id) if 0 < share <= 1 else []:
                    i = int(p.track_id[row])
                    if i in seen and i in last[1]:
                        place = last[1][i] + share * (seen[i] - last[1][i])
                        off = p.position_m[row, k, :2] - place
                        pool.add(int(p.is_static[row]), k, np.array([np.hypot(*off)]))
        last = (tracks.stamp_ns, seen)
        made.append(predictor(tracks))
        assert predictor.residuals is not None
        assert np.array_equal(predictor.residuals.pool.samples, pool.samples)
        np.testing.assert_allclose(predictor.residuals.pool.quantiles(0.5), pool.quantiles(0.5), rtol=1e-12)


def wandering(make_tracks: Make, frames: int, seed: int, dt: float = 0.1, n: int = 8) -> list[Tracks]:
    """Tracks at 1 m/s whose reported velocity is off by a fresh 0.2 m/s each frame: the prediction k
    steps ahead is off by 0.2 k dt times a unit normal vector, exactly and independently."""
    rng = np.random.default_rng(seed)
    result = []
    for k in range(frames):
        states = np.zeros((n, 6))
        states[:, 0], states[:, 1] = k * dt, np.arange(n)
        states[:, 3:5] = [1.0, 0.0] + 0.2 * rng.normal(size=(n, 2))
        result.append(make_tracks(k * dt, states, index=k))
    return result


def test_past_residuals_give_the_right_radius(make_tracks: Make) -> None:
    """Rayleigh residuals of scale 0.2 t: their 95 % quantile is 2.4477 times that."""
    config = PredictionConfig(steps=10, calibration_window=100_000)
    last = list(predict_tracks(wandering(make_tracks, 200, 0), config, TRACKING, Notes()))[-1]
    time_s = 0.1 * np.arange(1, 11)
    assert last.conformal_radius_m[0] == pytest.approx(2.4477 * 0.2 * time_s, rel=0.08)


@pytest.mark.parametrize("dt", [0.05, 0.1, 0.25])
def test_coverage_reaches_its_probability(make_tracks: Make, dt: float) -> None:
    """Predictions made with the past's radius only, compared with what came; any scan rate."""
    config = PredictionConfig(steps=10, probability=0.9)
    frames = wandering(make_tracks, 150, 1, dt)
    predictions = list(predict_tracks(frames, config, TRACKING, Notes()))
    hits = []
    for p in predictions[40:]:
        truth = p.position_m[:, :, :2].copy()
        truth[..., 0] = (p.stamp_ns - frames[0].stamp_ns) / 1e9 + 0.1 * np.arange(1, 11)
        truth[..., 1] = np.arange(8)[:, None]
        assert not np.isnan(p.conformal_radius_m).any()
        hits.append(np.linalg.norm(p.position_m[:, :, :2] - truth, axis=2) <= p.conformal_radius_m)
    assert np.mean(hits, axis=(0, 1)) == pytest.approx(np.full(10, 0.9), abs=0.035)
    assert np.mean(hits) >= 0.885


def test_nothing_of_the_future_is_used(make_tracks: Make) -> None:
    """Two logs that differ from frame 60 on have the same radii up to frame 60."""
    config = PredictionConfig(steps=10, probability=0.95)
    calm, wild = wandering(make_tracks, 90, 2), wandering(make_tracks, 90, 2)
    for frame in wild[61:]:
        frame.state[:, 0] += 5.0
    a, b = (list(predict_tracks(frames, config, TRACKING, Notes())) for frames in (calm, wild))
    for k in range(61):
        assert np.array_equal(a[k].conformal_radius_m, b[k].conformal_radius_m, equal_nan=True)
    assert not np.isnan(a[60].conformal_radius_m).any()
    assert b[75].conformal_radius_m[0, 5] > 3.0 > a[75].conformal_radius_m[0, 5]


def test_a_step_has_no_radius_before_its_time_has_come(make_tracks: Make) -> None:
    config = PredictionConfig(steps=10, probability=0.5)
    predictions = list(predict_tracks(wandering(make_tracks, 12, 3), config, TRACKING, Notes()))
    for k, p in enumerate(predictions):
        assert np.isnan(p.conformal_radius_m[0]).tolist() == [step > k for step in range(1, 11)]


def test_coasting_tracks_are_no_evidence(make_tracks: Make) -> None:
    frames = [make_tracks(0.1 * k, [[0.1 * k, 0, 0, 1, 0, 0]], seen=False, status=[2]) for k in range(40)]
    last = list(predict_tracks(frames, PredictionConfig(probability=0.5), TRACKING, Notes()))[-1]
    assert np.isnan(last.conformal_radius_m).all()


def test_standing_and_moving_tracks_have_their_own_radii(make_tracks: Make) -> None:
    frames = wandering(make_tracks, 80, 4)
    for frame in frames:
        frame.is_static[:4] = True
        frame.state[:4, 0] = 0.0
    last = list(predict_tracks(frames, PredictionConfig(steps=10), TRACKING, Notes()))[-1]
    assert last.conformal_radius_m[0] == pytest.approx(np.zeros(10), abs=1e-12)
    assert last.conformal_radius_m[7, -1] > 0.3


def test_calibration_is_learned_saved_and_used(make_tracks: Make) -> None:
    config = PredictionConfig(steps=10, probability=0.9)
    learned = learn_calibration(wandering(make_tracks, 120, 5), config, TRACKING, Notes(), "a.mcap")
    text = json.dumps(learned.to_dict(), allow_nan=False)
    loaded = Calibration.from_dict(json.loads(text))
    assert np.array_equal(loaded.radius_m, learned.radius_m, equal_nan=True)
    assert np.array_equal(loaded.samples, learned.samples)
    assert (loaded.probability, loaded.step_s, loaded.source) == (0.9, 0.1, "a.mcap")
    assert learned.samples[0].tolist() == [8 * (120 - k) for k in range(1, 11)]
    assert np.isnan(learned.radius_m[1]).all(), "nothing stood still"
    used = Predictor(
        PredictionConfig(steps=5, probability=0.9, calibration="file"), TRACKING, Notes(), calibration=loaded
    )(make_tracks(0.0, np.zeros((2, 6)), is_static=[False, True]))
    assert used.conformal_radius_m[0] == pytest.approx(learned.radius_m[0, :5])
    assert np.isnan(used.conformal_radius_m[1]).all()


@pytest.mark.parametrize(
    ("change", "text"),
    [({"step_s": 0.2}, "step_s"), ({"probability": 0.5}, "probability"), ({"steps": 11}, "steps")],
)
def test_a_calibration_must_fit(make_tracks: Make, change: dict[str, float], text: str) -> None:
    config = PredictionConfig(steps=10)
    learned = learn_calibration(wandering(make_tracks, 5, 6), config, TRACKING, Notes(), "a")
    other = config.model_copy(update={"calibration": "file", **change})
    with pytest.raises(UsageError, match=text):
        Predictor(other, TRACKING, Notes(), calibration=learned)
    with pytest.raises(UsageError, match="no calibration file"):
        Predictor(other, TRACKING, Notes())


@pytest.mark.parametrize(
    "content",
    [
        None,
        [],
        {},
        {"format": "other"},
        {"format": "adcbf-calibration-1", "probability": "x"},
        {
            "format": "adcbf-calibration-1",
            "probability": 0.9,
            "step_s": 0.1,
            "source": "",
            "groups": {"moving": {"radius_m": [1], "samples": [1]}, "static": {"radius_m": [-1], "samples": [1]}},
        },
        {
            "format": "adcbf-calibration-1",
            "probability": 0.9,
            "step_s": 0.1,
            "source": "",
            "groups": {"moving": {"radius_m": [1], "samples": [1]}, "static": {"radius_m": [1, 2], "samples": [1, 2]}},
        },
    ],
)
def test_what_is_no_calibration_is_refused(content: object) -> None:
    with pytest.raises(AdcbfError, match="not a calibration"):
        Calibration.from_dict(content)
