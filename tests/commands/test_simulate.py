"""`adcbf simulate` as a user meets it, and the sample log against what it writes today."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
import typer
import zstandard
from mcap.reader import make_reader
from typer.testing import CliRunner

from adcbf_cli.commands.simulate import simulate
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.simulation.parsing import parse_scenario
from adcbf_cli.core.simulation.simulator import Simulator
from adcbf_cli.io.simulation_log import write_log
from adcbf_cli.io.truth_writer import COLUMNS

SAMPLE_ZSTD = (1, 5, 7)

SCENARIO = """
duration_s: 0.3
seed: 4
terrain: {kind: bumps, size_m: 30}
objects: [{kind: rock, at_m: [3, 2]}]
movers: [{kind: person, path: {kind: line, from_m: [4, -2], to_m: [4, 5], speed_mps: 1.5}}]
ego: {path: {kind: line, from_m: [0, 0], to_m: [3, 0], speed_mps: 1}}
lidar: {kind: spinning, azimuth_step_deg: 2, max_range_m: 12}
"""

app = typer.Typer()
app.command()(simulate)


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    path = tmp_path / "crossing.yaml"
    path.write_text(SCENARIO, encoding="utf-8")
    return path


def run(*arguments: str | Path):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=True)


def test_the_same_seed_gives_the_same_bytes(scenario: Path, tmp_path: Path):
    outputs = []
    for name in "ab":
        result = run(scenario, "-o", tmp_path / f"{name}.mcap", "--truth", tmp_path / f"{name}.csv")
        assert result.exit_code == 0, result.output
        outputs.append(((tmp_path / f"{name}.mcap").read_bytes(), (tmp_path / f"{name}.csv").read_bytes()))
    assert outputs[0] == outputs[1]
    assert run(scenario, "-o", tmp_path / "c.mcap", "--seed", "5").exit_code == 0
    assert (tmp_path / "c.mcap").read_bytes() != outputs[0][0]


def test_the_default_name_and_the_json_summary(scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    result = run(scenario, "--json")
    summary = json.loads(result.stdout)
    assert (tmp_path / "crossing.mcap").stat().st_size == summary["bytes"]
    assert (summary["scans"], summary["objects"], summary["seed"], summary["truth"]) == (3, 2, 4, None)


def test_the_truth_table(scenario: Path, tmp_path: Path):
    run(scenario, "-o", tmp_path / "a.mcap", "--truth", tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert tuple(rows[0]) == COLUMNS
    order = [(int(row["timestamp_ns"]), int(row["track_id"])) for row in rows]
    assert order == sorted(order)
    assert len(rows) == 6
    person = [row for row in rows if row["class"] == "person"]
    np.testing.assert_allclose([float(row["y_m"]) for row in person], [-2.0, -1.85, -1.7])
    assert {row["vy_mps"] for row in person} == {"1.5000"}
    rock = next(row for row in rows if row["class"] == "rock")
    assert (rock["x_m"], rock["y_m"], rock["vx_mps"], rock["length_m"]) == ("3.0000", "2.0000", "0.0000", "0.8000")


def test_a_scan_is_logged_after_the_poses_that_place_it(scenario: Path, tmp_path: Path):
    run(scenario, "-o", tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream)
        times = [message.log_time for _, _, message in reader.iter_messages(log_time_order=False)]
        topics = [channel.topic for _, channel, _ in reader.iter_messages(log_time_order=False)]
        assert reader.get_header().library == "adcbf"
    assert times == sorted(times)
    assert topics[0] == "/tf_static"
    assert topics.count("/points") == 3
    assert times[topics.index("/points")] - times[0] == 100_000_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["missing.yaml"], "no such scenario file"),
        (["crossing.yaml", "-o", "a.bag"], "name it with .mcap"),
        (["crossing.yaml", "-o", "nowhere/a.mcap"], "there is no folder"),
        (["crossing.yaml", "--truth", "crossing.yaml"], "is the scenario itself"),
        (["crossing.yaml", "-o", "a.mcap", "--truth", "a.mcap"], "name the same file"),
        (["."], "cannot be read"),
        (["binary.yaml"], "not a text file"),
        (["rows.csv"], "rows.csv: a scenario is a mapping"),
        (["open.yaml"], "open.yaml:2: not valid YAML"),
        (["open.yaml", "--closed-loop"], "open.yaml:2: not valid YAML"),
    ],
)
def test_mistakes_get_one_line(
    scenario: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x01")
    (tmp_path / "rows.csv").write_text("a,b\n")
    (tmp_path / "open.yaml").write_text("ego: [1\n")
    before = sorted(path.name for path in tmp_path.iterdir())
    result = run(*arguments)
    assert isinstance(result.exception, UsageError)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def decoded(path: Path, seconds: float) -> list[tuple[str, int, bytes]]:
    with path.open("rb") as stream:
        found = make_reader(stream).iter_messages()
        messages = [(channel.topic, message.log_time, message.data) for _, channel, message in found]
    return [message for message in messages if message[1] <= messages[0][1] + seconds * 1e9]


def test_the_sample_log_is_what_its_scenario_gives(sample_data: Path, tmp_path: Path):
    """Every message of the first two seconds, byte for byte, whatever zstd made of them."""
    text = re.sub(r"duration_s: 20\b", "duration_s: 2", (sample_data / "scenario.yaml").read_text(encoding="utf-8"))
    simulator = Simulator(parse_scenario(text))
    write_log(tmp_path / "two_seconds.mcap", simulator, simulator)
    expected = decoded(tmp_path / "two_seconds.mcap", 2.0)
    assert sum(topic == "/points" for topic, _, _ in expected) == 20
    found = decoded(sample_data / "sample.mcap", 2.0)
    different = [a[:2] for a, b in zip(found, expected, strict=True) if a != b]
    assert different == []


def test_the_sample_is_remade_byte_for_byte(sample_data: Path, tmp_path: Path):
    if zstandard.ZSTD_VERSION != SAMPLE_ZSTD:
        pytest.skip(f"the sample was compressed by zstd {SAMPLE_ZSTD}, here is {zstandard.ZSTD_VERSION}")
    log, truth = tmp_path / "sample.mcap", tmp_path / "truth.csv"
    assert run(sample_data / "scenario.yaml", "-o", log, "--truth", truth).exit_code == 0
    assert truth.read_bytes() == (sample_data / "truth.csv").read_bytes()
    assert log.read_bytes() == (sample_data / "sample.mcap").read_bytes()
