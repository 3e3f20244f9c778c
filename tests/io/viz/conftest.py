"""One run folder for all tests of views. Tests that change it copy it first."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.commands.short_logs import write_short_log
from tests.io.viz.viz_runs import SAMPLE, adcbf

SCANS = 40
PLANNERS = ("-p", "pure-pursuit", "-p", "dwa")


@pytest.fixture(scope="session")
def viz_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds of the sample log, driven through by two planners from two starts, and planned along by one."""
    log = write_short_log(tmp_path_factory.mktemp("log") / "short.mcap", SCANS)
    run = tmp_path_factory.mktemp("run") / "short.adcbf"
    for command in (
        ("plan", log, "-o", run, "--range", "12", "-p", "dwa"),
        ("replay", run, *PLANNERS, "--seeds", "0:2", "--truth", SAMPLE / "truth.csv"),
        ("predict", run, "--viz", "foxglove", "--viz", "ros2", "--viz", "rrd"),
    ):
        code, _, err = adcbf(*command)
        assert code == 0, err
    return run
