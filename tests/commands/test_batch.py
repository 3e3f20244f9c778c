"""`adcbf batch` with real processes: failing logs, killed batches, exit codes, and what counts as finished."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from adcbf_cli import app
from adcbf_cli.commands.batch_work import LogTask, _key
from tests.commands.short_logs import write_short_log

CLOCKED = ("timings.parquet", ".lock")
"""What depends on the clock, and what is empty."""


def adcbf(*arguments: str | Path, cwd: Path, stdin: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "adcbf_cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False, input=stdin)


def objects(path: Path, seconds: float = 3.0, speed_mps: float = 1.0) -> Path:
    """A list of two walking objects, which stands for a log and takes a moment to work on."""
    lines = ["timestamp_ns,track_id,class,x_m,y_m"]
    for tick in range(round(seconds * 10)):
        lines += [f"{tick * 100_000_000},{i},person,{3.0 + i},{speed_mps * tick / 10 - i}" for i in (1, 2)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    return path


def contents(folder: Path) -> dict[str, bytes]:
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in CLOCKED]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def rows(folder: Path) -> dict[str, dict[str, Any]]:
    lines = (folder / "batch.jsonl").read_text().splitlines()
    return {row["log"]: row for row in map(json.loads, lines)}


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    """A folder with six logs that can be worked on."""
    for i in range(6):
        objects(tmp_path / f"walk{i}.csv", speed_mps=0.5 + i / 10)
    return tmp_path


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of which some cannot be worked on, and `b.batch` that was made of them."""
    folder = tmp_path_factory.mktemp("mixed")
    objects(folder / "mon" / "walk.csv")
    objects(folder / "tue" / "walk.csv", speed_mps=0.2)
    whole = write_short_log(folder / "whole.mcap", 12)
    (folder / "cut.mcap").write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    (folder / "noise.mcap").write_bytes(b"noise" * 99)
    patterns = ("*/walk.csv", "*.mcap", "gone.bag")
    done = adcbf("batch", *patterns, "-o", "b.batch", "-j", "2", "--", "--range", "8", cwd=folder)
    assert done.returncode == 1, done.stderr
    (folder / "stdout").write_text(done.stdout)
    (folder / "stderr").write_text(done.stderr)
    return folder


def test_a_failing_log_does_not_stop_the_others(mixed: Path) -> None:
    found = rows(mixed / "b.batch")
    assert {name: row["status"] for name, row in found.items()} == {
        "mon-walk": "done",
        "tue-walk": "done",
        "cut": "damaged",
        "noise": "failed",
        "whole": "done",
        "gone": "failed",
    }
    assert found["gone"]["error"] == "gone.bag does not exist"
    assert "noise.mcap is not a log" in found["noise"]["error"]
    assert found["cut"]["losses"]
    assert 0 < found["cut"]["frames"] < found["whole"]["frames"] == 12
    assert (found["whole"]["exit_code"], found["cut"]["exit_code"], found["gone"]["exit_code"]) == (0, 3, 1)
    assert found["whole"]["metrics"]["clusters.per_frame"] > 1


def test_lines_on_stdout_are_those_of_the_file_and_the_rest_is_on_stderr(mixed: Path) -> None:
    assert (mixed / "stdout").read_text() == (mixed / "b.batch" / "batch.jsonl").read_text()
    told = (mixed / "stderr").read_text().splitlines()
    assert told[-1] == "adcbf: 6 logs: 3 done, 1 damaged, 2 failed; b.batch"
    assert "adcbf: failed: gone.bag: does not exist" in told
    assert "Traceback" not in (mixed / "stderr").read_text()


def test_the_dataset_says_the_same_and_leads_to_the_run_folders(mixed: Path) -> None:
    batch = mixed / "b.batch"
    summary = pd.read_parquet(batch / "summary").set_index("log")
    for name, row in rows(batch).items():
        assert summary.loc[name, "status"] == row["status"]
        if row["run_folder"] is not None:
            report = json.loads((batch / row["run_folder"] / "report.json").read_text())
            own = pd.read_parquet(batch / "metrics" / f"log={name}" / "part.parquet").set_index("metric")
            assert {n: m["value"] for n, m in report["metrics"].items()} == {
                n: None if pd.isna(value) else value for n, value in own["value"].items()
            }
            assert row["source_sha256"] == report["source"]["sha256"]


def test_the_tables_of_all_run_folders_are_one_dataset(mixed: Path) -> None:
    import duckdb

    page = (Path(__file__).parents[2] / "docs" / "batch.md").read_text()
    query = page.partition("    SELECT log, count")[2].partition(";")[0].replace("sample.batch", str(mixed / "b.batch"))
    shutil.copytree(mixed / "b.batch" / "runs" / "log=whole", mixed / "b.batch" / "runs" / "log=noise")
    found = duckdb.sql(f"SELECT log FROM (SELECT log, count{query})").fetchall()
    assert sorted(log for (log,) in found) == ["cut", "mon-walk", "tue-walk", "whole"], "not what has failed since"


def test_killed_and_started_again_it_repeats_nothing_and_gives_the_same(logs: Path) -> None:

    def command(folder: str) -> list[str]:
        return ["batch", "*.csv", "--jobs", "2", "-o", folder, "--", "run"]

    assert adcbf(*command("calm.batch"), cwd=logs).returncode == 0
    batch = logs / "hurt.batch"
    began = [sys.executable, "-m", "adcbf_cli", *command("hurt.batch")]
    with subprocess.Popen(began, cwd=logs, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as running:
        while len(list(batch.glob("summary/*/part.parquet"))) < 2 and running.poll() is None:
            time.sleep(0.01)
        running.send_signal(signal.SIGKILL)
    assert not (batch / "batch.jsonl").exists(), "it was not at its end"
    wait_until_unlocked(batch)
    finished = {path.parent.name for path in batch.glob("summary/*/part.parquet")}
    assert 2 <= len(finished) < 6
    stamps = {name: (batch / "runs" / name / "clusters.parquet").stat().st_mtime_ns for name in finished}
    again = adcbf(*command("hurt.batch"), cwd=logs)
    assert again.returncode == 0, again.stderr
    assert f"; {len(finished)} of them finished before; " in again.stderr
    assert {name: (batch / "runs" / name / "clusters.parquet").stat().st_mtime_ns for name in finished} == stamps
    assert contents(batch) == contents(logs / "calm.batch")
    assert all(row["metrics"]["clusters.per_frame"] == 2 for row in rows(batch).values())


def wait_until_unlocked(batch: Path, within_s: float = 20.0) -> None:
    """Until the workers of a killed batch have followed it."""
    deadline = time.monotonic() + within_s
    while holders(batch) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not holders(batch)


def holders(batch: Path) -> set[int]:
    """The processes that have a file open in one of the batch's run folders."""
    found = set()
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        try:
            if str(batch / "runs") in os.readlink(link):
                found.add(int(link.parts[2]))
        except OSError:
            continue
    return found


def test_a_log_whose_process_is_killed_fails_alone_and_is_tried_again(logs: Path) -> None:
    batch = logs / "b.batch"
    write_short_log(logs / "long.mcap", 60)
    command = ["batch", "long.mcap", "walk0.csv", "walk1.csv", "-j", "2", "-o", batch.name, "--", "cluster"]
    with subprocess.Popen(
        [sys.executable, "-m", "adcbf_cli", *command],
        cwd=logs,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        while not list((batch / "runs" / "log=long").glob(".*.partial")) and running.poll() is None:
            time.sleep(0.01)
        (worker,) = holders_of(batch, "long")
        os.kill(worker, signal.SIGKILL)
        _, errors = running.communicate()
    assert running.returncode == 1
    assert "its process was killed by SIGKILL, out of memory perhaps" in errors
    assert {name: row["status"] for name, row in rows(batch).items()} == {
        "long": "failed",
        "walk0": "done",
        "walk1": "done",
    }
    again = adcbf(*command, cwd=logs)
    assert again.returncode == 0, again.stderr
    assert "3 logs: 3 done; 2 of them finished before" in again.stderr


def holders_of(batch: Path, name: str) -> set[int]:
    return holders(batch) & {
        int(link.parts[2]) for link in Path("/proc").glob("[0-9]*/fd/*") if f"log={name}/" in _target(link)
    }


def _target(link: Path) -> str:
    try:
        return os.readlink(link)
    except OSError:
        return ""


def test_interrupted_it_leaves_nothing_half_made_and_goes_on(logs: Path) -> None:
    batch = logs / "b.batch"
    command = ["batch", "*.csv", "-j", "2", "-o", batch.name, "--", "cluster"]
    began = [sys.executable, "-m", "adcbf_cli", *command]
    with subprocess.Popen(began, cwd=logs, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        while not list(batch.glob("summary/*/part.parquet")) and running.poll() is None:
            time.sleep(0.01)
        running.send_signal(signal.SIGTERM)
        _, errors = running.communicate()
    assert running.returncode == 128 + signal.SIGTERM, errors
    assert "Traceback" not in errors
    assert not list(batch.rglob("*.partial"))
    statuses = pd.read_parquet(batch / "summary")["status"]
    assert set(statuses) == {"done"}, "what was stopped has not failed"
    assert adcbf(*command, cwd=logs).returncode == 0


def reused(*command: str, cwd: Path) -> int:
    """How many logs a batch finds finished."""
    done = adcbf("batch", *command, cwd=cwd)
    assert done.returncode == 0, done.stderr
    last = done.stderr.splitlines()[-1]
    return int(last.partition("; ")[2].split()[0]) if "finished before" in last else 0


def test_what_a_log_depends_on_decides_what_is_repeated(logs: Path) -> None:
    """By content: the log, the files that the command names, the command, and the run folder as it was left."""
    settings = logs / "settings.yaml"
    settings.write_text("read: {object_radius_m: 0.2}\n")
    command = ("walk0.csv", "walk1.csv", "-o", "b.batch", "-j", "2", "--", "cluster", "-csettings.yaml")
    assert reused(*command, cwd=logs) == 0
    os.utime(logs / "walk0.csv")
    assert reused(*command, cwd=logs) == 2
    objects(logs / "walk0.csv", speed_mps=0.1)
    assert reused(*command, cwd=logs) == 1
    settings.write_text("read: {object_radius_m: 0.3}\n")
    assert reused(*command, cwd=logs) == 0
    other = ("--set", "read.object_radius_m=0.4")
    assert adcbf("cluster", "b.batch/runs/log=walk1", *other, cwd=logs).returncode == 0
    assert reused(*command, cwd=logs) == 1
    assert reused(*command, *other, cwd=logs) == 0


def test_a_run_folder_that_has_lost_something_is_made_whole(logs: Path) -> None:
    command = ("walk0.csv", "walk1.csv", "-o", "b.batch", "--", "cluster", "--viz", "foxglove")
    assert reused(*command, cwd=logs) == 0
    run = {name: logs / "b.batch" / "runs" / f"log={name}" for name in ("walk0", "walk1")}
    whole = {name: contents(folder) for name, folder in run.items()}
    (run["walk0"] / "clusters.parquet").unlink()
    (run["walk1"] / "viz.foxglove.mcap").unlink()
    assert reused(*command, cwd=logs) == 0
    assert {name: contents(folder) for name, folder in run.items()} == whole
    frames = run["walk1"] / "frames.parquet"
    frames.write_bytes(frames.read_bytes()[:-9])
    assert reused(*command, cwd=logs) == 1
    assert {name: contents(folder) for name, folder in run.items()} == whole


def test_a_log_that_was_moved_is_told_of_where_it_is(logs: Path) -> None:
    assert reused("walk0.csv", "-o", "b.batch", "--", "cluster", cwd=logs) == 0
    (logs / "attic").mkdir()
    (logs / "walk0.csv").rename(logs / "attic" / "walk0.csv")
    clusters = logs / "b.batch" / "runs" / "log=walk0" / "clusters.parquet"
    stamp = clusters.stat().st_mtime_ns
    moved = ("attic/walk0.csv", "-o", "b.batch", "--", "cluster")
    assert reused(*moved, cwd=logs) == 0
    assert clusters.stat().st_mtime_ns == stamp, "its content is the same"
    assert rows(logs / "b.batch")["walk0"]["path"] == "attic/walk0.csv"
    assert json.loads((clusters.parent / "run.json").read_text())["source"]["path"] == "../../../attic/walk0.csv"
    assert reused(*moved, cwd=logs) == 1


def test_the_results_are_those_of_the_command_whatever_ran_before_in_the_folder(logs: Path) -> None:
    driving = ("--start", "0,0", "--goal", "2,0", "-p", "pure-pursuit")
    earlier = adcbf("batch", "walk0.csv", "-o", "b.batch", "--", "run", "--fail-on", "tracks.confirmed>1", cwd=logs)
    assert earlier.returncode == 4
    for name, *options in (("cluster",), ("replay", *driving), ("evaluate",)):
        here, alone = logs / "b.batch", logs / f"{name}.batch"
        for folder in (here, alone):
            assert reused("walk0.csv", "-o", folder.name, "--", name, *options, cwd=logs) == 0
        told = [rows(folder)["walk0"] for folder in (here, alone)]
        for row in told:
            row["metrics"] = {metric: value for metric, value in row["metrics"].items() if "solve" not in metric}
        assert told[0] == told[1]
        own = [pd.read_parquet(folder / "metrics" / "log=walk0" / "part.parquet") for folder in (here, alone)]
        assert [*own[0]["metric"]] == [*own[1]["metric"]]
    assert (here / "runs" / "log=walk0" / "report.json").exists(), "what was there is left there"


TASK = {"directory": ".", "environment": (), "software": "adcbf"}


@pytest.mark.parametrize(
    "options",
    [
        ("evaluate", "-tt.truth.txt"),
        ("evaluate", "-t", "t.truth.txt"),
        ("run", "--truth={stem}.truth.txt"),
        ("replay", "--reference", "t.truth.txt"),
        ("predict", "--calibration", "t.truth.txt"),
        ("cluster", "-ct.truth.txt"),
    ],
)
def test_every_file_that_an_option_names_counts_by_its_content(
    options: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In its folder as KITTI has them, labels have a calibration beside it."""
    labels, calibration = tmp_path / "labels" / "t.truth.txt", tmp_path / "calib" / "t.truth.txt"
    for file in (labels, calibration):
        file.parent.mkdir()
        file.write_text("before")
    log = objects(labels.with_name("t.csv"))
    monkeypatch.chdir(labels.parent)
    task = LogTask(name="t", log=log.name, batch=str(tmp_path / "b.batch"), command=options, **TASK)  # type: ignore[arg-type]
    keys = [_key(task)]
    for file in (labels, calibration, log):
        file.write_text("after")
        keys.append(_key(task))
    assert len(set(keys)) == 4
    log.with_name("other.csv").write_text("of no concern")
    assert _key(task) == keys[-1]


def test_a_log_that_comes_later_renames_no_other(logs: Path) -> None:
    objects(logs / "mon" / "walk.csv")
    assert reused("*/walk.csv", "-o", "b.batch", "--", "cluster", cwd=logs) == 0
    objects(logs / "tue" / "walk.csv", speed_mps=0.2)
    assert reused("*/walk.csv", "-o", "b.batch", "--", "cluster", cwd=logs) == 1
    assert list(rows(logs / "b.batch")) == ["walk", "tue-walk"]


def test_what_a_command_writes_does_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(objects(tmp_path / "t.csv").parent)
    command = ("predict", "--save-calibration", "learnt.json")
    task = LogTask(name="t", log="t.csv", batch=str(tmp_path / "b.batch"), command=command, **TASK)  # type: ignore[arg-type]
    before = _key(task)
    Path("learnt.json").write_text("{}")
    assert _key(task) == before


def test_logs_with_names_of_any_kind_and_ways_that_lead_nowhere(logs: Path) -> None:
    odd = os.fsdecode(b"gr\xf6sse [1].csv")
    (logs / "walk0.csv").rename(logs / odd)
    (logs / "loop.csv").symlink_to("loop.csv")
    listed = "\0".join((odd, "loop.csv", f"{'x' * 300}.csv", "walk1.csv", ""))
    command = ["batch", "--from", "-", "-o", "b.batch", "--", "cluster"]
    done = subprocess.run(
        [sys.executable, "-m", "adcbf_cli", *command],
        cwd=logs,
        input=os.fsencode(listed),
        capture_output=True,
        check=False,
    )
    told = done.stderr.decode()
    assert done.returncode == 1, told
    assert "Traceback" not in told
    found = list(rows(logs / "b.batch").values())
    assert [row["status"] for row in found] == ["done", "failed", "failed", "done"]
    assert found[0]["path"] == "gr\\udcf6sse [1].csv"
    assert found[1]["log"] == "loop"
    assert all("Error:" not in row["error"] for row in found[1:3]), "each is told in plain words"
    summary = pd.read_parquet(logs / "b.batch" / "summary")
    assert set(summary["path"]) == {row["path"] for row in found}


def test_a_file_of_settings_beside_each_log(logs: Path) -> None:
    """Where one is missing or bad, that log fails, and it alone."""
    (logs / "walk1.yaml").write_text("read: {object_radius_m: 0.3}\n")
    (logs / "walk2.yaml").write_text("read: {radius_m: 0.3}\n")
    options = ("--", "cluster", "--config", "{dir}/{stem}.yaml")
    done = adcbf("batch", "walk0.csv", "walk1.csv", "walk2.csv", *options, cwd=logs)
    assert done.returncode == 1
    found = rows(logs / "adcbf.batch")
    assert [row["status"] for row in found.values()] == ["failed", "done", "failed"]
    manifest = json.loads((logs / "adcbf.batch" / "runs" / "log=walk1" / "run.json").read_text())
    assert manifest["config"]["read"]["object_radius_m"] == 0.3
    assert "walk0.yaml: cannot be read" in found["walk0"]["error"]
    assert "radius_m" in found["walk2"]["error"]


def test_logs_that_are_no_longer_named_leave_the_tables(logs: Path) -> None:
    assert adcbf("batch", "walk0.csv", "walk1.csv", "--", "cluster", cwd=logs).returncode == 0
    done = adcbf("batch", "--from", "-", "--json", "--", "cluster", cwd=logs, stdin="walk1.csv\n")
    document = json.loads(done.stdout)
    assert (document["counts"], [row["log"] for row in document["logs"]]) == ({"done": 1}, ["walk1"])
    batch = logs / "adcbf.batch"
    assert pd.read_parquet(batch / "summary")["log"].tolist() == ["walk1"]
    assert (batch / "runs" / "log=walk0" / "clusters.parquet").exists()
    assert "no longer in the tables, since not among these: 1 log of an earlier batch: walk0" in done.stderr


def test_any_command_on_each_log_with_what_is_its_own(logs: Path) -> None:
    objects(logs / "walk1.labels.csv", speed_mps=0.6)
    options = ("--range", "9", "--truth", "{dir}/{stem}.labels.csv", "--fail-on", "detection.recall<0.5")
    done = adcbf("batch", "walk1.csv", "walk2.csv", "--", "evaluate", *options, cwd=logs)
    found = rows(logs / "adcbf.batch")
    assert done.returncode == 1
    assert found["walk1"]["status"] == "done"
    assert found["walk1"]["metrics"]["detection.recall"] == 1
    assert "walk2.labels.csv" in found["walk2"]["error"], "it has no labels"
    driving = ("--start", "0,0", "--goal", "2,0", "-p", "pure-pursuit")
    driven = adcbf("batch", "walk1.csv", "--", "replay", *driving, cwd=logs)
    assert driven.returncode == 0, driven.stderr
    assert rows(logs / "adcbf.batch")["walk1"]["metrics"]["replay.pure-pursuit.success"] in (0, 1)


def test_exit_codes(logs: Path) -> None:
    whole = write_short_log(logs / "whole.mcap", 8)
    (logs / "cut.mcap").write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    assert adcbf("batch", "cut.mcap", "walk0.csv", "--", "cluster", cwd=logs).returncode == 3
    limit = ("--", "--fail-on", "tracks.confirmed>1")
    missed = adcbf("batch", "cut.mcap", "walk0.csv", *limit, cwd=logs)
    assert missed.returncode == 4, missed.stderr
    row = rows(logs / "adcbf.batch")["walk0"]
    assert (row["status"], row["exit_code"]) == ("missed", 4)
    assert row["thresholds_missed"][0].startswith("tracks.confirmed>1: it is")


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ([], "no logs"),
        (["*.bag"], "*.bag: no file matches"),
        (["--from", "nowhere.txt"], "nowhere.txt: cannot be read"),
        (["walk0.csv", "--range", "8"], "adcbf batch LOGS -- run --range"),
        (["walk0.csv", "--", "fly"], "fly: no command that runs on each log"),
        (["walk0.csv", "--", "run", "-o", "elsewhere"], "give -o before --"),
        (["walk0.csv", "--", "run", "--wide", "8"], "No such option"),
        (["walk0.csv", "--", "--config", "gone.yaml"], "gone.yaml: cannot be read"),
        (["walk0.csv", "--", "--set", "perception.rnge_m=3"], "did you mean perception.range_m?"),
        (["walk0.csv", "--engine", "cloud"], "must be one of processes, ray"),
        (["walk0.csv", "--address", "head:6379"], "needs --engine ray"),
        (["walk0.csv", "-o", "a.adcbf"], "a.adcbf: is the run folder of a log"),
        (["a.adcbf"], "a.adcbf: is a run folder"),
    ],
)
def test_what_cannot_be_meant_is_told_before_any_work(
    logs: Path,
    arguments: list[str],
    text: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (logs / "a.adcbf").mkdir()
    (logs / "a.adcbf" / "run.json").touch()
    monkeypatch.chdir(logs)
    monkeypatch.setattr(sys, "argv", ["adcbf", "batch", *arguments])
    with pytest.raises(SystemExit) as stop:
        app.main()
    said = capsys.readouterr()
    assert stop.value.code == 2, said.err
    assert text in said.err
    assert said.out == ""
    assert not (logs / "adcbf.batch").exists()


def test_two_batches_do_not_write_to_one_folder(logs: Path) -> None:
    import fcntl

    (logs / "adcbf.batch").mkdir()
    with (logs / "adcbf.batch" / ".lock").open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        done = adcbf("batch", "walk0.csv", "--", "cluster", cwd=logs)
    assert done.returncode == 1
    assert "another adcbf is writing here" in done.stderr
