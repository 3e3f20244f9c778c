"""Predictions against where their tracks were later seen: one pass in bounded memory, the whole log's numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.evaluation import quantiles
from adcbf_cli.core.evaluation.later import SCORED_TOGETHER, LaterSeen
from adcbf_cli.core.evaluation.lives import TrackLives
from adcbf_cli.core.evaluation.quantiles import QuantileSums
from adcbf_cli.core.paths import Paths
from adcbf_cli.core.types import NO_ID, Tracks
from tests.core.evaluation.scenes import Run, Seen, line

MS = 1_000_000


def uneven(run: Run, seed: int) -> list[Tracks]:
    """The run's tracks, each frame up to 0.8 ms late, tracks unseen now and then, and every seventh frame lost."""
    rng = np.random.default_rng(seed)
    frames = []
    for k in range(run.count):
        tracks = run.tracks(k)
        late = int(rng.integers(0, 800_000))
        seen = np.where(rng.random(len(tracks)) < 0.7, tracks.cluster_id, NO_ID)
        state = tracks.state + rng.normal(0, 0.05, tracks.state.shape)
        if k % 7:
            frames.append(replace(tracks, stamp_ns=tracks.stamp_ns + late, cluster_id=seen, state=state))
    return frames


@pytest.mark.parametrize("max_gap_s", [0.15, 0.5])
def test_a_sliding_window_gives_the_whole_logs_numbers(max_gap_s: float) -> None:
    run = Run([], [Seen(line(0, 0, 1.0)), Seen(line(5, 5), frames=range(30, 90)), Seen(line(3, 0), static=True)], 200)
    frames = uneven(run, 4)
    config = EvaluationConfig(max_gap_s=max_gap_s)
    later = LaterSeen(config)
    ids, stamps, places, predictions = [], [], [], []
    for tracks in frames:
        record = replace(run.predictions(tracks.frame_index), stamp_ns=tracks.stamp_ns)
        later.see(tracks)
        later.predict(record)
        predictions.append(record)
        seen = tracks.cluster_id != NO_ID
        ids.append(tracks.track_id[seen])
        stamps.append(np.full(int(seen.sum()), tracks.stamp_ns))
        places.append(tracks.state[seen, :2])
        assert len(later._seen) <= 50
        assert len(later._waiting) <= 36 + SCORED_TOGETHER
    later.finish()
    whole = Paths(np.concatenate(ids), np.concatenate(stamps), np.concatenate(places), round(max_gap_s * 1e9))
    square, count = 0.0, 0
    for record in predictions:
        for i, track in enumerate(record.track_id.tolist()):
            target = record.stamp_ns + 100 * MS * np.arange(1, 31)
            error = record.position_m[i, :, 0] - whole.at(np.full(30, track), target)[0][:, 0]
            square += float(np.nansum(error**2))
            count += int(np.isfinite(error).sum())
    metric = later.metrics()["later_seen.rmse_x_m"]
    assert metric.n == count > 1000
    assert metric.value == pytest.approx(np.sqrt(square / count), rel=1e-12)


def test_paths_answer_next_to_a_gap_as_they_do_at_their_ends() -> None:
    stamps = np.array([0, 100, 900, 1000]) * MS
    paths = Paths(np.zeros(4, np.int64), stamps, np.array([[0.0], [1.0], [9.0], [10.0]]), 500 * MS)
    asked = np.array([100 * MS + 900_000, 899 * MS, 102 * MS, 500 * MS, 898 * MS])
    values, known = paths.at(np.zeros(5, np.int64), asked)
    assert known.tolist() == [True, True, False, False, False]
    assert values[:2, 0].tolist() == [1.0, 9.0]


def test_lives_keep_one_row_a_track() -> None:
    seen = [Seen(line(float(i), 0), frames=range(25 * i, 25 * i + 20)) for i in range(16)]
    run = Run([], seen, 400)
    lives = TrackLives(EvaluationConfig())
    for k in range(run.count):
        lives.add(run.tracks(k), 0)
        assert len(lives._alive) <= 6, "ten seconds after it ended a track is let go"
    metrics = lives.metrics()
    assert metrics["tracks.created"].value == 16
    assert metrics["tracks.confirmed"].value == 16
    assert metrics["tracks.life_s.median"].value == pytest.approx(1.9)
    assert metrics["tracks.life_s.p90"].value == pytest.approx(1.9)
    assert metrics["tracks.restart_share"].value == pytest.approx(15 / 16)


def test_quantiles_are_numpys_for_as_long_as_all_numbers_fit() -> None:
    values = np.random.default_rng(0).choice([0.1, 0.2, 0.35, 1.0, 7.0], 20_001) + 0.0
    sums = QuantileSums()
    for part in np.array_split(values, 37):
        sums.add(part)
    for q in (0.0, 0.31, 0.5, 0.9, 1.0):
        assert sums.quantile(q) == np.quantile(values, q)
    assert (sums.count, sums.resolution) == (20_001, 0.0)
    assert QuantileSums().quantile(0.5) is None


def test_quantiles_of_more_numbers_are_as_exact_as_they_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quantiles, "MAX_KEPT", 500)
    values = np.random.default_rng(1).exponential(size=50_000)
    sums = QuantileSums()
    for part in np.array_split(values, 100):
        sums.add(part)
    assert sums.count == 50_000
    assert len(sums._values) <= 500
    assert 0 < sums.resolution < 0.1
    for q in (0.05, 0.5, 0.9):
        assert sums.quantile(q) == pytest.approx(np.quantile(values, q), abs=sums.resolution)
