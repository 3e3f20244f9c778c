"""The Table I benchmark: the whole road on a part of its circle, through its own command line."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

SOURCE = Path(__file__).parents[2] / "benchmarks" / "table1.py"


@pytest.fixture(scope="module")
def table1() -> ModuleType:
    spec = importlib.util.spec_from_file_location("table1_benchmark", SOURCE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_the_circle_is_tracked_and_predicted_from_points(table1: ModuleType, capsys: pytest.CaptureFixture[str]):
    """Ten seconds of the case: the bounds are several times what the package does, and a wrong centre,
    time stamp or motion model breaks them."""
    table1.main(["--only", "base", "--seeds", "1", "--first-seed", "100", "--duration", "10"])
    line = next(text for text in capsys.readouterr().out.splitlines() if text.startswith("| base"))
    numbers = [[float(value) for value in cell.split(" / ")] for cell in line.split(" | ")[1:5]]
    centre, tracking, prediction, last = numbers
    assert max(centre) < 0.04
    assert max(tracking) < 0.03
    assert max(prediction) < 0.12
    assert max(last) < 0.2
    assert "paper's Table I" not in line
