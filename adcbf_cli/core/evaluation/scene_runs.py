"""One closed-loop run through a simulated scene: a seed and a planner in, one row of plain values out.

Tasks are picklable, since runs go to other processes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.evaluation.driving import BY_NAME, score_drive
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.replay.escape import find_escape, judge_collision
from adcbf_cli.core.replay.records import Result
from adcbf_cli.core.replay.sensor_loop import KnowledgeSource, SceneDrive, drive_scene
from adcbf_cli.core.simulation.parsing import parse_scenario
from adcbf_cli.core.simulation.paths import motion_along
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.types import Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle

Row = dict[str, Any]

PATH_STEP_S = 0.2
"""Of the driven path that a row holds."""

TIMED = tuple(name for name in BY_NAME if name.startswith("solve_") or name == "deadline_missed_rate")
"""Metrics that need a clock."""


@dataclass(frozen=True)
class SceneTask:
    """text: the scenario's YAML, called `source`; its random values are drawn with `seed`, which is that of its
    noise too."""

    text: str
    source: str
    seed: int
    planner: str
    config: Config
    knowledge: KnowledgeSource = "perception"

    @property
    def run_id(self) -> str:
        return f"{self.planner}-{self.seed}"


@dataclass(frozen=True)
class SceneRun:
    """A run that has ended: its scene as drawn, its drive, and the row that is kept of it."""

    scenario: Scenario
    ran: SceneDrive
    row: Row


def run_scene(task: SceneTask, clock: Callable[[], int] | None = None) -> SceneRun:
    """Drives one scene. clock: nanoseconds; None: nothing is timed, and the row is the same wherever it is made."""
    scenario = parse_scenario(task.text, task.source, task.seed)
    notes, config = Notes(), task.config
    planner = make_planner(task.planner, Vehicle.from_config(config.vehicle), config.planning, notes)
    begin = 0 if clock is None else clock()
    ran = drive_scene(scenario, task.seed, planner, config, notes, clock or _no_clock, task.knowledge)
    row = _row(task, scenario, ran, notes)
    if clock is None:
        row["metrics"] |= dict.fromkeys(TIMED)
    else:
        row["wall_s"] = (clock() - begin) / 1e9
        row["stage_ms"] = {stage: _spent(values) for stage, values in ran.stage_ms.items()}
    return SceneRun(scenario, ran, row)


def _no_clock() -> int:
    return 0


def _row(task: SceneTask, scenario: Scenario, ran: SceneDrive, notes: Notes) -> Row:
    """What is kept of a run."""
    drive, config = ran.drive, task.config
    assert drive.result is not None
    return {
        "seed": task.seed,
        "planner": task.planner,
        "knowledge": task.knowledge,
        "result": str(drive.result),
        "duration_s": float(drive.stamp_ns[-1] - drive.stamp_ns[0]) / 1e9,
        "metrics": score_drive(drive, config.replay, config.planning),
        "scene": _features(scenario),
        "collision": _collision(scenario, ran, config) if drive.result is Result.COLLISION else None,
        "escape_exists": None if drive.result is Result.SUCCESS else _escape_exists(ran, config),
        "path": _thinned_path(ran),
        "log": None,
        "counters": dict(sorted(notes.counters.items())),
    }


def _features(scenario: Scenario) -> Row:
    """What made the scene: for telling which scenes are hard."""

    times = np.linspace(0.0, scenario.duration_s, 200)
    speeds = []
    for mover in scenario.movers:
        motion = motion_along(mover.path, times)
        speeds.append(float(np.hypot(motion.vx_mps, motion.vy_mps).max()))
    terrain = scenario.terrain
    return {
        "movers": len(scenario.movers),
        "fastest_mps": max(speeds, default=0.0),
        "standing": len(scenario.objects),
        "bumps_m": terrain.amplitude_m if terrain.kind == "bumps" else 0.0,
        "slope_deg": terrain.slope_deg,
    }


def _collision(scenario: Scenario, ran: SceneDrive, config: Config) -> Row:
    """What was hit, when, since when it was known, and whether it could have been avoided."""

    drive = ran.drive
    judged = judge_collision(ran.world, Vehicle.from_config(config.vehicle), drive, ran.known_since_ns)
    kinds = [*scenario.movers, *scenario.objects]
    start_ns = int(drive.stamp_ns[0])

    def since_start(stamp_ns: int | None) -> float | None:
        return None if stamp_ns is None else (stamp_ns - start_ns) / 1e9

    return {
        "object_id": judged.object_id,
        "kind": kinds[judged.object_id].kind,
        "moving": judged.object_id < len(scenario.movers),
        "at_s": float(drive.stamp_ns[-1] - start_ns) / 1e9,
        "speed_mps": float(drive.inputs[max(len(drive.inputs) - 2, 0), 0]),
        "known_since_s": since_start(judged.known_since_ns),
        "avoidable": judged.avoidable,
        "avoidable_until_s": since_start(judged.avoidable_until_ns),
    }


def _escape_exists(ran: SceneDrive, config: Config) -> bool:
    """Whether a drive through the scene exists at all; where one was driven, nobody has to search."""

    drive = ran.drive
    found = find_escape(
        ran.world,
        Vehicle.from_config(config.vehicle),
        drive.pose[0],
        np.zeros(2),
        int(drive.stamp_ns[0]),
        ran.limit_ns,
        goal_m=ran.goal_m,
        goal_tolerance_m=config.replay.goal_tolerance_m,
        tick_s=drive.period_s,
    )
    return found.found


def _thinned_path(ran: SceneDrive) -> list[list[float]]:
    drive = ran.drive
    step = max(1, round(PATH_STEP_S / drive.period_s))
    rows = np.concatenate([drive.pose[:-1:step, :2], drive.pose[-1:, :2]])
    return [[round(float(x), 3), round(float(y), 3)] for x, y in rows]


def _spent(values: list[float]) -> Row:
    """Milliseconds of one stage: how many calls, their sum, median and 95th percentile."""
    return {
        "calls": len(values),
        "sum": float(np.sum(values)),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
    }
