"""MPC planners whose solver answers what a test tells it to, and situations for them."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.config import PlanningConfig, VehicleConfig
from adcbf_cli.core.planning.mpc import MpcPlanner
from adcbf_cli.core.planning.planner import Situation
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.planning.problem import Instance, Obstacles, Solution, SolverStatus
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.types import FloatArray, Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle
from tests.core.planning.hard_cases import known

PLANNING = PlanningConfig()
VEHICLE = Vehicle.from_config(VehicleConfig())
STRAIGHT = ReferencePath(np.array([[0.0, 0.0], [9.0, 0.0]]), 0.75)
Discs = list[tuple[float, float, float, float, float]]


def seen(discs: Discs) -> Obstacles:
    return known(np.asarray(discs, dtype=float).reshape(-1, 5), 0.0, PLANNING.steps, PLANNING.step_s)


def situation(discs: Discs, inputs: tuple[float, float] = (0.75, 0.0), stamp_ns: int = 0) -> Situation:
    return Situation(stamp_ns, np.zeros(3), np.array(inputs), STRAIGHT, seen(discs))


def planner(name: str = "ad-cbf-mpc", **changes: object) -> MpcPlanner:
    made = make_planner(name, VEHICLE, PlanningConfig.model_validate(changes), Notes())
    assert isinstance(made, MpcPlanner)
    return made


class Says:
    """A solver that answers what it is told to: what the ladder does with answers is under test."""

    def __init__(self, *answers: Solution) -> None:
        self.answers = list(answers)
        self.guesses: list[FloatArray] = []
        self.instances: list[Instance] = []

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        self.instances.append(instance)
        self.guesses.append(guess)
        return self.answers[min(len(self.guesses), len(self.answers)) - 1]


def told(answer: Solution, *more: Solution, name: str = "ad-cbf-mpc", **changes: object) -> tuple[MpcPlanner, Says]:
    made, solver = planner(name, **changes), Says(answer, *more)
    made._solver = solver
    return made, solver


def constant(speed: float, turn: float = 0.0, merit: float = 1.0, status: str = "converged") -> Solution:
    return Solution(np.tile([speed, turn], (PLANNING.steps, 1)), SolverStatus(status), 3, merit)
