"""The closed loop's benchmark: its sums by hand, and one drive through a scene of two metres."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]

SCENE = """
duration_s: 12
route: {points_m: [[0, 0], [2, 0]]}
terrain: {size_m: 20}
objects: [{kind: box, at_m: [1, 1.5], size_m: [0.4, 0.4, 0.8]}]
lidar: {kind: spinning, instantaneous: true, channels: 8, azimuth_step_deg: 2, max_range_m: 10}
"""


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    return importlib.import_module("closed_loop")


def test_drives_are_summed_up(script: ModuleType) -> None:
    """Two drives of 2 s and 8 s: 500 ms of 5 s are scans, 1.5 s are plans, the rest is the loop's."""
    times = script.Times()
    times.add(script.Timed({"simulate": [100.0, 200.0], "plan": [500.0]}, 1.0, 2.0, "success"))
    times.add(script.Timed({"simulate": [200.0], "plan": [1000.0]}, 4.0, 8.0, "collision"))
    found = times.summary()
    assert found["stages"]["simulate"] == {"calls": 3, "median": 200.0, "p95": 200.0, "ms_per_simulated_s": 50.0}
    assert found["stages"]["plan"] == {"calls": 2, "median": 750.0, "p95": 1000.0, "ms_per_simulated_s": 150.0}
    assert found["stages"]["rest"] == {"calls": 2, "ms_per_simulated_s": 300.0}
    assert (found["simulated_s"], found["wall_s"], found["times_real_time"]) == (10.0, 5.0, 2.0)
    assert found["results"] == {"success": 1, "collision": 1}
    times.add(script.Timed({"plan": [100.0]}, 10.0, 5.0, "timeout"))
    assert times.summary()["slowest_drive_times_real_time"] == 0.5


def test_the_benchmark_drives(tmp_path: Path) -> None:
    scene, out = tmp_path / "tiny.yaml", tmp_path / "closed_loop.json"
    scene.write_text(SCENE, encoding="utf-8")
    options = ["--scene", f"{scene}=100000", "--ipopt", "0", "--json", str(out)]
    command = [sys.executable, str(ROOT / "benchmarks" / "closed_loop.py"), *options]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    (found,) = json.loads(out.read_text())["scenes"]
    own, perfect = found["loops"]["adcbf"], found["loops"]["perfect knowledge"]
    assert own["results"] == perfect["results"] == {"success": 1}
    assert set(own["stages"]) == {"simulate", "cluster", "track", "predict", "plan", "rest"}
    assert set(perfect["stages"]) == {"plan", "rest"}
    scans, plans = own["stages"]["simulate"]["calls"], own["stages"]["plan"]["calls"]
    assert plans == round(30 * own["simulated_s"]) + 1
    assert abs(scans - 10 * own["simulated_s"]) <= 1
    spent_ms = sum(stage["ms_per_simulated_s"] for stage in own["stages"].values())
    assert spent_ms == pytest.approx(1e3 / own["times_real_time"])
    assert all(stage["ms_per_simulated_s"] > 0 for stage in own["stages"].values())
    lines = done.stdout.splitlines()
    assert sum(line.startswith("| tiny |") for line in lines) == 2
    assert [line.split(" |")[0] for line in lines if line.startswith(("| plan", "| rest", "| total"))] == [
        "| plan",
        "| rest",
        "| total",
    ]


def test_scenes_are_named_with_seeds(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["closed_loop.py", "--scene", "crossings"])
    with pytest.raises(SystemExit) as ended:
        script.main()
    assert ended.value.code == 2
