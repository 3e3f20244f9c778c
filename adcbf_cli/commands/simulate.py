"""`adcbf simulate`: from a scenario file to a log with ground truth."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

from adcbf_cli.commands import completing
from adcbf_cli.commands.closed_loop import ClosedLoop, run_closed_loop
from adcbf_cli.commands.options import shared_options
from adcbf_cli.commands.terminal import print_json, print_table, progress


@shared_options
def simulate(
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO",
            help="Scenario file (YAML), or one that comes along by name.",
            show_default=False,
            autocompletion=completing.scenarios,
        ),
    ],
    options: ClosedLoop,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="OUT", help="Log, default <stem>.mcap; closed loop: folder, <stem>.runs."
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Instead of the scenario's own seed.")] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="OUT.csv", help="Also write each object's box at each scan.")
    ] = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON document instead of a table.")] = False,
) -> None:
    """Write a simulated log with ground truth, or let planners drive through its world.

    LiDAR by ray casting, odometry and tf, in a world that a scenario file describes. The same scenario and seed give
    the same bytes.

    With --closed-loop the ego drives itself along the scenario's route: each scan is cast from where it is, and
    clustered, tracked and predicted as a log's would be; planners plan with that at 30 Hz. One row a run goes to
    `runs.parquet`, rates with intervals to `report.md`, collisions to logs of their own that `adcbf replay` takes.
    The same command goes on where it was stopped.

    Scenarios that come along: `unstructured` (the paper's world), `crossings` (short random scenes).

    Examples:

        adcbf simulate sample_data/scenario.yaml -o sample.mcap --truth truth.csv

        adcbf simulate crossings --seed 7

        adcbf simulate unstructured --closed-loop -p all --record all

        adcbf simulate crossings --closed-loop --seeds 0:1000 --jobs 8
    """
    from adcbf_cli.core.errors import UsageError
    from adcbf_cli.core.simulation.parsing import parse_scenario
    from adcbf_cli.io.scenarios import read_scenario

    text, stem = read_scenario(scenario)
    parse_scenario(text, scenario, seed)  # here, what is wrong with it is told of the name that was given
    if options.closed_loop:
        if truth is not None:
            raise UsageError("--truth goes with a scripted log; --record all writes each run's log with its truth")
        run_closed_loop(text, stem, options, seed, output, json_output)
        return
    if options.stray():
        raise UsageError(f"{options.stray()[0]} needs --closed-loop")
    log = output if output is not None else Path(f"{stem}.mcap")
    summary = _write_scripted(text, stem, seed, Path(scenario), log, truth)
    if json_output:
        print_json(summary)
    else:
        print_table(
            "Simulated", ("what", "value"), [(key, str(value)) for key, value in summary.items() if value is not None]
        )


def _write_scripted(
    text: str, stem: str, seed: int | None, scenario: Path, log: Path, truth: Path | None
) -> dict[str, Any]:
    """The log of the scenario's own ego, and its truth if asked; what was written, for the user."""
    from adcbf_cli.core.simulation.parsing import parse_scenario
    from adcbf_cli.core.simulation.simulator import Simulator
    from adcbf_cli.io.atomic import atomic_path
    from adcbf_cli.io.simulation_log import write_log, write_scan_truth

    simulator = Simulator(parse_scenario(text, stem, seed), seed)
    _check_targets(scenario, log, truth)
    scans = progress(simulator, simulator.scans, "simulate")
    with ExitStack() as together:
        if truth is not None:  # renamed after the log is, so that the two are never long of different runs
            write_scan_truth(together.enter_context(atomic_path(truth)), simulator)
        points = write_log(log, simulator, scans)
    return {
        "log": str(log),
        "truth": None if truth is None else str(truth),
        "seed": simulator.seed,
        "scans": simulator.scans,
        "points": points,
        "objects": len(simulator.world.movers) + len(simulator.world.statics),
        "bytes": log.stat().st_size,
    }


def _check_targets(scenario: Path, log: Path, truth: Path | None) -> None:
    """Raises UsageError where an output could not be written, before the work is done."""
    from adcbf_cli.core.errors import UsageError
    from adcbf_cli.io.atomic import check_target

    if log.suffix != ".mcap":
        raise UsageError(f"{log}: the log is written as MCAP; name it with .mcap")
    targets = [path for path in (log, truth) if path is not None]
    for path in targets:
        check_target(path)
        if path.resolve() == scenario.resolve():
            raise UsageError(f"{path}: is the scenario itself; give another name")
    if truth is not None and truth.resolve() == log.resolve():
        raise UsageError(f"{truth}: --truth and --output name the same file")
