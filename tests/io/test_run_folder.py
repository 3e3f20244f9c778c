"""What a run folder may be trusted with: keys, manifest, lock."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

import pytest

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.types import Loss
from adcbf_cli.io.parquet import TableWriter
from adcbf_cli.io.run_folder import (
    STAGES,
    Manifest,
    OutdatedRunError,
    RunFolder,
    Source,
    SourceFile,
    StageRecord,
    identify_source,
    stage_keys,
)
from adcbf_cli.io.settings import resolve_config

SOURCE = Source("../log.mcap", "ab" * 32, (SourceFile("log.mcap", 3, "cd" * 32),))


def manifest(stages: dict[str, StageRecord] | None = None) -> Manifest:
    return Manifest(SOURCE, {"lidar": ["/points"]}, Config(), stages or {})


def test_the_manifest_comes_back_as_it_went(tmp_path: Path) -> None:
    record = StageRecord("k", {"frames": 2, "clusters": 9}, ["careful"], [Loss("chunk", 3)], {"repaired": 1})
    folder = RunFolder(tmp_path)
    folder.write_manifest(manifest({"cluster": record}))
    assert folder.manifest() == manifest({"cluster": record})


@pytest.mark.parametrize(
    ("stage", "setting", "changed"),
    [
        ("cluster", "perception.range_m=20", {"cluster", "track", "predict"}),
        ("cluster", "read.deskew=false", {"cluster", "track", "predict"}),
        ("track", "tracking.filter=ekf", {"track", "predict"}),
        ("predict", "prediction.steps=7", {"predict"}),
        ("evaluate", "evaluation.match_m=3", set()),
    ],
)
def test_a_setting_changes_its_stage_and_what_follows(stage: str, setting: str, changed: set[str]) -> None:
    before = stage_keys("input", Config(), None)
    after = stage_keys("input", resolve_config(Config(), settings=[setting], environment={}), None)
    assert {name for name in STAGES if before[name] != after[name]} == changed


def test_input_and_calibration_are_part_of_the_key() -> None:
    keys = stage_keys("input", Config(), None)
    assert all(keys[s] != stage_keys("other", Config(), None)[s] for s in STAGES)
    calibrated = stage_keys("input", Config(), "{}")
    assert [s for s in STAGES if keys[s] != calibrated[s]] == ["predict"]


def test_only_a_whole_stage_under_the_right_key_is_valid(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    assert not folder.has_valid("cluster", "k")
    for name in ("frames", "clusters"):
        with TableWriter(folder.table(name), name, {"key": "k"}):
            pass
    assert not folder.has_valid("cluster", "k"), "the manifest does not list it yet"
    folder.write_manifest(manifest({"cluster": StageRecord("k", {})}))
    assert folder.has_valid("cluster", "k")
    assert not folder.has_valid("cluster", "other")
    with TableWriter(folder.table("clusters"), "clusters", {"key": "other"}):
        pass
    assert not folder.has_valid("cluster", "k"), "one table is from another run"
    folder.table("clusters").write_bytes(folder.table("frames").read_bytes()[:-20])
    assert not folder.has_valid("cluster", "k"), "one table is cut short"


def test_a_log_of_one_file_is_known_by_its_own_sha256(tmp_path: Path) -> None:
    """Whatever it is called and wherever it lies: what `sha256sum` says can be compared with what is printed."""
    for place in ("here/a.mcap", "there/b.mcap"):
        file = tmp_path / place
        file.parent.mkdir()
        file.write_bytes(b"abc")
        assert identify_source(place, (file,)).sha256 == hashlib.sha256(b"abc").hexdigest()


def test_several_files_are_known_by_names_and_contents(tmp_path: Path) -> None:
    """The names of scans say when they were taken, so that they are part of what is recorded."""

    def known(place: str, **files: str) -> str:
        (tmp_path / place).mkdir()
        paths = [tmp_path / place / f"{name}.pcd" for name in files]
        for path, text in zip(paths, files.values(), strict=True):
            path.write_text(text)
        return identify_source(place, tuple(paths)).sha256

    assert known("here", a="1", b="2") == known("there", a="1", b="2")
    assert len({known("w", a="1", b="2"), known("x", a="1", b="3"), known("y", a="1", c="2"), known("z", a="12")}) == 4
    assert known("one", a="1") != known("other", b="1")


@pytest.mark.parametrize("text", ["", "{}", "[]", "not json", '{"schema_version": 1}'])
def test_an_unreadable_manifest_is_one_clear_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(AdcbfError, match=r"run\.json: unreadable .*remove the folder") as error:
        RunFolder(tmp_path).manifest()
    assert "\n" not in str(error.value)
    assert "indices" not in str(error.value), "not in Python's words"


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (('"match_m"', '"match_far_m"'), "evaluation.match_far_m"),
        (('"schema_version": 1', '"schema_version": 99'), "schema version 99"),
    ],
)
def test_another_versions_run_is_made_anew_from_the_log(tmp_path: Path, edit: tuple[str, str], words: str) -> None:
    folder = RunFolder(tmp_path)
    folder.write_manifest(manifest({"cluster": StageRecord("k", {"frames": 2})}))
    path = tmp_path / "run.json"
    path.write_text(path.read_text().replace(*edit))
    with pytest.raises(OutdatedRunError, match=f"{words}.*run on the log itself") as error:
        folder.manifest()
    assert "\n" not in str(error.value)
    assert folder.usable_manifest() is None
    assert not folder.has_valid("cluster", "k")


@pytest.mark.parametrize(
    ("old", "new"), [('"path": "../log.mcap"', '"path": 5'), ('"selection": {', '"selection": 1, "else": {')]
)
def test_a_manifest_edited_into_nonsense_is_one_clear_line(tmp_path: Path, old: str, new: str) -> None:
    RunFolder(tmp_path).write_manifest(manifest())
    path = tmp_path / "run.json"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(AdcbfError, match="unreadable"):
        RunFolder(tmp_path).manifest()


def test_no_manifest_is_no_run_folder(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="not a run folder"):
        RunFolder(tmp_path).manifest()


def test_a_file_is_no_run_folder_and_is_not_to_be_removed(tmp_path: Path) -> None:
    (tmp_path / "log.mcap").touch()
    with pytest.raises(UsageError, match=r"log\.mcap: not a run folder"):
        RunFolder(tmp_path / "log.mcap").manifest()


def test_two_writers_do_not_mix(tmp_path: Path) -> None:
    code = f"""
from pathlib import Path
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.run_folder import RunFolder
try:
    with RunFolder(Path({str(tmp_path / "run")!r})).locked():
        print("in")
except AdcbfError as error:
    print(error)
"""
    with RunFolder(tmp_path / "run").locked():
        second = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert "another adcbf is writing here" in second.stdout
    third = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert third.stdout == "in\n"


def test_what_a_killed_writer_left_is_cleared(tmp_path: Path) -> None:
    leftover = tmp_path / ".tracks.parquet.123.partial"
    leftover.write_bytes(b"half")
    with RunFolder(tmp_path).locked():
        assert not leftover.exists()


def test_a_file_in_the_folder_s_place(tmp_path: Path) -> None:
    (tmp_path / "run").write_text("")
    with pytest.raises(UsageError, match="in the way"), RunFolder(tmp_path / "run").locked():
        pass


def test_a_folder_that_nothing_came_of_does_not_stay(tmp_path: Path) -> None:
    new, old = tmp_path / "new", tmp_path / "old"
    old.mkdir()
    for folder in (new, old):
        with pytest.raises(ZeroDivisionError), RunFolder(folder).locked():
            raise ZeroDivisionError
    assert not new.exists()
    assert old.exists(), "somebody else's"
    with RunFolder(new).locked():
        (new / "result").touch()
    assert (new / "result").exists()
