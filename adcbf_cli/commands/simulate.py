"""`adcbf simulate`: from a scenario file to a log with ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

if TYPE_CHECKING:
    from adcbf_cli.core.simulation.objects import TruthBox
    from adcbf_cli.core.simulation.simulator import SimulatedScan, Simulator
    from adcbf_cli.core.types import FloatArray, IntArray
    from adcbf_cli.io.mcap_writer import LogWriter

ODOM_TOPIC = "/odom"
ODOM_FRAME = "odom"
BASE_FRAME = "base_link"
TRUTH_BLOCK = 100
"""Scans whose truth is held at once."""


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
    from adcbf_cli.io.truth_writer import write_truth

    simulator = Simulator(parse_scenario(_read(scenario), scenario.name), seed)
    log = output if output is not None else Path(f"{scenario.stem}.mcap")
    _check_targets(scenario, log, truth)
    scans = progress(simulator, simulator.scans, "simulate")
    with ExitStack() as together:
        if truth is not None:  # renamed after the log is, so that the two are never long of different runs
            write_truth(together.enter_context(atomic_path(truth)), _truth_blocks(simulator))
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


def _truth_blocks(simulator: Simulator) -> Iterator[tuple[IntArray, list[TruthBox]]]:
    stamps = simulator.stamps()
    for first in range(0, len(stamps), TRUTH_BLOCK):
        block = stamps[first : first + TRUTH_BLOCK]
        yield block, simulator.truth(block)


def write_log(path: Path, simulator: Simulator, scans: Iterable[SimulatedScan]) -> int:
    """Writes the scans with odometry, /tf and /tf_static as a log; returns the number of points. A
    scan is logged when it ends, as a driver would publish it."""
    from adcbf_cli.io.mcap_writer import open_log

    points = 0
    with open_log(path) as log:
        lidar = simulator.scenario.lidar
        log.write_transform(
            BASE_FRAME, lidar.frame_id, simulator.world.start_ns, simulator.base_from_sensor, static=True
        )
        waiting = _odometry(simulator)
        upcoming = next(waiting, None)
        for simulated in scans:
            end_ns = simulated.scan.stamp_ns + (0 if lidar.instantaneous else simulator.pattern.period_ns)
            while upcoming is not None and upcoming.stamp_ns <= end_ns:
                _write_odometry(log, upcoming)
                upcoming = next(waiting, None)
            _write_scan(log, simulator, simulated, end_ns)
            points += len(simulated.scan.points_m)
        while upcoming is not None:
            _write_odometry(log, upcoming)
            upcoming = next(waiting, None)
    return points


class _OdometrySample(NamedTuple):
    stamp_ns: int
    pose: FloatArray
    speed_mps: float
    turn_radps: float


def _odometry(simulator: Simulator) -> Iterator[_OdometrySample]:
    """Odometry samples up to the last but one, with velocities as the change to the next."""
    import numpy as np

    from adcbf_cli.core.frames import wrap_angle

    stamps = simulator.odometry_ns
    pose = simulator.odom_from_base(stamps)
    seconds = np.diff(stamps) / 1e9
    speed = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1) / seconds
    turn = wrap_angle(np.diff(np.arctan2(pose[:, 1, 0], pose[:, 0, 0]))) / seconds
    for index, stamp in enumerate(stamps[:-1]):
        yield _OdometrySample(int(stamp), pose[index], float(speed[index]), float(turn[index]))


def _write_odometry(log: LogWriter, sample: _OdometrySample) -> None:
    log.write_odometry(
        ODOM_TOPIC, ODOM_FRAME, BASE_FRAME, sample.stamp_ns, sample.pose, sample.speed_mps, sample.turn_radps
    )
    log.write_transform(ODOM_FRAME, BASE_FRAME, sample.stamp_ns, sample.pose)


def _write_scan(log: LogWriter, simulator: Simulator, simulated: SimulatedScan, log_ns: int) -> None:
    from adcbf_cli.io.mcap_writer import LaserSweep

    scan = simulated.scan
    if not scan.planar:
        log.write_cloud(scan, log_ns)
        return
    lidar, pattern = simulator.scenario.lidar, simulator.pattern
    azimuth = pattern.azimuth_rad
    step = float(azimuth[1] - azimuth[0]) if len(azimuth) > 1 else 0.0
    ray_time = float(pattern.offset_ns[-1]) / 1e9 / max(1, len(azimuth) - 1)
    sweep = LaserSweep(float(azimuth[0]), step, ray_time, pattern.period_ns / 1e9, lidar.min_range_m, lidar.max_range_m)
    log.write_laser_scan(scan.topic, scan.frame_id, scan.stamp_ns, log_ns, simulated.range_m[:, 0], sweep)


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
