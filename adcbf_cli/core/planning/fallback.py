"""What stands between a planner and the wheels: reach, clearance, braking, and the ladder of outcomes.

Takes inputs and predicted obstacles from the planners; gives plans that a vehicle can drive.
"""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.planning.planner import Details, Outcome, Plan, Situation
from adcbf_cli.core.types import FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

STANDING_MPS = 1e-3
"""Slower than this is standing."""

TOUCH_M = 1e-6
"""Surface distances are compared to this."""

ESCAPE = 0.75
"""Share of the distance left that a way out of the safety margin keeps."""


def surface_m(poses: FloatArray, centre_m: FloatArray, radius_m: FloatArray, body_radius_m: float) -> FloatArray:
    """(n, T) distance between the vehicle's circle at poses (T, 3) and obstacles: centres (n, T, 2),
    radii (n,); negative where they overlap."""
    gap = centre_m - poses[None, :, :2]
    return np.asarray(np.hypot(gap[..., 0], gap[..., 1]) - radius_m[:, None] - body_radius_m)


def required_m(surface_now_m: FloatArray, safety_m: float) -> FloatArray:
    """(n,) surface distance to keep from each obstacle: the safety distance, or, where the vehicle is
    closer than that already, not to come closer still. Without this a vehicle that starts within the
    margin could never leave."""
    return np.asarray(np.minimum(safety_m, surface_now_m) - TOUCH_M)


def braking(vehicle: Vehicle, situation: Situation, steps: int, step_s: float, first_step_s: float) -> Plan:
    """Braking from the inputs that the vehicle has now; STOPPED where it stands already."""
    wanted = vehicle.braking(situation.inputs, steps, step_s, first_step_s)
    inputs = within_limits(vehicle, wanted, situation.inputs, step_s, first_step_s)
    poses = vehicle.roll_out(situation.pose, inputs, step_s)
    return Plan(Outcome.STOPPED if stands(situation.inputs) else Outcome.BRAKED, inputs, poses, None)


def stands(inputs: FloatArray) -> bool:
    """Whether inputs (2,) are those of a vehicle that stands."""
    return abs(float(inputs[0])) < STANDING_MPS


def within_limits(
    vehicle: Vehicle, wanted: FloatArray, last: FloatArray, step_s: float, first_step_s: float
) -> FloatArray:
    """`Vehicle.within_limits`, at once where `wanted` (N, 2) is within them already, as it mostly is."""
    reach = np.empty_like(wanted)
    reach[0], reach[1:] = vehicle.rate_max * first_step_s, vehicle.rate_max * step_s
    before = np.empty_like(wanted)
    before[0], before[1:] = last, wanted[:-1]
    fits = wanted >= np.maximum(before - reach, vehicle.input_min)
    fits &= wanted <= np.minimum(before + reach, vehicle.input_max)
    return wanted.copy() if fits.all() else vehicle.within_limits(wanted, last, step_s, first_step_s)


def outcome_of(details: Details, hard: bool, tolerance: float = 1e-6) -> Outcome:
    """The rung that a solved problem stands on, clearances aside: BRAKED where `hard` forbids its slack."""
    if not details.feasible:
        return Outcome.BRAKED if hard else Outcome.RELAXED
    return Outcome.SOLVED if details.decay >= 1 - tolerance else Outcome.RELAXED


def relaxed_is_better(driven_m: float, braked_m: float, now_m: float, safety_m: float) -> bool:
    """Whether a plan that violates or weakens a barrier may be driven rather than braking.

    driven_m, braked_m: the smallest surface distances along the plan and along braking; now_m: the one
    now. It may where it keeps the safety distance all along, or comes no closer than braking would. A
    vehicle that is within the margin already may lose a share of what is left on its way out, or one
    that points at an obstacle could never turn away. So a plan that drives into something is never
    preferred to braking, unless braking is hit as well.
    """
    required = min(safety_m, braked_m)
    if now_m < safety_m and required > 0.0:
        required *= ESCAPE
    return driven_m >= required - TOUCH_M
