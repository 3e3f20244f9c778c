"""`adcbf evaluate` on run folders made by hand, from the options to the files and the exit code."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from adcbf_cli.commands.evaluate import evaluate, possible_metrics
from adcbf_cli.core.config import Config, EvaluationConfig, PerceptionConfig
from adcbf_cli.core.errors import EXIT_DATA_LOST, EXIT_THRESHOLD, AdcbfError, UsageError
from adcbf_cli.core.types import Loss
from adcbf_cli.io import tables
from adcbf_cli.io.parquet import TableWriter
from adcbf_cli.io.run_folder import STAGES, TABLES, Manifest, RunFolder, Source, StageRecord, stage_keys
from tests.core.evaluation.scenes import Labelled, Run, Seen, line

WALK = line(5.0, 2.0, vx=-0.5, vy=0.4)
RUN = Run([Labelled(WALK)], [Seen(lambda t: WALK(t) + np.array([0.05, 0.0])), Seen(line(-4.0, 0.0), static=True)])

app = typer.Typer(pretty_exceptions_enable=False)
app.command()(evaluate)


def write_run(folder: Path, run: Run, losses: list[Loss] | None = None) -> Path:
    """A run folder as the stages would have left it."""
    folder.mkdir()
    config = Config(perception=PerceptionConfig(range_m=20.0))
    keys = stage_keys("source", config, None)
    frames = range(run.count)
    columns = {
        "frames": lambda k: tables.frame_columns(run.clusters(k)),
        "clusters": lambda k: tables.cluster_columns(run.clusters(k)),
        "tracks": lambda k: tables.track_columns(run.tracks(k)),
        "predictions": lambda k: tables.prediction_columns(run.predictions(k)),
    }
    stages = {}
    for stage in STAGES:
        rows = {}
        for name in TABLES[stage]:
            with TableWriter(folder / f"{name}.parquet", name, {"key": keys[stage]}) as writer:
                for k in frames:
                    writer.write(columns[name](k))
            rows[name] = writer.rows
        stages[stage] = StageRecord(keys[stage], rows, losses=losses or [] if stage == "cluster" else [])
    with TableWriter(folder / "timings.parquet", "timings", {"key": keys["predict"]}):
        pass
    source = Source("absent.mcap", "source", ())
    RunFolder(folder).write_manifest(Manifest(source, {"world_frame": "odom"}, config, stages))
    return folder


def write_truth(path: Path, run: Run) -> Path:
    truth = run.truth()
    with path.open("w", newline="") as stream:
        table = csv.writer(stream)
        names = "timestamp_ns,track_id,class,x_m,y_m,z_m,yaw_rad,length_m,width_m,height_m,vx_mps,vy_mps"
        table.writerow(names.split(","))
        for i in range(len(truth)):
            place = [*truth.position_m[i], truth.yaw_rad[i], truth.length_m[i], truth.width_m[i], truth.height_m[i]]
            table.writerow([truth.stamp_ns[i], truth.track_id[i], truth.category[i], *place, 0, 0])
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_run(tmp_path / "log.adcbf", RUN)


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    return write_truth(tmp_path / "truth.csv", RUN)


def call(*arguments: object, code: int = 0):
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code, result.output
    return result


def test_json_report_and_files_say_the_same(folder: Path, truth: Path) -> None:
    result = call(folder, "--truth", truth, "--json")
    printed = json.loads(result.stdout)
    assert printed == json.loads((folder / "report.json").read_text())
    metrics = printed["metrics"]
    assert metrics["tracking.rmse_x_m"]["value"] == pytest.approx(0.05)
    assert metrics["tracking.rmse_x_m"]["unit"] == "m"
    assert metrics["tracking.rmse_x_m"]["n"] == 40
    assert metrics["prediction.rmse_x_m"]["value"] == pytest.approx(0.05)
    assert metrics["clear.mota"]["value"] == 1.0
    assert metrics["clear.mota_all_tracks"]["value"] == 0.0
    assert metrics["prediction.coverage_conformal_radius"]["value"] is None
    assert all(m["definition"] and m["sample"] for m in metrics.values())
    assert printed["schema_version"] == 1
    assert printed["basis"]["range_m"] == 20.0, "as far as perception looked"
    assert len(printed["truth_sha256"]) == 64
    assert printed["source"] == {"name": "absent.mcap", "sha256": "source"}
    page = (folder / "report.md").read_text()
    assert "| `tracking.rmse_x_m` | 0.05 |" in page
    for name in metrics:
        assert f"- `{name}` (" in page


def test_the_report_has_the_same_bytes_every_time(folder: Path, truth: Path) -> None:
    call(folder, "-t", truth)
    first = [(folder / name).read_bytes() for name in ("report.json", "report.md")]
    call(folder, "-t", truth)
    assert [(folder / name).read_bytes() for name in ("report.json", "report.md")] == first


def test_the_table_shows_value_unit_and_number_of_samples(folder: Path, truth: Path) -> None:
    lines = call(folder, "-t", truth).stdout.splitlines()
    (row,) = [row.split() for row in lines if "tracking.rmse_x_m" in row]
    assert row[:2] == ["tracking.rmse_x_m", "0.05"]
    assert row[-2:] == ["m", "40"]


def test_without_truth_the_later_seen_stands_in(folder: Path) -> None:
    document = json.loads(call(folder, "--json").stdout)
    assert document["basis"]["truth"] is None
    assert "tracking.rmse_x_m" not in document["metrics"]
    assert document["metrics"]["later_seen.fde_m.1.0s"]["value"] == pytest.approx(0.0, abs=1e-6)
    assert "No ground truth" in (folder / "report.md").read_text()


@pytest.mark.parametrize(
    ("limits", "code"),
    [
        (["tracking.rmse_x_m>0.1"], 0),
        (["tracking.rmse_x_m>0.04"], EXIT_THRESHOLD),
        (["detection.recall<0.9", "clear.mota_all_tracks<0.5"], EXIT_THRESHOLD),
        (["detection.recall.person<0.9"], 0),
        (["detection.recall.tram<0.9"], EXIT_THRESHOLD),
        (["prediction.coverage_conformal_radius<0.5"], EXIT_THRESHOLD),
    ],
)
def test_thresholds_set_the_exit_code_after_everything_is_written(
    folder: Path, truth: Path, limits: list[str], code: int
) -> None:
    options = [part for limit in limits for part in ("--fail-on", limit)]
    result = call(folder, "-t", truth, *options, code=code)
    document = json.loads((folder / "report.json").read_text())
    assert document["thresholds"] == limits
    assert bool(document["thresholds_missed"]) == (code == EXIT_THRESHOLD)
    assert ("threshold missed" in result.stderr) == (code == EXIT_THRESHOLD)


def test_a_limit_on_what_needs_truth_fails_without_it(folder: Path) -> None:
    result = call(folder, "--fail-on", "prediction.rmse_x_m>0.1", code=EXIT_THRESHOLD)
    assert "no ground truth was given" in result.stderr


def test_bad_limits_stop_before_any_work(folder: Path) -> None:
    with pytest.raises(UsageError, match=r"did you mean tracking\.rmse_x_m"):
        call(folder, "--fail-on", "tracking.rmse_xm>1")
    with pytest.raises(UsageError, match="expected metric"):
        call(folder, "--fail-on", "tracking.rmse_x_m=1")
    assert not (folder / "report.json").exists()


def test_lost_input_is_exit_3_and_in_the_report(tmp_path: Path, truth: Path) -> None:
    folder = write_run(tmp_path / "cut.adcbf", RUN, [Loss("the file ends early", 7)])
    call(folder, "-t", truth, code=EXIT_DATA_LOST)
    assert json.loads((folder / "report.json").read_text())["losses"] == [{"what": "the file ends early", "count": 7}]


def test_a_wider_scoring_range_than_perceptions_is_pointed_out(folder: Path, truth: Path) -> None:
    result = call(folder, "-t", truth, "--set", "evaluation.range_m=60")
    assert "objects between count as missed" in result.stderr
    assert json.loads((folder / "report.json").read_text())["basis"]["range_m"] == 60.0


def test_a_failed_evaluation_leaves_the_old_report(folder: Path, truth: Path) -> None:
    call(folder, "-t", truth)
    before = (folder / "report.json").read_bytes()
    truth.write_text("timestamp_ns,track_id,x_m,y_m\nnonsense,1,2,3\n")
    with pytest.raises(AdcbfError, match="row 2"):
        call(folder, "-t", truth)
    assert (folder / "report.json").read_bytes() == before


def test_metric_names_follow_the_horizons() -> None:
    names = possible_metrics(EvaluationConfig(horizons_s=(0.5,)))
    assert "prediction.fde_m.0.5s" in names
    assert "prediction.fde_m.3.0s" not in names


def test_every_metric_is_described_in_the_docs() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "metrics.md").read_text()
    for name in possible_metrics(EvaluationConfig()):
        stem = re.sub(r"\.\d\.\ds$", "", name)
        stem = re.sub(r"^later_seen(\.moving)?\.", "prediction.", stem)
        stem = re.sub(r"coverage_(50|90|95)$", "coverage_50", stem)
        stem = re.sub(r"corrected_(x_|y_|)m$", "corrected_*", stem)
        stem = re.sub(r"^(tracking|clustering)\.", "", stem)
        assert f"`{stem}`" in page or f"`{stem}." in page, name


def test_the_truth_is_read_before_the_log_is_worked_through(sample_data: Path, tmp_path: Path) -> None:
    bad = tmp_path / "truth.csv"
    bad.write_text("timestamp_ns,track_id,x_m,y_m\n1,1,2,far\n")
    for spec, complaint in ((bad, "row 2"), (tmp_path / "absent.csv", "cannot be read"), ("topic:/gone", "no topic")):
        with pytest.raises(AdcbfError, match=complaint):
            call(sample_data / "sample.mcap", "-t", spec, "-o", tmp_path / "run")
        assert not (tmp_path / "run").exists()


def test_real_street_from_points_to_score(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    log, labels = real_data("kitti0000/kitti0000_a.mcap"), real_data("kitti0000/kitti0000_a_gt_tracks.csv")
    document = json.loads(call(log, "-t", labels, "--range", "20", "-o", tmp_path / "run", "--json").stdout)
    metrics = document["metrics"]
    assert document["basis"]["truth"]["labelled_fov_deg"] == pytest.approx([-42.3, 20.3], abs=0.1)
    assert metrics["detection.recall"]["n"] == 152, "every label within 20 m, and no more"
    assert metrics["detection.recall"]["value"] > 0.9
    assert metrics["detection.track_recall"]["value"] > 0.8
    assert metrics["prediction.fde_m.1.0s"]["n"] > 80
    assert metrics["clustering.bias_along_m"]["value"] < 0, "what is seen of traffic is its near side"
    assert {row["class"] for row in document["objects"]} == {"Van", "Cyclist", "Pedestrian"}


def test_real_motion_capture_as_truth(real_data: Callable[[str], Path], tmp_path: Path) -> None:
    log = real_data("datmo/parallel.bag")
    options = ("--pose", "/ego_pose", "--truth", "topic:/red_pose", "-o", tmp_path / "run", "--json")
    metrics = json.loads(call(log, *options).stdout)["metrics"]
    assert metrics["detection.recall"]["value"] > 0.9
    assert metrics["tracking.rmse_m"]["n"] > 150
    assert metrics["tracking.rmse_m"]["value"] < 0.5
    assert metrics["clear.mota"]["value"] is None
    assert metrics["hota.ass_a"]["value"] is not None
