"""What metrics are made of adds up to them, on a run with all kinds of errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.evaluation.blocks import in_form
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.core.types import TrackStatus
from tests.core.evaluation.scenes import Labelled, Run, Seen, line

CONFIG = EvaluationConfig(range_m=50.0, bootstrap_block_s=1.0, horizons_s=(0.5,))
WALK, OTHER = line(5.0, 2.0, vx=-0.5, vy=0.4), line(-5.0, -4.0, vx=0.3)


def wavering(t: np.ndarray) -> np.ndarray:
    return WALK(t) + 0.1 * np.stack([np.sin(5 * t), np.cos(3 * t)], axis=-1)


@pytest.fixture(scope="module")
def metrics() -> Mapping[str, Metric]:
    """Eight seconds: the walker's track is another after a gap, the other's is late, two tracks are false, one of
    them where nothing is labelled, one on the walker, one stands, and one is never confirmed."""
    run = Run(
        [Labelled(WALK, frames=range(60)), Labelled(OTHER, frames=range(10, 60))],
        [
            Seen(wavering, frames=range(25)),
            Seen(wavering, frames=range(33, 60)),
            Seen(OTHER, frames=range(24, 60)),
            Seen(line(0.0, 9.0, vx=0.5), frames=range(52, 80)),
            Seen(lambda t: WALK(t) + 0.4, frames=range(12, 17)),
            Seen(line(9.0, 9.0), static=True),
            Seen(line(-9.0, 9.0), status=TrackStatus.TENTATIVE),
        ],
        count=80,
        steps=5,
    )
    return run.score(CONFIG).metrics


def test_the_run_has_what_it_should(metrics: Mapping[str, Metric]) -> None:
    found = {
        name: metrics[f"clear.{name}"].value
        for name in ("misses", "false_positives", "duplicates", "switches", "fragmentations")
    }
    assert found == {"misses": 8 + 14, "false_positives": 28 + 5, "duplicates": 5, "switches": 1, "fragmentations": 1}
    assert metrics["clear.false_positives_all_tracks"].value == 28 + 5 + 80
    assert (metrics["tracks.created"].value, metrics["tracks.confirmed"].value) == (7, 6)


def test_every_metric_is_what_its_blocks_add_up_to(metrics: Mapping[str, Metric]) -> None:
    known = {name: metric for name, metric in metrics.items() if metric.value is not None}
    whole = {name for name, metric in known.items() if metric.blocks is None}
    quantiles = {f"tracks.{name}.{q}" for name in ("life_s", "speed_mps") for q in ("median", "p90")}
    assert whole == quantiles | {"hota.hota", "hota.hota_all_tracks", "hota.ass_a"}
    assert all(known[name].interval is None for name in whole)
    for name in known.keys() - whole:
        blocks = known[name].blocks
        assert blocks is not None
        value = in_form(blocks.form, blocks.sums.sum(), blocks.counts.sum())
        assert known[name].value == pytest.approx(float(value), abs=1e-12), name


def test_an_interval_is_around_its_metric(metrics: Mapping[str, Metric]) -> None:
    spread = {
        name: metric for name, metric in metrics.items() if metric.interval is not None and metric.value is not None
    }
    for name in ("clear.mota", "clear.misses", "clear.switches", "hota.det_a", "tracking.bias_along_m"):
        low, high = spread[name].interval or (0.0, 0.0)
        assert low < high, name
    for name, metric in spread.items():
        assert metric.interval is not None
        assert metric.interval[0] - 1e-12 <= metric.value <= metric.interval[1] + 1e-12, name


def test_false_tracks_where_nothing_is_labelled_count_for_mota(metrics: Mapping[str, Metric]) -> None:
    """From 6 s on there is no object, and ten false tracks in a second."""
    blocks = metrics["clear.mota"].blocks
    assert blocks is not None
    assert blocks.sums[-2:].tolist() == [-10.0, -10.0]
    assert blocks.counts[-2:].tolist() == [0.0, 0.0]
    assert metrics["clear.mota"].value == pytest.approx(1 - (22 + 33 + 1) / 110)


def test_without_tracks_there_are_blocks_to_pair_with() -> None:
    """A tracker that reports nothing is at zero, which is no reason to leave it out of a comparison."""
    found = Run([Labelled(WALK)], [], count=60, steps=5).score(CONFIG).metrics
    for name in ("clear.mota", "hota.det_a", "hota.det_re"):
        assert (found[name].value, found[name].interval) == (0.0, (0.0, 0.0)), name
        blocks = found[name].blocks
        assert blocks is not None
        assert len(blocks.keys) == 6
