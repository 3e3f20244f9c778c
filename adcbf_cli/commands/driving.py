"""What `plan` and `replay` share: predictions of a run, a route, planners, then tables and a report.

run folder -> predictions --+
ground truth or tracks -> world --> open loop or closed loop -> drives -> tables, comparison
log, CSV, topic -> route --------+
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import typer

from adcbf_cli.commands.options import Driving, Shared, parse_seeds
from adcbf_cli.commands.plugin_hints import tell_overshadowed
from adcbf_cli.commands.terminal import COMPILING, patience, print_json, print_table, progress, say, show_notes
from adcbf_cli.core.errors import EXIT_THRESHOLD, AdcbfError, UsageError

if TYPE_CHECKING:
    from adcbf_cli.commands.stages import Job, Outcome
    from adcbf_cli.core.config import Config
    from adcbf_cli.core.evaluation.thresholds import Threshold
    from adcbf_cli.core.planning.planner import Planner
    from adcbf_cli.core.planning.reference import ReferencePath
    from adcbf_cli.core.replay.log_path import LogPath
    from adcbf_cli.core.replay.records import Drive
    from adcbf_cli.core.replay.routes import Start
    from adcbf_cli.core.replay.world import RecordedWorld
    from adcbf_cli.core.types import FloatArray, Notes, Predictions
    from adcbf_cli.core.vehicles.vehicle import Vehicle


@dataclass(frozen=True)
class Setting:
    """Everything that a drive happens in."""

    outcome: Outcome
    config: Config
    vehicle: Vehicle
    world: RecordedWorld
    world_source: str
    log_path: LogPath
    route: ReferencePath
    planners: tuple[str, ...]
    notes: Notes

    def planner(self, name: str) -> Planner:
        from adcbf_cli.core.planning.presets import make_planner

        return make_planner(name, self.vehicle, self.config.planning, self.notes)

    def predictions(self) -> Iterator[Predictions]:
        from adcbf_cli.io.tables import read_predictions

        total = self.outcome.manifest.stages["cluster"].rows.get("frames")
        return progress(read_predictions(self.outcome.folder.path), total, " + ".join(self.planners[:3]))


def run_open_loop(shared: Shared, driving: Driving) -> None:
    """`adcbf plan`."""
    job, thresholds, names = _prepare(shared, driving, "plan")
    setting = _set_up(job, shared, driving, "plan", names)
    from adcbf_cli.core.replay.open_loop import logged_drive, plan_along

    drives = plan_along(
        [setting.planner(name) for name in names],
        setting.predictions(),
        setting.world,
        setting.log_path,
        setting.route,
        setting.vehicle,
        setting.config,
        time.perf_counter_ns,
        setting.notes,
    )
    drives.append(logged_drive(setting.log_path, setting.world, setting.route, setting.vehicle, setting.config))
    _finish(setting, "plan", drives, driving, shared, thresholds)


def run_replay(shared: Shared, driving: Driving, start: str | None, seeds: str) -> None:
    """`adcbf replay`."""
    numbers = parse_seeds(seeds)
    place = None if start is None else parse_numbers("--start", start, (2, 3))
    job, thresholds, names = _prepare(shared, driving, "replay")
    setting = _set_up(job, shared, driving, "replay", names, place)
    from adcbf_cli.core.replay.closed_loop import replay
    from adcbf_cli.core.replay.open_loop import logged_drive
    from adcbf_cli.core.replay.records import LOGGED
    from adcbf_cli.core.replay.routes import check_duration, entries_for

    check_duration(setting.route, setting.config)
    if driving.against == LOGGED and not _follows_log(setting, driving):
        raise UsageError(f"--against {LOGGED}: the log's own vehicle drove no such way, so there is nothing to compare")
    first = _first_start(setting, place, driving)
    entries = entries_for(
        names, numbers, setting.planner, setting.route, first, setting.world, setting.vehicle, setting.config
    )
    drives = replay(
        entries,
        setting.predictions(),
        setting.world,
        setting.log_path,
        setting.vehicle,
        setting.config,
        time.perf_counter_ns,
        setting.notes,
    )
    if _follows_log(setting, driving):
        drives.append(logged_drive(setting.log_path, setting.world, setting.route, setting.vehicle, setting.config))
    _finish(setting, "replay", drives, driving, shared, thresholds)


def _follows_log(setting: Setting, driving: Driving) -> bool:
    """Whether the route is the way that the log's own vehicle took."""
    return setting.log_path.known and driving.goal is None and driving.reference is None


def parse_numbers(option: str, text: str, counts: tuple[int, ...]) -> FloatArray:
    """Comma-separated finite numbers, as many as one of `counts`. UsageError otherwise."""
    try:
        numbers = np.array([float(word) for word in text.split(",")])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) not in counts or not (np.abs(numbers) < 1e7).all():
        raise UsageError(f"{option} {text!r}: expected {' or '.join(map(str, counts))} numbers, such as 3.5,-1")
    return numbers


def planner_names(asked: Sequence[str] | None) -> tuple[str, ...]:
    """The planners to run, each once, in the order given."""
    from adcbf_cli.core.planning.presets import PLANNERS
    from adcbf_cli.core.plugins import Kind

    wanted = asked or ["ad-cbf-mpc"]
    names = tuple(dict.fromkeys(name for word in wanted for name in (PLANNERS if word == "all" else (word,))))
    tell_overshadowed(Kind.PLANNER, [name for name in names if name in PLANNERS])
    return names


def _prepare(shared: Shared, driving: Driving, kind: str) -> tuple[Job, list[Threshold], tuple[str, ...]]:
    """Everything that can be wrong in what was asked is found before any work is done."""
    from adcbf_cli.commands.stages import plan_job
    from adcbf_cli.core.evaluation.comparison import metric_names
    from adcbf_cli.core.evaluation.thresholds import check_names, parse_threshold
    from adcbf_cli.core.replay.records import LOGGED
    from adcbf_cli.core.replay.routes import reference_speed
    from adcbf_cli.io.reference import check_reference

    names = planner_names(driving.planner)
    thresholds = [parse_threshold(text) for text in driving.fail_on or []]
    check_names(thresholds, metric_names("plan" if kind == "plan" else "replay", (*names, LOGGED)))
    if driving.against is not None and driving.against not in (*names, LOGGED):
        raise UsageError(f"--against {driving.against}: not among the planners that run: {', '.join(names)}")
    if driving.goal is not None and driving.reference is not None:
        raise UsageError("--goal and --reference both say where to go; give one")
    if driving.goal is not None:
        parse_numbers("--goal", driving.goal, (2,))
    if driving.reference is not None:
        check_reference(driving.reference)
    job = plan_job(shared, driving.overrides())
    reference_speed(job.config)
    return job, thresholds, names


def _set_up(
    job: Job,
    shared: Shared,
    driving: Driving,
    kind: str,
    names: tuple[str, ...],
    start: FloatArray | None = None,
) -> Setting:
    """Runs the stages that are missing, and puts together what drives happen in."""
    from adcbf_cli.commands.evaluate import placed_truth
    from adcbf_cli.commands.stages import run_stages
    from adcbf_cli.core.planning.presets import make_planner
    from adcbf_cli.core.replay.world_sources import world_of
    from adcbf_cli.core.types import Notes
    from adcbf_cli.core.vehicles.vehicle import Vehicle
    from adcbf_cli.io.logs import is_object_list
    from adcbf_cli.io.tables import read_tracks
    from adcbf_cli.io.truth import read_truth, read_truth_option

    spec = str(job.log) if driving.truth is None and is_object_list(job.log) else driving.truth
    read = read_truth if driving.truth is None else read_truth_option
    place_truth = None if spec is None else read(spec, job.log)
    vehicle = Vehicle.from_config(job.config.vehicle)
    with patience(COMPILING):
        for name in names:  # an unusable setting is told before the stages run
            make_planner(name, vehicle, job.config.planning, Notes())
    outcome = run_stages(job, "predict", shared.force)
    if not outcome.manifest.stages["predict"].rows.get("predictions"):
        raise AdcbfError(
            f"{outcome.folder.path}: no predictions: no obstacle was ever confirmed in this log; "
            "look farther with --range, or at `adcbf track`"
        )
    notes = outcome.notes
    truth = None if place_truth is None else placed_truth(place_truth, job, outcome, notes)
    world, world_source = world_of(truth, read_tracks(outcome.folder.path), job.config)
    log_path = _log_path(job, outcome, kind)
    frame = outcome.manifest.selection.get("world_frame")
    route = _route(job, driving, log_path, world, frame, start, _speed(job.config, log_path, kind))
    return Setting(outcome, job.config, vehicle, world, world_source, log_path, route, names, notes)


def _speed(config: Config, log_path: LogPath, kind: str) -> float:
    """Speed along the route. Open loop: the log's own, unless set; a plan at another speed would differ from what
    the vehicle did for that reason alone."""
    from adcbf_cli.core.replay.routes import logged_speed, reference_speed

    if kind == "plan" and log_path.known and config.planning.reference_speed_mps is None:
        return min(logged_speed(log_path), config.vehicle.max_speed_mps)
    return reference_speed(config)


def _log_path(job: Job, outcome: Outcome, kind: str) -> LogPath:
    """Where the log's vehicle was, if it says so: open loop has no state to plan from else."""
    from adcbf_cli.core.replay.log_path import LogPath
    from adcbf_cli.io.tables import read_clusters

    path = LogPath.from_frames(read_clusters(outcome.folder.path))
    if kind == "plan" and not path.known:
        raise UsageError(
            f"{job.log}: no vehicle drove here, as far as the log says (--pose): there is no state to plan from"
        )
    return path


def _route(
    job: Job,
    driving: Driving,
    log_path: LogPath,
    world: RecordedWorld,
    world_frame: str | None,
    start: FloatArray | None,
    speed_mps: float,
) -> ReferencePath:
    """The path to follow: the user's points, a straight line to the user's goal, or the log's own way."""
    from adcbf_cli.core.planning.reference import ReferencePath
    from adcbf_cli.core.replay.routes import map_box, route_between, route_from_log
    from adcbf_cli.io.reference import read_reference

    box = map_box(log_path, world, job.config.perception.range_m)
    if driving.reference is not None:
        points = read_reference(driving.reference, job.log, world_frame)
        route = ReferencePath(points, speed_mps)
        box.check("reference's end", route.goal_m)
        return route
    if driving.goal is not None:
        goal = parse_numbers("--goal", driving.goal, (2,))
        here = log_path.pose[0] if start is None else start
        if not np.isfinite(here).all():
            raise UsageError(f"{job.log}: no vehicle drove here; --goal needs --start X,Y too")
        return route_between(here[:2], goal, speed_mps, box)
    if not log_path.known:
        raise UsageError(
            f"{job.log}: no vehicle drove here, as far as the log says (--pose): "
            "say where from and where to, --start X,Y --goal X,Y"
        )
    return route_from_log(log_path, speed_mps)


def _first_start(setting: Setting, place: FloatArray | None, driving: Driving) -> Start:
    """Where seed 0 starts: where the user says, else with the log, else standing at the route's start."""
    from adcbf_cli.core.replay.routes import Start, log_start

    if place is None:
        own_way = _follows_log(setting, driving)
        return log_start(setting.log_path, setting.route, setting.vehicle, from_log=own_way)
    pose = setting.route.at(np.zeros(1))[0]
    pose[: len(place)] = place
    return Start(setting.log_path.start_ns, pose, np.zeros(2))


def _finish(
    setting: Setting,
    kind: str,
    drives: list[Drive],
    driving: Driving,
    shared: Shared,
    thresholds: list[Threshold],
) -> None:
    """Tables, report, the terminal's table, thresholds, exit code."""
    from adcbf_cli.commands.driving_report import driving_document, write_driving
    from adcbf_cli.commands.summary import exit_for
    from adcbf_cli.commands.viz import write_viz
    from adcbf_cli.core.evaluation.comparison import add_to_report, compare
    from adcbf_cli.core.evaluation.comparison_text import headline
    from adcbf_cli.core.evaluation.report import Report
    from adcbf_cli.core.evaluation.thresholds import missed

    against = driving.against or (setting.planners[0] if len(setting.planners) > 1 else None)
    comparison = compare(drives, setting.config.replay, setting.config.planning, against)
    report = Report()
    add_to_report(comparison, report)
    failures = missed(thresholds, report)
    document = driving_document(setting, kind, drives, comparison, failures)
    folder = write_driving(setting, kind, drives, comparison, document)
    write_viz(setting.outcome, shared.viz)
    if shared.json_output:
        print_json(document)
    else:
        title = "closed loop, counterfactual" if kind == "replay" else "open loop"
        print_table(f"{folder}: {title}", *headline(comparison))
        say(f"world: {setting.world_source}; route {setting.route.length_m:.1f} m at {setting.route.speed_mps:g} m/s")
        say(f"all metrics, intervals, differences and definitions: {folder / 'report.md'}")
    show_notes(setting.notes)
    for line in failures:
        say(f"threshold missed: {line}")
    if failures:
        raise typer.Exit(EXIT_THRESHOLD)
    exit_for(setting.outcome)
