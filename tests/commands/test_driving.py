"""`plan`, `replay` and the scoring of drives, as a user would call them: real processes, real files."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from adcbf_cli.io.run_folder import DRIVING_FILES
from adcbf_cli.io.schemas import SCHEMAS

SAMPLE = Path(__file__).resolve().parents[2] / "sample_data"
ALL = (
    "mpc-dc", "mpc-cbf", "d-cbf-mpc", "a-cbf-mpc", "ad-cbf-mpc", "od-ad-cbf-mpc", "dwa", "apf", "pure-pursuit",
)  # fmt: skip
WAY = ("--start", "0,0", "--goal", "6,0", "--speed", "1", "--range", "8")


def adcbf(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "adcbf_cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, check=False)


def write_people(path: Path, **paths: tuple[tuple[float, float], tuple[float, float]]) -> Path:
    """An object list of 20 s at 5 Hz: each person at a start (m) with a velocity (m/s)."""
    rows = ["timestamp_ns,track_id,class,x_m,y_m"]
    for k in range(101):
        for number, ((x, y), (vx, vy)) in enumerate(paths.values()):
            t = 0.2 * k
            rows.append(f"{round(t * 1e9)},{number},Pedestrian,{x + vx * t:.4f},{y + vy * t:.4f}")
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def people(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One crosses in front, one stands beside the way."""
    path = tmp_path_factory.mktemp("log") / "people.csv"
    return write_people(path, crossing=((3.0, -4.0), (0.0, 0.8)), standing=((4.5, 1.2), (0.0, 0.0)))


@pytest.fixture(scope="module")
def replayed(people: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of all planners driving among the people."""
    folder = tmp_path_factory.mktemp("run") / "people.adcbf"
    done = adcbf("replay", people, "-o", folder, *WAY, "-p", "all", "--json")
    assert done.returncode == 0, done.stderr
    (folder / "stdout.json").write_text(done.stdout)
    return folder


def table(folder: Path, name: str) -> dict[str, list[object]]:
    return pq.read_table(folder / f"{name}.parquet").to_pydict()


def test_every_planner_drives(replayed: Path) -> None:
    drives = table(replayed / "replay", "drives")
    assert list(zip(drives["planner"], drives["seed"], strict=True)) == [(name, 0) for name in ALL]
    assert set(drives["result"]) <= {"success", "collision", "timeout"}
    ticks = dict(zip(zip(drives["planner"], drives["seed"], strict=True), drives["ticks"], strict=True))
    driven = table(replayed / "replay", "trajectories")
    keys = list(zip(driven["planner"], driven["seed"], strict=True))
    assert {key: keys.count(key) for key in ticks} == ticks


def test_a_predicting_planner_lets_the_crossing_person_pass(replayed: Path) -> None:
    found = json.loads((replayed / "stdout.json").read_text())["comparison"]["planners"]
    for name in ("d-cbf-mpc", "ad-cbf-mpc", "od-ad-cbf-mpc"):
        assert found[name]["metrics"]["success"]["value"] == 1.0
        assert found[name]["metrics"]["min_dist_m"]["value"] > 0.1


def test_what_is_driven_keeps_to_the_vehicle(replayed: Path) -> None:
    driven = table(replayed / "replay", "trajectories")
    drives = list(zip(driven["planner"], driven["seed"], strict=True))
    speed, turn, yaw = (np.array(driven[name], dtype=float) for name in ("speed_mps", "turn_input", "yaw_rad"))
    x, y = np.array(driven["x_m"]), np.array(driven["y_m"])
    period = 1 / 30
    same = np.array([a == b for a, b in zip(drives[1:], drives[:-1], strict=True)])
    assert (speed >= 0).all()
    assert (speed <= 1.0 + 1e-9).all()
    assert (np.abs(turn) <= 1.0 + 1e-9).all()
    assert np.abs(np.diff(speed)[same]).max() <= 1.0 * period + 1e-9
    assert np.abs(np.diff(turn)[same]).max() <= 3.0 * period + 1e-9
    half = 0.5 * turn * period
    step = speed * period * np.sinc(half / math.pi)
    np.testing.assert_allclose(np.diff(x)[same], (step * np.cos(yaw + half))[:-1][same], atol=1e-9)
    np.testing.assert_allclose(np.diff(y)[same], (step * np.sin(yaw + half))[:-1][same], atol=1e-9)


def test_clearance_is_the_distance_between_surfaces(replayed: Path) -> None:
    """By hand, from the people's straight paths: centre distance less both radii of 0.3 m."""
    driven = table(replayed / "replay", "trajectories")
    t = np.array(driven["timestamp_ns"]) / 1e9
    place = np.column_stack([driven["x_m"], driven["y_m"]])
    walker = np.column_stack([np.full(len(t), 3.0), -4.0 + 0.8 * t])
    stander = np.tile([4.5, 1.2], (len(t), 1))
    gap = np.min([np.hypot(*(place - who).T) for who in (walker, stander)], axis=0) - 0.6
    apart = gap > 0  # a touch between two ticks is told with its own depth
    np.testing.assert_allclose(np.array(driven["clearance_m"], dtype=float)[apart], gap[apart], atol=1e-3)
    assert apart.sum() > 1000


def test_stages_hold_barrier_and_gamma_of_each_plan(replayed: Path) -> None:
    stages = pq.read_table(replayed / "replay" / "plan_stages.parquet").to_pandas()
    one = stages[(stages.planner == "mpc-cbf") & (stages.seed == 0)]
    assert sorted(one.stage.unique()) == list(range(31))
    assert one.gamma.dropna().unique() == pytest.approx([0.1])
    adaptive = stages[(stages.planner == "ad-cbf-mpc") & (stages.seed == 0)].gamma.dropna()
    assert adaptive.min() >= 0.05
    assert adaptive.max() <= 1.0
    assert adaptive.nunique() > 10


def test_the_map_of_gamma_follows_eq_14(replayed: Path) -> None:
    found = pq.read_table(replayed / "replay" / "gamma.parquet").to_pandas()
    assert set(found.planner) == {"a-cbf-mpc", "ad-cbf-mpc", "od-ad-cbf-mpc"}
    row = found[(found.planner == "ad-cbf-mpc") & np.isclose(found.distance_m, 2.0) & np.isclose(found.radius_m, 0.4)]
    assert row.gamma.item() == pytest.approx(0.5), "A at the expected distance and radius"


def test_the_report_calls_itself_counterfactual(replayed: Path) -> None:
    text = (replayed / "replay" / "report.md").read_text()
    assert "Counterfactual" in text
    document = json.loads((replayed / "replay" / "report.json").read_text())
    assert document == json.loads((replayed / "stdout.json").read_text())
    assert document["mode"] == "closed loop"
    assert document["comparison"]["against"] == "mpc-dc", "the first"


def test_the_same_input_gives_the_same_bytes(replayed: Path, people: Path, tmp_path: Path) -> None:
    again = tmp_path / "people.adcbf"
    assert adcbf("replay", people, "-o", again, *WAY, "-p", "all").returncode == 0
    for name in DRIVING_FILES:
        if name.endswith(".parquet") and name != "solve_times.parquet":
            digests = [hashlib.sha256((f / "replay" / name).read_bytes()).hexdigest() for f in (replayed, again)]
            assert digests[0] == digests[1], name


def test_evaluate_scores_what_was_driven(replayed: Path) -> None:
    name = "replay.ad-cbf-mpc.path_length_m"
    done = adcbf("evaluate", replayed, "--json", "--fail-on", f"{name}>100", "--range", "8")
    assert done.returncode == 0, done.stderr
    scored = json.loads(done.stdout)["metrics"][name]
    direct = json.loads((replayed / "stdout.json").read_text())["comparison"]["planners"]["ad-cbf-mpc"]["metrics"]
    assert scored["value"] == pytest.approx(direct["path_length_m"]["value"])
    assert scored["n"] == 1
    missed = adcbf("evaluate", replayed, "--fail-on", f"{name}<100")
    assert missed.returncode == 4
    assert "threshold missed: replay.ad-cbf-mpc.path_length_m" in missed.stderr


def test_settings_of_another_version_are_told_in_one_line(replayed: Path, people: Path, tmp_path: Path) -> None:
    folder = tmp_path / people.with_suffix(".adcbf").name
    shutil.copytree(replayed, folder)
    shutil.copy(people, tmp_path / "people.csv")
    path = folder / "replay" / "drives.parquet"
    drives = pq.read_table(path)
    metadata = json.loads(drives.schema.metadata[b"adcbf"])
    del metadata["config"]["replay"]["near_m"]
    metadata["config"]["replay"]["nearness_m"] = 2.0
    pq.write_table(drives.replace_schema_metadata({b"adcbf": json.dumps(metadata).encode()}), path)
    done = adcbf("evaluate", folder, "--range", "8")
    assert done.returncode == 1, done.stderr
    assert "its settings are not this adcbf's; run `adcbf replay` again" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_drives_that_are_not_whole_are_left_out_and_told(people: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    assert adcbf("replay", people, "-o", folder, *WAY, "-p", "pure-pursuit").returncode == 0
    (folder / "replay" / "plans.parquet").unlink()
    done = adcbf("evaluate", folder, "--json")
    assert done.returncode == 0, done.stderr
    assert "replay/ is not whole" in done.stderr
    assert not [name for name in json.loads(done.stdout)["metrics"] if name.startswith("replay.")]


def test_seeds_start_alike_for_every_planner(people: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    done = adcbf("replay", people, "-o", folder, *WAY, "-p", "pure-pursuit", "-p", "apf", "--seeds", "0,3:5", "--json")
    assert done.returncode == 0, done.stderr
    driven = pq.read_table(folder / "replay" / "trajectories.parquet").to_pandas()
    first = driven[driven.tick == 0].set_index(["planner", "seed"])[["x_m", "y_m", "timestamp_ns"]]
    np.testing.assert_array_equal(first.loc["pure-pursuit"], first.loc["apf"])
    assert first.loc["apf"].index.tolist() == [0, 3, 4]
    assert (first.loc["apf"].loc[0] == [0.0, 0.0, 0]).all()
    assert first.loc["apf"].y_m.nunique() == 3
    pairs = json.loads(done.stdout)["comparison"]["planners"]["apf"]["differences"]["min_dist_m"]
    assert pairs["n_pairs"] == 3


def test_a_missed_threshold_ends_with_4(people: Path, tmp_path: Path) -> None:
    arguments = ("-o", tmp_path / "run", *WAY, "-p", "pure-pursuit", "--fail-on", "replay.pure-pursuit.path_length_m>1")
    done = adcbf("replay", people, *arguments)
    assert done.returncode == 4
    assert (tmp_path / "run" / "replay" / "report.json").is_file()


def test_new_predictions_clear_away_the_drives_of_the_old(people: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    assert adcbf("replay", people, "-o", folder, *WAY, "-p", "pure-pursuit").returncode == 0
    assert adcbf("predict", folder, "--steps", "20").returncode == 0
    assert not list((folder / "replay").iterdir())
    done = adcbf("evaluate", folder, "--json")
    assert not [name for name in json.loads(done.stdout)["metrics"] if name.startswith("replay.")]


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample log, planned along by two planners."""
    folder = tmp_path_factory.mktemp("plan") / "sample.adcbf"
    arguments = ("-o", folder, "--range", "12", "-t", SAMPLE / "truth.csv", "-p", "ad-cbf-mpc", "-p", "dwa")
    done = adcbf("plan", SAMPLE / "sample.mcap", *arguments)
    assert done.returncode == 0, done.stderr
    return folder


def test_plans_along_a_log_are_compared_with_what_its_vehicle_did(planned: Path) -> None:
    plans = pq.read_table(planned / "open_loop" / "plan_stages.parquet").to_pandas()
    one = plans[plans.planner == "ad-cbf-mpc"]
    assert one.tick.nunique() == 200
    assert one[one.stage == 0].plan_error_m.max() < 1e-6
    a_second_on = one[one.stage == 10].plan_error_m.dropna()
    assert len(a_second_on) == 190
    assert a_second_on.median() < 0.1, "the log's vehicle followed this very path at this speed"
    drives = table(planned / "open_loop", "drives")
    assert drives["planner"] == ["ad-cbf-mpc", "dwa", "logged"]
    assert drives["result"] == [None] * 3


def test_a_reference_of_the_users_own_is_followed(planned: Path, tmp_path: Path) -> None:
    route = tmp_path / "route.csv"
    route.write_text("x_m,y_m\n0,0\n3,0\n3,-2\n")
    done = adcbf("replay", planned, "--reference", route, "-p", "pure-pursuit", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["route"]["length_m"] == pytest.approx(5.0)
    assert document["comparison"]["planners"]["pure-pursuit"]["metrics"]["success"]["value"] == 1.0
    driven = table(planned / "replay", "trajectories")
    assert math.hypot(driven["x_m"][-1] - 3, driven["y_m"][-1] + 2) < 0.31  # type: ignore[operator]


BAD_CALLS = {
    "unknown planner": (("-p", "ad-cbf-mcp"), "did you mean ad-cbf-mpc"),
    "unknown solver": (("--solver", "gurobi"), "solver"),
    "unknown vehicle": (("--vehicle", "hovercraft"), "vehicle.kind"),
    "no horizon": (("--set", "planning.steps=0"), "planning.steps"),
    "unreachable limits": (("--speed", "5"), "vehicle reaches 1"),
    "bad seeds": (("--seeds", "3:x"), "--seeds"),
    "empty seeds": (("--seeds", "3:3"), "--seeds"),
    "bad start": (("--start", "1"), "--start"),
    "goal outside the map": (("--goal", "500,0"), "outside the map"),
    "goal and reference": (("--reference", "x.csv"), "give one"),
    "no reference": (("--reference", ""), "no such file"),
    "reference is a folder": (("--reference", "."), "no such file"),
    "goal at the start": (("--goal", "0,0"), "nothing to drive"),
    "no truth": (("--truth", ""), "folder"),
    "drives for days": (("--speed", "1e-5"), "planning steps"),
    "logged drive elsewhere": (("--against", "logged"), "the log's own vehicle"),
    "compare with nobody": (("--against", "dwa"), "--against"),
    "no barrier": (("--set", "planning.gamma_form=printed", "--set", "planning.gamma_floor=null"), "gamma is"),
    "printed barrier": (("--set", "planning.barrier_form=printed"), "class-K"),
    "unknown metric": (("--fail-on", "replay.ad-cbf-mpc.colision>0"), "did you mean replay.ad-cbf-mpc.collision"),
}


@pytest.mark.parametrize("case", BAD_CALLS)
def test_what_cannot_be_meant_is_told_in_one_line(people: Path, tmp_path: Path, case: str) -> None:
    extra, words = BAD_CALLS[case]
    way = [] if "--reference" in extra and case != "goal and reference" else WAY
    done = adcbf("replay", people, "-o", tmp_path / "run", *way, *extra)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert not (tmp_path / "run" / "replay").exists()


def test_a_route_needs_two_points(people: Path, tmp_path: Path) -> None:
    route = tmp_path / "route.csv"
    route.write_text("x_m,y_m\n1,1\n")
    done = adcbf("replay", people, "-o", tmp_path / "run", "--start", "0,0", "--reference", route)
    assert done.returncode == 2
    assert "single point" in done.stderr


def test_where_nothing_drove_there_is_no_state_to_plan_from(people: Path, tmp_path: Path) -> None:
    done = adcbf("plan", people, "-o", tmp_path / "run", "--goal", "6,0")
    assert done.returncode == 2
    assert "no vehicle drove here" in done.stderr


def test_a_sensor_that_stood_needs_no_pose(tmp_path: Path) -> None:
    """A log without poses is driven through as it was seen, from where the user says to where the user says."""
    log = SAMPLE / "sample.mcap"
    way = ("--start", "0,0", "--goal", "0.5,0.5", "-p", "pure-pursuit")
    done = adcbf("replay", log, "-o", tmp_path / "run", "--pose", "none", *way, "--json")
    assert done.returncode == 0, done.stderr
    metrics = json.loads(done.stdout)["comparison"]["planners"]["pure-pursuit"]["metrics"]
    assert metrics["success"]["value"] == 1.0
    assert metrics["diverged_share"]["value"] is None, "the log's vehicle was nowhere"
    planned = adcbf("plan", tmp_path / "run")
    assert planned.returncode == 2
    assert "no vehicle drove here" in planned.stderr


def test_without_predictions_there_is_nothing_to_plan_around(tmp_path: Path) -> None:
    listing = tmp_path / "glimpse.csv"
    listing.write_text("timestamp_ns,track_id,x_m,y_m\n0,1,0,0\n100000000,1,0,0\n")
    done = adcbf("replay", listing, "-o", tmp_path / "run", *WAY)
    assert done.returncode == 1
    assert "no predictions" in done.stderr


def test_obstacles_that_are_no_numbers_are_refused(people: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    assert adcbf("predict", people, "-o", folder, "--range", "8").returncode == 0
    path = folder / "predictions.parquet"
    whole = pq.read_table(path)
    x = whole["x_m"].to_pylist()
    x[40] = None
    pq.write_table(whole.set_column(whole.schema.get_field_index("x_m"), "x_m", pa.array(x, pa.float64())), path)
    assert pq.read_schema(path).equals(SCHEMAS["predictions"])
    done = adcbf("replay", folder, *WAY)
    assert done.returncode == 1, done.stderr
    assert "predictions" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list((folder / "replay").glob("*")) if (folder / "replay").exists() else True
