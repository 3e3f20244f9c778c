"""`fading`: an integrated Ornstein-Uhlenbeck process. Velocity fades to zero, as of people who stop and turn, so that
a prediction does not run away with a velocity that was seen for a moment.

    dv = -v / tau dt + sqrt(q) dW,  dx = v dt   (each axis by itself)
"""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.motion import MotionModel
from adcbf_cli.core.types import FloatArray

FADING_S = 8.0
"""tau: after this long, a third of the velocity is left."""


def fading(config: TrackingConfig, planar: bool) -> MotionModel:
    """States are x, y, z (m), vx, vy, vz (m/s); linear, so that `propagate` is a product with the matrix that
    `jacobian` gives. The process noise is that of a manoeuvre: adcbf scales it down for what keeps its course."""
    vertical = 0.0 if planar else config.vertical_ratio
    density = config.sigma_accel_mps2**2 * np.array([1.0, 1.0, vertical**2])
    speed = config.sigma_speed_mps * np.array([1.0, 1.0, max(0.1 * vertical, 1e-3)])
    return MotionModel(
        name="fading",
        dimension=6,
        linear=True,
        propagate=lambda states, dt: states @ _transition(dt).T,
        jacobian=lambda states, dt: _transition(dt),
        process_noise=lambda dt: _noise(dt, density),
        initial_variance=np.concatenate([np.zeros(3), speed**2]),
    )


def _transition(dt: float) -> FloatArray:
    """(6, 6)."""
    left = np.exp(-dt / FADING_S)
    return np.kron([[1.0, FADING_S * (1.0 - left)], [0.0, left]], np.eye(3))


def _noise(dt: float, density: FloatArray) -> FloatArray:
    """(6, 6): what white noise of this density (3,) on the velocity adds within dt."""
    tau, once, twice = FADING_S, -np.expm1(-dt / FADING_S), -np.expm1(-2 * dt / FADING_S)
    xx = tau**2 * (dt - 2 * tau * once + tau / 2 * twice)
    xv = tau**2 / 2 * once**2
    return np.kron([[xx, xv], [xv, tau / 2 * twice]], np.diag(density))
