"""A small closed loop for planners: discs that move at constant velocity, perfectly known.

`python -m tests.core.planning.hard_cases` prints what every planner makes of every case.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field

import numpy as np

from adcbf_cli.core.config import PlanningConfig, VehicleConfig
from adcbf_cli.core.planning.planner import Outcome, Planner, Situation
from adcbf_cli.core.planning.presets import PLANNERS, make_planner
from adcbf_cli.core.planning.problem import Obstacles
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.types import FloatArray, Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle

GOAL_TOLERANCE_M = 0.3


@dataclass(frozen=True)
class Case:
    """discs: rows of x, y, vx, vy, radius. The vehicle starts at `start` and follows `path` to its end."""

    name: str
    discs: list[tuple[float, float, float, float, float]]
    path: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, 0.0), (9.0, 0.0)])
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed_mps: float = 0.0
    duration_s: float = 30.0

    @property
    def is_static(self) -> bool:
        return all(disc[2] == 0.0 and disc[3] == 0.0 for disc in self.discs)


CASES = (
    Case("free", []),
    Case("dead ahead", [(4.0, 0.0, 0.0, 0.0, 0.4)]),
    Case("big ahead", [(4.5, 0.0, 0.0, 0.0, 1.0)]),
    Case("big, 5 cm aside", [(4.5, 0.05, 0.0, 0.0, 1.0)]),
    Case("oncoming", [(9.0, 0.0, -0.6, 0.0, 0.3)], speed_mps=0.75),
    Case("crossing", [(4.0, -3.2, 0.0, 0.6, 0.3)], speed_mps=0.75),
    Case("overtaking", [(-2.5, 0.0, 1.2, 0.0, 0.3)], speed_mps=0.75),
    Case("closing gap", [(4.5, 2.2, 0.0, -0.2, 0.4), (4.5, -2.2, 0.0, 0.2, 0.4)], speed_mps=0.75),
    Case("within the margin", [(0.0, 0.65, 0.0, 0.0, 0.3)]),
    Case("nose in the margin", [(0.7, 0.1, 0.0, 0.0, 0.3)]),
    Case("goal inside", [(9.0, 0.0, 0.0, 0.0, 0.5)]),
    Case("no way out", [(2.0 * np.cos(a), 2.0 * np.sin(a), 0.0, 0.0, 0.5) for a in np.arange(12) * np.pi / 6]),
    Case("slalom", [(2.5, 0.15, 0.0, 0.0, 0.3), (4.5, -0.15, 0.0, 0.0, 0.3), (6.5, 0.15, 0.0, 0.0, 0.3)]),
    Case("corner", [(3.5, 0.3, 0.0, 0.0, 0.3)], path=[(0.0, 0.0), (4.0, 0.0), (4.0, 5.0)]),
)


@dataclass(frozen=True)
class Course:
    """What happened: T ticks. clearance_m: (T,) smallest surface distance, infinite without discs."""

    pose: FloatArray
    inputs: FloatArray
    clearance_m: FloatArray
    outcomes: list[Outcome]
    starts: list[str]
    plan_ms: FloatArray
    arrived: bool
    period_s: float

    @property
    def collided(self) -> bool:
        return bool((self.clearance_m < 0).any())

    def share(self, outcome: Outcome) -> float:
        return float(np.mean([found is outcome for found in self.outcomes]))


def known(discs: FloatArray, time_s: float, steps: int, step_s: float) -> Obstacles:
    """Perfect knowledge at `time_s` of discs (n, 5)."""
    later_s = time_s + step_s * np.arange(steps + 1)
    return Obstacles(
        track_id=np.arange(len(discs)),
        position_m=discs[:, None, :2] + discs[:, None, 2:4] * later_s[:, None],
        radius_m=discs[:, 4].copy(),
        margin_m=np.zeros((len(discs), steps + 1)),
        velocity_mps=discs[:, 2:4].copy(),
        is_static=(discs[:, 2:4] == 0.0).all(axis=1),
    )


def drive(case: Case, planner: Planner, vehicle: Vehicle, planning: PlanningConfig) -> Course:
    """Drive until the goal, a collision, the case's duration, or where nothing moves any more."""
    discs = np.asarray(case.discs, dtype=float).reshape(-1, 5)
    path = ReferencePath(np.asarray(case.path), min(0.75, float(vehicle.input_max[0])))
    period_s = 1.0 / planning.rate_hz
    pose, inputs = np.asarray(case.start), np.array([case.speed_mps, 0.0])
    poses, applied, clearance, outcomes, starts, plan_ms = [], [], [], [], [], []
    arrived = False
    for tick in range(round(case.duration_s * planning.rate_hz)):
        seen = known(discs, tick * period_s, planning.steps, planning.step_s)
        gap = np.hypot(*(seen.position_m[:, 0] - pose[:2]).T) - seen.radius_m - vehicle.body_radius_m
        clearance.append(gap.min(initial=np.inf))
        poses.append(pose)
        begin = time.perf_counter()
        plan = planner.plan(Situation(round(tick * period_s * 1e9), pose, inputs, path, seen))
        plan_ms.append(1e3 * (time.perf_counter() - begin))
        check(plan.inputs, inputs, vehicle, planning)
        inputs = plan.inputs[0]
        applied.append(inputs)
        outcomes.append(plan.outcome)
        starts.append(plan.details.start if plan.details else "")
        pose = vehicle.step(pose, inputs, period_s)
        arrived = bool(np.hypot(*(pose[:2] - path.goal_m)) < GOAL_TOLERANCE_M)
        if arrived or clearance[-1] < 0 or (case.is_static and stands(poses, planning.rate_hz)):
            break
    return Course(
        np.array(poses), np.array(applied), np.array(clearance), outcomes, starts, np.array(plan_ms), arrived, period_s
    )


def stands(poses: list[FloatArray], rate_hz: float, for_s: float = 2.0) -> bool:
    """Whether the vehicle has not moved for so long."""
    ticks = round(for_s * rate_hz)
    return len(poses) > ticks and float(np.abs(poses[-1] - poses[-1 - ticks]).max()) < 5e-3


def check(inputs: FloatArray, last: FloatArray, vehicle: Vehicle, planning: PlanningConfig) -> None:
    """Every input of a plan is finite, in bounds and within the rates."""
    assert inputs.shape == (planning.steps, 2)
    assert np.isfinite(inputs).all()
    assert (inputs >= vehicle.input_min - 1e-9).all()
    assert (inputs <= vehicle.input_max + 1e-9).all()
    change = np.abs(np.diff(inputs, axis=0, prepend=last[None]))
    allowed = np.full((planning.steps, 1), planning.step_s)
    allowed[0] = 1.0 / planning.rate_hz
    assert (change <= vehicle.rate_max * allowed + 1e-9).all()


def main(names: list[str]) -> None:
    vehicle, planning = Vehicle.from_config(VehicleConfig()), PlanningConfig()
    header = ("case", "planner", "end", "s", "least m", "aside m", "relaxed", "braked", "stopped", "p50 ms", "max ms")
    print(("{:<20}{:<15}{:<10}" + "{:>9}" * 8).format(*header))
    for case in CASES:
        for name in names or PLANNERS:
            course = drive(case, make_planner(name, vehicle, planning, Notes()), vehicle, planning)
            end = "COLLISION" if course.collided else "goal" if course.arrived else "timeout"
            figures = (
                len(course.pose) * course.period_s,
                course.clearance_m.min(),
                np.abs(course.pose[:, 1]).max(),
                course.share(Outcome.RELAXED),
                course.share(Outcome.BRAKED),
                course.share(Outcome.STOPPED),
                np.median(course.plan_ms),
                course.plan_ms.max(),
            )
            print(("{:<20}{:<15}{:<10}" + "{:>9.2f}" * 8).format(case.name, name, end, *figures), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
