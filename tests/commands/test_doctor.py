"""`doctor` on this installation, and on ones that are broken on purpose by what stands first on the path."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adcbf_cli.commands import doctor_checks
from adcbf_cli.core.config import Config
from adcbf_cli.core.planning.problem import Solution, SolverStatus
from adcbf_cli.core.planning.solvers import base as solvers
from adcbf_cli.core.planning.solvers.base import SOLVERS
from adcbf_cli.core.planning.solvers.sqp import SqpSolver
from adcbf_cli.core.self_test import (
    POST_RADIUS_M,
    SPEED_MPS,
    START_M,
    VELOCITY_MPS,
    predict_scene,
    run_self_test,
)

PROJECT = Path(__file__).resolve().parents[2]
RUNS_AS = {"ok", "absent", "warning", "failed"}


def doctor(*arguments: str, first: Path | None = None) -> subprocess.CompletedProcess[str]:
    """first: a folder whose modules come before the installed ones."""
    path = os.pathsep.join(str(folder) for folder in (first, PROJECT) if folder is not None)
    command = [sys.executable, "-m", "adcbf_cli", "doctor", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path}, check=False)


def checks(done: subprocess.CompletedProcess[str]) -> dict[str, dict[str, Any]]:
    assert "Traceback" not in done.stderr
    return {check["name"]: check for check in json.loads(done.stdout)["checks"]}


def test_this_installation_is_whole() -> None:
    done = doctor("--json")
    found = checks(done)
    assert done.returncode == 0, done.stdout
    assert json.loads(done.stdout)["ok"] is True
    assert {check["state"] for check in found.values()} <= RUNS_AS - {"failed"}
    assert all(found[f"solver {name}"]["state"] == "ok" for name in SOLVERS)
    assert found["self-test"]["state"] == "ok"
    assert all(check["advice"] for check in found.values() if check["state"] != "ok")


def test_what_cannot_be_imported_fails_its_own_rows_and_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "casadi.py").write_text("raise ImportError('libcasadi.so.3.7: cannot open shared object file')")
    (tmp_path / "piqp.py").write_text("raise ImportError('made for another processor')")
    done = doctor(first=tmp_path)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    rows = done.stdout.splitlines()
    piqp = next(i for i, row in enumerate(rows) if row.split()[:3] == ["failed", "solver", "piqp"])
    assert "made for another processor" in rows[piqp]
    assert rows[piqp + 1].split() == ["->", "pip", "install", "--upgrade", "piqp"]
    ipopt = next(row for row in rows if row.split()[1:3] == ["solver", "ipopt"])
    assert ipopt.startswith("warning")
    assert "libcasadi.so.3.7" in ipopt
    assert any(row.split()[:2] == ["ok", "python"] for row in rows)


def test_missing_system_libraries_and_broken_plugins_are_told_and_are_no_failure(tmp_path: Path) -> None:
    (tmp_path / "open3d.py").write_text("raise OSError('libGL.so.1: cannot open shared object file')")
    (tmp_path / "torn.py").write_text("raise ValueError('torn')")
    info = tmp_path / "torn-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: torn\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[adcbf.planners]\ntorn = torn:make\ndwa = torn:make\n")
    done = doctor("--json", first=tmp_path)
    found = checks(done)
    assert done.returncode == 0, done.stdout
    assert found["open3d's libraries"]["state"] == "warning"
    assert "libGL.so.1" in found["open3d's libraries"]["detail"]
    assert found["open3d's libraries"]["advice"] == "sudo apt-get install -y libgl1"
    assert found["planner torn"]["state"] == found["planner dwa"]["state"] == "warning"
    assert "ValueError: torn" in found["planner torn"]["detail"]
    assert "built in" in found["planner dwa"]["detail"]
    assert found["self-test"]["state"] == "ok"


def test_plugins_are_put_to_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What can be imported may still not be made, plan nothing, or leave the process."""
    (tmp_path / "strange.py").write_text("""
import sys
from types import SimpleNamespace

def planner(plan):
    return lambda name, *_: SimpleNamespace(name=name, plan=plan)

idle = planner(lambda situation: None)
leaves = planner(lambda situation: sys.exit(4))

def greedy(name, vehicle):
    return None

def group(cells_m, config, min_cluster_size, returns):
    return cells_m[7, 7]
""")
    info = tmp_path / "strange-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: strange\nVersion: 1.0\n")
    names = "idle = strange:idle\nleaves = strange:leaves\ngreedy = strange:greedy\n"
    (info / "entry_points.txt").write_text(f"[adcbf.planners]\n{names}[adcbf.clusterers]\ngroup = strange:group\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    found = {check.name: check for check in doctor_checks._plugins()}
    assert {check.state for check in found.values()} == {"warning"}
    assert "the planner 'idle' of strange 1.0: its `plan` returns a NoneType" in found["planner idle"].detail
    assert "the planner 'leaves' of strange 1.0 failed (SystemExit: 4)" in found["planner leaves"].detail
    assert "the planner 'greedy' of strange 1.0 failed (TypeError" in found["planner greedy"].detail
    assert "the clusterer 'group' of strange 1.0 failed (IndexError" in found["clusterer group"].detail


@pytest.mark.parametrize(
    ("name", "fits", "state", "text"),
    [
        ("numpy", True, "ok", np.__version__),
        ("numpy", False, "failed", f"{np.__version__}, where >=99 is wanted"),
        ("open3d", False, "warning", "simulated scans cannot be cast"),
        ("not-a-package-at-all", True, "failed", "not installed"),
    ],
)
def test_a_package_is_held_to_what_is_wanted(name: str, fits: bool, state: str, text: str) -> None:
    found = doctor_checks._package(name, ">=99", lambda found, prereleases: fits)
    assert found.state == state
    assert text in found.detail
    assert found.advice == ("" if state == "ok" else f"pip install '{name}>=99'")


def test_the_self_test_notices_a_planner_that_does_not_look_ahead() -> None:
    """Who held the post where it is would drive into it."""
    predictions = predict_scene(Config())
    assert run_self_test(predictions, Config(), "ad-cbf-mpc").problems == ()
    assert any("into the post" in text for text in run_self_test(predictions, Config(), "mpc-dc").problems)


def test_the_self_test_notices_a_solver_that_never_solves(monkeypatch: pytest.MonkeyPatch) -> None:
    """The vehicle then brakes, and keeps clear of the post by standing."""
    failing = Solution(np.zeros((Config().planning.steps, 2)), SolverStatus.FAILED, 1, np.inf)
    monkeypatch.setattr(SqpSolver, "solve", lambda *_: failing)
    found = run_self_test(predict_scene(Config()), Config())
    assert found.clearance_m > 0
    assert any("not solved, but" in text for text in found.problems)
    assert any("m ahead" in text for text in found.problems)


def test_a_solver_that_another_took_the_place_of_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(solvers, "has_numba", lambda: False)
    found = {check.name: check for check in doctor_checks._solvers()}
    assert found["solver sqp"].state == "warning"
    assert "piqp takes the place of the solver sqp" in found["solver sqp"].detail
    assert found["solver sqp"].advice == "pip install numba"
    assert found["solver piqp"].state == "ok"


def test_the_self_tests_vehicle_would_hit_the_post_if_it_drove_on() -> None:
    t = np.arange(0, 6, 0.01)
    post_m = START_M + VELOCITY_MPS * (1.4 + t)[:, None]
    gap_m = np.hypot(SPEED_MPS * t - post_m[:, 0], post_m[:, 1]) - POST_RADIUS_M - Config().vehicle.body_radius_m
    assert gap_m.min() < 0


def test_the_self_test_notices_a_tracker_that_lost_the_post() -> None:
    blind = Config.model_validate({"perception": {"range_m": 1.0}})
    assert run_self_test(predict_scene(blind), blind).problems == ("0 tracks of one post",)
    slow = Config.model_validate({"tracking": {"sigma_speed_mps": 0.01, "sigma_accel_mps2": 0.01}})
    assert run_self_test(predict_scene(slow), slow).problems == ("2 tracks of one post",), "it walks on, and hides one"


def test_the_self_test_notices_a_wrong_velocity() -> None:
    right = predict_scene(Config())
    wrong = replace(right, velocity_mps=right.velocity_mps + 0.5)
    assert not run_self_test(right, Config()).problems
    assert any("m/s off" in text for text in run_self_test(wrong, Config()).problems)
