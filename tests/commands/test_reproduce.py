"""`adcbf reproduce` as a user meets it: its files, going on after a stop, and its errors."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner, Result

from adcbf_cli.commands import reproduce as command
from adcbf_cli.core import reproduction
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.reproduction.part import Part
from adcbf_cli.io.run_folder import RunFolder

SEEDS = "100000:100002"

app = typer.Typer()
app.command()(command.reproduce)


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=True)


def contents(folder: Path) -> dict[str, bytes]:
    """The folder's own files but the lock; the rows below it are in the order in which runs finished."""
    return {
        path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file() and path.name != ".lock"
    }


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("made")
    result = run("fig2", "fig4", "-o", folder, "--seeds", SEEDS)
    assert result.exit_code == 0, result.output
    return folder


def test_each_part_has_its_files(made: Path):
    names = {f"{part}.{suffix}" for part in ("fig2", "fig4") for suffix in ("json", "md", "png", "svg")}
    assert set(contents(made)) == names
    document = json.loads((made / "fig2.json").read_text(encoding="utf-8"))
    assert document["document"]["seeds"] == [100_000, 100_001]
    assert (made / "fig2.md").read_text(encoding="utf-8").startswith("# Fig. 2: ")


def test_more_processes_give_the_same_bytes(made: Path, tmp_path: Path):
    assert run("fig2", "-o", tmp_path, "--seeds", SEEDS, "--jobs", "2").exit_code == 0
    assert contents(tmp_path) == {name: found for name, found in contents(made).items() if name.startswith("fig2.")}


def test_what_is_finished_is_left_alone(made: Path):
    before = {path: path.stat().st_mtime_ns for path in made.iterdir() if path.suffix}
    result = run("fig2", "-o", made, "--seeds", SEEDS)
    assert result.exit_code == 0
    assert "fig2: finished already" in result.stderr
    assert result.stdout == (made / "fig2.md").read_text(encoding="utf-8")
    assert {path: path.stat().st_mtime_ns for path in made.iterdir() if path.suffix} == before


@pytest.mark.parametrize("damage", ["removed", "changed"])
def test_a_damaged_part_is_written_again_from_its_runs(made: Path, damage: str):
    before = contents(made)
    if damage == "removed":
        (made / "fig2.svg").unlink()
    else:
        (made / "fig2.png").write_bytes(b"not a picture")
    result = run("fig2", "-o", made, "--seeds", SEEDS)
    assert "2 of 2 runs are there already" in result.stderr
    assert contents(made) == before


def test_more_seeds_run_only_what_is_new(made: Path, tmp_path: Path):
    one = run("fig2", "-o", tmp_path, "--seeds", "100000")
    assert one.exit_code == 0
    two = run("fig2", "-o", tmp_path, "--seeds", SEEDS)
    assert "1 of 2 runs are there already" in two.stderr
    assert (tmp_path / "fig2.json").read_bytes() == (made / "fig2.json").read_bytes()


def test_all_joins_the_texts(made: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(command, "PARTS", ("fig2", "fig4"))
    assert run("all", "-o", made, "--seeds", SEEDS).exit_code == 0
    page = (made / "README.md").read_text(encoding="utf-8")
    assert page.startswith("# ")
    assert page.index("## Fig. 2") < page.index("## Fig. 4")
    assert "![" in page
    (made / "README.md").unlink()


def test_all_leaves_a_readme_that_it_did_not_write_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(command, "PARTS", ("fig4",))
    (tmp_path / "README.md").write_text("# My robot\n")
    result = run("all", "-o", tmp_path)
    assert isinstance(result.exception, UsageError)
    assert "README.md: is not of this command" in str(result.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["README.md"]
    assert (tmp_path / "README.md").read_text() == "# My robot\n"


def test_json_is_one_document_without_the_curves(made: Path):
    document = json.loads(run("fig4", "-o", made, "--json").stdout)
    results = document["parts"]["fig4"]["results"]
    assert results["cases"][0]["radius_m"] == 0.4
    assert "drawn" not in results
    assert document["parts"]["fig4"]["files"] == ["fig4.json", "fig4.md", "fig4.png", "fig4.svg"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tabel1"], "there is no part 'tabel1'; did you mean table1?"),
        (["fig4", "--seeds", "5:5"], "--seeds '5:5'"),
        (["fig4", "--seeds", "many"], "--seeds 'many'"),
    ],
)
def test_wrong_usage_is_one_line(arguments: list[str], message: str, tmp_path: Path):
    result = run(*arguments, "-o", tmp_path / "new")
    assert isinstance(result.exception, UsageError)
    assert message in str(result.exception)
    assert not (tmp_path / "new").exists()


def test_a_folder_that_is_none(tmp_path: Path):
    (tmp_path / "file").write_text("mine", encoding="utf-8")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        result = run("fig4", "-o", folder)
        assert isinstance(result.exception, UsageError)
        assert "not a folder" in str(result.exception)
    assert (tmp_path / "file").read_text(encoding="utf-8") == "mine"


def test_two_at_once_do_not_share_a_folder(tmp_path: Path):
    with RunFolder(tmp_path).locked():
        result = run("fig4", "-o", tmp_path)
    assert isinstance(result.exception, AdcbfError)
    assert "another adcbf is writing here" in str(result.exception)
    assert contents(tmp_path) == {}


def fail_at_two(seed: int) -> dict[str, Any]:
    if seed == 2:
        raise AdcbfError("no way to go")
    return {"seed": seed}


def small_part(name: str) -> Part:
    return Part(
        name=name,
        title="A small part",
        tasks=lambda seeds: {f"seed {seed}": seed for seed in seeds},
        run=fail_at_two,
        summarise=lambda rows: {"seeds": [row["seed"] for row in rows]},
        markdown=lambda document: f"seeds {document['seeds']}",
    )


def test_failed_runs_are_told_and_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reproduction, "load_part", small_part)
    for _ in range(2):
        result = run("table1", "-o", tmp_path, "--seeds", "1:4")
        assert isinstance(result.exception, AdcbfError)
        assert "some runs failed in table1" in str(result.exception)
        assert "finished already" not in result.stderr
    text = (tmp_path / "table1.md").read_text(encoding="utf-8")
    assert "seeds [1, 3]" in text
    assert "1 of 3 runs failed" in text
    assert "no way to go" in text
    assert run("table1", "-o", tmp_path, "--seeds", "3:5").exit_code == 0


def test_nothing_is_written_where_every_run_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(reproduction, "load_part", small_part)
    result = run("table1", "-o", tmp_path, "--seeds", "2")
    assert isinstance(result.exception, AdcbfError)
    assert "every run failed" in str(result.exception)
    assert contents(tmp_path) == {}


def test_help_needs_no_matplotlib():
    code = "import sys, adcbf_cli.app; print('matplotlib' in sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert loaded.strip() == "False"


@pytest.mark.parametrize("name", reproduction.PARTS)
def test_every_part_is_whole(name: str):
    """A part is found under its name, has runs for given seeds, and a picture's module if it says so."""
    import importlib

    part = reproduction.load_part(name)
    assert part.name == name
    assert part.tasks((3, 4))
    json.dumps(dict(part.settings), allow_nan=False)
    if part.figure:
        assert callable(importlib.import_module(f"adcbf_cli.io.figures.{name}").draw)
