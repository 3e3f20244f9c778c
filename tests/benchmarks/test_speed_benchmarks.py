"""The speed benchmarks' own parts: longer logs, summaries, and a plain side that computes the same things."""

from __future__ import annotations

import json
import subprocess
import sys
from itertools import islice
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from adcbf_cli.core.config import ReadConfig, TrackingConfig
from adcbf_cli.core.prediction.propagation import Propagator
from adcbf_cli.core.types import Notes
from adcbf_cli.io.frame_reader import FrameReader

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "sample_data" / "sample.mcap"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> ModuleType:
    """The benchmark script named by the test's parameter, imported as it sees its neighbours when it runs."""
    import importlib

    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    return importlib.import_module(request.param)


@pytest.mark.parametrize("script", ["memory"], indirect=True)
def test_a_repeated_log_is_the_same_drive_again_and_later(script: ModuleType, tmp_path: Path) -> None:
    longer = tmp_path / "longer.mcap"
    script.repeat_log(SAMPLE, longer, 2)
    with FrameReader(SAMPLE, ReadConfig(), Notes()) as reader:
        once = [frame.stamp_ns for frame in reader]
    with FrameReader(SAMPLE, ReadConfig(), Notes()) as reader:
        first = next(iter(reader))
    notes = Notes()
    with FrameReader(longer, ReadConfig(), notes) as reader:
        frames = iter(reader)
        stamps = [frame.stamp_ns for frame in islice(frames, len(once))]
        again = next(frames)
        stamps += [again.stamp_ns, *(frame.stamp_ns for frame in frames)]
    assert stamps[: len(once)] == once
    assert len(stamps) == 2 * len(once)
    period = again.stamp_ns - once[0]
    assert stamps[len(once) :] == [stamp + period for stamp in once]
    assert period >= once[-1] - once[0] + script.PAUSE_NS
    np.testing.assert_allclose(again.world_from_sensor, first.world_from_sensor, atol=1e-9)
    np.testing.assert_allclose(again.points_m, first.points_m, atol=1e-6)
    assert not notes.losses


@pytest.mark.parametrize("script", ["plain_pipeline"], indirect=True)
def test_the_looped_horizon_is_the_one_that_is_batched(script: ModuleType) -> None:
    config = TrackingConfig(cruise_ratio=1.0, vertical_ratio=1.0)
    rng = np.random.default_rng(3)
    states = rng.normal(0, 3, (4, 6))
    root = rng.normal(0, 0.2, (4, 6, 6))
    covariances = root @ np.swapaxes(root, 1, 2) + 0.01 * np.eye(6)
    positions, spreads = script.looped_horizon(config, states, covariances, 30, 0.1)
    batched = Propagator(config, 30, 0.1, Notes())(states, covariances, None)
    np.testing.assert_allclose(positions, batched.position_m, atol=1e-6)
    last_s = 3.0
    expected = covariances[:, :2, :2] + last_s * (covariances[:, :2, 3:5] + covariances[:, 3:5, :2])
    expected += last_s**2 * covariances[:, 3:5, 3:5]
    assert (np.linalg.eigvalsh(spreads[:, -1, :2, :2] - expected) > -1e-4).all()  # and the process noise


@pytest.mark.parametrize("script", ["plain_pipeline"], indirect=True)
def test_the_plain_tracker_follows_and_ends_tracks(script: ModuleType) -> None:
    tracker = script.PlainTracker(TrackingConfig())
    for k in range(20):
        centres = np.array([[5.0 + 0.1 * k, 1.0, 0.0], [0.0, -6.0, 0.0]])
        tracks = tracker(100_000_000 * k, centres, np.eye(4))
    assert len(tracks) == 2
    np.testing.assert_allclose(tracks[0].ukf.x, [6.9, 1, 0, 1, 0, 0], atol=0.05)
    for k in range(20, 33):
        tracks = tracker(100_000_000 * k, np.zeros((0, 3)), np.eye(4))
    assert not tracks


@pytest.mark.parametrize("script", ["measuring"], indirect=True)
def test_summaries_and_tables(script: ModuleType) -> None:
    assert script.spread([float(value) for value in range(100, 0, -1)]) == {"median": 50.5, "p95": 95.0, "max": 100.0}
    assert script.spread([2.0]) == {"median": 2.0, "p95": 2.0, "max": 2.0}
    table = script.markdown(["what", "ms"], [["a", 0.12345], ["b", None], ["c", 1234.5]])
    assert table.splitlines() == ["| what | ms |", "| --- | ---: |", "| a | 0.123 |", "| b | - |", "| c | 1,234 |"]
    assert script.ratio(3.0, 1.5) == 2.0
    assert script.ratio(None, 1.5) is None


def test_the_pipeline_benchmark_runs_both_roads(tmp_path: Path) -> None:
    out = tmp_path / "pipeline.json"
    command = [sys.executable, str(ROOT / "benchmarks" / "pipeline.py"), str(SAMPLE)]
    done = subprocess.run(
        [*command, "--ranges", "8", "--frames", "12", "--json", str(out)], check=True, capture_output=True
    )
    assert done.stdout.startswith(b"`sample.mcap`")
    found = json.loads(out.read_text())["crops"]["8"]
    for side in ("adcbf", "plain"):
        assert {"read", "ground", "cluster", "track", "predict", "total"} <= set(found[side]["ms"])
        assert found[side]["counts"]["points clustered"] > 0
        assert found[side]["counts"]["tracks"] > 0
    assert set(found["same_input_ms"]) == {"plain HDBSCAN", "adcbf horizon", "plain horizon"}
