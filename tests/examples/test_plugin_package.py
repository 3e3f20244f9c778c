"""The example package, installed as a user installs it, driven through the real command."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from sklearn.cluster import DBSCAN

from adcbf_cli.core.config import PerceptionConfig, TrackingConfig

PROJECT = Path(__file__).resolve().parents[2]
PACKAGE = PROJECT / "examples" / "plugin_package"
WAY = ("--start", "0,0", "--goal", "6,0", "--speed", "1", "--range", "8")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds the installed package; no network is asked."""
    folder = tmp_path_factory.mktemp("site")
    source = shutil.copytree(PACKAGE, folder / "source")  # building writes beside the sources
    offline = ("--no-deps", "--no-build-isolation", "--no-index", "--quiet")
    command = [sys.executable, "-m", "pip", "install", *offline, "--target", str(folder / "packages"), str(source)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return folder / "packages"


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """10 s at 5 Hz: one crosses in front, one stands beside the way."""
    path = tmp_path_factory.mktemp("log") / "people.csv"
    rows = [
        f"{k * 200_000_000},{number},Pedestrian,{x},{y}"
        for k in range(51)
        for number, (x, y) in enumerate([(3.0, -4.0 + 0.16 * k), (4.5, 1.8)])
    ]
    path.write_text("\n".join(["timestamp_ns,track_id,class,x_m,y_m", *rows]) + "\n")
    return path


def adcbf(site: Path, *arguments: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "adcbf_cli", *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(PROJECT)])}
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=environment, check=False)


def test_its_planner_and_motion_model_get_replay_metrics_and_reports(site: Path, people: Path, tmp_path: Path) -> None:
    asked = ("-p", "halt-near", "-p", "pure-pursuit", "--set", "tracking.model=fading")
    done = adcbf(site, "replay", people, "-o", "run.adcbf", *WAY, *asked, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    found = document["comparison"]["planners"]
    assert list(found) == ["halt-near", "pure-pursuit"]
    assert found["halt-near"]["metrics"]["success"]["value"] == 1.0
    assert document["counters"]["halts_for_what_is_near"] > 0
    assert document["plugins"]["halt-near"].startswith("adcbf-example 0.1.0+")
    assert set(document["plugins"]) == {"halt-near"}
    manifest = json.loads((tmp_path / "run.adcbf" / "run.json").read_text())
    assert manifest["plugins"]["tracking.model"].startswith("adcbf-example 0.1.0+")
    models = pq.read_table(tmp_path / "run.adcbf" / "tracks.parquet", columns=["model"])["model"].unique().to_pylist()
    assert models == ["fading"]
    outcomes = pq.read_table(tmp_path / "run.adcbf" / "replay" / "plans.parquet").to_pylist()
    assert "braked" in {row["outcome"] for row in outcomes if row["planner"] == "halt-near"}


def test_its_clusterer_is_used_and_its_results_are_kept_until_its_code_changes(site: Path, tmp_path: Path) -> None:
    text = (PROJECT / "sample_data" / "scenario.yaml").read_text()
    (tmp_path / "scene.yaml").write_text(text.replace("duration_s: 20", "duration_s: 1"))
    simulated = adcbf(site, "simulate", "scene.yaml", "-o", "scene.mcap", cwd=tmp_path)
    assert simulated.returncode == 0, simulated.stderr
    asked = ("cluster", "scene.mcap", "--range", "10", "--clusterer", "euclid", "--json")
    first = adcbf(site, *asked, cwd=tmp_path)
    assert first.returncode == 0, first.stderr
    assert json.loads(first.stdout)["computed"] == ["cluster"]
    assert pq.read_table(tmp_path / "scene.adcbf" / "clusters.parquet").num_rows > 0
    assert json.loads(adcbf(site, *asked, cwd=tmp_path).stdout)["computed"] == []

    changed = shutil.copytree(site, tmp_path / "changed")
    with (changed / "adcbf_example" / "clusterer.py").open("a") as source:
        source.write("# another version\n")
    assert json.loads(adcbf(changed, *asked, cwd=tmp_path).stdout)["computed"] == ["cluster"]

    gone = adcbf(tmp_path, *asked, cwd=tmp_path)
    assert gone.returncode == 2
    assert "no clusterer is called 'euclid'; there are hdbscan, dbscan" in gone.stderr
    assert "Traceback" not in gone.stderr


def test_its_planner_drives_in_simulated_scenes_too(site: Path, tmp_path: Path) -> None:
    asked = ("simulate", "crossings", "--closed-loop", "--knowledge", "perfect", "--seeds", "1", "-o", "runs", "--json")
    done = adcbf(site, *asked, "-p", "halt-near", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["plugins"]["halt-near"].startswith("adcbf-example 0.1.0+")
    assert pq.read_table(tmp_path / "runs" / "runs.parquet")["planner"].to_pylist() == ["halt-near"]


def test_euclid_gives_the_groups_of_dbscan_without_borders(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PACKAGE))
    from adcbf_example.clusterer import euclid

    config = PerceptionConfig()
    cells = np.random.default_rng(3).uniform(-6, 6, (150, 2))
    expected = DBSCAN(eps=config.dbscan_eps_m, min_samples=1).fit_predict(cells)
    ours = euclid(cells, config, 1, None).label
    assert (np.unique(np.stack([expected, ours]), axis=1).shape[1]) == expected.max() + 1 == ours.max() + 1 > 20
    small = np.bincount(expected)[expected] < 3
    assert ((euclid(cells, config, 3, None).label == -1) == small).all()


def test_fading_adds_as_much_in_one_step_as_in_two(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PACKAGE))
    from adcbf_example.motion_model import FADING_S, fading

    model = fading(TrackingConfig(), planar=False)
    step, noise = model.jacobian(np.zeros((1, 6)), 0.4), model.process_noise(0.4)
    twice = step @ noise @ step.T + noise
    np.testing.assert_allclose(model.process_noise(0.8), twice, rtol=1e-9)
    assert np.linalg.eigvalsh(noise).min() > 0
    far = model.propagate(np.array([[0, 0, 0, 1.0, 0, 0]]), 1000.0)
    np.testing.assert_allclose(far[0, [0, 3]], [FADING_S, 0.0], atol=1e-9)
