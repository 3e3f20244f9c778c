"""`adcbf report`: what the page says is what the run folder holds, and nothing is loaded from elsewhere."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.io.figures.of_run import drawn_drives
from adcbf_cli.io.html_report import gather
from adcbf_cli.io.report import number
from tests.commands.conftest import run_here
from tests.io.conftest import LogMaker


@pytest.fixture(scope="module")
def make() -> LogMaker:
    return LogMaker()


class Page(HTMLParser):
    """The parts of a page that tests look at."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, list[str]] = {}
        self._open: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if self._open:
            self.texts.setdefault(self._open[-1], []).append(data)

    @property
    def data(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.texts["script"][0])
        return found


@pytest.fixture(scope="module")
def page(driven_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "people.html"
    done = run_here("report", driven_run, "-o", path, "--no-figures")
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{path}\n"
    return path


def test_nothing_is_loaded_from_elsewhere(page: Path) -> None:
    found = Page(page)
    for tag, attributes in found.elements:
        assert not {"src", "srcset", "action", "style", "onclick"} & attributes.keys(), (tag, attributes)
        assert attributes.get("href", "#").startswith("#"), (tag, attributes)
    style = "".join(found.texts["style"])
    assert "url(" not in style
    assert "@import" not in style


def test_only_the_pages_own_script_and_style_may_run(page: Path) -> None:
    found = Page(page)
    policy = next(a["content"] for t, a in found.elements if t == "meta" and a.get("http-equiv"))
    assert policy is not None
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    for tag, text in (("script", found.texts["script"][-1]), ("style", found.texts["style"][0])):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy


def test_the_scene_is_the_tables_to_the_millimetre(page: Path, driven_run: Path) -> None:
    run = Page(page).data["runs"][0]
    scene, origin = run["scene"], np.array(run["scene"]["origin_m"])
    frames = pq.read_table(driven_run / "frames.parquet").to_pandas()
    assert [frame["frame"] for frame in scene["shown"]] == frames["frame_index"].tolist()
    tracks = pq.read_table(driven_run / "tracks.parquet").to_pandas()
    alive = tracks[tracks["status"] != "ended"]
    shown = np.array([[f["frame"], *t[:1], *t[2:6], t[9]] for f in scene["shown"] for t in f["tracks"]], dtype=float)
    np.testing.assert_array_equal(shown[:, :2], alive[["frame_index", "track_id"]])
    np.testing.assert_allclose(shown[:, 2:4] / 1000 + origin, alive[["x_m", "y_m"]], atol=0.00051)
    np.testing.assert_allclose(shown[:, 4:6] / 1000, alive[["vx_mps", "vy_mps"]], atol=0.00051)
    np.testing.assert_allclose(shown[:, 6] / 1000, alive["radius_m"], atol=0.00051)


def test_predictions_are_those_of_the_named_steps(page: Path, driven_run: Path) -> None:
    scene = Page(page).data["runs"][0]["scene"]
    origin = np.array(scene["origin_m"])
    table = pq.read_table(driven_run / "predictions.parquet").to_pandas()
    table = table.set_index(["frame_index", "track_id", "step"]).sort_index()
    assert scene["steps"][-1] == table.index.get_level_values("step").max()
    checked = 0
    for frame in scene["shown"]:
        for track, *flat in frame["predictions"]:
            steps = scene["steps"] if len(flat) > 5 else scene["steps"][-1:]
            for step, (x, y, xx, xy, yy) in zip(steps, np.reshape(flat, (-1, 5)), strict=True):
                row = table.loc[(frame["frame"], track, step)]
                assert np.array([x, y]) / 1e3 + origin == pytest.approx([row.x_m, row.y_m], abs=0.00051)
                expected = [row.cov_xx_m2, row.cov_xy_m2, row.cov_yy_m2]
                assert [xx / 1e6, xy / 1e6, yy / 1e6] == pytest.approx(expected, abs=5.1e-7)
                checked += 1
    assert checked > 100


def test_drives_are_the_tables_and_end_where_they_ended(page: Path, driven_run: Path) -> None:
    run = Page(page).data["runs"][0]
    group, origin = run["drives"][0], np.array(run["scene"]["origin_m"])
    ticks = pq.read_table(driven_run / "replay" / "trajectories.parquet").to_pandas()
    results = pq.read_table(driven_run / "replay" / "drives.parquet").to_pylist()
    assert len(group["drives"]) == len(results) == 4
    for drive, entry in zip(group["drives"], results, strict=True):
        mine = ticks[(ticks.planner == entry["planner"]) & (ticks.seed == entry["seed"])]
        assert (drive["planner"], drive["seed"], drive["result"]) == (
            entry["planner"],
            entry["seed"],
            entry["result"],
        )
        assert drive["ticks"] == len(mine)
        assert min(c for c in drive["clearance_mm"] if c is not None) == round(mine.clearance_m.min() * 1000)
        end = np.array([drive["x_mm"][-1], drive["y_mm"][-1]]) / 1e3 + origin
        assert end == pytest.approx(mine[["x_m", "y_m"]].to_numpy()[-1], abs=0.00051)
    route = np.reshape(group["route"]["xy_mm"], (-1, 2)) / 1e3 + origin
    assert route == pytest.approx(np.array([[0, 0], [6, 0]]))


def test_every_planner_stands_in_the_table_with_its_interval(page: Path, driven_run: Path) -> None:
    text = page.read_text()
    planners = json.loads((driven_run / "replay" / "report.json").read_text())["comparison"]["planners"]
    for name, found in planners.items():
        assert f"{name} ({found['drives']} drive" in text
        total = found["metrics"]["success"]
        low, high = total["interval_95"]
        assert f"{number(low)} to {number(high)}" in text
        assert number(found["metrics"]["min_dist_m"]["value"]) in text


def test_a_page_shows_what_its_reports_were_made_with(driven_run: Path, tmp_path: Path) -> None:
    """run.json is not written again where all tables stay valid; and plans are stored of the first seed given."""
    copy = tmp_path / "copy.adcbf"
    shutil.copytree(driven_run, copy)
    way = ("--start", "0,0", "--goal", "6,0", "--speed", "1", "-p", "ad-cbf-mpc", "--seeds", "3,1")
    done = run_here("replay", copy, *way, "--set", "vehicle.body_radius_m=0.2")
    assert done.returncode == 0, done.stderr
    page = gather.gather_run(copy, "people", gather.Wishes(), lambda items, *_: iter(items))
    settings = dict(page.settings)
    assert settings["vehicle.body_radius_m (replay)"] == "0.2"
    assert settings["perception.range_m"] == "8.0"
    assert not [key for key in settings if key.startswith("evaluation.")]
    (group,) = page.data["drives"]
    assert group["shown_seeds"] == [3, 1]
    assert {drive["seed"] for drive in group["drives"] if drive["plans"] is not None} == {3}
    shown = drawn_drives({"run": page.data})
    assert shown is not None
    assert [drive["seed"] for drive in shown.drives] == [3]
    frames = json.loads(pq.read_schema(copy / "frames.parquet").metadata[b"adcbf"])
    assert ("adcbf", frames["adcbf"]) in page.about


def test_what_is_missing_names_the_command_that_makes_it(driven_run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "a copy.adcbf"
    shutil.copytree(driven_run, copy)
    shutil.rmtree(copy / "replay")
    (copy / "report.json").unlink()
    done = run_here("report", copy, "--json", "--no-figures")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    missing = {entry["section"]: entry["command"] for entry in document["runs"][0]["missing"]}
    assert missing["replay"] == f"adcbf replay '{copy}' --start X,Y --goal X,Y -p all --seeds 0:20"
    assert missing["plan"] is None, "without the vehicle's poses there is no open loop"
    assert missing["scores"] == f"adcbf evaluate '{copy}' --truth FILE"
    text = (copy / "report.html").read_text()
    assert f"adcbf replay &#39;{copy}&#39;" in text
    assert Page(copy / "report.html").data["runs"][0]["drives"] == []


def test_drives_of_other_predictions_are_not_shown(driven_run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.adcbf"
    shutil.copytree(driven_run, copy)
    manifest = json.loads((copy / "run.json").read_text())
    for stage in manifest["stages"].values():
        stage["key"] = "0" * 64
    (copy / "run.json").write_text(json.dumps(manifest))
    done = run_here("report", copy)
    assert done.returncode == 1
    assert "no finished stage" in done.stderr
    assert not (copy / "report.html").exists()


def test_the_same_runs_give_the_same_bytes(page: Path, driven_run: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.html"
    assert run_here("report", driven_run, "-o", again, "--no-figures").returncode == 0
    assert again.read_bytes() == page.read_bytes()


def test_what_a_log_names_cannot_become_markup(driven_run: Path, tmp_path: Path) -> None:
    """Names and texts of a run come from files that anybody may have made."""
    copy = tmp_path / "<img src=x onerror=alert(1)>.adcbf"
    shutil.copytree(driven_run, copy)
    evil = "</script><script>alert(2)</script><b title='\"&"
    manifest = json.loads((copy / "run.json").read_text())
    manifest["stages"]["track"]["warnings"] = [evil]
    manifest["selection"]["reasons"] = [evil]
    (copy / "run.json").write_text(json.dumps(manifest))
    page = tmp_path / "evil.html"
    done = run_here("report", copy, "-o", page, "--no-figures")
    assert done.returncode == 0, done.stderr
    found = Page(page)
    assert not [attributes for tag, attributes in found.elements if tag == "img"]
    assert len([tag for tag, _ in found.elements if tag == "script"]) == 2
    assert f" {evil}" in found.texts["li"]
    assert found.data["runs"][0]["name"] == copy.name


def test_two_runs_stand_side_by_side(driven_run: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.adcbf"
    shutil.copytree(driven_run, other)
    page = tmp_path / "both.html"
    assert run_here("report", driven_run, other, "-o", page, "--no-figures").returncode == 0
    found = Page(page)
    assert [run["name"] for run in found.data["runs"]] == ["people.adcbf", "other.adcbf"]
    assert len([1 for tag, a in found.elements if tag == "figure" and a.get("class") == "scene"]) == 2


def test_figures_lie_in_a_folder_of_the_pages_own(driven_run: Path, tmp_path: Path) -> None:
    """`figures/` beside a page may be a paper's."""
    papers = [tmp_path / "figures" / name for name in ("margins.svg", "planners.png")]
    papers[0].parent.mkdir()
    for path in papers:
        path.write_text("a paper's own")
    done = run_here("report", driven_run, "-o", tmp_path / "people.html", "--json")
    assert done.returncode == 0, done.stderr
    drawn = [Path(path) for path in json.loads(done.stdout)["figures"]]
    names = {"top_view", "margins", "solve_times", "gamma_map", "calibration", "planners"}
    assert {(path.parent, path.stem, path.suffix) for path in drawn} == {
        (tmp_path / "people.figures", name, suffix) for name in names for suffix in (".svg", ".png")
    }
    for path in drawn:
        head = path.read_bytes()[:8]
        assert head == b"\x89PNG\r\n\x1a\n" if path.suffix == ".png" else head.startswith(b"<?xml")
    assert {path.read_text() for path in papers} == {"a paper's own"}


def test_figures_without_evidence_are_not_drawn_and_old_ones_leave(driven_run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.adcbf"
    shutil.copytree(driven_run, copy)
    assert run_here("report", copy).returncode == 0
    assert (copy / "figures" / "margins.svg").exists()
    shutil.rmtree(copy / "replay")
    assert run_here("report", copy).returncode == 0
    left = {path.stem for path in (copy / "figures").iterdir()}
    assert left == {"top_view", "calibration"}


def test_a_page_of_outdated_tables_does_not_stay(driven_run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.adcbf"
    shutil.copytree(driven_run, copy)
    other = tmp_path / "other.adcbf"
    shutil.copytree(driven_run, other)
    assert run_here("report", copy, other).returncode == 0
    assert (copy / "figures" / "other.adcbf" / "top_view.svg").exists()
    assert run_here("track", copy, "--set", "tracking.confirm_hits=4").returncode == 0
    assert not (copy / "report.html").exists()
    assert not (copy / "figures").exists()


@pytest.mark.parametrize("command", [["evaluate"], ["replay", "--start", "0,0", "--goal", "6,0", "-p", "pure-pursuit"]])
def test_a_page_of_other_results_does_not_stay(command: list[str], driven_run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.adcbf"
    shutil.copytree(driven_run, copy)
    assert run_here("report", copy).returncode == 0
    own = copy / "figures" / "mine.svg"
    own.write_text("kept by hand")
    done = run_here(command[0], copy, *command[1:])
    assert done.returncode == 0, done.stderr
    assert not (copy / "report.html").exists()
    assert list((copy / "figures").iterdir()) == [own]


def test_a_run_that_is_too_large_is_thinned_and_says_so(driven_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = gather.gather_run(driven_run, "people", gather.Wishes(), lambda items, *_: iter(items))
    size = len(json.dumps(whole.data, separators=(",", ":")))
    monkeypatch.setattr(gather, "PAGE_BYTES", size - 1)
    thinned = gather.gather_run(driven_run, "people", gather.Wishes(), lambda items, *_: iter(items))
    assert len(json.dumps(thinned.data, separators=(",", ":"))) < size
    assert thinned.data["scene"]["shown"] == whole.data["scene"]["shown"][::2]
    assert "top view: one in 2 of 121 scans" in thinned.thinned
    assert thinned.data["scene"]["lives"] == whole.data["scene"]["lives"]


def test_points_from_the_log_are_those_that_would_be_stored(tmp_path: Path, make: LogMaker) -> None:
    log = make.mcap(tmp_path / "drive.mcap", make.drive(scans=12, padding=30))
    stored, read = tmp_path / "stored.adcbf", tmp_path / "read.adcbf"
    assert run_here("cluster", log, "-o", stored, "--range", "20", "--labels").returncode == 0
    assert run_here("cluster", log, "-o", read, "--range", "20").returncode == 0
    scenes = []
    for folder in (stored, read):
        run = gather.gather_run(folder, "drive", gather.Wishes(), lambda items, *_: iter(items))
        assert "points" not in run.missing
        assert run.missing["tracks"] == ("no tracks were made", f"adcbf track {folder}")
        scenes.append(run.data["scene"]["shown"])
    assert scenes[0] == scenes[1]
    assert sum(len(frame.get("points", ())) for frame in scenes[0]) > 0
    for what, says in ((None, "no longer where it was"), (b"no log", "has changed"), (b"", "has changed")):
        log.unlink(missing_ok=True)
        if what is not None:
            log.write_bytes(what)
        gone = gather.gather_run(read, "drive", gather.Wishes(), lambda items, *_: iter(items))
        assert says in gone.missing["points"][0]
    log.unlink()
    log.mkdir()
    emptied = gather.gather_run(read, "drive", gather.Wishes(), lambda items, *_: iter(items))
    assert "has changed" in emptied.missing["points"][0]


def test_runs_of_the_same_name_are_told_apart(driven_run: Path, tmp_path: Path) -> None:
    twin = tmp_path / "other" / driven_run.name
    shutil.copytree(driven_run, twin)
    done = run_here("report", driven_run, twin, "-o", tmp_path / "both.html", "--json")
    assert done.returncode == 0, done.stderr
    names = [run["name"] for run in Page(tmp_path / "both.html").data["runs"]]
    assert names == [str(driven_run), str(twin)]
    drawn = json.loads(done.stdout)["figures"]
    assert len(set(drawn)) == len(drawn) == 24
    assert all(Path(path).is_file() for path in drawn)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere.adcbf"], "not a run folder"),
        (["RUN", "RUN"], "given twice"),
        (["RUN", "-o", "missing/page.html"], "there is no folder"),
        (["RUN", "-o", "run.json"], "run.json: a page's name ends in .html"),
        (["RUN", "-o", "drive.mcap"], "drive.mcap: a page's name ends in .html"),
    ],
)
def test_bad_input_is_one_line(arguments: list[str], says: str, driven_run: Path) -> None:
    done = run_here("report", *[str(driven_run) if word == "RUN" else word for word in arguments])
    assert done.returncode == 2
    assert says in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_a_damaged_report_is_named(driven_run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.adcbf"
    shutil.copytree(driven_run, copy)
    for content in ('{"schema_version": 1, "metrics": {"a": 3}}', "not json", '{"schema_version": 7}'):
        (copy / "report.json").write_text(content)
        done = run_here("report", copy)
        assert done.returncode == 1
        assert "report.json" in done.stderr
        assert "adcbf evaluate" in done.stderr
        assert done.stderr.count("\n") == 1


def test_an_interval_without_ends_is_none(driven_run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.adcbf"
    shutil.copytree(driven_run, copy)
    report = json.loads((copy / "report.json").read_text())
    for metric in report["metrics"].values():
        metric["interval_95"] = [None, None]
    (copy / "report.json").write_text(json.dumps(report))
    done = run_here("report", copy)
    assert done.returncode == 0, done.stderr
    points = Page(copy / "report.html").data["runs"][0]["calibration"]
    assert {point["interval"] for point in points} == {None}


def test_a_score_without_evidence_is_a_dash() -> None:
    from adcbf_cli.io.html_report.evidence import score_cell

    none = Metric(None, "m", 0, "prediction", "nothing").to_dict()
    assert score_cell(none).text == "-"
    assert score_cell(Metric(0.0, "m", 3, "prediction", "nothing").to_dict()).text == "0"
