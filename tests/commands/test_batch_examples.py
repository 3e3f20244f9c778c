"""The Makefile and the batch script in examples/ do what they say, on real logs."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands.short_logs import SAMPLE, write_short_log

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """With an `adcbf` on the path, that runs this very package."""
    command = tmp_path / "bin" / "adcbf"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m adcbf_cli "$@"\n')
    command.chmod(0o755)
    package = str(EXAMPLES.parent)
    return os.environ | {"PATH": f"{command.parent}:{os.environ['PATH']}", "PYTHONPATH": package}


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_gives_a_report_a_log_and_repeats_nothing(tmp_path: Path, environment: dict[str, str]) -> None:
    for name in ("a", "b"):
        write_short_log(tmp_path / f"{name}.mcap", 10)
    shutil.copy(SAMPLE / "truth.csv", tmp_path / "a.truth.csv")
    command = ["make", "-f", str(EXAMPLES / "Makefile"), "-j2", "OPTIONS=--range 8"]

    def make(*more: str) -> str:
        done = subprocess.run([*command, *more], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    make()
    reports = {name: json.loads((tmp_path / f"{name}.adcbf" / "report.json").read_text()) for name in ("a", "b")}
    assert reports["a"]["basis"]["truth"] is not None
    assert reports["b"]["basis"]["truth"] is None
    assert reports["a"]["basis"]["range_m"] == 8
    assert "adcbf run" not in make()
    make("a.adcbf/replay/report.json", "PLANNERS=pure-pursuit")
    replay = json.loads((tmp_path / "a.adcbf" / "replay" / "report.json").read_text())
    assert replay["comparison"]["planners"]["pure-pursuit"]["drives"] == 1
    shutil.copy(SAMPLE / "truth.csv", tmp_path / "b.truth.csv")
    told = make()
    assert "adcbf run b.mcap" in told, "it has a truth now"
    assert "adcbf run a.mcap" not in told


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_keeps_the_report_that_a_replay_was_made_from(tmp_path: Path, environment: dict[str, str]) -> None:
    (tmp_path / "sub").mkdir()
    write_short_log(tmp_path / "sub" / "a.mcap", 10)
    command = ["make", "-f", str(EXAMPLES / "Makefile"), "sub/a.adcbf/replay/report.json", "PLANNERS=pure-pursuit"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "sub" / "a.adcbf" / "report.json").exists()


def test_the_batch_script_compares_with_last_time(tmp_path: Path, environment: dict[str, str]) -> None:
    (tmp_path / "logs").mkdir()
    write_short_log(tmp_path / "logs" / "a.mcap", 40)
    write_short_log(tmp_path / "logs" / "glance.mcap", 3)

    def check(*arguments: str, options: str) -> int:
        command = [str(EXAMPLES / "batch.sh"), "logs", *arguments]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment | {"OPTIONS": options}, capture_output=True, text=True
        )
        assert "Traceback" not in done.stderr
        return done.returncode

    assert check("old.batch", options="--range 8") == 0
    assert check("same.batch", "old.batch", options="--range 8") == 0
    compared = {run: tmp_path / "same.batch" / "runs" / f"log={run}" for run in ("a", "glance")}
    scores = json.loads((compared["glance"] / "report.json").read_text())["metrics"]
    assert scores["later_seen.rmse_x_m"]["value"] is None, "too short to be scored, in both"
    page = (compared["a"] / "comparison.md").read_text()
    assert "without an interval" in page
    assert "**Threshold missed**" not in page
    worse = "--range 8 --set tracking.model=ca"
    assert check("worse.batch", "old.batch", options=worse) == 4
    assert "**Threshold missed**" in (tmp_path / "worse.batch" / "runs" / "log=a" / "comparison.md").read_text()
    (tmp_path / "logs" / "bad.bag").write_bytes(b"nothing")
    assert check("worse.batch", "old.batch", options=worse) == 1, "a log that failed outranks one that became worse"
