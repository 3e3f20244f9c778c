"""Fig. 6: what is drawn comes from the scene of the seed, and from the runs' own ways."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.reproduction import fig6
from adcbf_cli.core.simulation.parsing import parse_scenario
from adcbf_cli.scenarios import scenario_text
from tests.core.reproduction.runs_of_scenes import a_run

SEED = 100_000


@pytest.fixture(scope="module")
def scenario() -> Any:
    return parse_scenario(scenario_text("unstructured"), "unstructured", SEED)


@pytest.fixture(scope="module")
def document(scenario: Any) -> dict[str, Any]:
    """ad-cbf-mpc waits where the first mover comes to its end; mpc-dc hits something."""
    end = scenario.movers[0].path.to_m
    stays = a_run("ad-cbf-mpc", SEED) | {"path": [list(end)] * 401, "duration_s": 80.0}
    return fig6.summarise([a_run("mpc-dc", SEED, "collision", min_dist_m=-0.01), stays])


def test_all_that_stands_is_there_as_it_is(scenario: Any, document: dict[str, Any]):
    standing = document["drawn"]["standing"]
    assert len(standing) == len(scenario.objects)
    box = next(index for index, thing in enumerate(scenario.objects) if thing.kind == "box")
    assert standing[box]["centre_m"] == pytest.approx(scenario.objects[box].at_m, abs=1e-3)
    assert standing[box]["box"]["length_m"] == pytest.approx(scenario.objects[box].size_m[0], abs=1e-3)
    tree = next(index for index, thing in enumerate(scenario.objects) if thing.kind == "tree")
    assert standing[tree]["radius_m"] == pytest.approx(scenario.objects[tree].trunk_radius_m, abs=1e-3)
    assert standing[tree]["box"] is None
    assert [thing["ellipse"] for thing in standing] == [thing.kind == "rock" for thing in scenario.objects]


def test_a_mover_is_drawn_where_it_was_nearest(scenario: Any, document: dict[str, Any]):
    """The first mover walks to where the vehicle stands."""
    movers = document["drawn"]["movers"]
    path = scenario.movers[0].path
    assert len(movers) == len(scenario.movers)
    assert movers[0]["met"]
    assert movers[0]["gap_m"] < 0
    np.testing.assert_allclose(movers[0]["way_m"][0], path.from_m, atol=1e-2)
    np.testing.assert_allclose(movers[0]["centre_m"], path.to_m, atol=0.2)
    np.testing.assert_allclose(movers[0]["ego_m"], path.to_m, atol=1e-3)


def test_a_mover_that_never_came_near_is_not_met(scenario: Any):
    far = a_run("ad-cbf-mpc", SEED) | {"path": [[-50.0, 40.0], [-50.0, 40.0]]}
    drawn = fig6.summarise([far])["drawn"]
    assert not any(mover["met"] for mover in drawn["movers"])


def test_runs_are_told_with_their_ends(document: dict[str, Any]):
    text = fig6.markdown(document)
    assert "| `mpc-dc` | collision (person) | 10.0 | -0.01 | - |" in text
    assert f"seed {SEED}" in text
    assert document["met_by"] == "ad-cbf-mpc"
