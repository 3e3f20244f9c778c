"""The Table I benchmark's own arithmetic, and the whole road on a part of its circle."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
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


def test_going_straight_on_misses_the_circle_by_half_a_t_squared(table1: ModuleType):
    """To second order the error is a t^2 / 2 with a = (2 pi w)^2 A, shared by x and y over a turn."""
    acceleration = (2 * np.pi * 0.015) ** 2 * 2.5
    all_steps, last = table1.straight_ahead()
    ahead = 0.1 * np.arange(1, 31)
    np.testing.assert_allclose(last, acceleration * 9 / 2 / np.sqrt(2), rtol=0.01)
    np.testing.assert_allclose(all_steps, np.sqrt(np.mean((acceleration * ahead**2 / 2) ** 2) / 2), rtol=0.01)


def test_positions_are_equation_11(table1: ModuleType):
    np.testing.assert_allclose(table1.positions(np.array([0.0])), [[8.5, -0.5]])
    np.testing.assert_allclose(table1.positions(np.array([0.25 / 0.015])), [[6.0, 2.0]], atol=1e-12)


def test_rmse_and_interval(table1: ModuleType):
    runs = []
    for value in (1.0, 3.0):
        road = table1.Road(table1.Variant("x").config({}))
        road.frames = road.tracked = 2
        road.errors["tracking"] = [np.array([[value, 0.0]]), np.array([[-value, 2.0]])]
        runs.append(road)
    result = table1.summarise(runs)
    assert result["tracking"]["x"]["runs_m"] == [1.0, 3.0]
    assert result["tracking"]["x"]["mean_m"] == pytest.approx(2.0)
    assert result["tracking"]["x"]["half_width_m"] == pytest.approx(
        12.7062, abs=1e-3
    )  # t(0.975, 1) * sqrt(2) / sqrt(2)
    assert result["tracking"]["y"]["mean_m"] == pytest.approx(np.sqrt(2), abs=1e-6)
    assert result["prediction"]["x"]["mean_m"] is None
    assert result["tracked_share"] == 1.0


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
