"""Which logs a batch is of, and their names."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

from adcbf_cli.core.errors import UsageError
from adcbf_cli.io.batch_logs import find_logs, unique_names


def made(folder: Path, *names: str) -> list[Path]:
    paths = [folder / name for name in names]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return paths


def test_paths_patterns_and_a_list_give_each_log_once_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    made(tmp_path, "b.bag", "a.bag", "deep/er/c.bag", "d e.mcap")
    (tmp_path / "list.txt").write_text("# Monday\n\n  d e.mcap  \nb.bag\n./a.bag\ngone.bag\n")
    found = find_logs(["b.bag", "**/*.bag"], "list.txt")
    assert [str(path) for path in found] == ["b.bag", "a.bag", "deep/er/c.bag", "d e.mcap", "gone.bag"]


def test_a_list_may_come_through_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("x.bag\ny.bag\n"))
    assert find_logs([], "-") == [Path("x.bag"), Path("y.bag")]


def test_a_file_whose_name_looks_like_a_pattern_is_that_file(tmp_path: Path) -> None:
    (path,) = made(tmp_path, "run[1].bag")
    assert find_logs([str(path)], None) == [path]


@pytest.mark.parametrize(
    ("words", "listed", "text"),
    [([], None, "no logs"), (["*.bag"], None, "no file matches"), ([], "empty.txt", "names no log")],
)
def test_nothing_to_do_is_wrong_usage(
    words: list[str], listed: str | None, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.txt").write_text("# nothing\n")
    with pytest.raises(UsageError, match=text):
        find_logs(words, listed)


@pytest.mark.parametrize(
    ("logs", "names"),
    [
        (["a.bag", "b.bag"], ["a", "b"]),
        (["mon/drive.bag", "tue/drive.bag", "walk.bag"], ["mon-drive", "tue-drive", "walk"]),
        (["x/mon/drive.bag", "y/mon/drive.bag"], ["x-mon-drive", "y-mon-drive"]),
        (["drive.bag", "drive.mcap"], ["drive.bag", "drive.mcap"]),
        (["Drive.bag", "drive.BAG"], ["Drive", "drive-2"]),
        (["a b.bag", "a=b.bag"], ["a_b", "a_b-2"]),
        (["2024-01-02.bag", "1e5.bag", "007.bag"], ["log-2024-01-02", "log-1e5", "log-007"]),
        (["null.bag", "__HIVE_DEFAULT_PARTITION__.bag"], ["log-null", "log-__HIVE_DEFAULT_PARTITION__"]),
        (["..hidden.bag", "größe.bag"], ["hidden", "gr_e"]),
    ],
)
def test_names(logs: list[str], names: list[str], tmp_path: Path) -> None:
    assert unique_names(made(tmp_path, *logs)) == names


def test_a_folder_is_named_whole_and_long_names_are_cut(tmp_path: Path) -> None:
    bag = tmp_path / "rosbag2.2024"
    bag.mkdir()
    long = [tmp_path / f"{letter * 200}{end}.bag" for letter, end in (("x", "1"), ("x", "2"))]
    found = unique_names([bag, *long])
    assert found[0] == "rosbag2.2024"
    assert len(set(found)) == 3
    assert all(len(name) < 140 for name in found)


def test_names_are_the_same_in_any_order(tmp_path: Path) -> None:
    logs = made(tmp_path, "mon/drive.bag", "tue/drive.bag", "walk.bag")
    assert unique_names(logs[::-1]) == unique_names(logs)[::-1]
