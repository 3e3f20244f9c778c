"""The quick start's commands, typed in their order into one shell, do what the page says."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent
PAGE = PROJECT / "docs" / "quickstart.md"
INSTALLS = ("pip install", "adcbf doctor")
"""Blocks left out here: the tests run in an installation, and the doctor has tests of its own."""

MARK = "=== "


@pytest.fixture(scope="module")
def typed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str], str]:
    """The folder in which all was typed, what each command printed, and what went to stderr."""
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed")
    folder = tmp_path_factory.mktemp("clone")
    shutil.copytree(PROJECT / "sample_data", folder / "sample_data")
    (folder / "bin").mkdir()
    for name, module in (("adcbf", "-m adcbf_cli"), ("python", "")):
        command = folder / "bin" / name
        command.write_text(f'#!/bin/sh\nPYTHONPATH="{PROJECT}" exec "{sys.executable}" {module} "$@"\n')
        command.chmod(0o755)
    path = os.pathsep.join([str(folder / "bin"), os.environ["PATH"]])
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail"],
        input="\n".join(script()),
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PATH": path},
        check=False,
    )
    assert done.returncode == 0, done.stderr
    printed = (part.partition("\n") for part in done.stdout.split(MARK)[1:])
    return folder, {command: output for command, _, output in printed}, done.stderr


def script() -> list[str]:
    """The page's code, each command announced on stdout before it runs."""
    lines = []
    for kind, code in re.findall(r"^```(sh|python)\n(.*?)^```", PAGE.read_text(), flags=re.S | re.M):
        if any(words in code for words in INSTALLS):
            continue
        if kind == "python":
            lines += [f"echo '{MARK}python'", "python - <<'END'", code.rstrip(), "END"]
        else:
            for command in code.strip().splitlines():
                lines += [f"printf '{MARK}%s\\n' {shell_quoted(command)}", command]
    return lines


def shell_quoted(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"


def output_of(typed: tuple[Path, dict[str, str], str], start: str) -> str:
    return next(output for command, output in typed[1].items() if command.startswith(start))


def test_the_log_is_looked_at_and_scored(typed: tuple[Path, dict[str, str], str]) -> None:
    assert "/points" in output_of(typed, "adcbf info sample_data/sample.mcap")
    assert "detection.recall" in output_of(typed, "adcbf run sample_data/sample.mcap --range 12")
    listed = output_of(typed, "ls sample.adcbf").split()
    assert {"tracks.parquet", "predictions.parquet", "report.md", "run.json"} <= set(listed)
    assert "radius_m" in output_of(typed, "python")


def test_planners_drive_and_tracks_are_not_computed_again(typed: tuple[Path, dict[str, str], str]) -> None:
    table = output_of(typed, "adcbf replay sample.adcbf")
    assert "ad-cbf-mpc" in table
    planners = json.loads((typed[0] / "sample.adcbf" / "replay" / "report.json").read_text())["comparison"]["planners"]
    assert planners["ad-cbf-mpc"]["metrics"]["success"]["value"] == 1.0
    assert planners["pure-pursuit"]["metrics"]["timeout"]["value"] == 1.0
    manifest = json.loads((typed[0] / "sample.adcbf" / "run.json").read_text())
    assert set(manifest["stages"]) == {"cluster", "track", "predict"}
    assert typed[2].count("cluster, track, predict computed") == 2  # for sample.adcbf and for ekf.adcbf


def test_the_page_to_send_is_there(typed: tuple[Path, dict[str, str], str]) -> None:
    page = (typed[0] / "sample.adcbf" / "report.html").read_text()
    assert page.lstrip().lower().startswith("<!doctype html")


def test_two_runs_are_compared_and_a_missed_threshold_is_an_exit_code(typed: tuple[Path, dict[str, str], str]) -> None:
    compared = output_of(typed, "adcbf compare sample.adcbf ekf.adcbf")
    assert "difference" in compared
    assert "exit code 4" in output_of(typed, "adcbf evaluate ekf.adcbf")


def test_a_scene_is_simulated_with_its_truth(typed: tuple[Path, dict[str, str], str]) -> None:
    assert (typed[0] / "crossings.csv").read_text().startswith("timestamp_ns,")
    assert "/points" in output_of(typed, "adcbf info crossings.mcap")


def test_every_block_is_run_or_known_to_be_left_out() -> None:
    blocks = re.findall(r"^```(\w*)", PAGE.read_text(), flags=re.M)[::2]
    assert set(blocks) <= {"sh", "python"}
    assert len(script()) > 15
