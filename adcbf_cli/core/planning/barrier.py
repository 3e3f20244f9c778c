"""The barrier h = |p - o|^2 - R^2 (eq. 13a) and how fast it may fall: gamma.

A stage's constraint is h[k + 1] >= (1 - gamma[k]) h[k]. With gamma = 1 it is the distance constraint
of MPC-DC, h[k + 1] >= 0; a fixed gamma gives MPC-CBF; eq. 14 makes it a function of the distance and
the obstacle's radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import erf, erfc

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.types import FloatArray

CHECKED_RADII_M = np.linspace(0.05, 2.0, 40)
"""Obstacle radii that `barrier_flaw` looks at: from a pole's to a car's."""

CHECKED_DISTANCE_M = 10.0
"""It looks at centre distances from contact, h = 0, to this one."""


@dataclass(frozen=True, slots=True)
class FixedGamma:
    """The same gamma everywhere; 1 is a plain distance constraint."""

    value: float


@dataclass(frozen=True, slots=True)
class AdaptiveGamma:
    """Eq. 14: gamma(d, r) = A (1 + E((d - d_E), sigma_d)) (1 - E((r - r_E), sigma_r)), clipped.

    form: "cdf", E(x, s) = erf(x / (sqrt(2) s)); "printed", E(x, s) = erf(x) / (sqrt(2) s).
    floor, ceiling: the clip; None: none at that end.
    """

    amplitude: float = 0.5
    distance_m: float = 2.0
    radius_m: float = 0.4
    distance_sigma_m: float = 0.6
    radius_sigma_m: float = 0.2
    form: Literal["cdf", "printed"] = "cdf"
    floor: float | None = 0.05
    ceiling: float | None = 1.0


@dataclass(frozen=True, slots=True)
class Barrier:
    """decay: optimal decay, h[k + 1] >= w (1 - gamma[k]) h[k] with w in [0, 1] at a cost of
    decay_weight (w - 1)^2; None: no decay.
    steps: stages with a barrier (M_CBF), None: all. form: "product" is dh >= -gamma h; "printed" is
    dh >= -gamma (eq. 13b as printed).
    frozen: gamma is taken from the instance instead of from the poses inside the problem.
    """

    gamma: FixedGamma | AdaptiveGamma
    decay_weight: float | None = None
    steps: int | None = None
    form: Literal["product", "printed"] = "product"
    frozen: bool = False


def gamma_at(gamma: FixedGamma | AdaptiveGamma, distance_m: FloatArray, radius_m: FloatArray) -> FloatArray:
    """Gamma at centre distances and obstacle radii (broadcast together)."""
    if isinstance(gamma, FixedGamma):
        return np.full(np.broadcast_shapes(np.shape(distance_m), np.shape(radius_m)), gamma.value)
    far = _one_plus_edge(np.asarray(distance_m) - gamma.distance_m, gamma.distance_sigma_m, gamma.form)
    small = _one_plus_edge(gamma.radius_m - np.asarray(radius_m), gamma.radius_sigma_m, gamma.form)
    value = np.asarray(gamma.amplitude * far * small)
    if gamma.floor is not None:
        value = np.maximum(value, gamma.floor)
    return value if gamma.ceiling is None else np.asarray(np.minimum(value, gamma.ceiling))


def _one_plus_edge(offset_m: FloatArray, sigma_m: float, form: Literal["cdf", "printed"]) -> FloatArray:
    """1 + E(offset, sigma); E is odd in the offset, so that 1 - E(x) is this at -x."""
    if form == "printed":
        return np.asarray(1.0 + erf(offset_m) / (np.sqrt(2.0) * sigma_m))
    # erfc keeps what 1 + erf would round away far below the edge.
    return np.asarray(erfc(-offset_m / (np.sqrt(2.0) * sigma_m)))


def check_barrier(barrier: Barrier, body_radius_m: float, safety_distance_m: float) -> None:
    """Raise UsageError where `barrier_flaw` finds one."""
    flaw = barrier_flaw(barrier, body_radius_m, safety_distance_m)
    if flaw is not None:
        raise UsageError(
            f"the barrier is no class-K function: {flaw} (planning.accept_invalid_barrier=true builds it all the same)"
        )


def barrier_flaw(barrier: Barrier, body_radius_m: float, safety_distance_m: float) -> str | None:
    """Why alpha is no class-K function for these obstacles, and what mends it; None where it is one.

    The constraint is dh >= -alpha(h), with alpha(h) = gamma(d(h), r) h, or gamma alone in the printed form,
    and d(h)^2 = h + R^2, R = body_radius_m + r + safety_distance_m. Needed are alpha(0) = 0, strictly
    increasing in h, and alpha(h) <= h, which keeps h from changing its sign within a step.
    Judged at CHECKED_RADII_M, from contact to CHECKED_DISTANCE_M.
    """
    contact_m = body_radius_m + CHECKED_RADII_M + safety_distance_m
    share = np.linspace(0.0, 1.0, 400)
    distance_m = contact_m[:, None] + share * np.maximum(CHECKED_DISTANCE_M - contact_m, 1.0)[:, None]
    gamma = gamma_at(barrier.gamma, distance_m, CHECKED_RADII_M[:, None])
    if barrier.form == "printed":
        return (
            f"as printed it is alpha = gamma, so alpha(0) = {gamma[:, 0].max():.2g}, not 0: h may still fall at "
            "h = 0; set planning.barrier_form=product"
        )

    def place(at: tuple[np.intp, ...]) -> str:
        return f"an obstacle of r = {CHECKED_RADII_M[at[0]]:.2f} m at d = {distance_m[at]:.2f} m"

    lowest = np.unravel_index(np.argmin(gamma), gamma.shape)
    if gamma[lowest] <= 0.0:
        return f"gamma is {gamma[lowest]:.2g} for {place(lowest)}, not positive; {_cure(barrier.gamma, 'low')}"
    highest = np.unravel_index(np.argmax(gamma), gamma.shape)
    if gamma[highest] > 1.0:
        return f"alpha(h) > h, as gamma is {gamma[highest]:.2f}, for {place(highest)}; {_cure(barrier.gamma, 'high')}"
    rise = np.diff(gamma * (distance_m**2 - contact_m[:, None] ** 2), axis=1)
    worst = np.unravel_index(np.argmin(rise), rise.shape)
    if rise[worst] <= 0.0:
        return f"alpha falls with growing h for {place(worst)}; {_cure(barrier.gamma, 'low')}"
    return None


def _cure(gamma: FixedGamma | AdaptiveGamma, end: Literal["low", "high"]) -> str:
    if isinstance(gamma, FixedGamma):
        return "set planning.gamma_fixed within (0, 1]"
    if end == "high":
        return "set planning.gamma_ceiling=1"
    if gamma.form == "printed":
        return "set planning.gamma_form=cdf"
    return "set planning.gamma_floor=0.05"
