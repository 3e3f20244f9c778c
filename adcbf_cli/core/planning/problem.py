"""What a solver is given and what it gives back.

A `Problem` does not change while a planner runs; an `Instance` is one planning step of it. The
decision variables are the inputs u[0..N-1]; poses follow from them by the vehicle's exact step, so
any two solvers can be compared by the merit of their inputs alone (`adcbf_cli.core.planning.merit`).

Stage k = 0..N-1 holds inputs u[k] for `step_s`, from pose[k] to pose[k + 1]. The rate limit is
|u[k] - u[k - 1]| <= rate_max * step_s, and |u[0] - last_inputs| <= rate_max * first_step_s, since
u[0] is what the vehicle does in the next control period.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from adcbf_cli.core.planning.barrier import Barrier
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray
from adcbf_cli.core.vehicles.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class Weights:
    """Half of each times the squared residual, summed over stages, is the cost; SI units.

    position, heading: pose[1..N] against reference[1..N] (the last times `terminal`).
    speed: u[k][0] against reference[k + 1]'s; turn: u[k][1] against reference[k + 1]'s.
    accel, turn_accel: (u[k] - u[k - 1]) / dt, where dt is `step_s` (`first_step_s` for k = 0).
    """

    position: float
    heading: float
    speed: float
    turn: float
    accel: float
    turn_accel: float
    terminal: float


@dataclass(frozen=True, slots=True)
class Problem:
    """slack_weight: cost per m^2 of violation, summed over obstacles and stages (exact L1 penalty)."""

    vehicle: Vehicle
    steps: int
    step_s: float
    first_step_s: float
    weights: Weights
    barrier: Barrier
    slack_weight: float


@dataclass(frozen=True, slots=True)
class Instance:
    """One planning step.

    pose: (3,) x, y, yaw in the world. last_inputs: (2,), applied up to now.
    reference: (N + 1, 5) x, y, yaw, speed, second input at now + k * step_s; yaw is continuous and
        within pi of the pose's at k = 0.
    obstacle_m: (n, N + 1, 2) centres at now + k * step_s. obstacle_radius_m: (n,) own radii, which
        gamma depends on. keep_out_m: (n, N + 1) R = r_c + r_obs + r_s + uncertainty, so that
        h = |p - o|^2 - R^2 (eq. 13a).
    gamma: (n, N) where it is frozen (from the previous plan), else None.
    """

    pose: FloatArray
    last_inputs: FloatArray
    reference: FloatArray
    obstacle_m: FloatArray
    obstacle_radius_m: FloatArray
    keep_out_m: FloatArray
    gamma: FloatArray | None = None

    def __len__(self) -> int:
        """The number of obstacles."""
        return len(self.obstacle_radius_m)


class SolverStatus(enum.StrEnum):
    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit"
    """The best iterate, feasible in dynamics and bounds, but not yet stationary."""
    FAILED = "failed"
    """Inputs must not be used."""


@dataclass(frozen=True, slots=True)
class Solution:
    """inputs: (N, 2), within bounds and rate limits unless status is FAILED. merit: by `merit()`."""

    inputs: FloatArray
    status: SolverStatus
    iterations: int
    merit: float


@dataclass(frozen=True, slots=True)
class Obstacles:
    """What the planner knows of n obstacles at one moment, over its horizon.

    track_id: (n,). position_m: (n, N + 1, 2) at now + k * step_s, k = 0 being now.
    radius_m: (n,) own radii. margin_m: (n, N + 1) the position's uncertainty as a radius, zero
        where it is not used. velocity_mps: (n, 2) now. is_static: (n,) bool.
    """

    track_id: IntArray
    position_m: FloatArray
    radius_m: FloatArray
    margin_m: FloatArray
    velocity_mps: FloatArray
    is_static: BoolArray

    def __len__(self) -> int:
        return len(self.track_id)
