"""`adcbf batch --engine ray` on a real cluster of several processes, with workers killed in the middle."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from adcbf_cli.commands import batch_engines
from tests.commands.campaign_work import Job, run
from tests.commands.short_logs import write_short_log
from tests.commands.test_batch import contents, holders_of, objects, rows

pytest.importorskip("ray", reason="Ray is not installed: pip install 'adcbf[ray]'")

COMMAND = ("batch", "long.mcap", "walk0.csv", "walk1.csv", "gone.csv", "-j", "2")


def adcbf(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "adcbf_cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


@pytest.fixture(autouse=True)
def surroundings(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """No cluster of the user's own, and none that a test leaves behind."""
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    yield
    ray = batch_engines.load_ray()
    assert not ray.is_initialized()


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    write_short_log(tmp_path / "long.mcap", 40)
    for i in range(2):
        objects(tmp_path / f"walk{i}.csv", speed_mps=0.5 + i / 10)
    return tmp_path


def test_a_worker_killed_in_the_middle_changes_nothing(logs: Path) -> None:
    """The log is begun anew by another worker; the results are those of processes, to the byte."""
    calm = adcbf(*COMMAND, "-o", "calm.batch", "--", "run", cwd=logs)
    batch = logs / "hurt.batch"
    began = [*COMMAND, "--engine", "ray", "-o", batch.name, "--", "run"]
    with subprocess.Popen(
        [sys.executable, "-m", "adcbf_cli", *began], cwd=logs, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        while not list((batch / "runs" / "log=long").glob(".*.partial")) and running.poll() is None:
            time.sleep(0.01)
        victims = holders_of(batch, "long")
        assert len(victims) == 1
        assert running.pid not in victims
        os.kill(victims.pop(), signal.SIGKILL)
        told, errors = running.communicate()
    assert (running.returncode, calm.returncode) == (1, 1), errors
    assert {name: row["status"] for name, row in rows(batch).items()} == {
        "long": "done",
        "walk0": "done",
        "walk1": "done",
        "gone": "failed",
    }
    assert told == (batch / "batch.jsonl").read_text()
    assert errors.splitlines()[-1] == "adcbf: 4 logs: 3 done, 1 failed; hurt.batch"
    assert contents(batch) == contents(logs / "calm.batch")
    assert rows(batch)["long"]["metrics"]["clusters.per_frame"] > 1


def test_a_cluster_that_is_there_already_is_used_by_its_address(logs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver of its own starts the cluster, with a worker process for each CPU, and reports nothing home."""
    script = """
import json, os, sys, ray
context = ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
print(context.address_info["gcs_address"], flush=True)
sys.stdin.read()
"""
    for name, value in {
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": "5" * 64,
        **batch_engines.NO_USAGE_STATISTICS,
    }.items():
        monkeypatch.setenv(name, value)
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as cluster:
        assert cluster.stdout is not None
        address = cluster.stdout.readline().strip()
        arguments = (
            "--engine",
            "ray",
            "--address",
            address,
            "--json",
            "--",
            "cluster",
            "--set",
            "read.object_radius_m=0.3",
        )
        done = adcbf("batch", "walk0.csv", "walk1.csv", *arguments, cwd=logs)
        cluster.communicate("")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["counts"] == {"done": 2}


def test_tasks_run_at_the_same_time_in_other_processes_and_dead_ones_are_told(tmp_path: Path) -> None:
    """Two that wait for each other; one that dies each time that it is tried; one that raises."""
    log = tmp_path / "log"
    together = {name: Job(i, log, does="meet") for i, name in enumerate("ab")}
    met = dict(batch_engines.on_ray(together, run, 2, None))
    assert met == {"a": {"met": True}, "b": {"met": True}}
    pids = {int(line.split()[1]) for line in log.read_text().splitlines()}
    assert len(pids - {os.getpid()}) == 2
    log.unlink()
    tasks = {"dies": Job(0, log, does="die"), "raises": Job(1, log, does="raise"), "counts": Job(2, log)}
    found = dict(batch_engines.on_ray(tasks, run, 2, None))
    assert found["counts"] == {"number": 2, "square": 4, "third": 2 / 3}
    assert found["raises"]["error"].startswith("ValueError: no root for 1")
    tries = batch_engines.RETRIES + 1
    assert found["dies"]["error"].startswith(f"its Ray worker died {tries} times")
    assert sum(line.split()[0] == "0" for line in log.read_text().splitlines()) == tries


def test_each_way_to_end_is_told_as_what_it_was() -> None:
    from ray.exceptions import OutOfMemoryError, RayTaskError, WorkerCrashedError

    traceback = "Traceback (most recent call last):\n  File x\nModuleNotFoundError: No module named 'adcbf_cli'\n"
    lacking = RayTaskError("attempt", traceback, ModuleNotFoundError("No module named 'adcbf_cli'"))
    assert batch_engines._why(lacking).endswith("could not begin: ModuleNotFoundError: No module named 'adcbf_cli'")
    assert batch_engines._why(OutOfMemoryError("1 worker was killed\nat 15 GB")).endswith(
        "its machine's memory ran out"
    )
    assert batch_engines._why(WorkerCrashedError()) == "its Ray worker died 4 times (WorkerCrashedError)"


def test_where_memory_runs_out_ray_does_not_try_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ray reads it from the environment; what the user says there counts."""
    (name,) = batch_engines.FEW_OOM_RETRIES
    monkeypatch.setenv(name, "7")
    batch_engines.load_ray()
    assert os.environ[name] == "7"
    monkeypatch.delenv(name)
    batch_engines.load_ray()
    assert os.environ[name] == str(batch_engines.RETRIES)


def test_ray_reports_nothing_home(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_USAGE_STATS_ENABLED", raising=False)
    ray = batch_engines.load_ray()
    with batch_engines._connected(None, 1):
        assert ray.get(ray.remote(os.getenv).remote("RAY_USAGE_STATS_ENABLED")) == "0"
        told = usage_stats_of(Path("/tmp/ray/session_latest").resolve().name)
    assert set(told.values()) == {"0"}, told


def usage_stats_of(session: str) -> dict[str, str | None]:
    """What each of a cluster's own processes, which would do the reporting, has been told; by its first word."""
    told = {}
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            words = (process / "cmdline").read_bytes().decode().split("\0")
            if any(session in word for word in words):
                variables = (process / "environ").read_bytes().decode().split("\0")
                value = [v.partition("=")[2] for v in variables if v.startswith("RAY_USAGE_STATS_ENABLED=")]
                told[f"{words[0]} {process.name}"] = value[0] if value else None
    return told


def test_no_cluster_at_the_address_is_one_line(logs: Path) -> None:
    done = adcbf("batch", "walk0.csv", "--engine", "ray", "--address", "127.0.0.1:1", "--", "cluster", cwd=logs)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("adcbf: error: no Ray cluster at 127.0.0.1:1")
    assert "Traceback" not in done.stderr
