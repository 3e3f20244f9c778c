"""The stage commands on the sample log, as a user would call them: real processes, real files."""

from __future__ import annotations

import hashlib
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from tests.commands.short_logs import write_short_log

TABLES = ("frames", "clusters", "tracks", "predictions")
RANGE = ("--range", "12")


def adcbf(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "adcbf_cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


def digests(folder: Path) -> dict[str, str]:
    return {name: hashlib.sha256((folder / f"{name}.parquet").read_bytes()).hexdigest() for name in TABLES}


SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
SHORT_SCANS = 50


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample log's first five seconds, in small chunks: most tests need no more."""
    return write_short_log(tmp_path_factory.mktemp("log") / "short.mcap", SHORT_SCANS)


@pytest.fixture(scope="module")
def run_folder(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The short log's run folder, scored; do not write to its tables."""
    folder = tmp_path_factory.mktemp("whole") / "short.adcbf"
    done = adcbf("run", log, "-o", folder, *RANGE, "--truth", SAMPLE / "truth.csv", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["run"]["computed"] == ["cluster", "track", "predict"]
    return folder


def test_run_writes_every_table_sorted_by_time(run_folder: Path) -> None:
    for name in TABLES:
        stamps = pq.read_table(run_folder / f"{name}.parquet", columns=["timestamp_ns"])["timestamp_ns"].to_numpy()
        assert len(stamps) > 0
        assert (stamps[1:] >= stamps[:-1]).all()
    assert json.loads((run_folder / "report.json").read_text())["metrics"]["tracking.rmse_x_m"]["n"] > 50
    assert "tracking.rmse_x_m" in (run_folder / "report.md").read_text()


def test_no_table_holds_a_nan(run_folder: Path) -> None:
    for name in TABLES:
        table = pq.read_table(run_folder / f"{name}.parquet")
        for column in table.schema.names:
            if table[column].type == "double":
                assert not pc.any(pc.is_nan(table[column])).as_py(), f"{name}.{column}"


def test_stages_one_by_one_give_the_same_bytes_as_one_pass(run_folder: Path, log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "steps.adcbf"
    assert adcbf("cluster", log, "-o", folder, *RANGE).returncode == 0
    tracked = adcbf("track", folder, "--json")
    assert tracked.returncode == 0, tracked.stderr
    facts = json.loads(tracked.stdout)
    assert (facts["computed"], facts["reused"]) == (["track"], ["cluster"])
    assert adcbf("predict", folder).returncode == 0
    assert digests(folder) == digests(run_folder)


def test_a_setting_recomputes_its_stage_and_what_follows(log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "a.adcbf"
    assert adcbf("predict", log, "-o", folder, *RANGE).returncode == 0
    again = json.loads(adcbf("predict", log, "-o", folder, *RANGE, "--json").stdout)
    assert again["computed"] == []
    filtered = json.loads(adcbf("predict", folder, "--set", "tracking.filter=kf", "--json").stdout)
    assert filtered["computed"] == ["track", "predict"]
    longer = json.loads(adcbf("predict", folder, "--steps", "5", "--json").stdout)
    assert longer["computed"] == ["predict"]
    assert json.loads((folder / "run.json").read_text())["config"]["tracking"]["filter"] == "kf"


def test_outdated_tables_do_not_stay(log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "a.adcbf"
    assert adcbf("run", log, "-o", folder, *RANGE).returncode == 0
    assert adcbf("cluster", folder, "--range", "5").returncode == 0
    assert not (folder / "tracks.parquet").exists()
    assert not (folder / "predictions.parquet").exists()
    assert not (folder / "report.json").exists()


def test_a_changed_or_lost_log_is_not_mistaken(log: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(log.read_bytes())
    assert adcbf("cluster", copy, *RANGE, cwd=tmp_path).returncode == 0
    folder = tmp_path / "copy.adcbf"
    copy.write_bytes(log.read_bytes()[:-1])
    changed = adcbf("cluster", folder, "--range", "6")
    assert changed.returncode == 1
    assert "has changed since" in changed.stderr
    copy.unlink()
    gone = adcbf("cluster", folder, "--range", "6")
    assert gone.returncode == 1
    assert "this log is gone" in gone.stderr


def test_killed_at_any_moment_nothing_half_written_is_trusted(run_folder: Path, log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "killed.adcbf"
    command = [sys.executable, "-m", "adcbf_cli", "predict", str(log), "-o", str(folder), *RANGE]
    dice = random.Random(3)
    for _ in range(6):
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(dice.uniform(0.3, 3.0))
        process.send_signal(signal.SIGKILL)
        process.wait()
        for name in TABLES:
            table = folder / f"{name}.parquet"
            if table.exists():
                assert pq.read_table(table).num_rows > 0
    assert subprocess.run(command, capture_output=True, check=False).returncode == 0
    assert digests(folder) == digests(run_folder)
    assert not list(folder.glob(".*.partial"))


def test_point_labels_agree_with_the_clusters(log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "labels.adcbf"
    assert adcbf("cluster", log, "-o", folder, "--labels", *RANGE).returncode == 0
    points = pq.read_table(folder / "points.parquet").to_pydict()
    clusters = pq.read_table(folder / "clusters.parquet").to_pydict()
    labelled = {(f, c) for f, c in zip(points["frame_index"], points["cluster_id"], strict=True) if c is not None}
    found = set(zip(clusters["frame_index"], clusters["cluster_id"], strict=True))
    assert labelled == found


def test_a_calibration_learned_on_one_log_serves_another(log: Path, tmp_path: Path) -> None:
    folder, file = tmp_path / "a.adcbf", tmp_path / "calibration.json"
    assert adcbf("predict", log, "-o", folder, *RANGE, "--save-calibration", file).returncode == 0
    assert adcbf("predict", folder, "--calibration", file).returncode == 0
    again = json.loads(adcbf("predict", folder, "--json").stdout)
    assert again["computed"] == [], "the folder keeps its calibration"
    assert adcbf("evaluate", folder).returncode == 0
    rows = pq.read_table(folder / "predictions.parquet")
    first_frame = rows.filter(rows["frame_index"].to_numpy() == rows["frame_index"][0].as_py())
    assert first_frame["conformal_radius_m"].null_count == 0, "radii are there from the first frame on"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_told_to_stop_clears_up(log: Path, tmp_path: Path, number: signal.Signals) -> None:
    folder = tmp_path / "run"
    command = [sys.executable, "-m", "adcbf_cli", "run", str(log), "-o", str(folder)]

    def hear_interrupts() -> None:
        # A shell starts its background jobs deaf to SIGINT, and whoever they start inherits that.
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=hear_interrupts
    ) as running:
        while running.poll() is None and not list(folder.glob(".*.partial")):
            time.sleep(0.01)
        running.send_signal(number)
        _, errors = running.communicate()
    assert running.returncode in (1, 130, 128 + signal.SIGTERM), errors
    assert "Traceback" not in errors
    assert not folder.exists(), "it was made for nothing"


def test_a_full_disk_leaves_no_table_behind(log: Path, tmp_path: Path) -> None:
    """No file may exceed 20 kB here: some tables are finished before the largest one fails."""
    folder = tmp_path / "run"
    done = subprocess.run(
        [sys.executable, "-m", "adcbf_cli", "run", str(log), "-o", str(folder)],
        capture_output=True,
        text=True,
        preexec_fn=_small_files_only,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.count("adcbf: error") == 1, done.stderr
    assert "Traceback" not in done.stderr
    assert not folder.exists(), "it was made for nothing"


def _small_files_only() -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


def test_what_the_end_needs_is_checked_at_the_beginning(log: Path, tmp_path: Path) -> None:
    bad, endless = tmp_path / "bad.json", tmp_path / "endless.json"
    bad.write_text("{}")
    group = '{"radius_m": [1.0], "samples": [1e999]}'
    endless.write_text(
        '{"format": "adcbf-calibration-1", "probability": 0.95, "step_s": 0.1, "source": "", '
        f'"groups": {{"moving": {group}, "static": {group}}}}}'
    )
    folder = tmp_path / "run"
    for option, file, code in (
        ("--calibration", bad, 2),
        ("--calibration", endless, 2),
        ("--calibration", SAMPLE / "truth.csv", 2),
        ("--truth", bad, 2),
        ("--save-calibration", tmp_path / "absent" / "c.json", 2),
        ("--save-calibration", tmp_path, 2),
    ):
        done = adcbf("run" if option == "--truth" else "predict", log, "-o", folder, option, file)
        assert done.returncode == code, done.stderr
        assert done.stderr.count("adcbf: error") == 1
        assert str(file) in done.stderr
        assert not folder.exists(), "nothing was computed first"


def test_thresholds_set_the_exit_code_and_the_report_is_there_all_the_same(run_folder: Path, tmp_path: Path) -> None:
    truth = run_folder.parent / "none.csv"
    passed = adcbf("evaluate", run_folder, "--fail-on", "later_seen.rmse_x_m>100")
    assert passed.returncode == 0, passed.stderr
    missed = adcbf("evaluate", run_folder, "--fail-on", "later_seen.rmse_x_m>0.000001")
    assert missed.returncode == 4
    assert "threshold missed: later_seen.rmse_x_m" in missed.stderr
    assert (run_folder / "report.json").exists()
    assert adcbf("evaluate", run_folder, "--truth", truth).returncode in (1, 2)


@pytest.mark.parametrize("command", ["cluster", "track", "predict", "evaluate", "run", "info"])
@pytest.mark.parametrize(
    ("make", "code", "text"),
    [
        (None, 1, "does not exist"),
        (b"", 1, ""),
        (b"garbage" * 100, 1, ""),
    ],
)
def test_bad_logs_are_one_line(command: str, make: bytes | None, code: int, text: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.mcap"
    if make is not None:
        path.write_bytes(make)
    done = adcbf(command, path, cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert done.stdout == ""
    assert text in done.stderr.lower()
    assert "bad.mcap" in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.glob("*.adcbf/*.parquet"))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["cluster"], "Missing argument"),
        (["cluster", "LOG", "--range", "-3"], "perception.range_m: input should be greater than 0"),
        (["cluster", "LOG", "--range", "wide"], "--range"),
        (["cluster", "LOG", "--lidar", "/nothing"], "/nothing"),
        (["cluster", "LOG", "--clusterer", "kmeans"], "perception.clusterer"),
        (["cluster", "LOG", "--set", "perception.rnge_m=3"], "did you mean perception.range_m?"),
        (["track", "LOG", "--filter", "pf"], "tracking.filter"),
        (["predict", "LOG", "--steps", "0"], "prediction.steps"),
        (["predict", "LOG", "--calibration", "nowhere.json"], "nowhere.json: cannot be read"),
        (["evaluate", "LOG", "--fail-on", "tracking.rmse_x>1"], "tracking.rmse_x"),
        (["config", "dump", "--config", "nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["simulate", "nowhere.yaml"], "nowhere.yaml"),
        (["fly"], "fly"),
    ],
)
def test_wrong_usage_is_exit_code_2(arguments: list[str], text: str, log: Path, tmp_path: Path) -> None:
    done = adcbf(*[str(log) if a == "LOG" else a for a in arguments], cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert text in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("*.parquet"))


def test_a_cut_log_is_read_to_the_cut_and_says_so_each_time(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    content = log.read_bytes()
    cut.write_bytes(content[: len(content) // 2])
    done = adcbf("track", cut, *RANGE, cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    assert "lost:" in done.stderr
    frames = pq.read_table(tmp_path / "cut.adcbf" / "frames.parquet").num_rows
    assert SHORT_SCANS * 0.3 < frames < SHORT_SCANS * 0.7
    again = adcbf("predict", tmp_path / "cut.adcbf")
    assert again.returncode == 3, "reused clusters are from a damaged log still"
    page = adcbf("report", tmp_path / "cut.adcbf", "--no-figures", "--no-points")
    assert page.returncode == 3
    assert "cut.adcbf: lost:" in page.stderr


def test_json_is_one_document_on_stdout(log: Path, tmp_path: Path) -> None:
    done = adcbf("cluster", log, "--json", cwd=tmp_path)
    facts = {fact["name"]: fact["value"] for fact in json.loads(done.stdout)["facts"]}
    assert facts["scans"] == SHORT_SCANS
    assert (tmp_path / "short.adcbf" / "run.json").exists()


def test_settings_are_dumped_and_described(tmp_path: Path) -> None:
    dumped = adcbf("config", "dump", "--set", "tracking.filter=ekf")
    assert "filter: ekf" in dumped.stdout
    (tmp_path / "run.yaml").write_text(dumped.stdout)
    assert adcbf("config", "dump", "--config", tmp_path / "run.yaml").stdout == dumped.stdout
    schema = json.loads(adcbf("config", "schema").stdout)
    assert "TrackingConfig" in schema["$defs"]


def test_a_name_that_is_not_text_is_shown_as_far_as_it_is(log: Path, tmp_path: Path) -> None:
    odd = tmp_path / os.fsdecode(b"a\xff.mcap")
    odd.write_bytes(log.read_bytes())
    for arguments in (["info", odd, "--json"], ["run", odd, *RANGE], ["report", "a .adcbf", "--no-figures"]):
        done = adcbf(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "a .adcbf" / "report.json").read_text(encoding="utf-8"))
    assert report["source"]["name"] == "a .mcap"
    done = adcbf("run", odd, *RANGE, "-o", os.fsdecode(b"b\xff"), cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr == "adcbf: error: -o b : not UTF-8, as the names of tables have to be\n"
