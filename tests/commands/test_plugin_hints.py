"""A package that offers a built-in name is told of where that name is used, and nowhere else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from adcbf_cli.commands.driving import planner_names


@pytest.fixture
def usurper(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package whose planner is called `dwa` and cannot even be imported."""
    info = tmp_path / "usurper-3.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: usurper\nVersion: 3.1\n")
    (info / "entry_points.txt").write_text("[adcbf.planners]\ndwa = not_there:make\n")
    monkeypatch.syspath_prepend(str(tmp_path))


@pytest.mark.usefixtures("usurper")
@pytest.mark.parametrize(("asked", "lines"), [(["dwa"], 1), (["all"], 1), (["apf", "ad-cbf-mpc"], 0), (None, 0)])
def test_the_built_in_planner_is_taken_and_the_other_told(
    asked: list[str] | None, lines: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert planner_names(asked)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("warning: the planner 'dwa' of usurper 3.1 cannot be used") == lines
    assert len(said.err.splitlines()) == lines


@pytest.mark.parametrize("command", [[], ["replay"], ["batch"]])
def test_help_looks_for_no_plugins(command: list[str]) -> None:
    code = f"""
import sys
from adcbf_cli.app import app
try:
    app({[*command, "--help"]!r})
finally:
    print("adcbf_cli.core.plugins" in sys.modules, file=sys.stderr)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "Usage:" in done.stdout
    assert done.stderr == "False\n"
