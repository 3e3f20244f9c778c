"""Two levels of process noise per track: keeping its course, or manoeuvring.

The interacting multiple model filter of Blom and Bar-Shalom (1988; Bar-Shalom, Li, Kirubarajan
2001, sec. 11.6) over modes that share the motion model and differ in process noise only. Modes
switch as a continuous-time Markov chain, so that the step's length does not matter.

Arrays over n tracks and m modes (m = 2, or 1 where the levels are the same): states (n, m, d),
covariances (n, m, d, d), probabilities (n, m), the cruising mode first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.linalg import symmetrised
from adcbf_cli.core.types import FloatArray

MIN_PROBABILITY = 1e-6
"""No mode is ever ruled out for good."""

MANOEUVRES_AT_FIRST = 0.9
"""Probability that a new track manoeuvres: what is seen of it first changes, as it comes out from behind something or
apart from its neighbour, and its centre with it, whether or not it keeps its course. Not for a planar laser, which
sees a walker's legs: a track that manoeuvres follows each of their steps."""


@dataclass(frozen=True, slots=True)
class ModeChain:
    """The modes' process noise, as a factor (m,) on its covariance, and how they switch."""

    noise_factor: FloatArray
    cruise_s: float
    manoeuvre_s: float

    @classmethod
    def from_config(cls, config: TrackingConfig) -> ModeChain:
        single = config.cruise_ratio == 1.0
        factors = [1.0] if single else [config.cruise_ratio**2, 1.0]
        return cls(np.array(factors), config.cruise_s, config.manoeuvre_s)

    @property
    def stationary(self) -> FloatArray:
        """(m,) the share of time spent in each mode."""
        if len(self.noise_factor) == 1:
            return np.ones(1)
        return np.array([self.cruise_s, self.manoeuvre_s]) / (self.cruise_s + self.manoeuvre_s)

    def at_first(self, planar: bool) -> FloatArray:
        """(m,) the probabilities of a new track's modes."""
        if planar or len(self.noise_factor) == 1:
            return self.stationary
        return np.array([1.0 - MANOEUVRES_AT_FIRST, MANOEUVRES_AT_FIRST])

    def transition(self, dt: float) -> FloatArray:
        """(m, m) probability of going from row's to column's mode within dt (s)."""
        modes = len(self.noise_factor)
        decay = np.exp(-dt * (1 / self.cruise_s + 1 / self.manoeuvre_s))
        matrix: FloatArray = decay * np.eye(modes) + (1 - decay) * np.broadcast_to(self.stationary, (modes, modes))
        return matrix


def mix(
    states: FloatArray, covariances: FloatArray, probabilities: FloatArray, transition: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Each mode's starting point for the next step: states, covariances, predicted probabilities."""
    joint = probabilities[:, :, None] * transition
    predicted = joint.sum(axis=1)
    share = np.swapaxes(joint / predicted[:, None, :], 1, 2)
    mixed = share @ states
    deviation = states[:, None, :, :] - mixed[:, :, None, :]
    spread = np.einsum("nji,njia,njib->njab", share, deviation, deviation)
    averaged = np.einsum("nji,niab->njab", share, covariances)
    return mixed, symmetrised(averaged + spread), predicted


def combine(states: FloatArray, covariances: FloatArray, probabilities: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (n, d) and covariance (n, d, d) of the mixture of modes."""
    mean = np.einsum("nm,nmd->nd", probabilities, states)
    deviation = states - mean[:, None, :]
    spread = np.einsum("nm,nma,nmb->nab", probabilities, deviation, deviation)
    return mean, symmetrised(np.einsum("nm,nmab->nab", probabilities, covariances) + spread)


def reweighed(probabilities: FloatArray, log_likelihood: FloatArray) -> FloatArray:
    """Bayes' rule on mode probabilities (n, m), given each mode's log likelihood (n, m)."""
    logits = np.log(probabilities) + log_likelihood
    weights = np.exp(logits - logits.max(axis=1, keepdims=True))
    posterior = np.maximum(weights / weights.sum(axis=1, keepdims=True), MIN_PROBABILITY)
    normalised: FloatArray = posterior / posterior.sum(axis=1, keepdims=True)
    return normalised
