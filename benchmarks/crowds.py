"""Seeded crowds that a planner drives through: where the planning benchmark's instances come from.

An area of 16 x 10 m holds standing and walking circles, half and half; the path leads along its middle.
Walkers go straight on and turn back at the area's edge; nobody reacts to the vehicle. What a planner is
told of them is their place and velocity now, carried on straight: what a tracker would say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.planning.mpc import MpcPlanner
from adcbf_cli.core.planning.planner import Situation
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.planning.problem import Instance, Obstacles, Problem, Solution
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.planning.solvers.base import Solver
from adcbf_cli.core.types import BoolArray, FloatArray, Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle

PLANNER = "ad-cbf-mpc"
AREA_M = np.array([16.0, 10.0])
START_M, GOAL_M = np.array([0.5, 5.0]), np.array([15.5, 5.0])
CLEAR_M = 1.5
"""No circle's centre is nearer than this to the start at first."""

RADIUS_M = (0.1, 0.5)
SPEED_MPS = (0.3, 1.2)
LONGEST_S = 30.0
"""A drive takes 20 s at the path's speed."""


@dataclass(frozen=True)
class Crowd:
    """m circles: place_m (m, 2) at time zero, velocity_mps (m, 2), radius_m (m,)."""

    place_m: FloatArray
    velocity_mps: FloatArray
    radius_m: FloatArray

    @property
    def is_static(self) -> BoolArray:
        return np.asarray(~self.velocity_mps.any(axis=1))

    def at(self, time_s: float, steps: int, step_s: float) -> Obstacles:
        """What is told of them at this time."""
        folded = np.mod(self.place_m + time_s * self.velocity_mps, 2 * AREA_M)
        back = folded > AREA_M
        place = np.where(back, 2 * AREA_M - folded, folded)
        velocity = np.where(back, -self.velocity_mps, self.velocity_mps)
        ahead_s = step_s * np.arange(steps + 1)
        return Obstacles(
            track_id=np.arange(len(place)),
            position_m=place[:, None] + ahead_s[:, None] * velocity[:, None],
            radius_m=self.radius_m,
            margin_m=np.zeros((len(place), steps + 1)),
            velocity_mps=velocity,
            is_static=self.is_static,
        )


def crowd(seed: int, count: int) -> Crowd:
    """`count` circles, every other one walking."""
    rng = np.random.default_rng([seed, count])
    places: list[FloatArray] = []
    while len(places) < count:
        place = rng.uniform(0.0, AREA_M)
        if np.hypot(*(place - START_M)) > CLEAR_M:
            places.append(place)
    bearing, speed = rng.uniform(-np.pi, np.pi, count), rng.uniform(*SPEED_MPS, count)
    speed[::2] = 0.0
    velocity = speed[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    return Crowd(np.array(places), velocity, rng.uniform(*RADIUS_M, count))


class Recorder:
    """A solver that notes what it is asked."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self.asked: list[tuple[Instance, FloatArray]] = []

    def solve(self, instance: Instance, guess: FloatArray) -> Solution:
        self.asked.append((instance, guess))
        return self._solver.solve(instance, guess)


@dataclass(frozen=True)
class Tick:
    """One tick of a drive: what the planner was told, and its first question to the solver."""

    situation: Situation
    instance: Instance
    guess: FloatArray


def drive(seed: int, count: int, config: Config) -> tuple[Problem, list[Tick]]:
    """The default planner's way through a crowd, to the goal, to a collision or for LONGEST_S."""
    planning, vehicle = config.planning, Vehicle.from_config(config.vehicle)
    people = crowd(seed, count)
    planner = make_planner(PLANNER, vehicle, planning, Notes())
    assert isinstance(planner, MpcPlanner)
    recorder = Recorder(planner._solver)
    planner._solver = recorder
    path = ReferencePath(np.stack([START_M, GOAL_M]), planning.reference_speed_mps or 0.75)
    pose, inputs = np.append(START_M, 0.0), np.zeros(2)
    ticks: list[Tick] = []
    for number in range(round(LONGEST_S * planning.rate_hz)):
        time_s = number / planning.rate_hz
        known = people.at(time_s, planning.steps, planning.step_s)
        gap = known.position_m[:, 0] - pose[:2]
        clearance = np.hypot(gap[:, 0], gap[:, 1]) - known.radius_m - vehicle.body_radius_m
        if clearance.min() < 0.0 or np.hypot(*(pose[:2] - GOAL_M)) < 0.3:
            break
        situation = Situation(round(1e9 * time_s), pose, inputs, path, known)
        recorder.asked.clear()
        plan = planner.plan(situation)
        ticks.append(Tick(situation, *recorder.asked[0]))
        inputs = plan.inputs[0]
        pose = vehicle.step(pose, inputs, 1.0 / planning.rate_hz)
    return planner._problem, ticks
