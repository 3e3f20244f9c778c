"""A planner drives through a simulated scene, from the LiDAR's rays to the wheels.

    where the ego is -> scan -> cluster -> track -> predict -> plan -> where the ego is next

The scans are taken from where the vehicle really is, tilted by the ground under its wheels; what a
planner knows is what its own sensor has seen. The movers follow their script and do not react.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.perception.pipeline import Perception
from adcbf_cli.core.planning.planner import Planner
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.prediction.predictor import Predictor
from adcbf_cli.core.replay.closed_loop import Driver, Known
from adcbf_cli.core.replay.drive_log import Setting
from adcbf_cli.core.replay.free_space import seen_through
from adcbf_cli.core.replay.knowledge import Knowledge
from adcbf_cli.core.replay.log_path import LogPath
from adcbf_cli.core.replay.perfect_knowledge import PerfectKnowledge
from adcbf_cli.core.replay.records import Drive
from adcbf_cli.core.replay.routes import Entry, check_duration, reference_speed
from adcbf_cli.core.replay.simulated_world import SimulatedWorld
from adcbf_cli.core.simulation.driven import DrivenMotion
from adcbf_cli.core.simulation.paths import route_points
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.simulator import Simulator
from adcbf_cli.core.tracking.tracker import Tracker
from adcbf_cli.core.types import Clusters, FloatArray, IntArray, Notes, Predictions
from adcbf_cli.core.vehicles.vehicle import Vehicle

Given = TypeVar("Given")
Done = TypeVar("Done")

KnowledgeSource = Literal["perception", "perfect"]

SEEN_WITHIN_M = 0.3
"""A true thing is known from when a track's centre is in it or this near to its surface,
as predicted for its first step."""


@dataclass(frozen=True, slots=True)
class SceneDrive:
    """One drive through a scene.

    known_since_ns: by the truth's id, when the tracker first reported a thing, or, with perfect knowledge, when it
        first was within the range of what planners are told; it is not there if never.
    stage_ms: wall milliseconds by stage: "simulate", "cluster", "track", "predict" a scan, "plan" a tick.
    motion: where the vehicle was at any time of the drive, for taking its scans again.
    goal_m: (2,) where it was to go; limit_ns: until when.
    """

    drive: Drive
    world: SimulatedWorld
    known_since_ns: dict[int, int]
    stage_ms: dict[str, list[float]]
    motion: DrivenMotion
    goal_m: FloatArray
    limit_ns: int


def route_of(scenario: Scenario, config: Config) -> ReferencePath:
    """The path that the scene asks to be driven. UsageError where it has none."""
    if scenario.route is None:
        raise UsageError("the scenario has no route: a closed loop needs one to drive along (docs/scenarios.md)")
    return ReferencePath(route_points(scenario.route), reference_speed(config))


def drive_scene(
    scenario: Scenario,
    seed: int,
    planner: Planner,
    config: Config,
    notes: Notes,
    clock: Callable[[], int],
    knowledge: KnowledgeSource = "perception",
    keep_stages: bool = False,
    on_clusters: Callable[[Clusters], None] | None = None,
) -> SceneDrive:
    """Drives from the route's start until it is at its goal, collides, or takes too long.

    seed: of the scene's noise, terrain and shapes. clock: nanoseconds, read around stages only.
    keep_stages: keep every plan's stages, not only what was driven. on_clusters: is given each scan's obstacles.
    """
    vehicle = Vehicle.from_config(config.vehicle)
    path = route_of(scenario, config)
    check_duration(path, config)
    start_ns = scenario.start_time_s * 1_000_000_000
    motion = DrivenMotion(vehicle, start_ns, path.at(np.zeros(1))[0])
    simulator = Simulator(scenario, seed, motion)
    end_ns = start_ns + round(1e9 * config.replay.timeout_factor * path.length_m / path.speed_mps)
    world = SimulatedWorld(simulator.world, control_ticks(start_ns, end_ns, config.planning.rate_hz))
    nowhere = LogPath(np.array([start_ns, end_ns]), np.full((2, 3), np.nan))
    entry = Entry(planner, seed, start_ns, motion.at(np.array([start_ns]))[0], np.zeros(2), path, keep_stages)
    setting = Setting(world, nowhere, vehicle, config)
    driver = Driver(entry, setting, clock, notes)
    senses = _Senses(simulator, world, config, notes, clock, on_clusters)
    known: Known = senses if knowledge == "perception" else PerfectKnowledge(world)
    while driver.result is None:
        if knowledge == "perception":
            senses.up_to(driver.stamp_ns)
            driver.step(known, senses.believed(driver.stamp_ns))
        else:
            driver.step(known)
        if driver.result is None:
            motion.drive(driver.inputs, driver.stamp_ns, driver.pose)
    drive = driver.drive()
    assert drive.steps is not None
    stage_ms = {**senses.stage_ms, "plan": drive.steps.solve_ms.tolist()}
    known_since_ns = (
        senses.known_since_ns if knowledge == "perception" else _told_since_ns(drive, world, setting.range_m)
    )
    return SceneDrive(drive, world, known_since_ns, stage_ms, motion, path.goal_m, end_ns)


def control_ticks(start_ns: int, end_ns: int, rate_hz: float) -> IntArray:
    """(k,) the control ticks of a drive from start to end, in ns, and one more."""
    count = int((end_ns - start_ns) / 1e9 * rate_hz) + 2
    since_start = np.rint(np.arange(count) * 1e9 * (1.0 / rate_hz)).astype(np.int64)
    return np.asarray(start_ns + since_start)


def _told_since_ns(drive: Drive, world: SimulatedWorld, range_m: float) -> dict[int, int]:
    """By the truth's id, the first tick at which a thing was within range of one who knows everything there."""
    since: dict[int, int] = {}
    for stamp_ns, pose in zip(drive.stamp_ns.tolist(), drive.pose, strict=True):
        things = world.at(stamp_ns)
        for thing in things.id[things.clearance(pose[None, :2], 0.0)[0] <= range_m].tolist():
            since.setdefault(world.thing_of(thing), stamp_ns)
    return since


@dataclass(slots=True)
class _Stopwatch:
    """Milliseconds by stage, one value a call."""

    clock: Callable[[], int]
    spent_ms: dict[str, list[float]] = field(default_factory=dict)

    def __call__(self, stage: str, work: Callable[[Given], Done], given: Given) -> Done:
        before = self.clock()
        done = work(given)
        self.spent_ms.setdefault(stage, []).append((self.clock() - before) / 1e6)
        return done


class _Senses:
    """The ego's own eyes: scans as they end, through the package's stages, into what a planner knows."""

    def __init__(
        self,
        simulator: Simulator,
        world: SimulatedWorld,
        config: Config,
        notes: Notes,
        clock: Callable[[], int],
        on_clusters: Callable[[Clusters], None] | None,
    ) -> None:
        self._simulator = simulator
        self._world = world
        self._perceive = Perception(config.perception, notes)
        self._track = Tracker(config.tracking, notes)
        self._predict = Predictor(config.prediction, config.tracking, notes)
        self._knowledge = Knowledge(notes, config.vehicle.body_radius_m)
        self._timed = _Stopwatch(clock)
        self._on_clusters = on_clusters
        self._exact = not simulator.scenario.odometry.drifts
        self._next = 0
        self.known_since_ns: dict[int, int] = {}
        self.obstacles = self._knowledge.obstacles

    @property
    def stage_ms(self) -> dict[str, list[float]]:
        return self._timed.spent_ms

    def believed(self, stamp_ns: int) -> FloatArray | None:
        """The pose (3,) that odometry tells; None where that is the true one."""
        if self._exact:
            return None
        pose = self._simulator.odom_from_base(np.array([stamp_ns]))[0]
        return np.array([pose[0, 3], pose[1, 3], np.arctan2(pose[1, 0], pose[0, 0])])

    def up_to(self, stamp_ns: int) -> None:
        """Takes in all scans that have ended by now."""
        while self._simulator.ready_ns(self._next) <= stamp_ns:
            simulated = self._timed("simulate", self._simulator.scan, self._next)
            clusters = self._timed("cluster", self._perceive, simulated.frame)
            if self._on_clusters is not None:
                self._on_clusters(clusters)
            tracks = self._timed("track", self._track, clusters)
            predictions = self._timed("predict", self._predict, tracks)
            self._knowledge.update(predictions, simulated.odom_from_base[:2, 3])
            track_id, centre_m, radius_m = self._knowledge.standing()
            self._knowledge.forget(track_id[seen_through(simulated.frame, centre_m, radius_m)])
            self._note_known(predictions, stamp_ns)
            self._next += 1

    def _note_known(self, predictions: Predictions, stamp_ns: int) -> None:
        """Which true things are known now for the first time."""
        if not len(predictions):
            return
        truth = self._world.at(predictions.stamp_ns + round(predictions.step_s * 1e9))
        near = truth.clearance(predictions.position_m[:, 0, :2], 0.0) <= SEEN_WITHIN_M
        for thing in truth.id[near.any(axis=0)].tolist():
            self.known_since_ns.setdefault(self._world.thing_of(thing), stamp_ns)
