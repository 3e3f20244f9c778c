"""A scenario, run: one scan after another with the poses and the truth that belong to it.

No file is needed: tests, benchmarks and closed loops take scans from here; `adcbf simulate` writes
them to a log. The ego goes as its scenario scripts it, or as a vehicle drives it while scans are taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.deskew import knot_offsets_ns, move_points
from adcbf_cli.core.frames import Trajectory, invert, pose_matrix, quaternion_from_rotation
from adcbf_cli.core.simulation.driven import EgoMotion, ScriptedMotion
from adcbf_cli.core.simulation.lidar import base_from_sensor, firing_pattern, measured_ranges, quantise
from adcbf_cli.core.simulation.objects import TruthBox
from adcbf_cli.core.simulation.odometry import Drift, as_recorded, simulate_drift
from adcbf_cli.core.simulation.poses import compose
from adcbf_cli.core.simulation.randomness import Purpose, generator
from adcbf_cli.core.simulation.scenario import PlanarLaser, Scenario
from adcbf_cli.core.simulation.terrain import rest_on_wheels
from adcbf_cli.core.simulation.world import NS_PER_S, World
from adcbf_cli.core.types import FloatArray, Frame, IntArray, Scan

ALL_POSES_NS = 3600 * NS_PER_S
"""Odometry samples are never this far apart: every two neighbours are interpolated."""


@dataclass(frozen=True, slots=True)
class SimulatedScan:
    """One scan with what was true at its stamp.

    scan: as a driver would publish it, in the sensor's frame, not corrected for motion.
    range_m: (columns, channels) the measured ranges, inf without a return.
    frame: the same scan placed in the world by the odometry, corrected for the ego's motion, as
        reading the log back would.
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
    """A scenario and seed, ready to run. `seed` None takes the scenario's own; `motion` None its own ego.

    scripted: whether the ego is the scenario's own. A motion may still grow: `scan` and `odom_from_base` answer for
    what lies before its end.
    """

    def __init__(self, scenario: Scenario, seed: int | None = None, motion: EgoMotion | None = None) -> None:
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        self.world = World(scenario, self.seed)
        self.pattern = firing_pattern(scenario.lidar)
        self.base_from_sensor = base_from_sensor(scenario.lidar.mount)
        self._motion: EgoMotion = ScriptedMotion(scenario) if motion is None else motion
        self.scripted = motion is None
        self._odometry_step_ns = round(NS_PER_S / scenario.odometry.rate_hz)
        self._mount = pose_matrix(*_as_recorded(self.base_from_sensor))
        self._odometry_ns: list[int] = []
        self._true_poses = np.zeros((0, 4, 4))
        self._drift: Drift | None = None
        self._reported = Trajectory()
        self._follow_odometry()

    @property
    def scans(self) -> int:
        """How many scans end before the motion does."""
        length_ns = self._motion.end_ns - self.world.start_ns
        if self.scripted:
            return length_ns // self.pattern.period_ns
        count = max(0, (length_ns - int(self.pattern.offset_ns.max())) // self.pattern.period_ns + 1)
        while count and self._until_pose_ns(count - 1) > length_ns:
            count -= 1
        return count

    @property
    def odometry_ns(self) -> IntArray:
        """(k,) stamps of the odometry so far; a script's go one step beyond its end."""
        self._follow_odometry()
        return np.array(self._odometry_ns, dtype=np.int64)

    def stamps(self) -> IntArray:
        """(scans,) each scan's stamp."""
        return self.world.start_ns + np.arange(self.scans, dtype=np.int64) * self.pattern.period_ns

    def ready_ns(self, index: int) -> int:
        """When a scan can be read: it has ended, and the odometry of its end has come."""
        return self.world.start_ns + self._until_pose_ns(index)

    def _until_pose_ns(self, index: int) -> int:
        end_ns = index * self.pattern.period_ns + int(self.pattern.offset_ns.max())
        return -(-end_ns // self._odometry_step_ns) * self._odometry_step_ns

    def world_from_base(self, time_ns: IntArray) -> FloatArray:
        """(n, 4, 4) the ego's true pose at (n,) times."""
        ego = self.scenario.ego
        place = self._motion.at(time_ns)
        return rest_on_wheels(self.world.ground, place[:, 0], place[:, 1], place[:, 2], ego.wheelbase_m, ego.track_m)

    def odom_from_base(self, time_ns: IntArray) -> FloatArray:
        """(n, 4, 4) the pose that odometry reports."""
        self._follow_odometry()
        assert self._drift is not None
        return compose(self._drift.at(self.world.seconds(time_ns)), self.world_from_base(time_ns))

    def truth(self, time_ns: IntArray) -> list[TruthBox]:
        """Every object's box at (n,) times, by id."""
        return self.world.truth(time_ns)

    def __iter__(self) -> Iterator[SimulatedScan]:
        for index in range(self.scans):
            yield self.scan(index)

    def scan(self, index: int) -> SimulatedScan:
        """The index-th scan. ValueError where the ego has not driven that far yet."""
        lidar = self.scenario.lidar
        stamp_ns = self.world.start_ns + index * self.pattern.period_ns
        time_ns = stamp_ns + self.pattern.offset_ns
        world_from_sensor = self._true_sensor(time_ns)
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
            frame=self._place(index, scan),
            object_id=hits.object_id[column, channel],
            world_from_base=self.world_from_base(np.array([stamp_ns]))[0],
            odom_from_base=self.odom_from_base(np.array([stamp_ns]))[0],
        )

    def _true_sensor(self, time_ns: IntArray) -> FloatArray:
        """(n, 4, 4) the sensor's true pose at (n,) times; one pose where all are one time."""
        if time_ns[0] == time_ns[-1]:
            pose = compose(self.world_from_base(time_ns[:1]), self.base_from_sensor)
            return np.repeat(pose, len(time_ns), axis=0)
        return compose(self.world_from_base(time_ns), self.base_from_sensor)

    def _follow_odometry(self) -> None:
        """Takes the odometry's samples up to the motion's end."""
        step_ns, start_ns = self._odometry_step_ns, self.world.start_ns
        length_ns = self._motion.end_ns - start_ns
        count = -(-length_ns // step_ns) + 2 if self.scripted else length_ns // step_ns + 1
        if count <= len(self._odometry_ns):
            return
        new = start_ns + np.arange(len(self._odometry_ns), count, dtype=np.int64) * step_ns
        self._odometry_ns += new.tolist()
        true_poses = self.world_from_base(new)
        self._true_poses = np.concatenate([self._true_poses, true_poses])
        time_s = self.world.seconds(np.array(self._odometry_ns))
        # The drift is a walk from the start: the same draws give the same beginning however long it gets.
        random = generator(self.seed, Purpose.ODOMETRY)
        self._drift = simulate_drift(self.scenario.odometry, time_s, self._true_poses, random)
        for stamp_ns, pose in zip(
            new.tolist(), compose(self._drift.at(self.world.seconds(new)), true_poses), strict=True
        ):
            self._reported.add(stamp_ns, *_as_recorded(pose))

    def _place(self, index: int, scan: Scan) -> Frame:
        """The scan as a Frame, placed and corrected with the odometry's samples."""
        self._follow_odometry()
        at_stamp = self._world_from_sensor(np.array([scan.stamp_ns]))[0]
        points = scan.points_m
        if scan.offset_ns is not None and len(scan.offset_ns):
            knots = knot_offsets_ns(scan.offset_ns)
            if len(knots) > 1:
                matrices = self._world_from_sensor(scan.stamp_ns + knots)
                points = move_points(points, scan.offset_ns, knots, invert(at_stamp) @ matrices)
        return Frame(
            index=index,
            stamp_ns=scan.stamp_ns,
            points_m=points,
            world_from_sensor=at_stamp,
            planar=scan.planar,
            pose_known=True,
        )

    def _world_from_sensor(self, time_ns: IntArray) -> FloatArray:
        """(n, 4, 4) by the odometry's samples, as a log's reader tells it."""
        poses, _ = self._reported.at(time_ns, ALL_POSES_NS)
        return np.asarray(poses @ np.repeat(self._mount[None], len(poses), axis=0))


def _as_recorded(pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position and unit quaternion of a pose (4, 4), as a log holds and its reader takes them."""
    xyzw = np.array(as_recorded(quaternion_from_rotation(pose[:3, :3])))
    return np.array(as_recorded(pose[:3, 3])), xyzw / float(np.linalg.norm(xyzw))
