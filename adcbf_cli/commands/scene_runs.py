"""One closed-loop run of a campaign, timed, and written out as a log where asked.

Top-level and picklable, since runs go to other processes.
"""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from adcbf_cli.core.evaluation.scene_runs import SceneRun, SceneTask

Record = Literal["none", "collisions", "all"]

LOGS = "logs"
"""In the folder of the runs: a folder for each run that is written out."""

LOG_FILES = ("run.mcap", "truth.csv", "route.csv", "scene.yaml", "run.yaml")


@dataclass(frozen=True)
class RecordedTask:
    """record: which runs are written out as logs, into `logs`/<planner>-<seed>/."""

    task: SceneTask
    record: Record
    logs: Path


def run_and_record(asked: RecordedTask) -> dict[str, Any]:
    """Drives one scene; its row, with where its log is."""
    from adcbf_cli.core.evaluation.scene_runs import run_scene
    from adcbf_cli.core.replay.records import Result

    run = run_scene(asked.task, time.perf_counter_ns)
    collided = run.ran.drive.result is Result.COLLISION
    if asked.record == "all" or (asked.record == "collisions" and collided):
        folder = asked.logs / asked.task.run_id
        write_scene_log(folder, asked.task, run)
        run.row["log"] = f"{asked.logs.name}/{folder.name}/run.mcap"
    return run.row


def write_scene_log(folder: Path, task: SceneTask, run: SceneRun) -> None:
    """The drive as `adcbf simulate` writes one: run.mcap and truth.csv, with the route that it followed, the
    scene that it was drawn as and the settings that it was driven with. The log appears last."""
    from adcbf_cli.core.simulation.parsing import scenario_yaml
    from adcbf_cli.core.simulation.paths import route_points
    from adcbf_cli.core.simulation.simulator import Simulator
    from adcbf_cli.io.atomic import atomic_path, remove_leftovers, write_text_atomically
    from adcbf_cli.io.settings import settings_yaml
    from adcbf_cli.io.simulation_log import write_log, write_scan_truth

    folder.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder)
    scenario = run.scenario
    simulator = Simulator(scenario, task.seed, run.ran.motion)
    assert scenario.route is not None
    route = "\n".join(f"{x:.6f},{y:.6f}" for x, y in route_points(scenario.route))
    write_text_atomically(folder / "route.csv", f"x_m,y_m\n{route}\n")
    write_text_atomically(folder / "scene.yaml", scenario_yaml(scenario))
    write_text_atomically(folder / "run.yaml", settings_yaml(task.config))
    with ExitStack() as together:
        write_scan_truth(together.enter_context(atomic_path(folder / "truth.csv")), simulator)
        write_log(folder / "run.mcap", simulator, simulator)


def remove_scene_log(folder: Path) -> None:
    """Removes what `write_scene_log` wrote, and the folder if nothing else is in it."""
    from adcbf_cli.io.atomic import remove_leftovers

    remove_leftovers(folder)
    for name in LOG_FILES:
        (folder / name).unlink(missing_ok=True)
    if not any(folder.iterdir()):
        folder.rmdir()
