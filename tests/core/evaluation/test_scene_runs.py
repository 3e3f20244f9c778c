"""Rows of runs through small scenes: what a success, a collision and a timeout leave behind."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import count
from typing import Any

import pytest

from adcbf_cli.core.config import Config
from adcbf_cli.core.evaluation.driving import BY_NAME
from adcbf_cli.core.evaluation.scene_runs import PATH_STEP_S, TIMED, SceneRun, SceneTask, run_scene

SCENE = """
duration_s: 12
route: {points_m: [[0, 0], [2.2, 0]]}
terrain: {kind: bumps, size_m: 20, amplitude_m: 0.05}
lidar: {kind: spinning, instantaneous: true, channels: 8, azimuth_step_deg: 2, max_range_m: 10}
"""
PASSES = """
objects: [{kind: box, at_m: [0.3, 1.5], size_m: [0.4, 0.4, 0.8]}]
movers:
  - {kind: cylinder, radius_m: 0.25, path: {kind: line, from_m: [1.2, {uniform: [-2.1, -1.9]}], to_m: [1.2, 3],
     speed_mps: 1.2}}
"""
RUNS_INTO = """
movers: [{kind: person, path: {kind: line, from_m: [3, 0], to_m: [-3, 0], speed_mps: 1}}]
"""
WALLED_OFF = """
objects:
  - {kind: wall, from_m: [1.2, -3], to_m: [1.2, 3]}
  - {kind: wall, from_m: [-1.2, -3], to_m: [-1.2, 3]}
  - {kind: wall, from_m: [-1.2, -3], to_m: [1.2, -3]}
  - {kind: wall, from_m: [-1.2, 3], to_m: [1.2, 3]}
"""
BLIND = {"perception": {"range_m": 0.35}}

TOLD = {"seed", "planner", "knowledge", "result", "duration_s", "metrics", "scene", "collision", "escape_exists"}
TOLD |= {"path", "log", "counters"}


def run(
    more: str,
    planner: str = "pure-pursuit",
    settings: dict[str, Any] | None = None,
    clock: Callable[[], int] | None = None,
    knowledge: Any = "perception",
) -> SceneRun:
    config = Config.model_validate(settings or {})
    return run_scene(SceneTask(SCENE + more, "small", 100_001, planner, config, knowledge), clock)


def test_a_success() -> None:
    done = run(PASSES, "ad-cbf-mpc")
    row = done.row
    assert set(row) == TOLD
    assert (row["seed"], row["planner"], row["knowledge"]) == (100_001, "ad-cbf-mpc", "perception")
    assert row["result"] == "success"
    assert row["collision"] is row["escape_exists"] is row["log"] is None
    assert row["scene"] == {
        "movers": 1,
        "fastest_mps": pytest.approx(1.2),
        "standing": 1,
        "bumps_m": 0.05,
        "slope_deg": 0.0,
    }
    assert row["duration_s"] == row["metrics"]["nav_time_s"] > 1.9
    assert set(row["metrics"]) == set(BY_NAME)
    assert row["metrics"]["min_dist_m"] > 0
    pose = done.ran.drive.pose
    assert row["path"][0] == [0.0, 0.0]
    assert row["path"][-1] == pytest.approx(pose[-1, :2], abs=1e-3)
    assert row["path"][1] == pytest.approx(pose[round(30 * PATH_STEP_S), :2], abs=1e-3)
    assert json.loads(json.dumps(row, allow_nan=False)) == row


def test_without_a_clock_a_row_is_always_the_same_and_nothing_is_timed() -> None:
    first, again = run(PASSES, "ad-cbf-mpc").row, run(PASSES, "ad-cbf-mpc").row
    assert first == again
    assert {name for name in TIMED if first["metrics"][name] is not None} == set()
    assert not {"wall_s", "stage_ms"} & set(first)
    assert {"solve_p50_ms", "solve_max_ms", "deadline_missed_rate"} <= set(TIMED)


def test_a_clock_adds_times_and_changes_nothing_else() -> None:
    """A clock that goes on by a millisecond each time it is read: every call takes just that."""
    ticks = count()
    timed = run(PASSES, clock=lambda: 1_000_000 * next(ticks)).row
    plain = run(PASSES).row
    stages = timed.pop("stage_ms")
    assert {stage: (spent["median"], spent["p95"]) for stage, spent in stages.items()} == dict.fromkeys(
        ("simulate", "cluster", "track", "predict", "plan"), (1.0, 1.0)
    )
    plans = round(30 * timed["duration_s"]) + 1
    assert stages["plan"] == {"calls": plans, "sum": plans, "median": 1.0, "p95": 1.0}
    calls = sum(spent["calls"] for spent in stages.values())
    assert timed.pop("wall_s") == pytest.approx((2 * calls + 1) / 1000)
    assert timed["metrics"]["solve_p50_ms"] == 1.0
    assert timed["metrics"]["deadline_missed_rate"] == 0.0
    timed["metrics"] |= dict.fromkeys(TIMED)
    assert timed == plain


def test_a_collision_with_something_never_seen() -> None:
    """A person who walks towards a blind vehicle, in the open: there was a way, but nobody knew that it was needed."""
    done = run(RUNS_INTO, settings=BLIND)
    row = done.row
    assert row["result"] == "collision"
    hit = row["collision"]
    assert {name: hit[name] for name in ("object_id", "kind", "moving", "known_since_s", "avoidable")} == {
        "object_id": 0,
        "kind": "person",
        "moving": True,
        "known_since_s": None,
        "avoidable": None,
    }
    assert hit["at_s"] == row["duration_s"]
    inputs = done.ran.drive.inputs
    assert hit["speed_mps"] == inputs[-2, 0] > 0.3, "that of the last tick that was driven"
    assert row["escape_exists"] is True
    assert row["metrics"]["nav_time_s"] is None
    assert row["metrics"]["collision"] == 1.0


def test_a_collision_with_something_known() -> None:
    """Pure pursuit knows the person and stands still, who goes on: a search finds a way around."""
    row = run(RUNS_INTO).row
    assert row["result"] == "collision"
    hit = row["collision"]
    assert 0 < hit["known_since_s"] < hit["at_s"]
    assert hit["avoidable"] is True
    assert hit["known_since_s"] < hit["avoidable_until_s"] < hit["at_s"]
    assert row["escape_exists"] is True


def test_a_standing_thing_is_named_after_the_movers() -> None:
    box = "\nobjects: [{kind: box, at_m: [1.2, 0], size_m: [0.4, 0.4, 0.8]}]"
    aside = "\nmovers: [{kind: cylinder, radius_m: 0.3, path: {kind: stand, at_m: [-4, 4]}}]"
    row = run(box + aside, settings=BLIND).row
    assert (row["collision"]["object_id"], row["collision"]["kind"], row["collision"]["moving"]) == (1, "box", False)


def test_a_timeout_where_there_is_no_way() -> None:
    """Walls all around: the planner stands before them until its time is up, and the search finds nothing either."""
    short = {"replay": {"timeout_factor": 1.5}}
    done = run(WALLED_OFF, "ad-cbf-mpc", short)
    row = done.row
    assert row["result"] == "timeout"
    assert row["collision"] is None
    assert row["escape_exists"] is False
    assert row["duration_s"] == pytest.approx(1.5 * done.ran.drive.nominal_s, abs=0.05)
    assert row["metrics"]["timeout"] == 1.0


def test_perfect_knowledge_is_told_in_the_row() -> None:
    row = run(PASSES, knowledge="perfect").row
    assert (row["knowledge"], row["result"]) == ("perfect", "success")
