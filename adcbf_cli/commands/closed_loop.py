"""`adcbf simulate --closed-loop`: planners drive through a scene, over many seeds, in parallel."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from adcbf_cli.commands import completing
from adcbf_cli.commands.options import ConfigFile, Settings, parse_seeds
from adcbf_cli.commands.scene_runs import LOGS, RecordedTask, remove_scene_log, run_and_record
from adcbf_cli.commands.terminal import COMPILING, patience, print_json, print_table, say
from adcbf_cli.core.errors import EXIT_FAILED, EXIT_THRESHOLD, UsageError

if TYPE_CHECKING:
    from adcbf_cli.core.config import Config
    from adcbf_cli.core.evaluation.monte_carlo import MonteCarlo
    from adcbf_cli.core.evaluation.thresholds import Threshold


RESULTS = ("runs.parquet", "report.json", "report.md")
"""What is made of the finished runs' rows, in the folder that holds these."""


@dataclass(frozen=True)
class ClosedLoop:
    """What `simulate --closed-loop` takes beside the scenario."""

    closed_loop: Annotated[
        bool, typer.Option("--closed-loop", help="Let planners drive the ego along the scenario's route.")
    ] = False
    seeds: Annotated[
        str | None, typer.Option("--seeds", metavar="A:B|N,...", help="Closed loop: one run a seed and planner.")
    ] = None
    planner: Annotated[
        list[str] | None,
        typer.Option(
            "--planner",
            "-p",
            metavar="NAME|all",
            help="Closed loop: repeatable; default ad-cbf-mpc.",
            autocompletion=completing.planners,
        ),
    ] = None
    jobs: Annotated[int, typer.Option("--jobs", "-j", min=1, help="Closed loop: runs at once.")] = 1
    knowledge: Annotated[
        str,
        typer.Option(
            "--knowledge",
            metavar="perception|perfect",
            help="Closed loop: what planners know.",
            autocompletion=completing.one_of("perception", "perfect"),
        ),
    ] = "perception"
    record: Annotated[
        str,
        typer.Option(
            "--record",
            metavar="none|collisions|all",
            help="Closed loop: runs to write out as logs.",
            autocompletion=completing.one_of("none", "collisions", "all"),
        ),
    ] = "collisions"
    against: Annotated[
        str | None,
        typer.Option(
            "--against",
            metavar="NAME",
            help="Closed loop: planner that the others are compared with.",
            autocompletion=completing.planners,
        ),
    ] = None
    fail_on: Annotated[
        list[str] | None,
        typer.Option("--fail-on", metavar="METRIC>NUMBER", help="Closed loop: exit with 4 if this holds; repeatable."),
    ] = None
    config: ConfigFile = None
    settings: Settings = None

    def stray(self) -> list[str]:
        """Options given that mean something in a closed loop only."""
        given = {
            "--seeds": self.seeds,
            "--planner": self.planner,
            "--jobs": self.jobs != 1,
            "--knowledge": self.knowledge != "perception",
            "--record": self.record != "collisions",
            "--against": self.against,
            "--fail-on": self.fail_on,
            "--config": self.config,
            "--set": self.settings,
        }
        return [name for name, value in given.items() if value]


def run_closed_loop(
    text: str, stem: str, options: ClosedLoop, seed: int | None, output: Path | None, as_json: bool
) -> None:
    """Runs what is missing of the campaign, and writes its tables and report."""
    from adcbf_cli.commands.campaign import ERROR, run_campaign
    from adcbf_cli.io.atomic import remove_leftovers
    from adcbf_cli.io.plugin_versions import stage_plugins
    from adcbf_cli.io.run_folder import code_version
    from adcbf_cli.io.run_rows import RunRows

    tasks, thresholds = _plan(text, stem, options, seed, output)
    folder = _folder(stem, output)
    first = next(iter(tasks.values()))
    versions = [code_version(), *stage_plugins(first.task.config).values()]
    key = _key(text, first.task.config, options, " ".join(versions))
    with RunRows(folder, "runs", key) as rows:
        remove_leftovers(folder)
        if rows.opened == "replaced":
            say(f"{folder}: held runs of another scene, setting, --knowledge, --record or version; they are replaced")
            _remove_results(folder)
        found = run_campaign(tasks, run_and_record, rows, options.jobs, stem)
        results = [
            {"planner": asked.task.planner, "seed": asked.task.seed} | row
            for asked, row in zip(tasks.values(), found, strict=True)
        ]
        _finish(folder, stem, text, first.task.config, options, results, thresholds, as_json)
    if any(ERROR in row for row in results):
        raise typer.Exit(EXIT_FAILED)


def _plan(
    text: str, stem: str, options: ClosedLoop, seed: int | None, output: Path | None
) -> tuple[dict[str, RecordedTask], list[Threshold]]:
    """Everything that can be wrong in what was asked is found before any work is done. The runs are kept by planner
    and seed, and, of another package's planner, its version."""
    from adcbf_cli.commands.driving import planner_names
    from adcbf_cli.core.config import CLOSED_LOOP
    from adcbf_cli.core.evaluation.monte_carlo import metric_names
    from adcbf_cli.core.evaluation.scene_runs import SceneTask
    from adcbf_cli.core.evaluation.thresholds import check_names, parse_threshold
    from adcbf_cli.core.planning.presets import PLANNERS, make_planner
    from adcbf_cli.core.replay.routes import check_duration
    from adcbf_cli.core.replay.sensor_loop import route_of
    from adcbf_cli.core.simulation.parsing import parse_scenario
    from adcbf_cli.core.types import Notes
    from adcbf_cli.core.vehicles.vehicle import Vehicle
    from adcbf_cli.io.plugin_versions import planner_plugins
    from adcbf_cli.io.settings import resolve_config

    if seed is not None and options.seeds is not None:
        raise UsageError("--seed and --seeds both say which scenes to draw; give one")
    names = planner_names(options.planner)
    knowledge = _choice("--knowledge", options.knowledge, ("perception", "perfect"))
    record = _choice("--record", options.record, ("none", "collisions", "all"))
    if options.against is not None and options.against not in names:
        raise UsageError(f"--against {options.against}: not among the planners that run: {', '.join(names)}")
    thresholds = [parse_threshold(word) for word in options.fail_on or []]
    check_names(thresholds, metric_names(names))
    config = resolve_config(CLOSED_LOOP, options.config, options.settings or ())
    seeds = None if options.seeds is None else parse_seeds(options.seeds)
    scenario = parse_scenario(text, stem, seed if seeds is None else seeds[0])
    check_duration(route_of(scenario, config), config)
    vehicle = Vehicle.from_config(config.vehicle)
    with patience(COMPILING):
        for name in names:
            make_planner(name, vehicle, config.planning, Notes())
    logs = _folder(stem, output) / LOGS
    tasks = [
        SceneTask(text, stem, number, name, config, knowledge)  # type: ignore[arg-type]
        for number in seeds or (scenario.seed,)
        for name in names
    ]
    versions = planner_plugins(names, PLANNERS)
    run_ids = [" ".join([task.run_id, *filter(None, [versions.get(task.planner)])]) for task in tasks]
    recorded = [RecordedTask(task, record, logs) for task in tasks]  # type: ignore[arg-type]
    return dict(zip(run_ids, recorded, strict=True)), thresholds


def _folder(stem: str, output: Path | None) -> Path:
    """Where the runs go; UsageError where something else is there that they would overwrite."""
    from adcbf_cli.io.run_folder import RunFolder

    folder = Path(f"{stem}.runs") if output is None else output
    if folder.exists() and not folder.is_dir():
        raise UsageError(f"{folder}: is a file; the runs of a closed loop go into a folder")
    if RunFolder.is_one(folder):
        raise UsageError(f"{folder}: is the run folder of a log; choose another with -o")
    if not (folder / "runs.jsonl").exists():
        for name in RESULTS:
            if (folder / name).exists():
                raise UsageError(f"{folder / name}: would be overwritten; move it, or choose another folder with -o")
    return folder


def _choice(option: str, given: str, known: Sequence[str]) -> str:
    if given not in known:
        raise UsageError(f"{option} {given!r}: must be one of {', '.join(known)}")
    return given


def _key(text: str, config: Config, options: ClosedLoop, version: str) -> str:
    """Of all that a run's row depends on, but for its seed and planner."""
    parts = [text, config.model_dump_json(), options.knowledge, options.record, version]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _remove_results(folder: Path) -> None:
    """What was made of the rows that are gone, and nothing else that lies in the folder."""
    for name in RESULTS:
        (folder / name).unlink(missing_ok=True)
    for log in (folder / LOGS).glob("*/"):
        remove_scene_log(log)


def _finish(
    folder: Path,
    stem: str,
    text: str,
    config: Config,
    options: ClosedLoop,
    results: list[dict[str, Any]],
    thresholds: list[Threshold],
    as_json: bool,
) -> None:
    """Table, report, the terminal's table, thresholds."""
    from adcbf_cli.commands.campaign import ERROR
    from adcbf_cli.core.evaluation import monte_carlo
    from adcbf_cli.core.evaluation.report import Report
    from adcbf_cli.core.evaluation.thresholds import missed
    from adcbf_cli.core.planning.presets import PLANNERS
    from adcbf_cli.io.atomic import write_text_atomically
    from adcbf_cli.io.plugin_versions import planner_plugins, stage_plugins
    from adcbf_cli.io.run_folder import code_version
    from adcbf_cli.io.run_tables import write_runs

    finished = dict.fromkeys(row["planner"] for row in results if ERROR not in row)
    against = options.against or (next(iter(finished)) if len(finished) > 1 else None)
    if against not in finished:  # the rates of the others still stand
        against = None
    study: MonteCarlo = monte_carlo.study(results, against)
    report = Report()
    report.metrics |= study.metrics()
    failures = missed(thresholds, report)
    provenance = {
        "scenario": {"name": stem, "sha256": hashlib.sha256(text.encode()).hexdigest()},
        "knowledge": options.knowledge,
        "config": config.model_dump(mode="json"),
        "plugins": {**stage_plugins(config), **planner_plugins(finished, PLANNERS)},
        "adcbf": code_version(),
    }
    document: dict[str, Any] = {
        "schema_version": 1,
        "mode": "closed loop, simulated",
        **provenance,
        "thresholds_missed": failures,
        "study": study.to_dict(),
    }
    write_runs(folder / "runs.parquet", results, provenance)
    write_text_atomically(folder / "report.json", json.dumps(document, indent=2, allow_nan=False) + "\n")
    write_text_atomically(folder / "report.md", _heading(stem, options) + study.markdown())
    if as_json:
        print_json(document)
    else:
        print_table(f"{folder}: closed loop, simulated", *study.headline())
        say(f"all rates, intervals, differences and runs: {folder / 'report.md'}, {folder / 'runs.parquet'}")
    for line in failures:
        say(f"threshold missed: {line}")
    if failures:
        raise typer.Exit(EXIT_THRESHOLD)


def _heading(stem: str, options: ClosedLoop) -> str:
    seen = "what their own simulated LiDAR saw" if options.knowledge == "perception" else "everything, as it is"
    return (
        f"# Closed loop in simulated scenes\n\nScenario: {stem}. Planners know {seen}. "
        "Movers follow their script and do not react.\n\n"
    )
