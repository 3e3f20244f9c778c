"""Run folders that several tests of commands read. Tests that change one copy it first."""

from __future__ import annotations

import io
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import pytest

from adcbf_cli.app import main


@dataclass(frozen=True)
class Done:
    """What a command left behind."""

    returncode: int
    stdout: str
    stderr: str


def run_here(*arguments: str | Path) -> Done:
    """The `adcbf` command in this process: its packages are loaded once for all calls."""
    out, err = io.StringIO(), io.StringIO()
    with patch.object(sys, "argv", ["adcbf", *map(str, arguments)]), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
            code = 0
        except SystemExit as left:
            code = left.code if isinstance(left.code, int) else 0 if left.code is None else 1
    return Done(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def driven_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A list of two people, one crossing and one standing, with two planners driving among them twice: scored, and in
    closed loop."""
    log = tmp_path_factory.mktemp("log") / "people.csv"
    rows = ["timestamp_ns,track_id,class,x_m,y_m"]
    for k in range(61):
        t = 0.2 * k
        rows.append(f"{round(t * 1e9)},1,Pedestrian,3.0,{0.8 * t - 4:.4f}")
        rows.append(f"{round(t * 1e9)},2,Pedestrian,4.5,1.2")
    log.write_text("\n".join(rows) + "\n")
    folder = tmp_path_factory.mktemp("run") / "people.adcbf"
    way = ("--start", "0,0", "--goal", "6,0", "--speed", "1", "--range", "8")
    done = run_here("replay", log, "-o", folder, *way, "-p", "ad-cbf-mpc", "-p", "pure-pursuit", "--seeds", "0:2")
    assert done.returncode == 0, done.stderr
    scored = run_here("evaluate", folder, "--truth", log)
    assert scored.returncode == 0, scored.stderr
    return folder
