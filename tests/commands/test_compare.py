"""`adcbf compare` on real run folders: what it shows, what it refuses, and its exit codes."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from adcbf_cli import app
from tests.commands.short_logs import SAMPLE, write_short_log

SCORED = ("--range", "12", "--truth", SAMPLE / "truth.csv")


def adcbf(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "adcbf_cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`main` and `branch`: a short log, where the second takes measurements for noisier; both scored and driven."""
    folder = tmp_path_factory.mktemp("runs")
    log = write_short_log(folder / "short.mcap", 60)
    for name, noise in (("main", "0.1"), ("branch", "0.5")):
        setting = ("--set", f"tracking.sigma_extent_ratio={noise}")
        done = adcbf("run", log, "-o", folder / name, *SCORED, *setting)
        assert done.returncode == 0, done.stderr
        driven = adcbf("replay", folder / name, "-p", "pure-pursuit", "--seeds", "0:5")
        assert driven.returncode == 0, driven.stderr
    return folder


def test_blocks_add_up_to_the_metrics(folder: Path) -> None:
    """An independent reading of score_blocks.parquet gives the report's own values."""
    value_of = {
        "mean": lambda total, count: total / count,
        "root_mean": lambda total, count: (total / count) ** 0.5,
        "total": lambda total, count: total,
    }
    metrics = json.loads((folder / "main" / "report.json").read_text())["metrics"]
    rows = pq.read_table(folder / "main" / "score_blocks.parquet").to_pandas()
    assert rows["metric"].nunique() > 100
    for name, mine in rows.groupby("metric"):
        (form,) = mine["form"].unique()
        expected = value_of[form](mine["sum"].sum(), mine["count"].sum())
        assert metrics[name]["value"] == pytest.approx(expected), name
        if form != "total" and not name.startswith("hota."):  # frames and stretches are counted there
            assert metrics[name]["n"] == mine["count"].sum(), name
        assert mine["block"].is_monotonic_increasing


def test_differences_are_those_of_the_reports(folder: Path) -> None:
    done = adcbf("compare", "main", "branch", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    (run,) = document["runs"]
    assert (document["base"]["run"], run["run"]) == ("main", "branch")
    assert run["settings"] == {"tracking.sigma_extent_ratio": [0.1, 0.5]}
    reports = [json.loads((folder / name / "report.json").read_text())["metrics"] for name in ("main", "branch")]
    for name, (a, b) in {n: (reports[0][n]["value"], reports[1][n]["value"]) for n in reports[0]}.items():
        entry = run["metrics"][name]
        assert (entry["base"], entry["value"]) == (a, b)
        if a is not None and b is not None:
            assert entry["difference"] == pytest.approx(b - a)
            assert (entry["interval_95"] is None) == (entry["no_interval"] is not None)
    error = run["metrics"]["tracking.rmse_x_m"]
    assert error["paired_by"] == "blocks of 5 s"
    assert error["interval_95"][0] <= error["difference"] <= error["interval_95"][1]
    assert run["metrics"]["later_seen.rmse_x_m"]["no_interval"] == "fewer than 5 blocks of 5 s"
    without_truth = run["metrics"]["replay.pure-pursuit.min_dist_m"]["no_interval"]
    assert without_truth == "another world, route or start: drives of a seed are no pairs", "each has its own tracks"


def test_counts_scores_and_biases_have_intervals_too(folder: Path, tmp_path: Path) -> None:
    """Six seconds are too few blocks of 5 s, and enough of 1 s."""
    for name in ("main", "branch"):
        shutil.copytree(folder / name, tmp_path / name)
        setting = ("--set", "evaluation.bootstrap_block_s=1")
        done = adcbf("evaluate", tmp_path / name, "--truth", SAMPLE / "truth.csv", *setting)
        assert done.returncode == 0, done.stderr
    (run,) = json.loads(adcbf("compare", "main", "branch", "--json", cwd=tmp_path).stdout)["runs"]
    for name in ("clear.mota", "clear.misses", "hota.det_a", "hota.loc_a", "tracking.bias_along_m", "tracks.per_frame"):
        entry = run["metrics"][name]
        assert (entry["paired_by"], entry["no_interval"]) == ("blocks of 1 s", None), name
        assert entry["pairs"] >= 6, name
        assert entry["interval_95"][0] <= entry["difference"] <= entry["interval_95"][1], name
    whole = {name for name, entry in run["metrics"].items() if entry["no_interval"] == "one number for the whole log"}
    quantiles = {f"tracks.{name}.{q}" for name in ("life_s", "speed_mps") for q in ("median", "p90")}
    assert whole == quantiles | {"hota.hota", "hota.hota_all_tracks", "hota.ass_a"}


def test_a_run_differs_from_itself_by_nothing(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "main", tmp_path / "copy")
    done = adcbf("compare", folder / "main", tmp_path / "copy", "--json")
    metrics = json.loads(done.stdout)["runs"][0]["metrics"]
    assert {entry["difference"] for entry in metrics.values()} == {0, None}
    assert {entry["verdict"] for entry in metrics.values()} <= {"the same", "unknown", "no clear difference"}
    unclear = [name for name, entry in metrics.items() if entry["verdict"] == "no clear difference"]
    assert all(name.startswith("replay.") for name in unclear), "rates over few drives only"


def test_a_table_for_people_and_a_page_for_a_pull_request(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    done = adcbf("compare", "main", "branch", "--markdown", page, cwd=folder)
    assert done.returncode == 0, done.stderr
    shown = done.stdout.splitlines()
    assert any(line.split()[:1] == ["tracking.rmse_x_m"] for line in shown)
    assert any(line.split()[:1] == ["replay.pure-pursuit.min_dist_m"] for line in shown)
    assert page.read_text().startswith("## Compared with `main`")
    assert adcbf("compare", "main", "branch", "--markdown", "-", cwd=folder).stdout == page.read_text()


def test_a_limit_that_is_exceeded_is_exit_code_4(folder: Path) -> None:
    passed = adcbf("compare", "main", "branch", "--fail-on", "detection.recall<-0.5", cwd=folder)
    assert passed.returncode == 0, passed.stderr
    missed = adcbf("compare", "main", "branch", "--fail-on", "tracking.nees<-1%", "--json", cwd=folder)
    assert missed.returncode == 4, "a filter that is told of more noise is less sure of itself"
    assert "threshold missed: branch: tracking.nees<-1%: from" in missed.stderr
    assert json.loads(missed.stdout)["runs"][0]["thresholds_missed"]


def test_blocks_of_another_report_are_not_used(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "main", tmp_path / "edited")
    report = tmp_path / "edited" / "report.json"
    report.write_text(report.read_text() + "\n")
    done = adcbf("compare", folder / "main", tmp_path / "edited", "--json")
    reason = json.loads(done.stdout)["runs"][0]["metrics"]["tracking.rmse_x_m"]["no_interval"]
    assert reason == "a run was scored without score_blocks.parquet"


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["main"], 2, "at least one more run folder"),
        (["main", "main"], 2, "given twice"),
        (["main", "nowhere"], 2, "nowhere: not a run folder"),
        (["main", "unscored"], 1, "adcbf evaluate unscored"),
        (["main", "broken"], 1, "broken/report.json: unreadable"),
        (["main", "huge"], 1, "huge/report.json: unreadable"),
        (["main", "endless"], 1, "endless/report.json: unreadable"),
        (["main", "branch", "--fail-on", "tracking.rmse_x_m>0.1"], 2, "a change with its sign"),
        (["main", "branch", "--fail-on", "tracking.rmse_z_m>+1%"], 2, "did you mean tracking.rmse_"),
        (["main", "branch", "--json", "--markdown", "-"], 2, "both want stdout"),
        (["main", "branch", "--markdown", "nowhere/page.md"], 2, "there is no folder nowhere"),
        (["main", "branch", "--markdown", "main/run.json"], 2, "main/run.json: a page's name ends in .md"),
    ],
)
def test_what_cannot_be_compared_is_told_in_one_line(
    folder: Path,
    arguments: list[str],
    code: int,
    text: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("unscored", "broken", "huge", "endless"):
        (folder / name).mkdir(exist_ok=True)
        shutil.copy(folder / "main" / "run.json", folder / name)
    score = '{"metrics": {"a": {"value": %s, "unit": "", "n": 1, "sample": "", "definition": ""}}}'
    for name, value in (("broken", "NaN"), ("huge", "1" + 400 * "0"), ("endless", "1e999")):
        (folder / name / "report.json").write_text(score % value)
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["adcbf", "compare", *arguments])
    with pytest.raises(SystemExit) as stop:
        app.main()
    said = capsys.readouterr()
    assert stop.value.code == code, said.err
    assert text in said.err
    assert said.out == ""
    assert len(said.err.strip().splitlines()) == 1
