"""A scenario, run: one scan after another with the poses and the truth that belong to it.

No file is needed: tests, benchmarks and closed-loop replay take scans from here; `adcbf simulate`
writes them to a log.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.frames import invert, transform_points
from adcbf_cli.core.simulation.lidar import base_from_sensor, firing_pattern, measured_ranges, quantise
from adcbf_cli.core.simulation.objects import TruthBox
from adcbf_cli.core.simulation.odometry import simulate_drift
from adcbf_cli.core.simulation.paths import ego_path, motion_along
from adcbf_cli.core.simulation.poses import compose
from adcbf_cli.core.simulation.randomness import Purpose, generator
from adcbf_cli.core.simulation.scenario import PlanarLaser, Scenario
from adcbf_cli.core.simulation.terrain import rest_on_wheels
from adcbf_cli.core.simulation.world import NS_PER_S, World
from adcbf_cli.core.types import FloatArray, Frame, IntArray, Scan


@dataclass(frozen=True, slots=True)
class SimulatedScan:
    """One scan with what was true at its stamp.

    scan: as a driver would publish it, in the sensor's frame, not corrected for motion.
    range_m: (columns, channels) the measured ranges, inf without a return.
    frame: the same scan placed in the world by the odometry, corrected for the ego's motion.
    object_id: (n,) the truth id that each point lies on, NO_ID for the ground.
    world_from_base, odom_from_base: (4, 4) at the stamp; they differ by the odometry's drift.
    """

    scan: Scan
    range_m: FloatArray
    frame: Frame
    object_id: IntArray
    world_from_base: FloatArray
    odom_from_base: FloatArray


class Simulator:
    """A scenario and seed, ready to run. `seed` None takes the scenario's own."""

    def __init__(self, scenario: Scenario, seed: int | None = None) -> None:
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        self.world = World(scenario, self.seed)
        self.pattern = firing_pattern(scenario.lidar)
        self.base_from_sensor = base_from_sensor(scenario.lidar.mount)
        self._path = ego_path(scenario)
        self.scans = int(np.floor(scenario.duration_s * scenario.lidar.rate_hz + 1e-9))
        self.odometry_ns = self._odometry_stamps()
        time_s = self.world.seconds(self.odometry_ns)
        self._drift = simulate_drift(
            scenario.odometry, time_s, self.world_from_base(self.odometry_ns), generator(self.seed, Purpose.ODOMETRY)
        )

    def stamps(self) -> IntArray:
        """(scans,) each scan's stamp."""
        return self.world.start_ns + np.arange(self.scans, dtype=np.int64) * self.pattern.period_ns

    def _odometry_stamps(self) -> IntArray:
        """Stamps from the first scan's to the last one's end, and one beyond."""
        step = round(NS_PER_S / self.scenario.odometry.rate_hz)
        length = self.scans * self.pattern.period_ns
        return self.world.start_ns + np.arange(-(-length // step) + 2, dtype=np.int64) * step

    def world_from_base(self, time_ns: IntArray) -> FloatArray:
        """(n, 4, 4) the ego's true pose at (n,) times."""
        ego = self.scenario.ego
        motion = motion_along(self._path, self.world.seconds(time_ns))
        return rest_on_wheels(self.world.ground, motion.x_m, motion.y_m, motion.yaw_rad, ego.wheelbase_m, ego.track_m)

    def odom_from_base(self, time_ns: IntArray) -> FloatArray:
        """(n, 4, 4) the pose that odometry reports."""
        return compose(self._drift.at(self.world.seconds(time_ns)), self.world_from_base(time_ns))

    def truth(self, time_ns: IntArray) -> list[TruthBox]:
        """Every object's box at (n,) times, by id."""
        return self.world.truth(time_ns)

    def __iter__(self) -> Iterator[SimulatedScan]:
        for index, stamp_ns in enumerate(self.stamps()):
            yield self._scan(index, int(stamp_ns))

    def _scan(self, index: int, stamp_ns: int) -> SimulatedScan:
        lidar = self.scenario.lidar
        time_ns = stamp_ns + self.pattern.offset_ns
        world_from_sensor = compose(self.world_from_base(time_ns), self.base_from_sensor)
        hits = self.world.cast(
            time_ns, world_from_sensor, self.pattern.directions, lidar.max_range_m + 6 * lidar.range_sigma_m
        )
        ranges = measured_ranges(hits.range_m, lidar, generator(self.seed, Purpose.RANGING, index))
        planar = isinstance(lidar, PlanarLaser)
        if planar:
            ranges = quantise(ranges)
        column, channel = np.nonzero(np.isfinite(ranges))
        points = ranges[column, channel, None] * self.pattern.directions[column, channel]
        if not planar:
            points = quantise(points)
        offset = None if lidar.instantaneous else self.pattern.offset_ns[column]
        scan = Scan(stamp_ns, lidar.frame_id, lidar.topic, points, offset, planar)
        return SimulatedScan(
            scan=scan,
            range_m=ranges,
            frame=self._place(index, scan, column),
            object_id=hits.object_id[column, channel],
            world_from_base=self.world_from_base(np.array([stamp_ns]))[0],
            odom_from_base=self.odom_from_base(np.array([stamp_ns]))[0],
        )

    def _place(self, index: int, scan: Scan, column: IntArray) -> Frame:
        """The scan as a Frame, every point carried from its own firing's pose to the stamp's."""
        at_stamp = self.odom_from_base(np.array([scan.stamp_ns]))[0] @ self.base_from_sensor
        points = scan.points_m if self.scenario.lidar.instantaneous else self._corrected(scan, column, at_stamp)
        return Frame(
            index=index,
            stamp_ns=scan.stamp_ns,
            points_m=points,
            world_from_sensor=at_stamp,
            planar=scan.planar,
            pose_known=True,
        )

    def _corrected(self, scan: Scan, column: IntArray, at_stamp: FloatArray) -> FloatArray:
        """The scan's points as seen from the sensor's pose at the stamp."""
        at_firing = compose(self.odom_from_base(scan.stamp_ns + self.pattern.offset_ns), self.base_from_sensor)
        at_stamp = self.odom_from_base(np.array([scan.stamp_ns]))[0] @ self.base_from_sensor
        rotation, shift = at_firing[column, :3, :3], at_firing[column, :3, 3]
        in_world = np.einsum("nij,nj->ni", rotation, scan.points_m) + shift
        return transform_points(invert(at_stamp), in_world)
