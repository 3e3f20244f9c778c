"""Campaigns of runs with real processes: order, failures, killed workers, signals, and going on afterwards."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from adcbf_cli.commands import campaign
from adcbf_cli.commands.campaign import run_campaign
from adcbf_cli.commands.run_progress import RunProgress, duration
from adcbf_cli.io.run_rows import RunRows
from tests.commands.campaign_work import Job, jobs, run

PROJECT = Path(__file__).resolve().parents[2]


def done(tasks: dict[str, Job], folder: Path, at_once: int) -> list[dict[str, Any]]:
    with RunRows(folder, "runs", "k") as rows:
        return run_campaign(tasks, run, rows, at_once, "squares")


def runs_begun(log: Path) -> list[int]:
    """The numbers of the runs in the order in which they began."""
    return [int(line.split()[0]) for line in log.read_text().splitlines()]


def processes(log: Path) -> set[int]:
    return {int(line.split()[1]) for line in log.read_text().splitlines()}


def alive(pid: int) -> bool:
    """Whether the process runs; one that has ended and that nobody asked about (a zombie) does not."""
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True).stdout.strip()
    return bool(state) and not state.startswith("Z")


def eventually(true: Callable[[], bool], within_s: float = 20.0) -> bool:
    deadline = time.monotonic() + within_s
    while not (found := true()) and time.monotonic() < deadline:
        time.sleep(0.02)
    return found


@pytest.mark.parametrize("at_once", [1, 2, 3])
def test_rows_come_in_the_order_of_the_tasks(tmp_path: Path, at_once: int) -> None:
    tasks = jobs(7, tmp_path / "log")
    tasks["run 0"] = replace(tasks["run 0"], lasts_s=0.3)  # the first to begin is not the first to finish
    results = done(tasks, tmp_path, at_once)
    assert results == [{"number": n, "square": n * n, "third": n / 3} for n in range(7)]
    found = processes(tmp_path / "log")
    assert found == {os.getpid()} if at_once == 1 else len(found - {os.getpid()}) == at_once


def test_processes_do_work_at_the_same_time(tmp_path: Path) -> None:
    """Two runs, each of which waits until the other has begun: one after the other they would never end."""
    tasks = {"a": Job(0, tmp_path / "log", does="meet"), "b": Job(1, tmp_path / "log", does="meet")}
    assert done(tasks, tmp_path, 2) == [{"met": True}, {"met": True}]


def test_a_worker_has_one_thread_and_the_environment_is_as_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    found = done(jobs(2, tmp_path / "log", does="threads"), tmp_path, 2)
    assert all(set(row["blas"]) == {1} for row in found)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "OPENBLAS_NUM_THREADS" not in os.environ


@pytest.mark.parametrize("at_once", [1, 2])
def test_a_run_that_raises_is_a_row_and_the_rest_go_on(
    tmp_path: Path, at_once: int, capsys: pytest.CaptureFixture[str]
) -> None:
    tasks = jobs(5, tmp_path / "log")
    for number, does in ((1, "raise"), (2, "refuse"), (3, "nan")):
        tasks[f"run {number}"] = replace(tasks[f"run {number}"], does=does)
    results = done(tasks, tmp_path, at_once)
    assert [set(row) for row in results] == [{"number", "square", "third"}, *[{"run", "error"}] * 3, set(results[0])]
    assert results[1]["error"].startswith("ValueError: no root for 1 (campaign_work.py:")
    assert results[2]["error"] == "scene 2: nothing to drive on"
    assert "not JSON compliant" in results[3]["error"]
    assert all("\n" not in row["error"] for row in results[1:4])
    assert "3 of 5 runs failed, the first with: ValueError: no root for 1" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("does", "error"),
    [
        ("die", "its process was killed by SIGKILL, out of memory perhaps"),
        ("exit", "its process ended early, with exit code 3"),
        ("leave", "its process ended early, with exit code 5"),
    ],
)
def test_a_worker_that_dies_fails_its_own_run_only(tmp_path: Path, does: str, error: str) -> None:
    tasks = jobs(8, tmp_path / "log", lasts_s=0.02)
    for number in (0, 1, 4, 7):  # both at once, one amid others, the last
        tasks[f"run {number}"] = replace(tasks[f"run {number}"], does=does)
    results = done(tasks, tmp_path, 2)
    assert [row for row in results if "error" in row] == [{"run": f"run {n}", "error": error} for n in (0, 1, 4, 7)]
    assert [results[n]["square"] for n in (2, 3, 5, 6)] == [4, 9, 25, 36]


def test_work_that_a_worker_cannot_import_fails_the_runs_with_the_reason(tmp_path: Path) -> None:
    tasks = jobs(3, tmp_path / "log")
    broken: dict[str, Any] = {run_id: Unreadable() for run_id in tasks}
    with RunRows(tmp_path, "runs", "k") as rows:
        results = run_campaign(broken, run, rows, 2, "squares")
    assert [row["error"].partition(" (")[0] for row in results] == ["LookupError: not to be had here"] * 3


class Unreadable:
    """What can be sent to another process, but not be received there."""

    def __reduce__(self) -> Any:
        return refuse_to_be_read, ()


def refuse_to_be_read() -> None:
    raise LookupError("not to be had here")


@pytest.mark.parametrize("at_once", [1, 2])
def test_only_what_is_missing_or_failed_is_run_again(
    tmp_path: Path, at_once: int, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "log"
    tasks = jobs(4, log)
    done(tasks | {"run 2": replace(tasks["run 2"], does="raise")}, tmp_path, at_once)
    log.unlink()
    capsys.readouterr()
    results = done({**jobs(6, log)}, tmp_path, at_once)
    assert sorted(runs_begun(log)) == [2, 4, 5]
    assert "squares: 3 of 6 runs are there already" in capsys.readouterr().err
    assert [row["square"] for row in results] == [0, 1, 4, 9, 16, 25]
    log.unlink()
    assert done(jobs(6, log), tmp_path, at_once) == results
    assert not log.exists()


def test_rows_of_tasks_not_asked_for_stay_where_they_are(tmp_path: Path) -> None:
    done(jobs(5, tmp_path / "log"), tmp_path, 1)
    few = {"run 3": jobs(5, tmp_path / "log")["run 3"]}
    assert [row["number"] for row in done(few, tmp_path, 1)] == [3]
    with RunRows(tmp_path, "runs", "k") as rows:
        assert len(rows.done) == 5


def command(folder: Path, count: int, lasts_s: float, at_once: int) -> list[str]:
    return [sys.executable, "-m", "tests.commands.campaign_script", *map(str, (folder, count, lasts_s, at_once))]


def started(folder: Path, at_once: int) -> subprocess.Popen[str]:
    """A campaign in a process group of its own, at its fourth run or later."""
    arguments = command(folder, 200, 0.05, at_once)
    parent = subprocess.Popen(
        arguments, cwd=PROJECT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    log = folder / "log"
    assert eventually(lambda: log.exists() and len(runs_begun(log)) >= 4), parent.communicate(timeout=5)
    return parent


@pytest.mark.parametrize("at_once", [1, 2])
@pytest.mark.parametrize("how", ["SIGTERM", "SIGINT to all", "SIGKILL"])
def test_stopped_at_any_moment_nothing_is_left_running_and_the_finished_rows_are_kept(
    tmp_path: Path, how: str, at_once: int
) -> None:
    parent = started(tmp_path, at_once)
    if how == "SIGINT to all":  # what Ctrl-C does
        os.killpg(parent.pid, signal.SIGINT)
    else:
        parent.send_signal(signal.Signals[how])
    _, errors = parent.communicate(timeout=20)
    assert parent.returncode != 0
    assert "Traceback" not in errors
    assert eventually(lambda: not any(alive(pid) for pid in processes(tmp_path / "log")))
    with RunRows(tmp_path, "runs", "k") as rows:
        begun = runs_begun(tmp_path / "log")
        assert 3 - at_once <= len(rows.done) < 200  # a run may begin before the row of the one before is written
        assert set(rows.done) <= {f"run {number}" for number in begun}
        assert not any("error" in row for row in rows.done.values())


def test_after_a_sigkill_the_same_command_ends_as_if_nothing_had_been(tmp_path: Path) -> None:
    undisturbed = subprocess.run(
        command(tmp_path / "a", 24, 0.0, 2), cwd=PROJECT, capture_output=True, text=True, check=True
    )
    for _ in range(2):
        parent = started(tmp_path / "b", 2)
        parent.kill()
        parent.communicate(timeout=20)
        (tmp_path / "b" / "log").unlink()
    again = subprocess.run(command(tmp_path / "b", 24, 0.0, 1), cwd=PROJECT, capture_output=True, text=True, check=True)
    assert "runs are there already" in again.stderr
    assert again.stdout == undisturbed.stdout
    assert len(json.loads(again.stdout)) == 24


def test_a_worker_deaf_to_being_asked_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(campaign, "GRACE_S", 0.1)
    tasks = {"deaf": Job(0, tmp_path / "log", does="ignore"), "quick": Job(1, tmp_path / "log", does="count")}
    finished = campaign.run_in_processes(tasks, run, 2)
    assert next(finished)[0] == "quick"
    assert eventually(lambda: (tmp_path / "deaf").exists())
    finished.close()
    assert not any(alive(pid) for pid in processes(tmp_path / "log"))


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.4, "0 s"), (99, "99 s"), (100, "2 min"), (3540, "59 min"), (3599, "1 h 00 min")]
)
def test_durations_as_one_says_them(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_without_a_terminal_there_is_a_line_now_and_then(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    clock = iter([0.0, 10.0, 40.0, 40.0, 50.0])
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    with RunProgress(11, "squares") as progress:
        for failed in (False, True, False):
            progress.advance(failed)
    assert capsys.readouterr().err == "adcbf: squares: 2 of 11 runs, 1 failed, 0.05 runs/s, 3 min left\n"
