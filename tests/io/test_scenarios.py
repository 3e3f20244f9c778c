"""Scenario files are found: the user's own first, then those that come with the package."""

from __future__ import annotations

from pathlib import Path

import pytest

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.simulation.parsing import MAX_SCENARIO_CHARACTERS, parse_scenario
from adcbf_cli.io.scenarios import read_scenario, scenario_names


def test_packaged_scenarios_are_found_by_name():
    assert scenario_names() == ["crossings", "unstructured"]
    text, stem = read_scenario("unstructured")
    assert stem == "unstructured"
    assert parse_scenario(text).route is not None


def test_a_file_comes_before_a_packaged_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "crossings").mkdir()
    assert "movers:" in read_scenario("crossings")[0]  # a folder is no file
    (tmp_path / "crossings").rmdir()
    (tmp_path / "crossings").write_text("mine")
    assert read_scenario("crossings") == ("mine", "crossings")
    (tmp_path / "my.scene.yaml").write_text("also mine")
    assert read_scenario(str(tmp_path / "my.scene.yaml")) == ("also mine", "my.scene")


@pytest.mark.parametrize("name", ["crosings", "crosings.yaml", "nowhere/crosings.yaml"])
def test_an_unknown_name_lists_those_that_there_are(name: str):
    with pytest.raises(UsageError, match=r"crossings, unstructured; did you mean 'crossings'\?") as raised:
        read_scenario(name)
    assert str(raised.value).startswith(f"{name}: no such scenario file")


def test_what_is_no_text_file_gets_one_line(tmp_path: Path):
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(UsageError, match="not a text file"):
        read_scenario(str(tmp_path / "binary.yaml"))
    with pytest.raises(UsageError, match="cannot be read: Is a directory"):
        read_scenario(str(tmp_path))
    with pytest.raises(UsageError, match="cannot be read"):
        read_scenario("a\0b")


def test_a_file_of_any_size_is_read_no_further_than_needed(tmp_path: Path):
    (tmp_path / "long.yaml").write_text("#" * (2 * MAX_SCENARIO_CHARACTERS))
    text, _ = read_scenario(str(tmp_path / "long.yaml"))
    assert len(text) == MAX_SCENARIO_CHARACTERS + 1
    with pytest.raises(UsageError, match="longer than"):
        parse_scenario(text)
