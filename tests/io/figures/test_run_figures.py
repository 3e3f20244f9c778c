"""A run's figures draw the numbers they are given."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adcbf_cli.io.figures import calibration, gamma_map, margins, planners, solve_times, style, top_view


def drive(planner: str, seed: int, offset: int) -> dict[str, Any]:
    ticks = list(range(5))
    return {
        "kind": "replay",
        "planner": planner,
        "seed": seed,
        "result": "collision" if planner == "dwa" else "success",
        "t_ms": [100 * k for k in ticks],
        "x_mm": [1000 * k for k in ticks],
        "y_mm": [offset * k for k in ticks],
        "clearance_mm": [1000, 500, None, 250 + offset, 800],
        "barrier_cm2": [None] * 5 if planner == "logged" else [10_000, 5_000, None, 2_500, 8_000],
        "gamma_e4": [None] * 5 if planner == "logged" else [10_000, 1_000, None, 1_000, 5_000],
        "solve_us": [None] * 5 if planner == "logged" else [1_000, 2_000, 40_000, 1_500, 900],
        "solve_shares": {"us": [900, 1_000, 40_000], "share_e4": [5_000, 7_000, 10_000]},
    }


@pytest.fixture
def document() -> dict[str, Any]:
    frame = {
        "sensor": [0, 0, 0],
        "tracks": [[1, 2, 3000, 1000, 0, 0, 1, 0, 1, 400], [2, 1, 500, 0, 0, 0, 1, 0, 1, 300]],
    }
    drives = [drive("ad-cbf-mpc", 0, 100), drive("dwa", 0, -100), drive("dwa", 1, -900), drive("logged", 0, 0)]
    group = {
        "kind": "replay",
        "planners": ["ad-cbf-mpc", "dwa", "logged"],
        "drives": drives,
        "shown_seeds": [0, 1],
        "deadline_ms": 33.3,
        "route": {"xy_mm": [0, 0, 4000, 0]},
    }
    maps = {
        "planners": ["ad-cbf-mpc"],
        "distance_mm": [0, 1000, 2000, 3000],
        "radius_mm": [100, 500],
        "gamma_e4": [0, 0, 2000, 1000, 6000, 3000, 10000, 8000],
        "keep_out_mm": 500,
    }
    covered = {"reference": "later_seen", "radius": None, "horizon_s": None, "n": 9}
    points = [
        {**covered, "nominal": 0.5, "observed": 0.4, "interval": [0.3, 0.55]},
        {**covered, "nominal": 0.95, "observed": 0.9, "interval": None},
    ]
    found = {"success": [1.0, [0.6, 1.0]], "min_dist_m": [0.25, None]}
    comparison = {
        "metrics": {name: {"unit": unit} for name, unit in (("success", ""), ("min_dist_m", "m"))},
        "planners": {"ad-cbf-mpc": found, "dwa": {"success": [0.0, [0.0, 0.4]], "min_dist_m": [None, None]}},
    }
    scene = {"origin_m": [10, 20], "shown": [frame]}
    run = {"scene": scene, "drives": [group], "gamma": [maps], "calibration": points}
    return {"run": run, "comparisons": {"replay": comparison}}


def lines(axes: Any) -> dict[str, np.ndarray]:
    return {line.get_label(): line.get_xydata() for line in axes.get_lines() if not line.get_label().startswith("_")}


def test_the_top_view_is_in_world_metres_and_of_one_seed(document: dict[str, Any]) -> None:
    found = lines(top_view.draw(document).axes[0])
    np.testing.assert_allclose(found["ad-cbf-mpc"], [[10 + k, 20 + 0.1 * k] for k in range(5)])
    np.testing.assert_allclose(found["dwa"], [[10 + k, 20 - 0.1 * k] for k in range(5)])
    np.testing.assert_allclose(found["reference"], [[10, 20], [14, 20]])
    assert "logged" not in found


def test_margins_keep_gaps_where_nothing_is_known(document: dict[str, Any]) -> None:
    clearance, barrier, gamma = margins.draw(document).axes
    np.testing.assert_allclose(lines(clearance)["ad-cbf-mpc"][:, 1], [1, 0.5, np.nan, 0.35, 0.8])
    np.testing.assert_allclose(lines(barrier)["dwa"][:, 1], [1, 0.5, np.nan, 0.25, 0.8])
    np.testing.assert_allclose(lines(gamma)["dwa"][:, 1], [1, 0.1, np.nan, 0.1, 0.5])


def test_solve_times_have_the_distribution_of_all_steps(document: dict[str, Any]) -> None:
    by_step, shares = solve_times.draw(document).axes
    assert set(lines(by_step)) == {"ad-cbf-mpc", "dwa", "deadline 33.3 ms"}
    first = shares.get_lines()[0].get_xydata()
    np.testing.assert_allclose(first, np.column_stack([[0.9, 1, 40], [0.5, 0.7, 1]]))


def test_planners_without_a_value_have_no_dot(document: dict[str, Any]) -> None:
    success, distance = (axes for axes in planners.draw(document).axes if axes.get_visible())
    assert [float(line.get_xdata()[0]) for line in success.get_lines()] == [1.0, 0.0]
    assert [float(line.get_xdata()[0]) for line in distance.get_lines()] == [0.25]
    assert distance.get_title() == "min_dist_m [m]"


def test_calibration_stands_at_its_level(document: dict[str, Any]) -> None:
    axes = calibration.draw(document).axes[0]
    dots = axes.get_lines()[1].get_xydata()
    np.testing.assert_allclose(dots, [[0.5, 0.4], [0.95, 0.9]])
    assert axes.get_ylim()[0] <= 0.3


def test_gammas_map_is_laid_out_by_distance_and_radius(document: dict[str, Any]) -> None:
    mesh = gamma_map.draw(document).axes[0].collections[0]
    np.testing.assert_allclose(mesh.get_array(), [[0, 0.2, 0.6, 1.0], [0, 0.1, 0.3, 0.8]])


def test_a_vehicle_that_is_wider_than_the_map_has_no_line_of_touch(document: dict[str, Any]) -> None:
    (drawn,) = document["run"]["gamma"]
    drawn |= {"keep_out_mm": 5400, "gamma_e4": [0] * 8}
    axes = gamma_map.draw(document).axes[0]
    assert [text.get_text() for text in axes.texts] == []
    assert len(axes.get_lines()) == 0


@pytest.mark.parametrize("name", ["top_view", "margins", "solve_times", "gamma_map", "calibration", "planners"])
def test_a_runs_figure_has_the_same_bytes_again(name: str, document: dict[str, Any], tmp_path: Path) -> None:
    for folder in (tmp_path / "one", tmp_path / "two"):
        folder.mkdir()
        style.write_figure(name, document, folder)
    for kind in style.FORMATS:
        assert (tmp_path / "one" / f"{name}.{kind}").read_bytes() == (tmp_path / "two" / f"{name}.{kind}").read_bytes()
