"""Two parts of one kind of run: the second takes what the first has run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from adcbf_cli.commands import reproduce as command
from adcbf_cli.core import reproduction
from adcbf_cli.core.reproduction.part import Part

RAN: list[int] = []


def count(seed: int) -> dict[str, Any]:
    RAN.append(seed)
    return {"seed": seed}


FIRST = Part(
    name="table2",
    title="All seeds",
    tasks=lambda seeds: {f"seed {seed}": seed for seed in seeds},
    run=count,
    summarise=lambda rows: {"seeds": [row["seed"] for row in rows]},
    markdown=lambda document: f"seeds {document['seeds']}",
)
SECOND = replace(
    FIRST, name="fig6", title="The first seed", tasks=lambda seeds: {f"seed {seeds[0]}": seeds[0]}, runs_of="table2"
)


@pytest.mark.parametrize("order", [("table2", "fig6"), ("fig6", "table2")])
def test_runs_are_shared_whichever_part_comes_first(
    order: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(reproduction, "load_part", {"table2": FIRST, "fig6": SECOND}.__getitem__)
    RAN.clear()
    app = typer.Typer()
    app.command()(command.reproduce)
    for name in order:
        result = CliRunner().invoke(app, [name, "-o", str(tmp_path), "--seeds", "3:6"])
        assert result.exit_code == 0, result.output
    assert sorted(RAN) == [3, 4, 5]
    assert (tmp_path / "fig6.md").read_text(encoding="utf-8") == "# The first seed\n\nseeds [3]\n"
    assert (tmp_path / "table2.md").read_text(encoding="utf-8") == "# All seeds\n\nseeds [3, 4, 5]\n"
    assert [path.name for path in (tmp_path / "runs").glob("*.jsonl")] == ["table2.jsonl"]
