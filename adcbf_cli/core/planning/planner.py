"""What every planner is: something that turns a situation into a plan, once a tick."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Protocol

from adcbf_cli.core.planning.problem import Obstacles
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Situation:
    """What a planner knows at one tick: pose (3,) x, y, yaw in the world, the inputs (2,) applied up
    to now, the path to follow, and the obstacles it has seen."""

    stamp_ns: int
    pose: FloatArray
    inputs: FloatArray
    path: ReferencePath
    obstacles: Obstacles


class Outcome(enum.StrEnum):
    """The fallback ladder, best first."""

    SOLVED = "solved"
    RELAXED = "relaxed"
    """With slack or decay: a barrier is violated or weakened, by the amount in the plan's details. Without the ladder
    also a plan that no solver vouches for (status "failed")."""
    BRAKED = "braked"
    """No usable plan: the vehicle brakes within its limits."""
    STOPPED = "stopped"
    """No usable plan, and it stands already."""


@dataclass(frozen=True, slots=True)
class Details:
    """What an optimising planner can say about its plan; n obstacles in the problem, N stages.

    status: the solver's. start: which start won ("shifted", "reference", "sampled";
        "evading": no solution, but the way that keeps the most room; where none was solved and the plan is
        driven all the same, "shifted" or "held"). merit: as in merit().
    violation_m2: largest barrier violation over all rows; decay: smallest decay used (1: none).
    feasible: whether the barriers hold without slack (to 1e-6 m^2).
    track_id: (n,) whose columns follow. barrier_m2: (N + 1, n) h along the plan; gamma, slack_m2: (N, n).
    dropped: obstacles beyond `max_obstacles`, not in the problem.
    """

    status: str
    start: str
    iterations: int
    merit: float
    violation_m2: float
    decay: float
    feasible: bool
    track_id: IntArray
    barrier_m2: FloatArray
    gamma: FloatArray
    slack_m2: FloatArray
    dropped: int


@dataclass(frozen=True, slots=True)
class Plan:
    """inputs: (N, 2), the first to be applied now, finite and within the vehicle's limits whatever
    happened. poses: (N + 1, 3) that they lead to. details: None for planners without optimisation."""

    outcome: Outcome
    inputs: FloatArray
    poses: FloatArray
    details: Details | None


class Planner(Protocol):
    """One run's planner; it may remember its last plan."""

    @property
    def name(self) -> str: ...

    def plan(self, situation: Situation) -> Plan: ...
