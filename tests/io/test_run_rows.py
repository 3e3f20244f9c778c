"""Rows of finished runs: what a killed process leaves, other keys, other files, other processes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.run_rows import RunRows

ROWS = {"7/calm": {"seed": 7, "time_s": 0.1 + 0.2, "path": None}, "8/calm": {"seed": 8, "ids": [1, 2]}}


def written(folder: Path, key: str = "k") -> Path:
    with RunRows(folder, "runs", key) as rows:
        for run_id, row in ROWS.items():
            rows.add(run_id, row)
    return folder / "runs.jsonl"


def test_rows_come_back_as_they_were_added(tmp_path: Path) -> None:
    path = written(tmp_path / "a" / "b")
    with RunRows(path.parent, "runs", "k") as rows:
        assert rows.opened == "kept"
        assert rows.done == ROWS
        rows.add("9/calm", {"seed": 9})
    header, *lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert header == {"key": "k", "schema_version": 1}
    assert [line["run"] for line in lines] == ["7/calm", "8/calm", "9/calm"]


def test_a_row_is_on_disk_before_add_returns(tmp_path: Path) -> None:
    with RunRows(tmp_path, "runs", "k") as rows:
        rows.add("1", {"a": 1})
        assert json.loads((tmp_path / "runs.jsonl").read_text().splitlines()[-1]) == {"run": "1", "row": {"a": 1}}


def test_what_add_returns_is_what_will_be_read(tmp_path: Path) -> None:
    with RunRows(tmp_path, "runs", "k") as rows:
        now = rows.add("1", {"pair": (1, 2.5), "by_id": {3: "x"}})
        assert rows.done["1"] == now
    with RunRows(tmp_path, "runs", "k") as rows:
        assert rows.done["1"] == now == {"pair": [1, 2.5], "by_id": {"3": "x"}}


def test_a_later_row_replaces_a_run_s_earlier_one(tmp_path: Path) -> None:
    path = written(tmp_path)
    with RunRows(tmp_path, "runs", "k") as rows:
        rows.add("7/calm", {"seed": 7, "again": True})
    with RunRows(tmp_path, "runs", "k") as rows:
        assert rows.done == ROWS | {"7/calm": {"seed": 7, "again": True}}
        assert list(rows.done) == ["7/calm", "8/calm"]
    assert len(path.read_text().splitlines()) == 4


def test_cut_anywhere_the_whole_rows_before_the_cut_stay(tmp_path: Path) -> None:
    whole = written(tmp_path).read_bytes()
    ends = [index + 1 for index, byte in enumerate(whole) if byte == ord("\n")]
    for cut in range(len(whole) + 1):
        (tmp_path / "runs.jsonl").write_bytes(whole[:cut])
        kept = sum(end <= cut for end in ends[1:])
        with RunRows(tmp_path, "runs", "k") as rows:
            assert rows.opened == ("kept" if cut >= ends[0] else "new")
            assert rows.done == dict(list(ROWS.items())[:kept])
            rows.add("after", {"cut": cut})
        with RunRows(tmp_path, "runs", "k") as rows:
            assert rows.done["after"] == {"cut": cut}
            assert len(rows.done) == kept + 1


def test_a_last_line_of_noise_is_cut_off_too(tmp_path: Path) -> None:
    path = written(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(whole + b"\0" * 40 + b"\n")
    with RunRows(tmp_path, "runs", "k") as rows:
        assert rows.done == ROWS
    assert path.read_bytes() == whole


def test_a_damaged_line_in_the_middle_is_an_error_that_names_it(tmp_path: Path) -> None:
    path = written(tmp_path)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[0] + b'{"run": "7\n' + lines[2])
    with pytest.raises(AdcbfError, match=r"runs\.jsonl: line 2 is no run's row"):
        RunRows(tmp_path, "runs", "k")


def test_another_key_begins_anew_and_says_so(tmp_path: Path) -> None:
    path = written(tmp_path)
    with RunRows(tmp_path, "runs", "other") as rows:
        assert (rows.opened, rows.done) == ("replaced", {})
        rows.add("1", {})
    assert json.loads(path.read_text().splitlines()[0])["key"] == "other"
    with RunRows(tmp_path, "runs", "other") as rows:
        assert (rows.opened, rows.done) == ("kept", {"1": {}})


def test_another_schema_begins_anew(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text().replace('"schema_version": 1', '"schema_version": 0'))
    with RunRows(tmp_path, "runs", "k") as rows:
        assert rows.opened == "replaced"


@pytest.mark.parametrize("content", ["seed,time\n1,2\n", "notes", '{"rows": []}\n', "[1]\n", '{"key": 3}\n'])
def test_a_file_of_something_else_is_left_alone(tmp_path: Path, content: str) -> None:
    path = tmp_path / "runs.jsonl"
    path.write_text(content)
    with pytest.raises(AdcbfError, match="not a file of runs"):
        RunRows(tmp_path, "runs", "k")
    assert path.read_text() == content


def test_a_file_in_the_folder_s_place(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    for folder in (tmp_path / "out", tmp_path / "out" / "deeper"):
        with pytest.raises(AdcbfError, match="not a folder"):
            RunRows(folder, "runs", "k")


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_no_number_is_not_a_value(tmp_path: Path, value: float) -> None:
    with RunRows(tmp_path, "runs", "k") as rows, pytest.raises(ValueError, match="JSON compliant"):
        rows.add("1", {"time_s": value})
    assert len((tmp_path / "runs.jsonl").read_text().splitlines()) == 1


def test_two_at_once_are_refused_and_nothing_is_lost(tmp_path: Path) -> None:
    with RunRows(tmp_path, "runs", "k") as rows, RunRows(tmp_path, "others", "k"):
        rows.add("1", {"a": 1})
        with pytest.raises(AdcbfError, match="another adcbf is writing here"):
            RunRows(tmp_path, "runs", "other key")
        rows.add("2", {"a": 2})
    with RunRows(tmp_path, "runs", "k") as rows:
        assert list(rows.done) == ["1", "2"]


def test_the_lock_ends_with_a_killed_process(tmp_path: Path) -> None:
    code = (
        "import os, signal, sys; from pathlib import Path; from adcbf_cli.io.run_rows import RunRows; "
        "RunRows(Path(sys.argv[1]), 'runs', 'k').add('1', {'a': 1}); os.kill(os.getpid(), signal.SIGKILL)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path)]).returncode == -9
    with RunRows(tmp_path, "runs", "k") as rows:
        assert rows.done == {"1": {"a": 1}}
