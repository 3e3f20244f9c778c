"""The batch benchmark: its sums by hand, and one round on a list of two objects."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

from tests.commands.test_batch import objects

ROOT = Path(__file__).parents[2]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    return importlib.import_module("batch")


def test_what_starting_costs_is_told_apart_from_the_logs(script: ModuleType) -> None:
    """Four logs: one process takes 2 s to start and 5 s a log, two take 3 s and half of that."""
    one, two = script.Way("processes", 1), script.Way("processes", 2)
    rows = script.table([one, two], {one: 22.0, two: 13.0}, {one: 2.0, two: 3.0}, 4)
    assert [row["s_a_log"] for row in rows] == [5.0, 2.5]
    assert [row["speed_up"] for row in rows] == [1.0, pytest.approx(22 / 13)]


def test_each_way_is_measured_on_its_own_logs(
    script: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fastest of the rounds counts, and each begins with nothing there."""
    ways = [script.Way("processes", count) for count in (1, 2)]
    log = objects(tmp_path / "walk.csv")
    logs = {way: script.copies(log, way.processes, tmp_path / f"tiny{way.processes}") for way in ways}
    seen = []

    def wall_s(way: object, given: Path, folder: Path, options: list[str]) -> float:
        folder.mkdir()
        seen.append((way, len(list(given.iterdir()))))
        return 10.0 - len(seen)

    monkeypatch.setattr(script.Way, "wall_s", wall_s)
    assert script.measure(logs, [], 2, tmp_path) == {ways[0]: 7.0, ways[1]: 6.0}
    assert seen == [(ways[0], 1), (ways[1], 2)] * 2
    assert not list(tmp_path.glob("*.batch"))


def test_one_round(tmp_path: Path) -> None:
    log, figures = objects(tmp_path / "walk.csv"), tmp_path / "figures.json"
    options = ["--log", str(log), "--copies", "1", "--rounds", "1", "--processes", "1", "--json", str(figures)]
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "batch.py"), *options], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    rows = json.loads(figures.read_text())["rows"]
    assert [row["engine"] for row in rows] == (["processes", "ray"] if find_spec("ray") else ["processes"])
    assert all(row["wall_s"] > 0 and row["start_s"] > 0 for row in rows)
    assert "| engine | processes |" in done.stdout
