"""Fig. 6 and the ablations' picture: what the document says is what is drawn."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.reproduction.drives import PLANNERS
from adcbf_cli.io.figures import ablations, fig6, style

SPEEDS_MPS = (0.2, 0.8, 1.5)


def scene_document() -> dict[str, Any]:
    box = {"length_m": 2.0, "width_m": 1.0, "yaw_rad": np.pi / 2}
    standing = [
        {"centre_m": [5.0, 2.0], "radius_m": None, "box": box},
        {"centre_m": [9.0, -1.0], "radius_m": 0.3, "box": None},
    ]
    person = {"radius_m": 0.4, "box": None, "centre_m": [3.0, 1.0], "ego_m": [3.0, 0.0], "gap_m": 0.3}
    movers = [
        {**person, "met": True, "way_m": [[3.0, 3.0], [3.0, -3.0]]},
        {**person, "met": False, "way_m": [[8.0, -3.0], [8.0, 3.0]]},
    ]
    ways = [
        {"planner": "mpc-dc", "result": "collision", "path_m": [[0.0, 0.0], [3.0, 0.1]]},
        {"planner": "a-cbf-mpc", "result": "timeout", "path_m": [[0.0, 0.0], [6.0, 0.1]]},
        {"planner": "ad-cbf-mpc", "result": "success", "path_m": [[0.0, 0.0], [5.0, -0.5], [10.0, 0.0]]},
    ]
    drawn = {"route_m": [[0.0, 0.0], [10.0, 0.0]], "goal_tolerance_m": 0.3, "body_radius_m": 0.3}
    return {"met_by": "ad-cbf-mpc", "drawn": {**drawn, "standing": standing, "movers": movers, "ways": ways}}


def speeds_document() -> dict[str, Any]:
    def point(speed: float, number: int) -> dict[str, Any]:
        rate = {"value": number / 10, "interval_95": [number / 20, number / 10 + 0.1]}
        return {"speed_mps": speed, "n": 20, "here": {"collision": rate}}

    speeds = {
        planner: {"points": [point(speed, number) for speed in SPEEDS_MPS]} for number, planner in enumerate(PLANNERS)
    }
    speeds["mpc-dc"]["points"][1]["here"] = None
    return {"speeds": speeds}


@pytest.mark.parametrize(("name", "document"), [("fig6", scene_document()), ("ablations", speeds_document())])
def test_the_same_document_gives_the_same_bytes(name: str, document: dict[str, Any], tmp_path: Path):
    one, two = tmp_path / "one", tmp_path / "two"
    for folder in (one, two):
        folder.mkdir()
        style.write_figure(name, document, folder)
    for kind in style.FORMATS:
        assert (one / f"{name}.{kind}").read_bytes() == (two / f"{name}.{kind}").read_bytes()
    assert "dc:date" not in (one / f"{name}.svg").read_text(encoding="utf-8")


@pytest.mark.parametrize(("draw", "document"), [(fig6.draw, scene_document()), (ablations.draw, speeds_document())])
def test_axes_carry_units(draw: Any, document: dict[str, Any]):
    (axes,) = draw(document).axes
    assert all(re.search(r"\[.+\]", label) for label in (axes.get_xlabel(), axes.get_ylabel()))


def test_the_scene_is_to_scale_and_in_place():
    (axes,) = fig6.draw(scene_document()).axes
    assert axes.get_aspect() == 1.0
    box, tree = axes.patches[:2]
    corners = box.get_patch_transform().transform(box.get_path().vertices)[:4]
    np.testing.assert_allclose(corners.min(axis=0), [4.5, 1.0], atol=1e-9)  # turned by 90 degrees
    np.testing.assert_allclose(corners.max(axis=0), [5.5, 3.0], atol=1e-9)
    assert (tree.center, tree.radius) == ((9.0, -1.0), 0.3)
    met = [patch for patch in axes.patches if getattr(patch, "center", None) == (3.0, 1.0)]
    assert len(met) == 1


def test_ends_of_failed_runs_are_marked():
    (axes,) = fig6.draw(scene_document()).axes
    marks = {line.get_marker(): tuple(line.get_xydata()[0]) for line in axes.get_lines() if line.get_marker() in "Xs"}
    assert marks == {"X": (3.0, 0.1), "s": (6.0, 0.1)}


def test_rates_are_drawn_in_per_cent_with_their_intervals():
    (axes,) = ablations.draw(speeds_document()).axes
    first, _, third, *_ = axes.containers
    assert len(first.lines[0].get_xdata()) == len(SPEEDS_MPS) - 1  # a speed without a run
    np.testing.assert_allclose(np.asarray(third.lines[0].get_ydata(), dtype=float), 20.0)
    np.testing.assert_allclose(np.asarray(third.lines[0].get_xdata(), dtype=float), SPEEDS_MPS)
    (bars,) = third.lines[2]
    np.testing.assert_allclose(bars.get_segments()[0][:, 1], [10.0, 30.0])
