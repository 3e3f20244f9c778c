"""What is said while something takes long."""

from __future__ import annotations

import functools
import time
from pathlib import Path

import pytest
from numba.core import config

from adcbf_cli.commands import terminal
from adcbf_cli.core.planning.solvers import sqp_loop
from adcbf_cli.core.planning.solvers.compiling import kept

SOON_S = 0.01


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal, "_SOON_S", SOON_S)
    monkeypatch.setattr(terminal, "_AGAIN_S", SOON_S)


def _one(number: int) -> int:
    return number + 1


def test_what_takes_long_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal.patience("waiting"):
        time.sleep(20 * SOON_S)
    assert capsys.readouterr().err == "adcbf: waiting\n"


def test_compiling_is_said_where_there_is_some_and_not_where_what_is_kept_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A small function in the solver's place, which takes long to compile itself."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    for said in (1, 0):
        monkeypatch.setattr(sqp_loop, "entry", functools.cache(lambda: kept(_one)))
        with terminal.patience(terminal.COMPILING):
            assert sqp_loop.entry()(1) == 2
            time.sleep(20 * SOON_S)
        assert capsys.readouterr().err.count("compiling") == said


def test_nothing_is_said_of_a_solver_that_is_not_used(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sqp_loop, "entry", functools.cache(lambda: kept(_one)))
    with terminal.patience(terminal.COMPILING):
        time.sleep(20 * SOON_S)
    assert capsys.readouterr().err == ""
