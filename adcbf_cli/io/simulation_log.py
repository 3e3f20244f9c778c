"""A simulated drive as a log: scans, odometry, transforms, and the ground truth beside it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from adcbf_cli.core.frames import wrap_angle
from adcbf_cli.core.simulation.objects import TruthBox
from adcbf_cli.core.simulation.simulator import SimulatedScan, Simulator
from adcbf_cli.core.types import FloatArray, IntArray
from adcbf_cli.io.mcap_writer import LaserSweep, LogWriter, open_log
from adcbf_cli.io.truth_writer import write_truth

ODOM_TOPIC = "/odom"
ODOM_FRAME = "odom"
BASE_FRAME = "base_link"
TRUTH_BLOCK = 100
"""Scans whose truth is held at once."""


def write_scan_truth(path: Path, simulator: Simulator) -> None:
    """Every object's box at each scan, as CSV. `path` is for the caller to make atomic."""
    write_truth(path, _truth_blocks(simulator))


def _truth_blocks(simulator: Simulator) -> Iterator[tuple[IntArray, list[TruthBox]]]:
    stamps = simulator.stamps()
    for first in range(0, len(stamps), TRUTH_BLOCK):
        block = stamps[first : first + TRUTH_BLOCK]
        yield block, simulator.truth(block)


def write_log(path: Path, simulator: Simulator, scans: Iterable[SimulatedScan]) -> int:
    """Writes the scans with odometry, /tf and /tf_static as a log; returns the number of points. A
    scan is logged when it ends, as a driver would publish it."""
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
    """Odometry samples with velocities as the change to the next. A script's last sample is there for that only; a
    drive's is written too, with the velocity before: its last scan is placed by it."""
    stamps = simulator.odometry_ns
    pose = simulator.odom_from_base(stamps)
    seconds = np.diff(stamps) / 1e9
    speed = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1) / seconds
    turn = wrap_angle(np.diff(np.arctan2(pose[:, 1, 0], pose[:, 0, 0]))) / seconds
    if len(stamps) == 1:  # it collided where it stood
        speed = turn = np.zeros(1)
    for index, stamp in enumerate(stamps[:-1] if simulator.scripted else stamps):
        known = min(index, len(speed) - 1)
        yield _OdometrySample(int(stamp), pose[index], float(speed[known]), float(turn[known]))


def _write_odometry(log: LogWriter, sample: _OdometrySample) -> None:
    log.write_odometry(
        ODOM_TOPIC, ODOM_FRAME, BASE_FRAME, sample.stamp_ns, sample.pose, sample.speed_mps, sample.turn_radps
    )
    log.write_transform(ODOM_FRAME, BASE_FRAME, sample.stamp_ns, sample.pose)


def _write_scan(log: LogWriter, simulator: Simulator, simulated: SimulatedScan, log_ns: int) -> None:
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
