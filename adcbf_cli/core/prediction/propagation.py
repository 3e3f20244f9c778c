"""Where tracks will be: mean and covariance over the horizon, for all tracks at once.

No measurement of the future exists, so there is no correction: the motion model and its process
noise only (the paper's Algorithm 1 prints one; see the reading of the paper). Process noise follows
the tracks' modes: a track that manoeuvres now is expected to settle, one that keeps its course may
start to manoeuvre. Both modes share the motion model, so mean and covariance of this mixture over
the horizon are exact for the linear models.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.filters import BatchFilter
from adcbf_cli.core.tracking.modes import ModeChain
from adcbf_cli.core.types import FloatArray, Notes


@dataclass(frozen=True, slots=True)
class Horizon:
    """position_m (n, N, 3), velocity_mps (n, N, 2), covariance_m2 (n, N, 2, 2) of x and y."""

    position_m: FloatArray
    velocity_mps: FloatArray
    covariance_m2: FloatArray


class Propagator:
    """Propagates states of one motion model over a fixed horizon."""

    def __init__(self, config: TrackingConfig, steps: int, step_s: float, notes: Notes) -> None:
        self._kalman = BatchFilter(config, planar=False, notes=notes)
        self._chain = ModeChain.from_config(config)
        self._steps = steps
        self._step_s = step_s
        if self._kalman.motion.linear:
            self._maps = self._transition_powers()
            self._noise = np.stack([self._accumulated_noise(mode) for mode in np.eye(len(self._chain.noise_factor))])

    def __call__(self, states: FloatArray, covariances: FloatArray, manoeuvre: FloatArray | None) -> Horizon:
        """states (n, d), covariances (n, d, d); manoeuvre: (n,) probability, None: the usual share."""
        n = len(states)
        modes = np.tile(self._chain.stationary, (n, 1))
        if manoeuvre is not None and modes.shape[1] == 2:
            modes = np.stack([1.0 - manoeuvre, manoeuvre], axis=1)
        if self._kalman.motion.linear:
            return self._linear(states, covariances, modes)
        return self._stepwise(states, covariances, modes)

    def _linear(self, states: FloatArray, covariances: FloatArray, modes: FloatArray) -> Horizon:
        """Closed form: x_k = F^k x, P_k = F^k P F^k^T plus the noise gathered since."""
        future = np.einsum("kij,nj->nki", self._maps[:, :6], states)
        plane = self._maps[:, :2]
        spread = plane[None] @ covariances[:, None] @ np.swapaxes(plane, 1, 2)[None]
        noise = np.einsum("nm,mkij->nkij", modes, self._noise)
        return Horizon(future[..., :3], future[..., 3:5], spread + noise)

    def _stepwise(self, states: FloatArray, covariances: FloatArray, modes: FloatArray) -> Horizon:
        """One unscented (or linearised) transform a step, over all tracks."""
        noise = self._kalman.motion.process_noise(self._step_s)
        transition = self._chain.transition(self._step_s)
        means, planes = [], []
        for _ in range(self._steps):
            modes = modes @ transition
            factor = modes @ self._chain.noise_factor
            states, covariances = self._kalman.predict(states, covariances, self._step_s, factor[:, None, None] * noise)
            means.append(states)
            planes.append(covariances[:, :2, :2])
        future = np.stack(means, axis=1)
        return Horizon(future[..., :3], future[..., 3:5], np.stack(planes, axis=1))

    def _transition_powers(self) -> FloatArray:
        """(N, d, d): F^1 .. F^N, each computed for its own time, without accumulated rounding."""
        state = np.zeros((1, self._kalman.motion.dimension))
        return np.stack([self._kalman.motion.jacobian(state, k * self._step_s) for k in range(1, self._steps + 1)])

    def _accumulated_noise(self, mode: FloatArray) -> FloatArray:
        """(N, 2, 2) process noise in x and y after each step, for a track that starts in this mode."""
        transition = self._chain.transition(self._step_s)
        step_map = self._maps[0]
        step_noise = self._kalman.motion.process_noise(self._step_s)
        gathered = np.zeros_like(step_noise)
        result = np.zeros((self._steps, 2, 2))
        for k in range(self._steps):
            mode = mode @ transition
            gathered = step_map @ gathered @ step_map.T + (mode @ self._chain.noise_factor) * step_noise
            result[k] = gathered[:2, :2]
        return result
