"""The planning benchmarks' own parts: crowds, instances, gaps, and pedestrians as objects."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from adcbf_cli.core.config import Config
from adcbf_cli.core.planning.merit import merit

ROOT = Path(__file__).parents[2]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> ModuleType:
    """The benchmark script named by the test's parameter, imported as it sees its neighbours when it runs."""
    import importlib

    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    return importlib.import_module(request.param)


@pytest.mark.parametrize("script", ["crowds"], indirect=True)
def test_walkers_turn_back_at_the_edge_with_their_velocity(script: ModuleType) -> None:
    walker = script.Crowd(np.array([[15.0, 4.0]]), np.array([[1.0, 0.0]]), np.array([0.3]))
    before, after = walker.at(0.5, 3, 0.1), walker.at(2.5, 3, 0.1)
    np.testing.assert_allclose(before.position_m[0, :, 0], [15.5, 15.6, 15.7, 15.8])
    np.testing.assert_allclose(after.position_m[0, :, 0], [14.5, 14.4, 14.3, 14.2])
    np.testing.assert_allclose([before.velocity_mps[0], after.velocity_mps[0]], [[1, 0], [-1, 0]])


@pytest.mark.parametrize("script", ["crowds"], indirect=True)
def test_a_crowd_is_its_seed_and_half_of_it_walks(script: ModuleType) -> None:
    one, same, other = script.crowd(3, 20), script.crowd(3, 20), script.crowd(4, 20)
    np.testing.assert_array_equal(one.place_m, same.place_m)
    assert not np.allclose(one.place_m, other.place_m)
    assert one.is_static.sum() == 10
    assert (np.hypot(*(one.place_m - script.START_M).T) > script.CLEAR_M).all()


@pytest.mark.parametrize("script", ["crowds"], indirect=True)
def test_a_drive_goes_along_the_path_and_asks_about_no_more_than_allowed(
    script: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script, "LONGEST_S", 8.0)
    config = Config.model_validate({"planning": {"max_obstacles": 3, "solver": "piqp", "rate_hz": 5.0}})
    problem, ticks = script.drive(0, 20, config)
    x = [float(tick.situation.pose[0]) for tick in ticks]
    assert x[-1] > x[0] + 3.0
    assert max(len(tick.instance) for tick in ticks) == 3
    assert all(tick.instance.pose is tick.situation.pose for tick in ticks)
    assert np.isfinite([merit(problem, tick.instance, tick.guess) for tick in ticks]).all()


@pytest.mark.parametrize("script", ["planning"], indirect=True)
def test_a_gap_is_what_the_merit_is_above_the_oracles(script: ModuleType) -> None:
    oracle = script.Run([10.0, 20.0, 30.0, 40.0], [1.0, 2.0, 4.0, 5.0])
    run = script.Run([1.0, 2.0, 3.0, 2.0], [1.0, 1.0, 4.04, 10.0])
    found = script.compared(run, oracle)
    assert found["ratio"] == 12.5
    assert found["gap_median"] == pytest.approx(0.005)
    assert (found["better"], found["poorer"]) == (0.25, 0.25 + 0.25)
    assert found["ms"]["max"] == 3.0


@pytest.mark.parametrize("script", ["pedestrians"], indirect=True)
def test_annotations_become_objects_in_metres_and_seconds(script: ModuleType, tmp_path: Path) -> None:
    source, target = tmp_path / "obsmat.txt", tmp_path / "people.csv"
    source.write_text("786 2 9 0 3 1.5 0 0.1\n780 1 8.5 0 -2 1.5 0 0\n786 1 9.25 0 -2 1.5 0 0\n", encoding="utf-8")
    recording = script.read_obsmat(source, 15.0)
    script.write_objects(recording, target)
    assert target.read_text(encoding="utf-8").splitlines() == [
        "timestamp_ns,track_id,class,x_m,y_m",
        "0,1,pedestrian,8.500000,-2.000000",
        "400000000,1,pedestrian,9.250000,-2.000000",
        "400000000,2,pedestrian,9.000000,3.000000",
    ]
    assert recording.length_s == pytest.approx(0.4)


@pytest.mark.parametrize("script", ["pedestrians"], indirect=True)
def test_a_crossing_goes_across_or_along_the_way_people_walk(script: ModuleType) -> None:
    rng = np.random.default_rng(0)
    place = np.column_stack([rng.uniform(0, 20, 500), rng.uniform(0, 6, 500)])
    velocity = np.column_stack([rng.choice([-1.4, 1.4], 500), rng.normal(0, 0.1, 500)])
    people = script.Recording(np.arange(500.0), np.arange(500), place, velocity)
    start, goal = people.crossing("across")
    assert abs(goal[0] - start[0]) < 1.0
    np.testing.assert_allclose([start[1], goal[1]], [-1.0, 7.0], atol=0.3)
    start, goal = people.crossing("along")
    assert abs(goal[1] - start[1]) < 2.0
    np.testing.assert_allclose([start[0], goal[0]], [-1.0, 21.0], atol=0.6)
