"""`adcbf simulate --closed-loop` as a user meets it: a scene of two metres, driven for real."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from adcbf_cli.app import app
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.evaluation.run_measures import MEASURES
from adcbf_cli.core.simulation.parsing import parse_scenario
from adcbf_cli.io.schemas import SCHEMAS

SCENE = """
duration_s: 12
route: {points_m: [[0, 0], [2.2, 0]]}
terrain: {size_m: 20}
objects: [{kind: box, at_m: [0.3, 1.5], size_m: [0.4, 0.4, 0.8]}]
movers:
  - kind: cylinder
    radius_m: 0.25
    path: {kind: line, from_m: [1.2, {uniform: [-2.1, -1.9]}], to_m: [1.2, 3], speed_mps: 1.2}
lidar: {kind: spinning, instantaneous: true, channels: 8, azimuth_step_deg: 2, max_range_m: 10}
"""

BLIND = ("-p", "pure-pursuit", "--set", "perception.range_m=0.35")
"""It never looks farther than its own hull: it is hit."""

SEEDS = (100_001, 100_002)
PLANNERS = ("pure-pursuit", "ad-cbf-mpc")
CAMPAIGN = ("--seeds", "100001:100003", "-p", PLANNERS[0], "-p", PLANNERS[1], "--against", "ad-cbf-mpc")
RESULTS = {"runs.jsonl", "runs.parquet", "report.json", "report.md"}
TIMES = ("solve_p50_ms", "solve_p95_ms", "solve_p99_ms", "solve_max_ms", "deadline_missed_rate")


@dataclass(frozen=True)
class Done:
    exit_code: int
    stdout: str
    stderr: str


def adcbf(*arguments: str | Path) -> Done:
    """In this process, which spares each call its imports; errors come out as the entry point tells them."""
    found = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if isinstance(found.exception, AdcbfError):
        return Done(found.exception.exit_code, found.stdout, f"{found.stderr}adcbf: error: {found.exception}\n")
    if found.exception is not None and not isinstance(found.exception, SystemExit):
        raise found.exception
    return Done(found.exit_code, found.stdout, found.stderr)


def simulate(*arguments: str | Path) -> Done:
    return adcbf("simulate", *arguments)


def scene_file(folder: Path, text: str = SCENE) -> Path:
    path = folder / "tiny.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def rows_of(folder: Path) -> dict[str, dict[str, Any]]:
    """The kept rows by run id, in the order in which they came."""
    lines = (folder / "runs.jsonl").read_text().splitlines()[1:]
    return {entry["run"]: entry["row"] for entry in map(json.loads, lines)}


def table_of(folder: Path) -> list[dict[str, Any]]:
    return pq.read_table(folder / "runs.parquet").to_pylist()


def untimed(folder: Path) -> list[dict[str, Any]]:
    return [{name: value for name, value in row.items() if name not in TIMES} for row in table_of(folder)]


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two planners in two scenes, one run after the other; beside the folder what was printed."""
    home = tmp_path_factory.mktemp("campaign")
    done = simulate(scene_file(home), "--closed-loop", *CAMPAIGN, "-o", home / "out", "--json")
    assert done.exit_code == 0, done.stderr
    (home / "stdout.json").write_text(done.stdout)
    return home / "out"


@pytest.fixture(scope="module")
def collided(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A blind planner in one scene."""
    home = tmp_path_factory.mktemp("collided")
    done = simulate(scene_file(home), "--closed-loop", "--seeds", "100001", *BLIND, "-o", home / "out")
    assert done.exit_code == 0, done.stderr
    return home / "out"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return scene_file(tmp_path)


def again(folder: Path, tmp_path: Path) -> Path:
    """A copy of a finished campaign, and of its scene, to go on with."""
    shutil.copy(folder.parent / "tiny.yaml", tmp_path)
    return Path(shutil.copytree(folder, tmp_path / "out"))


def test_one_row_a_run_planner_by_planner(campaign: Path) -> None:
    assert {path.name for path in campaign.iterdir()} == RESULTS
    table = pq.read_table(campaign / "runs.parquet")
    assert table.schema.equals(SCHEMAS["runs"])
    rows = table.to_pylist()
    assert [(row["planner"], row["seed"]) for row in rows] == [(name, seed) for name in PLANNERS for seed in SEEDS]
    kept = rows_of(campaign)
    for row in rows:
        source = kept[f"{row['planner']}-{row['seed']}"]
        assert row["duration_s"] == source["duration_s"] > 1.5
        assert row["path_length_m"] == source["metrics"]["path_length_m"]
        assert (row["result"], row["movers"], row["standing"]) == ("success", 1, 1)
        assert row["fastest_mps"] == pytest.approx(1.2)
        assert row["error"] is row["log"] is row["hit_kind"] is row["hit_moving"] is None
        assert row["solve_p50_ms"] > 0
    metadata = json.loads(table.schema.metadata[b"adcbf"])
    assert metadata["table"] == "runs"
    assert metadata["scenario"]["name"] == "tiny"
    assert metadata["knowledge"] == "perception"
    assert metadata["config"]["planning"]["rate_hz"] == 30


def test_seeds_draw_scenes_that_planners_share(campaign: Path) -> None:
    """How near the mover comes depends on where it starts, and pure pursuit never leaves the line."""
    kept = rows_of(campaign)
    nearest = [kept[f"pure-pursuit-{seed}"]["metrics"]["min_dist_m"] for seed in SEEDS]
    assert nearest[0] != nearest[1]
    assert all(kept[f"{name}-{SEEDS[0]}"]["scene"] == kept[f"{PLANNERS[0]}-{SEEDS[0]}"]["scene"] for name in PLANNERS)
    assert all(row["wall_s"] > 0 for row in kept.values())
    assert all(
        set(row["stage_ms"]) == {"simulate", "cluster", "track", "predict", "plan"}
        and row["stage_ms"]["cluster"]["calls"] == row["stage_ms"]["track"]["calls"] > 15
        for row in kept.values()
    )


def test_the_report_pairs_the_planners(campaign: Path) -> None:
    document = json.loads((campaign / "report.json").read_text())
    assert json.loads((campaign.parent / "stdout.json").read_text()) == document, "--json prints the same, and only it"
    found = document["study"]
    assert found["against"] == "ad-cbf-mpc"
    assert list(found["planners"]) == list(PLANNERS)
    assert set(found["planners"]["pure-pursuit"]["measures"]) == {measure.name for measure in MEASURES}
    paired = found["planners"]["pure-pursuit"]["differences"]["min_dist_m"]
    kept = rows_of(campaign)
    near = {name: sum(kept[f"{name}-{seed}"]["metrics"]["min_dist_m"] for seed in SEEDS) / 2 for name in PLANNERS}
    assert paired["n_pairs"] == 2
    assert paired["value"] == pytest.approx(near["pure-pursuit"] - near["ad-cbf-mpc"])
    assert not found["planners"]["ad-cbf-mpc"]["differences"]
    text = (campaign / "report.md").read_text()
    assert "| ad-cbf-mpc | 2 | 100 %" in text
    assert "Scenario: tiny. Planners know what their own simulated LiDAR saw." in text


def test_two_processes_find_the_same(campaign: Path, tmp_path: Path) -> None:
    done = simulate(campaign.parent / "tiny.yaml", "--closed-loop", *CAMPAIGN, "-j", "2", "-o", tmp_path / "out")
    assert done.exit_code == 0, done.stderr
    assert untimed(tmp_path / "out") == untimed(campaign)


def test_only_what_is_missing_is_run(campaign: Path, tmp_path: Path) -> None:
    folder = again(campaign, tmp_path)
    lines = (folder / "runs.jsonl").read_text().splitlines(keepends=True)
    (folder / "runs.jsonl").write_text("".join(lines[:3]) + lines[3][:40])
    for name in RESULTS - {"runs.jsonl"}:
        (folder / name).unlink()
    done = simulate(tmp_path / "tiny.yaml", "--closed-loop", *CAMPAIGN, "-o", folder)
    assert done.exit_code == 0, done.stderr
    assert "2 of 4 runs are there already" in done.stderr
    assert untimed(folder) == untimed(campaign)
    before, after = rows_of(campaign), rows_of(folder)
    kept = [run for run, row in after.items() if row["wall_s"] == before[run]["wall_s"]]
    assert kept == list(before)[:2]


def test_fewer_seeds_are_reported_from_the_rows_that_are_there(campaign: Path, tmp_path: Path) -> None:
    folder = again(campaign, tmp_path)
    done = simulate(tmp_path / "tiny.yaml", "--closed-loop", "--seeds", "100002", "-o", folder)
    assert done.exit_code == 0, done.stderr
    assert "1 of 1 runs are there already" in done.stderr
    assert [(row["planner"], row["seed"]) for row in table_of(folder)] == [("ad-cbf-mpc", SEEDS[1])]
    assert len(rows_of(folder)) == 4


def test_another_setting_replaces_the_runs_and_nothing_else(collided: Path, tmp_path: Path) -> None:
    folder = again(collided, tmp_path)
    mine = [folder / "notes.txt", folder / "logs" / "mine.csv", folder / "logs" / "pure-pursuit-100001" / "view.json"]
    for path in mine:
        path.write_text("mine")
    options = ("--closed-loop", "--seeds", "100002", "-p", "pure-pursuit", "--knowledge", "perfect")
    done = simulate(tmp_path / "tiny.yaml", *options, "-o", folder)
    assert done.exit_code == 0, done.stderr
    assert "held runs of another scene, setting, --knowledge, --record or version; they are replaced" in done.stderr
    assert list(rows_of(folder)) == ["pure-pursuit-100002"]
    assert [row["knowledge"] for row in table_of(folder)] == ["perfect"]
    assert all(path.read_text() == "mine" for path in mine)
    left = [path for path in (folder / "logs").rglob("*") if path.is_file()]
    assert sorted(left) == sorted(mine[1:]), "the old runs' logs are gone"
    assert "Planners know everything, as it is." in (folder / "report.md").read_text()


def test_a_collision_is_told(collided: Path) -> None:
    (row,) = table_of(collided)
    assert (row["result"], row["hit_kind"], row["hit_object_id"], row["hit_moving"]) == (
        "collision",
        "cylinder",
        0,
        True,
    )
    assert row["collision"] == 1.0
    assert 0 < row["hit_at_s"] == row["duration_s"] < 5
    assert row["escape_exists"] is True
    assert row["min_dist_m"] < 0
    assert row["nav_time_s"] is None
    assert row["log"] == "logs/pure-pursuit-100001/run.mcap"
    assert json.loads((collided / "report.json").read_text())["study"]["scenes"]["way_exists"] == 1


def test_a_collision_is_written_out_as_a_log_that_can_be_replayed(collided: Path, tmp_path: Path) -> None:
    folder = collided / "logs" / "pure-pursuit-100001"
    assert {path.name for path in folder.iterdir()} == {
        *("run.mcap", "truth.csv", "route.csv", "scene.yaml", "run.yaml")
    }
    drawn = parse_scenario((collided.parent / "tiny.yaml").read_text(), "tiny", SEEDS[0])
    assert parse_scenario((folder / "scene.yaml").read_text(), "scene") == drawn
    arguments = ["replay", folder / "run.mcap", "--reference", folder / "route.csv", "--truth", folder / "truth.csv"]
    more = ["-p", "pure-pursuit", "-o", tmp_path / "run.adcbf", "--json"]
    done = adcbf(*arguments, *more)
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["route"]["length_m"] == pytest.approx(2.2)
    settings = adcbf("config", "dump", "--config", folder / "run.yaml")
    assert "range_m: 0.35" in settings.stdout, "those of the drive"


@pytest.mark.parametrize(("record", "options", "logs"), [("none", BLIND, 0), ("all", ("-p", "pure-pursuit"), 1)])
def test_what_is_recorded_is_asked_for(
    scene: Path, tmp_path: Path, record: str, options: tuple[str, ...], logs: int
) -> None:
    out = tmp_path / "out"
    done = simulate(scene, "--closed-loop", "--seed", "100001", *options, "--record", record, "-o", out)
    assert done.exit_code == 0, done.stderr
    (row,) = table_of(out)
    assert (row["result"] == "collision") is (record == "none")
    assert len(list(out.glob("logs/*/run.mcap"))) == logs
    assert (row["log"] is None) is (not logs)


def test_a_missed_threshold_is_exit_code_4_after_everything_is_written(collided: Path, tmp_path: Path) -> None:
    folder = again(collided, tmp_path)
    (folder / "report.md").unlink()
    command = (tmp_path / "tiny.yaml", "--closed-loop", "--seeds", "100001", *BLIND, "-o", folder)
    done = simulate(*command, "--fail-on", "simulate.pure-pursuit.collision>0", "--json")
    assert done.exit_code == 4
    assert "threshold missed: simulate.pure-pursuit.collision>0: it is 1" in done.stderr
    assert json.loads(done.stdout)["thresholds_missed"] == ["simulate.pure-pursuit.collision>0: it is 1"]
    assert (folder / "report.md").exists()
    assert simulate(*command, "--fail-on", "simulate.pure-pursuit.success>0").exit_code == 0


def test_runs_that_fail_are_named_and_tried_again(scene: Path, tmp_path: Path) -> None:
    """The ground of some scenes is too small for their route."""
    scene.write_text(SCENE.replace("size_m: 20", "size_m: {choice: [20, 4]}"), encoding="utf-8")
    sizes = {seed: parse_scenario(scene.read_text(), "tiny", seed).terrain.size_m for seed in range(100_000, 100_020)}
    good, bad = (next(seed for seed, size in sizes.items() if size == wanted) for wanted in (20, 4))
    out = tmp_path / "out"
    command = (scene, "--closed-loop", "--knowledge", "perfect", "-p", "pure-pursuit", "-o", out)
    done = simulate(*command, "--seeds", f"{good},{bad}")
    assert done.exit_code == 1
    assert "1 of 2 runs failed" in done.stderr
    told = {row["seed"]: (row["planner"], row["result"], row["error"]) for row in table_of(out)}
    assert told[good] == ("pure-pursuit", "success", None)
    assert told[bad][:2] == ("pure-pursuit", None)
    assert "leaves the terrain" in told[bad][2]
    study = json.loads((out / "report.json").read_text())["study"]
    assert [row["run"] for row in study["failed"]] == [f"pure-pursuit-{bad}"]
    assert study["planners"]["pure-pursuit"]["runs"] == 1
    done = simulate(*command, "--seeds", str(bad), "--against", "pure-pursuit")
    assert done.exit_code == 1, "and where none succeeds there is still a report"
    assert json.loads((out / "report.json").read_text())["study"]["planners"] == {}


BAD = [
    ((), "--seeds", ["--seeds", "0:2"]),
    ((), "--planner", ["-p", "ad-cbf-mpc"]),
    ((), "--set", ["--set", "planning.steps=20"]),
    ((), "--fail-on", ["--fail-on", "simulate.ad-cbf-mpc.collision>0"]),
    ((), "--jobs", ["--jobs", "2"]),
    (("--closed-loop",), "--record all", ["--truth", "truth.csv"]),
    (("--closed-loop",), "give one", ["--seed", "1", "--seeds", "1:2"]),
    (("--closed-loop",), "swift", ["-p", "swift"]),
    (("--closed-loop",), "perception, perfect", ["--knowledge", "x"]),
    (("--closed-loop",), "none, collisions, all", ["--record", "x"]),
    (("--closed-loop",), "dwa", ["--against", "dwa"]),
    (("--closed-loop",), "--seeds", ["--seeds", "3:3"]),
    (("--closed-loop",), "unknown metric", ["--fail-on", "simulate.dwa.collision>0"]),
    (("--closed-loop",), "planning.stepz", ["--set", "planning.stepz=1"]),
    (("--closed-loop",), "--jobs", ["--jobs", "0"]),
]


@pytest.mark.parametrize(("before", "told", "asked"), BAD, ids=[" ".join(asked) for _, _, asked in BAD])
def test_what_makes_no_sense_is_refused_before_anything_is_written(
    scene: Path, tmp_path: Path, before: tuple[str, ...], told: str, asked: list[str]
) -> None:
    done = simulate(scene, *before, *asked, "-o", tmp_path / "out")
    assert done.exit_code == 2, done.stderr
    assert told in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["tiny.yaml"]


def test_a_scene_without_a_route_is_refused(scene: Path, tmp_path: Path) -> None:
    ego = "ego: {path: {kind: stand, at_m: [0, 0]}}"
    scene.write_text(SCENE.replace("route: {points_m: [[0, 0], [2.2, 0]]}", ego), encoding="utf-8")
    done = simulate(scene, "--closed-loop", "-o", tmp_path / "out")
    assert done.exit_code == 2
    assert "has no route" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("there", "exit_code", "told"),
    [
        ("out", 2, "is a file"),
        ("out/report.md", 2, "would be overwritten"),
        ("out/run.json", 2, "run folder of a log"),
        ("out/runs.jsonl", 1, "not a file of runs"),
    ],
)
def test_what_is_there_already_is_left_alone(
    scene: Path, tmp_path: Path, there: str, exit_code: int, told: str
) -> None:
    path = tmp_path / there
    path.parent.mkdir(exist_ok=True)
    path.write_text("mine\n")
    done = simulate(scene, "--closed-loop", "-p", "pure-pursuit", "-o", tmp_path / "out")
    assert done.exit_code == exit_code, done.stderr
    assert told in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert path.read_text() == "mine\n"
    assert {found for found in tmp_path.rglob("*") if found.is_file()} == {scene, path}
