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
from adcbf_cli.core.replay.world import RecordedWorld
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class Setting:
    """What all drives of a replay share."""

    world: RecordedWorld
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
    """One planning step. stages: None where they are not kept."""

    plan: Plan
    obstacles: int
    conflict: bool
    deviation_m: float
    solve_ms: float
    stages: tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None


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

    def planned(self, plan: Plan, known: Obstacles, solve_ms: float) -> None:
        """Adds what was planned at the newest tick, knowing these obstacles."""
        planning, vehicle = self._setting.config.planning, self._setting.vehicle
        now = self._ticks[-1]
        reference = horizon(vehicle, self._path, now.along_m, now.pose, planning.steps, planning.step_s)
        away = plan.poses[: len(reference), :2] - reference[: len(plan.poses), :2]
        near_m = vehicle.body_radius_m + planning.safety_distance_m
        self._steps.append(
            _Planned(
                plan=plan,
                obstacles=len(known),
                conflict=bool(comes_closer(reference[:, :2], known, near_m).any()),
                deviation_m=float(np.hypot(away[:, 0], away[:, 1]).max()),
                solve_ms=solve_ms,
                stages=_stages_of(plan) if self._keep_stages else None,
            )
        )

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
            stages=self._plan_stages() if self._steps and self._keep_stages else None,
            plan_error_m=plan_error_m,
        )

    def _plan_steps(self) -> PlanSteps:
        details = [step.plan.details for step in self._steps]

        def number(name: str) -> FloatArray:
            return np.array([np.nan if d is None else float(getattr(d, name)) for d in details])

        return PlanSteps(
            outcome=tuple(str(step.plan.outcome) for step in self._steps),
            status=tuple("" if d is None else d.status for d in details),
            start=tuple("" if d is None else d.start for d in details),
            iterations=np.array([-1 if d is None else d.iterations for d in details], dtype=np.int64),
            merit=number("merit"),
            violation_m2=number("violation_m2"),
            decay=number("decay"),
            feasible=number("feasible"),
            obstacles=np.array([step.obstacles for step in self._steps], dtype=np.int64),
            dropped=np.array([0 if d is None else d.dropped for d in details], dtype=np.int64),
            conflict=np.array([step.conflict for step in self._steps], dtype=np.bool_),
            deviation_m=np.array([step.deviation_m for step in self._steps]),
            solve_ms=np.array([step.solve_ms for step in self._steps]),
        )

    def _plan_stages(self) -> PlanStages:
        last = np.full((1, 2), np.nan)
        stages = [step.stages for step in self._steps if step.stages is not None]
        return PlanStages(
            pose=np.stack([step.plan.poses for step in self._steps]),
            inputs=np.stack([np.concatenate([step.plan.inputs, last]) for step in self._steps]),
            barrier_m2=np.stack([s[0] for s in stages]),
            gamma=np.stack([s[1] for s in stages]),
            slack_m2=np.stack([s[2] for s in stages]),
            track_id=np.stack([s[3] for s in stages]).astype(np.int64),
        )


def comes_closer(points_m: FloatArray, known: Obstacles, near_m: float) -> BoolArray:
    """(n,) whether points (N + 1, 2), one a stage, come closer than `near_m` to an obstacle's surface."""
    offset = known.position_m - points_m[None, : known.position_m.shape[1]]
    distance = np.hypot(offset[..., 0], offset[..., 1]) - known.radius_m[:, None]
    return np.asarray((distance < near_m).any(axis=1))


def _stages_of(plan: Plan) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Barrier, gamma, slack and track id (N + 1,) of the obstacle whose barrier is lowest at each stage."""
    stages = len(plan.poses)
    empty = np.full(stages, np.nan)
    details = plan.details
    if details is None or details.barrier_m2.shape[1] == 0:
        return empty, empty, empty, np.full(stages, NO_ID)
    lowest = np.argmin(details.barrier_m2, axis=1)
    rows = np.arange(stages)
    gamma, slack = empty.copy(), empty.copy()
    gamma[:-1] = details.gamma[rows[:-1], lowest[:-1]]
    slack[:-1] = details.slack_m2[rows[:-1], lowest[:-1]]
    return details.barrier_m2[rows, lowest], gamma, slack, details.track_id[lowest]
