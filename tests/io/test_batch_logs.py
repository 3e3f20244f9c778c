"""Which logs a batch is of, and their names."""

from __future__ import annotations

import io
import os
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
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"x.bag\r\ny\x0c.bag\n")))
    assert find_logs([], "-") == [Path("x.bag"), Path("y\x0c.bag")]


def test_a_list_may_be_that_of_find_print0(monkeypatch: pytest.MonkeyPatch) -> None:
    listed = b"./gr\xf6sse.bag\0./# two\nlines .bag\0"
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(listed)))
    assert find_logs([], "-") == [Path(os.fsdecode(b"gr\xf6sse.bag")), Path("# two\nlines .bag")]


def test_what_cannot_be_looked_up_is_kept_and_named(tmp_path: Path) -> None:
    loop, long = tmp_path / "loop.bag", tmp_path / f"{'x' * 300}.bag"
    loop.symlink_to(loop)
    found = find_logs([str(loop), str(long), str(long)], None)
    assert found == [loop, long]
    assert unique_names(found, {})[0] == "loop"


def test_patterns_leave_out_what_adcbf_wrote(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Named by its path it is taken: that is refused with a word of its own."""
    monkeypatch.chdir(tmp_path)
    made(tmp_path, "a.mcap", "a.adcbf/run.json", "a.adcbf/viz.ros2.mcap", "runs/b.mcap")
    made(tmp_path, "w.batch/runs/log=a/run.json", "w.batch/runs/log=a/viz.ros2.mcap")
    for dataset in ("summary", "metrics"):
        (tmp_path / "w.batch" / dataset).mkdir()
    assert find_logs(["**/*.mcap"], None) == [Path("a.mcap"), Path("runs/b.mcap")]
    assert find_logs(["*"], None) == [Path("a.mcap"), Path("runs")]
    assert find_logs(["a.adcbf"], None) == [Path("a.adcbf")]
    with pytest.raises(UsageError, match=r"no file matches this pattern but what adcbf itself wrote"):
        find_logs(["*.adcbf/*.mcap"], None)


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
        (["epoch.bag", "Infinity.bag", "0x1F.bag"], ["log-epoch", "log-Infinity", "log-0x1F"]),
        (["epochs.bag", "info.bag", "2 walks.bag"], ["epochs", "info", "2_walks"]),
        (["null.bag", "__HIVE_DEFAULT_PARTITION__.bag"], ["log-null", "log-__HIVE_DEFAULT_PARTITION__"]),
        (["..hidden.bag", "größe.bag"], ["hidden", "gr_e"]),
    ],
)
def test_names(logs: list[str], names: list[str], tmp_path: Path) -> None:
    assert unique_names(made(tmp_path, *logs), {}) == names


def test_a_folder_is_named_whole_and_long_names_are_cut(tmp_path: Path) -> None:
    bag = tmp_path / "rosbag2.2024"
    bag.mkdir()
    long = [tmp_path / f"{letter * 200}{end}.bag" for letter, end in (("x", "1"), ("x", "2"))]
    found = unique_names([bag, *long], {})
    assert found[0] == "rosbag2.2024"
    assert len(set(found)) == 3
    assert all(len(name) < 140 for name in found)


def test_names_are_the_same_in_any_order(tmp_path: Path) -> None:
    logs = made(tmp_path, "mon/drive.bag", "tue/drive.bag", "walk.bag")
    assert unique_names(logs[::-1], {}) == unique_names(logs, {})[::-1]


def test_a_log_keeps_the_name_that_it_had_when_others_come(tmp_path: Path) -> None:
    logs = made(tmp_path, "mon/drive.bag", "tue/drive.bag", "wed/drive.bag", "b.bag")
    before = {logs[0]: "drive", logs[3]: "Tue-drive", tmp_path / "gone.bag": "wed-drive"}
    assert unique_names(logs, before) == ["drive", "tue-drive-2", "wed-drive", "Tue-drive"]
    assert unique_names(logs[:2][::-1], before) == ["tue-drive", "drive"]
