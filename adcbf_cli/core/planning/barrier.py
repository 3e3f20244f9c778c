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

from adcbf_cli.core.types import FloatArray


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
    return np.clip(value, gamma.floor, gamma.ceiling) if (gamma.floor, gamma.ceiling) != (None, None) else value


def _one_plus_edge(offset_m: FloatArray, sigma_m: float, form: Literal["cdf", "printed"]) -> FloatArray:
    """1 + E(offset, sigma); E is odd in the offset, so that 1 - E(x) is this at -x."""
    if form == "printed":
        return np.asarray(1.0 + erf(offset_m) / (np.sqrt(2.0) * sigma_m))
    # erfc keeps what 1 + erf would round away far below the edge.
    return np.asarray(erfc(-offset_m / (np.sqrt(2.0) * sigma_m)))
