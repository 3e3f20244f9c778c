"""What is measured at each tick of a drive, gathered into the `Drive` record. Shared by both loops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.planning.planner import Plan
from adcbf_cli.core.planning.problem import Obstacles
from adcbf_cli.core.planning.pursuit import horizon
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.replay.log_path import LogPath
from adcbf_cli.core.replay.records import Drive, PlanStages, PlanSteps, Result
from adcbf_cli.core.replay.world import TrueWorld
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, IntArray
from adcbf_cli.core.vehicles.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class Setting:
    """What all drives of a replay share."""

    world: TrueWorld
    log_path: LogPath
    vehicle: Vehicle
    config: Config

    @property
    def range_m(self) -> float:
        """How far the ego knows obstacles."""
        configured = self.config.replay.range_m
        return self.config.perception.range_m if configured is None else configured


@dataclass(frozen=True, slots=True)
class _Tick:
    stamp_ns: int
    pose: FloatArray
    clearance_m: float
    nearest_id: int
    ttc_s: float
    reference_m: float
    along_m: float
    log_m: float
    recorded: bool
    goal_reachable: bool


@dataclass(frozen=True, slots=True)
class _Planned:
    """One planning step, in plain numbers: plans themselves would fill the memory of long replays."""

    outcome: str
    status: str
    start: str
    iterations: int
    merit: float
    violation_m2: float
    decay: float
    feasible: float
    obstacles: int
    dropped: int
    conflict: bool
    deviation_m: float
    solve_ms: float


@dataclass(frozen=True, slots=True)
class _Stages:
    """One plan's stages, as a row of `PlanStages`."""

    pose: FloatArray
    inputs: FloatArray
    barrier_m2: FloatArray
    gamma: FloatArray
    slack_m2: FloatArray
    track_id: IntArray


class DriveLog:
    """One drive's rows, tick by tick: `tick`, then `planned` if anything plans, then `applied`."""

    def __init__(self, setting: Setting, planner: str, seed: int, path: ReferencePath, keep_stages: bool) -> None:
        self._setting = setting
        self._planner = planner
        self._seed = seed
        self._path = path
        self._keep_stages = keep_stages
        self._ticks: list[_Tick] = []
        self._steps: list[_Planned] = []
        self._stages: list[_Stages] = []
        self._inputs: list[FloatArray] = []
        self._goal_radius_m = max(setting.vehicle.body_radius_m - setting.config.replay.goal_tolerance_m, 0.0)

    @property
    def clearance_m(self) -> float:
        """At the newest tick."""
        return self._ticks[-1].clearance_m

    def tick(
        self, stamp_ns: int, pose: FloatArray, speed_mps: float, along_m: float, touched: tuple[float, int] | None
    ) -> None:
        """Measures a tick. touched: clearance and id of a collision since the last tick, which counts for
        this one."""
        setting, body = self._setting, self._setting.vehicle.body_radius_m
        objects = setting.world.at(stamp_ns)
        clearance, nearest = touched or setting.world.nearest(pose[:2], body, stamp_ns)
        velocity = speed_mps * np.array([np.cos(pose[2]), np.sin(pose[2])])
        goal = objects.clearance(self._path.goal_m[None], self._goal_radius_m)
        log_m = setting.log_path.at(np.array([stamp_ns]))[0, :2] - pose[:2]
        self._ticks.append(
            _Tick(
                stamp_ns=stamp_ns,
                pose=np.array(pose, dtype=float),
                clearance_m=clearance,
                nearest_id=nearest,
                ttc_s=objects.time_to_collision(pose[:2], velocity, body),
                reference_m=float(self._path.distance(pose[None, :2])[0]),
                along_m=along_m,
                log_m=float(np.hypot(*log_m)),
                recorded=setting.log_path.start_ns <= stamp_ns <= setting.log_path.end_ns,
                goal_reachable=not bool((goal < 0.0).any()),
            )
        )

    def planned(self, plan: Plan, pose: FloatArray, known: Obstacles, solve_ms: float) -> None:
        """Adds what was planned at the newest tick, from where the planner took itself to be (3,), knowing
        these obstacles."""
        planning, vehicle = self._setting.config.planning, self._setting.vehicle
        now = self._ticks[-1]
        reference = horizon(vehicle, self._path, now.along_m, pose, planning.steps, planning.step_s)
        away = plan.poses[: len(reference), :2] - reference[: len(plan.poses), :2]
        near_m = vehicle.body_radius_m + planning.safety_distance_m
        details = plan.details
        self._steps.append(
            _Planned(
                outcome=str(plan.outcome),
                status="" if details is None else details.status,
                start="" if details is None else details.start,
                iterations=-1 if details is None else details.iterations,
                merit=np.nan if details is None else details.merit,
                violation_m2=np.nan if details is None else details.violation_m2,
                decay=np.nan if details is None else details.decay,
                feasible=np.nan if details is None else float(details.feasible),
                obstacles=len(known),
                dropped=0 if details is None else details.dropped,
                conflict=bool(comes_closer(reference[:, :2], known, near_m).any()),
                deviation_m=float(np.hypot(away[:, 0], away[:, 1]).max()),
                solve_ms=solve_ms,
            )
        )
        if self._keep_stages:
            self._stages.append(_stages_of(plan))

    def applied(self, inputs: FloatArray) -> None:
        """The inputs (2,) from the newest tick on."""
        self._inputs.append(np.array(inputs, dtype=float))

    def drive(self, period_s: float, result: Result | None, plan_error_m: FloatArray | None = None) -> Drive:
        """The record of all ticks so far."""
        ticks = self._ticks

        def column(name: str) -> FloatArray:
            return np.array([getattr(tick, name) for tick in ticks], dtype=float)

        return Drive(
            planner=self._planner,
            seed=self._seed,
            period_s=period_s,
            nominal_s=self._path.length_m / self._path.speed_mps,
            reference_length_m=self._path.length_m,
            reference_speed_mps=self._path.speed_mps,
            stamp_ns=np.array([t.stamp_ns for t in ticks], dtype=np.int64),
            pose=np.array([t.pose for t in ticks]).reshape(-1, 3),
            inputs=np.array(self._inputs).reshape(-1, 2),
            clearance_m=column("clearance_m"),
            nearest_id=np.array([t.nearest_id for t in ticks], dtype=np.int64),
            ttc_s=column("ttc_s"),
            reference_m=column("reference_m"),
            along_m=column("along_m"),
            log_m=column("log_m"),
            recorded=np.array([t.recorded for t in ticks], dtype=np.bool_),
            goal_reachable=np.array([t.goal_reachable for t in ticks], dtype=np.bool_),
            result=result,
            steps=self._plan_steps() if self._steps else None,
            stages=self._plan_stages() if self._stages else None,
            plan_error_m=plan_error_m,
        )

    def _plan_steps(self) -> PlanSteps:
        steps = self._steps

        def floats(name: str) -> FloatArray:
            return np.array([getattr(step, name) for step in steps], dtype=float)

        def counts(name: str) -> IntArray:
            return np.array([getattr(step, name) for step in steps], dtype=np.int64)

        return PlanSteps(
            outcome=tuple(step.outcome for step in steps),
            status=tuple(step.status for step in steps),
            start=tuple(step.start for step in steps),
            iterations=counts("iterations"),
            merit=floats("merit"),
            violation_m2=floats("violation_m2"),
            decay=floats("decay"),
            feasible=floats("feasible"),
            obstacles=counts("obstacles"),
            dropped=counts("dropped"),
            conflict=np.array([step.conflict for step in steps], dtype=np.bool_),
            deviation_m=floats("deviation_m"),
            solve_ms=floats("solve_ms"),
        )

    def _plan_stages(self) -> PlanStages:
        return PlanStages(*(np.stack([getattr(row, name) for row in self._stages]) for name in PlanStages.__slots__))


def comes_closer(points_m: FloatArray, known: Obstacles, near_m: float) -> BoolArray:
    """(n,) whether points (N + 1, 2), one a stage, come closer than `near_m` to an obstacle's surface."""
    offset = known.position_m - points_m[None, : known.position_m.shape[1]]
    distance = np.hypot(offset[..., 0], offset[..., 1]) - known.radius_m[:, None]
    return np.asarray((distance < near_m).any(axis=1))


def _stages_of(plan: Plan) -> _Stages:
    """The plan, with barrier, gamma, slack and id of the obstacle whose barrier is lowest at each stage."""
    stages = len(plan.poses)
    barrier, gamma, slack = (np.full(stages, np.nan) for _ in range(3))
    track_id = np.full(stages, NO_ID, dtype=np.int64)
    details = plan.details
    if details is not None and details.barrier_m2.shape[1] > 0:
        lowest, rows = np.argmin(details.barrier_m2, axis=1), np.arange(stages)
        barrier, track_id = details.barrier_m2[rows, lowest], details.track_id[lowest]
        gamma[:-1] = details.gamma[rows[:-1], lowest[:-1]]
        slack[:-1] = details.slack_m2[rows[:-1], lowest[:-1]]
    inputs = np.concatenate([plan.inputs, np.full((1, 2), np.nan)])
    return _Stages(plan.poses, inputs, barrier, gamma, slack, track_id)
