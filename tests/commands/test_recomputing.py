"""What a command says and keeps where a run folder is there already."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.commands.conftest import run_here
from tests.commands.short_logs import write_short_log


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A list of one person who walks by; its folder is the current one."""
    monkeypatch.chdir(tmp_path)
    rows = [f"{round(k * 2e8)},1,Pedestrian,3.0,{0.16 * k - 2:.4f}" for k in range(25)]
    (tmp_path / "walk.csv").write_text("\n".join(["timestamp_ns,track_id,class,x_m,y_m", *rows]) + "\n")
    return Path("walk.csv")


def test_falling_back_to_the_defaults_is_said_and_so_is_what_goes(log: Path) -> None:
    assert run_here("evaluate", log, "--range", "12").returncode == 0
    done = run_here("predict", log)
    assert done.returncode == 0
    assert done.stderr.splitlines()[0] == (
        "adcbf: walk.adcbf: cluster + track + predict computed anew (perception.range_m 12 -> 4); "
        "removed, being out of date: report.json; give walk.adcbf, not the log, to keep its settings"
    )
    assert not Path("walk.adcbf/report.json").exists()


def test_what_was_asked_for_and_costs_nothing_is_not_told(log: Path) -> None:
    assert run_here("predict", log, "--range", "12").stderr.count("anew") == 0
    assert run_here("predict", "walk.adcbf", "--set", "tracking.filter=kf").stderr.count("anew") == 0
    assert run_here("evaluate", "walk.adcbf").stderr.count("anew") == 0


def test_tables_that_go_are_named(log: Path) -> None:
    assert run_here("evaluate", log, "--range", "12").returncode == 0
    told = run_here("cluster", "walk.adcbf", "--range", "9").stderr.splitlines()[0]
    assert "perception.range_m 12 -> 9" in told
    assert "tracks.parquet, predictions.parquet, report.json" in told
    assert "keep its settings" not in told, "they were kept, but for the one that was given"


def test_a_log_that_cannot_be_read_as_asked_costs_no_results(log: Path, tmp_path: Path) -> None:
    drive = write_short_log(tmp_path / "drive.mcap", 10)
    assert run_here("run", drive, "-o", "drive.adcbf").returncode == 0
    before = {path.name: path.read_bytes() for path in Path("drive.adcbf").glob("[!.]*")}
    for folder in ("drive.adcbf", "new.adcbf"):
        done = run_here("run", drive, "-o", folder, "--lidar", "/nothing")
        assert done.returncode == 2, done.stderr
    assert {path.name: path.read_bytes() for path in Path("drive.adcbf").glob("[!.]*")} == before
    assert not Path("new.adcbf").exists()


@pytest.mark.parametrize(
    ("marker", "what"),
    [("runs.jsonl", "the runs of a closed loop"), ("batch.jsonl", "a batch"), ("runs/log=a/run.json", "a batch")],
)
def test_the_results_of_other_commands_are_not_overwritten(marker: str, what: str, log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "taken"
    (folder / marker).parent.mkdir(parents=True)
    (folder / marker).touch()
    (folder / "report.json").write_text("theirs")
    done = run_here("run", log, "-o", folder)
    assert done.returncode == 2
    assert f"holds {what}; choose another folder" in done.stderr
    assert (folder / "report.json").read_text() == "theirs"
    assert not (folder / ".lock").exists()
