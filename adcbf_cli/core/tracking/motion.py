"""Motion models in the world frame: how a stack of track states moves on by a time step.

Every state starts x, y, z (m), vx, vy, vz (m/s). `cv` is that; `ca` adds ax, ay, az (m/s^2); `ct`
adds the turn rate about the world's z (rad/s). Process noise is continuous white noise on the
highest derivative, so that one long step and several short ones add the same amount.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from adcbf_cli.core.config import MOTION_MODELS, TrackingConfig
from adcbf_cli.core.types import FloatArray

SMALL_ANGLE_RAD = 1e-4


@dataclass(frozen=True, slots=True)
class MotionModel:
    """One motion model.

    propagate: states (..., d), dt in s -> (..., d). jacobian: states (n, d), dt -> (n, d, d), or
    (d, d) for a linear model, for which it is the transition matrix itself.
    process_noise: dt -> (d, d), of an obstacle that manoeuvres.
    initial_variance: (d,) of a new track; its positions are zero, as the measurement gives them.
    """

    name: str
    dimension: int
    linear: bool
    propagate: Callable[[FloatArray, float], FloatArray]
    jacobian: Callable[[FloatArray, float], FloatArray]
    process_noise: Callable[[float], FloatArray]
    initial_variance: FloatArray


def build_motion_model(config: TrackingConfig, planar: bool) -> MotionModel:
    """The model named by `config.model`, built in or of an installed package. For a planar laser the vertical noise
    is zero. Raises UsageError for a package's model that cannot be had, or does not fit."""
    if config.model not in MOTION_MODELS:
        return _plugin_model(config, planar)
    vertical = 0.0 if planar else config.vertical_ratio
    density = np.array([1.0, 1.0, vertical**2])
    speed = config.sigma_speed_mps * np.array([1.0, 1.0, max(0.1 * vertical, 1e-3)])
    if config.model == "ca":
        accel = config.sigma_accel_mps2 * np.array([1.0, 1.0, max(vertical, 1e-3)])
        return MotionModel(
            name="ca",
            dimension=9,
            linear=True,
            propagate=lambda states, dt: states @ _transition_matrix(3, dt).T,
            jacobian=lambda states, dt: _transition_matrix(3, dt),
            process_noise=lambda dt: _white_noise(3, dt, config.sigma_jerk_mps3**2 * density),
            initial_variance=np.concatenate([np.zeros(3), speed**2, accel**2]),
        )
    if config.model == "ct":
        return MotionModel(
            name="ct",
            dimension=7,
            linear=False,
            propagate=_turn,
            jacobian=_turn_jacobian,
            process_noise=lambda dt: _turn_noise(dt, config.sigma_accel_mps2**2 * density, config.sigma_turn_radps2**2),
            initial_variance=np.concatenate([np.zeros(3), speed**2, [config.sigma_turn_radps2**2]]),
        )
    return MotionModel(
        name="cv",
        dimension=6,
        linear=True,
        propagate=lambda states, dt: states @ _transition_matrix(2, dt).T,
        jacobian=lambda states, dt: _transition_matrix(2, dt),
        process_noise=lambda dt: _white_noise(2, dt, config.sigma_accel_mps2**2 * density),
        initial_variance=np.concatenate([np.zeros(3), speed**2]),
    )


def _plugin_model(config: TrackingConfig, planar: bool) -> MotionModel:
    """A package's model, under the name that it was asked for by, tried on two states."""
    from adcbf_cli.core.errors import UsageError
    from adcbf_cli.core.plugins import Kind, find_plugin, guarded, load_plugin, malformed

    plugin = find_plugin(Kind.MOTION_MODEL, config.model, MOTION_MODELS)
    made: MotionModel = load_plugin(plugin)(config, planar)
    model = replace(
        made,
        propagate=guarded(plugin, made.propagate),
        jacobian=guarded(plugin, made.jacobian),
        process_noise=guarded(plugin, made.process_noise),
    )
    d = model.dimension
    if d < 6 or np.shape(model.initial_variance) != (d,):
        raise malformed(plugin, f"initial_variance {np.shape(model.initial_variance)} for a state of {d} (at least 6)")
    states = np.zeros((2, d))
    if any(np.shape(model.propagate(np.zeros(shape), 0.1)) != shape for shape in ((2, d), (2, 3, d))):
        raise malformed(plugin, f"propagate must turn states (n, {d}), and (n, m, {d}), into as many")
    if np.shape(model.jacobian(states, 0.1)) != ((d, d) if model.linear else (2, d, d)):
        raise malformed(plugin, f"jacobian of states {(2, d)} must be {(d, d)} where linear, else {(2, d, d)}")
    if np.shape(model.process_noise(0.1)) != (d, d):
        raise malformed(plugin, f"process_noise must be {(d, d)}")
    if config.filter == "kf" and not model.linear:
        raise UsageError(f"filter 'kf' needs a linear motion model, which {plugin} is not; take 'ukf' or 'ekf'")
    return replace(model, name=config.model)


def _transition_matrix(derivatives: int, dt: float) -> FloatArray:
    """Polynomial motion of three independent axes, positions first: (3 d, 3 d)."""
    matrix = np.eye(3 * derivatives)
    rows = np.arange(3 * (derivatives - 1))
    matrix[rows, rows + 3] = dt
    if derivatives == 3:
        matrix[rows[:3], rows[:3] + 6] = 0.5 * dt * dt
    return matrix


def _white_noise(derivatives: int, dt: float, density: FloatArray) -> FloatArray:
    """Continuous white noise of spectral density (3,) on each axis's highest derivative."""
    one_axis = _one_axis_noise(derivatives, dt)
    return (one_axis[:, None, :, None] * np.diag(density)[None, :, None, :]).reshape(3 * derivatives, 3 * derivatives)


@lru_cache(maxsize=64)
def _one_axis_noise(derivatives: int, dt: float) -> FloatArray:
    """The same on one axis, of density 1. Most frames come at one rate, and filterpy takes its time."""
    from filterpy.common import Q_continuous_white_noise

    noise: FloatArray = Q_continuous_white_noise(derivatives, dt)
    noise.flags.writeable = False
    return noise


def _turn_noise(dt: float, density: FloatArray, turn_density: float) -> FloatArray:
    noise = np.zeros((7, 7))
    noise[:6, :6] = _white_noise(2, dt, density)
    noise[6, 6] = turn_density * dt
    return noise


def _turn_integrals(rate: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
    """sin(w t) / w and (1 - cos(w t)) / w, smooth through w = 0."""
    angle = rate * dt
    return dt * np.sinc(angle / np.pi), 0.5 * angle * dt * np.sinc(angle / (2 * np.pi)) ** 2


def _turn(states: FloatArray, dt: float) -> FloatArray:
    """Coordinated turn with Cartesian velocity (Bar-Shalom, Li, Kirubarajan 2001, sec. 11.7)."""
    vx, vy, rate = states[..., 3], states[..., 4], states[..., 6]
    sine, versine = _turn_integrals(rate, dt)
    cos, sin = np.cos(rate * dt), np.sin(rate * dt)
    moved = states.copy()
    moved[..., 0] += sine * vx - versine * vy
    moved[..., 1] += versine * vx + sine * vy
    moved[..., 2] += dt * states[..., 5]
    moved[..., 3] = cos * vx - sin * vy
    moved[..., 4] = sin * vx + cos * vy
    return moved


def _turn_jacobian(states: FloatArray, dt: float) -> FloatArray:
    vx, vy, rate = states[..., 3], states[..., 4], states[..., 6]
    angle = rate * dt
    sine, versine = _turn_integrals(rate, dt)
    cos, sin = np.cos(angle), np.sin(angle)
    small = np.abs(angle) < SMALL_ANGLE_RAD
    divisor = np.where(small, 1.0, rate)
    sine_by_rate = np.where(small, -angle * dt * dt / 3, (dt * cos - sine) / divisor)
    versine_by_rate = np.where(small, 0.5 * dt * dt, (dt * sin - versine) / divisor)
    jacobian = np.zeros((*states.shape[:-1], 7, 7))
    jacobian[..., np.arange(7), np.arange(7)] = 1.0
    jacobian[..., 0, 3], jacobian[..., 0, 4] = sine, -versine
    jacobian[..., 1, 3], jacobian[..., 1, 4] = versine, sine
    jacobian[..., 2, 5] = dt
    jacobian[..., 3, 3], jacobian[..., 3, 4] = cos, -sin
    jacobian[..., 4, 3], jacobian[..., 4, 4] = sin, cos
    jacobian[..., 0, 6] = sine_by_rate * vx - versine_by_rate * vy
    jacobian[..., 1, 6] = versine_by_rate * vx + sine_by_rate * vy
    jacobian[..., 3, 6] = dt * (-sin * vx - cos * vy)
    jacobian[..., 4, 6] = dt * (cos * vx - sin * vy)
    return jacobian
