"""`--viz` as a user gives it: what is refused, what is said, and that the files are whole, the same, or absent."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from adcbf_cli.io.run_folder import RunFolder
from adcbf_cli.io.viz.scenes import show_of
from tests.commands.short_logs import write_short_log
from tests.io.viz.viz_runs import adcbf, rows

ALL = ("--viz", "foxglove", "--viz", "ros2", "--viz", "rrd")
FILES = ("viz.foxglove.mcap", "viz.foxglove-layout.json", "viz.ros2.mcap", "viz.rviz", "viz.rrd")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_short_log(tmp_path_factory.mktemp("log") / "short.mcap", scans=12)


@pytest.fixture(scope="module")
def run(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All views of a short log, made by the command that made the tables too. Tests that change it copy it first."""
    folder = tmp_path_factory.mktemp("run") / "short.adcbf"
    code, out, err = adcbf("run", log, "-o", folder, "--range", "12", "--json", *ALL)
    assert code == 0, err
    json.loads(out)
    for name in FILES:
        assert str(folder / name) in err
    return folder


def copied(run: Path, target: Path) -> Path:
    """The run, with the log beside it as before."""
    source = json.loads((run / "run.json").read_text())["source"]["path"]
    shutil.copytree(run, target / "run" / run.name)
    there = (target / "run" / run.name / source).resolve()
    there.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy((run / source).resolve(), there)
    return target / "run" / run.name


def digests(folder: Path) -> dict[str, str]:
    return {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in FILES}


def topics(path: Path) -> dict[str, int]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = summary.statistics.channel_message_counts
        return {channel.topic: counts[number] for number, channel in summary.channels.items()}


def test_the_same_run_gives_the_same_bytes(run: Path) -> None:
    before = digests(run)
    code, _, err = adcbf("predict", run, *ALL)
    assert code == 0, err
    assert "cluster, track, predict reused" in err
    assert digests(run) == before


def test_an_earlier_stage_shows_what_the_folder_holds(log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "short.adcbf"
    code, _, err = adcbf("cluster", log, "-o", folder, "--range", "12", "--viz", "foxglove")
    assert code == 0, err
    assert topics(folder / "viz.foxglove.mcap") == {"/tf": 12, "/cloud": 12, "/clusters": 12, "/driven": 4}
    code, _, err = adcbf("track", folder, "--viz", "foxglove")
    assert code == 0, err
    assert topics(folder / "viz.foxglove.mcap")["/tracks"] == 12
    assert "/predictions" not in topics(folder / "viz.foxglove.mcap")


@pytest.mark.parametrize("loss", ["gone", "changed", "no log", "an empty folder"])
def test_without_its_log_a_run_is_shown_without_points(loss: str, run: Path, tmp_path: Path) -> None:
    folder = copied(run, tmp_path)
    log = (folder / json.loads((folder / "run.json").read_text())["source"]["path"]).resolve()
    if loss == "gone":
        log.unlink()
    elif loss == "changed":
        log.write_bytes(log.read_bytes()[:-1])
    elif loss == "no log":
        log.write_bytes(b"nothing that a log begins with")
    else:
        log.unlink()
        log.mkdir()
    code, _, err = adcbf("predict", folder, *ALL)
    assert code == 0, err
    said = [line for line in err.splitlines() if "without the cloud" in line]
    assert len(said) == 1
    assert ("is gone" if loss == "gone" else "has changed") in said[0]
    for name in ("viz.foxglove.mcap", "viz.ros2.mcap"):
        whole = topics(run / name)
        assert topics(folder / name) == {topic: count for topic, count in whole.items() if topic != "/cloud"}


def test_a_cut_log_is_shown_up_to_the_damage(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    whole = log.read_bytes()
    cut.write_bytes(whole[: len(whole) * 2 // 3])
    code, _, err = adcbf("cluster", cut, "-o", tmp_path / "cut.adcbf", "--range", "12", "--viz", "foxglove")
    assert code == 3, err
    frames = rows(tmp_path / "cut.adcbf" / "frames.parquet")
    assert 0 < len(frames) < 12
    assert topics(tmp_path / "cut.adcbf" / "viz.foxglove.mcap")["/cloud"] == len(frames)


def test_views_of_what_is_computed_anew_are_removed(run: Path, tmp_path: Path) -> None:
    folder = copied(run, tmp_path)
    code, _, err = adcbf("track", folder, "--set", "tracking.max_coast_s=0.5")
    assert code == 0, err
    assert [name for name in FILES if (folder / name).exists()] == []


def test_a_vehicle_is_as_wide_as_it_was_driven(driven_run: Path, tmp_path: Path) -> None:
    """run.json is not written again where all tables stay valid."""
    folder = tmp_path / "people.adcbf"
    shutil.copytree(driven_run, folder)
    way = ("--start", "0,0", "--goal", "6,0", "-p", "pure-pursuit", "--set", "vehicle.body_radius_m=0.2")
    code, _, err = adcbf("replay", folder, *way)
    assert code == 0, err
    run = RunFolder(folder)
    show, _ = show_of(run, run.manifest())
    assert show.body_radius_m == {"replay": 0.2}


def test_a_damaged_table_leaves_no_view(run: Path, tmp_path: Path) -> None:
    folder = copied(run, tmp_path)
    for name in FILES:
        (folder / name).unlink()
    table = folder / "clusters.parquet"
    whole = table.read_bytes()
    table.write_bytes(whole[:200] + bytes(400) + whole[600:])  # its footer, and so its key, is as it was
    code, _, err = adcbf("predict", folder, *ALL)
    assert code == 1
    assert "clusters.parquet" in err
    assert sorted(path.name for path in folder.iterdir() if "viz" in path.name) == []


def test_an_object_list_has_no_points_and_nobody_complains(tmp_path: Path) -> None:
    log = tmp_path / "people.csv"
    lines = [f"{200_000_000 * k},1,Pedestrian,3.0,{0.16 * k - 2:.3f}" for k in range(20)]
    log.write_text("\n".join(["timestamp_ns,track_id,class,x_m,y_m", *lines]) + "\n")
    code, _, err = adcbf("predict", log, "-o", tmp_path / "people.adcbf", "--range", "8", "--viz", "foxglove")
    assert code == 0, err
    assert "without the cloud" not in err
    frames = len(rows(tmp_path / "people.adcbf" / "frames.parquet"))
    shown = topics(tmp_path / "people.adcbf" / "viz.foxglove.mcap")
    assert shown == {"/tf": frames, "/clusters": frames, "/tracks": frames, "/predictions": frames}


def test_times_that_no_viewer_reads_are_told(tmp_path: Path) -> None:
    log = tmp_path / "people.csv"
    lines = [f"{200_000_000 * (k - 5)},1,Pedestrian,3.0,0.0" for k in range(10)]
    log.write_text("\n".join(["timestamp_ns,track_id,class,x_m,y_m", *lines]) + "\n")
    code, _, err = adcbf("cluster", log, "-o", tmp_path / "people.adcbf", "--viz", "foxglove", "--viz", "ros2")
    assert code == 1
    assert "before 1970" in err
    assert not list((tmp_path / "people.adcbf").glob("*viz*"))


def test_an_unknown_viewer_is_refused_before_the_work(log: Path, tmp_path: Path) -> None:
    code, _, err = adcbf("run", log, "-o", tmp_path / "x.adcbf", "--viz", "rviz")
    assert code == 2
    assert err == "adcbf: error: --viz 'rviz': must be one of foxglove, ros2, rrd\n"
    assert not (tmp_path / "x.adcbf").exists()


def test_without_reruns_sdk_the_user_is_told_what_to_install(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)  # what importing it meets where it is not installed
    code, _, err = adcbf("run", log, "-o", tmp_path / "x.adcbf", "--viz", "rrd")
    assert code == 2
    assert "pip install 'adcbf[rerun]'" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "x.adcbf").exists()
