"""`adcbf simulate`: from a scenario file to a log with ground truth."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    pass


def simulate(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (YAML), see docs/scenarios.md.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT.mcap", help="Log; default: <scenario's stem>.mcap here."),
    ] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Instead of the scenario's own seed.")] = None,
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="OUT.csv", help="Also write each object's box at each scan.")
    ] = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON document instead of a table.")] = False,
) -> None:
    """Write a simulated log with ground truth.

    LiDAR by ray casting, odometry and tf, in a world that a scenario file describes.

    The same scenario and seed give the same bytes.

    Examples:

        adcbf simulate sample_data/scenario.yaml -o sample.mcap --truth truth.csv

        adcbf simulate crossing.yaml --seed 7
    """
    from adcbf_cli.commands.terminal import print_json, print_table, progress
    from adcbf_cli.core.simulation.parsing import parse_scenario
    from adcbf_cli.core.simulation.simulator import Simulator
    from adcbf_cli.io.atomic import atomic_path
    from adcbf_cli.io.simulation_log import write_log, write_scan_truth

    simulator = Simulator(parse_scenario(_read(scenario), scenario.name), seed)
    log = output if output is not None else Path(f"{scenario.stem}.mcap")
    _check_targets(scenario, log, truth)
    scans = progress(simulator, simulator.scans, "simulate")
    with ExitStack() as together:
        if truth is not None:  # renamed after the log is, so that the two are never long of different runs
            write_scan_truth(together.enter_context(atomic_path(truth)), simulator)
        points = write_log(log, simulator, scans)
    summary: dict[str, Any] = {
        "log": str(log),
        "truth": None if truth is None else str(truth),
        "seed": simulator.seed,
        "scans": simulator.scans,
        "points": points,
        "objects": len(simulator.world.movers) + len(simulator.world.statics),
        "bytes": log.stat().st_size,
    }
    if json_output:
        print_json(summary)
    else:
        print_table(
            "Simulated", ("what", "value"), [(key, str(value)) for key, value in summary.items() if value is not None]
        )


def _read(path: Path) -> str:
    """The scenario's text; raises UsageError where there is none."""
    from adcbf_cli.core.errors import UsageError
    from adcbf_cli.core.simulation.parsing import MAX_SCENARIO_CHARACTERS

    try:
        with path.open(encoding="utf-8") as stream:
            return stream.read(MAX_SCENARIO_CHARACTERS + 1)
    except FileNotFoundError as error:
        raise UsageError(f"{path}: no such scenario file") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: not a text file; a scenario is YAML") from error
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error


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
