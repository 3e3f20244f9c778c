"""Kalman filters over a stack of n states (n, d) and covariances (n, d, d) at once.

Three kinds share one update: they differ in how a Gaussian passes through the motion and the
measurement. `ukf`: Merwe's scaled sigma points. `ekf`: analytic Jacobians. `kf`: everything linear.

Sigma points are handled as deviations from the mean. With d_i = f(x_i) - f(x_0), and w the weight
of the outer points, Merwe's mean and covariance are exactly

    m = sum_i w d_i,    mean = f(x_0) + m,    cov = sum_i w d_i d_i^T + (beta - alpha^2) m m^T,

which leaves out the centre weight (-1e6 for alpha = 0.001) and the cancellation that it brings, and
is positive semidefinite for beta >= alpha^2. Angles are averaged as wrapped deviations too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.linalg import cholesky_with_repair, inverted, quadratic_form, symmetrised, turned
from adcbf_cli.core.tracking.measurement import Cartesian, Measurement, Spherical
from adcbf_cli.core.tracking.motion import MotionModel, build_motion_model
from adcbf_cli.core.types import FloatArray, Notes


@dataclass(frozen=True, slots=True)
class Expectation:
    """What n states expect to be measured: mean (n, k), covariance (n, k, k) without noise, and
    covariance with the state (n, d, k)."""

    mean: FloatArray
    covariance: FloatArray
    cross: FloatArray


@dataclass(frozen=True, slots=True)
class Correction:
    """The result of an update: state and covariance, the measurement's normalised innovation
    squared (n,) and log likelihood (n,)."""

    state: FloatArray
    covariance: FloatArray
    nis: FloatArray
    log_likelihood: FloatArray


@dataclass(frozen=True, slots=True)
class SigmaWeights:
    """Merwe's scaled sigma points for d dimensions: the outer points' distance from the mean in
    standard deviations, their weight, and the weight of the mean's own deviation."""

    spread: float
    outer: float
    mean_term: float

    @classmethod
    def merwe(cls, dimension: int, config: TrackingConfig) -> SigmaWeights:
        from filterpy.kalman import MerweScaledSigmaPoints

        points = MerweScaledSigmaPoints(dimension, config.ukf_alpha, config.ukf_beta, config.ukf_kappa)
        return cls(
            spread=float(config.ukf_alpha * np.sqrt(dimension + config.ukf_kappa)),
            outer=float(points.Wc[1]),
            mean_term=config.ukf_beta - config.ukf_alpha**2,
        )


class BatchFilter:
    """Prediction and update for a stack of tracks, with one motion model and one measurement."""

    def __init__(self, config: TrackingConfig, planar: bool, notes: Notes) -> None:
        self.motion: MotionModel = build_motion_model(config, planar)
        self.measurement: Measurement = Cartesian(planar) if config.filter == "kf" else Spherical(planar)
        self._unscented = config.filter == "ukf"
        self._weights = SigmaWeights.merwe(self.motion.dimension, config)
        self._widest_shift_m = config.sigma_range_m
        self._notes = notes

    def predict(
        self, states: FloatArray, covariances: FloatArray, dt: float, noise: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Moves states (n, d) and covariances on by dt (s); noise: (d, d) or (n, d, d), added.

        For a linear model the unscented transform equals F P F^T, which is then what is computed.
        """
        if self.motion.linear or not self._unscented:
            jacobian = self.motion.jacobian(states, dt)
            moved = self.motion.propagate(states, dt)
            spread = jacobian @ covariances @ np.swapaxes(jacobian, -1, -2)
            return moved, symmetrised(spread + noise)
        factor, _ = cholesky_with_repair(covariances, self._notes)
        offsets = self._weights.spread * np.swapaxes(factor, 1, 2)
        centre = self.motion.propagate(states, dt)
        points = states[:, None, :] + np.concatenate([offsets, -offsets], axis=1)
        deviations = self.motion.propagate(points, dt) - centre[:, None, :]
        mean, covariance = self._transformed(deviations)
        return centre + mean, symmetrised(covariance + noise)

    def expect(self, states: FloatArray, covariances: FloatArray, world_from_sensor: FloatArray) -> Expectation:
        """The measurement that states (n, d) lead to expect, seen from the sensor's pose (4, 4).

        Where a state's spread is so wide beside its range that the sphere's curvature shifts the expected
        range by more than the sensor's noise, sigma points give way to the tangent: the shift would be taken
        for an innovation, and draw a new track of unknown speed near the sensor towards it.
        """
        rotation = world_from_sensor[:3, :3]
        points = (states[:, :3] - world_from_sensor[:3, 3]) @ rotation
        if not self._unscented:
            return self._linearised(points, covariances, rotation)
        factor, _ = cholesky_with_repair(covariances, self._notes)
        # The factor is lower triangular and the measurement sees positions only: beyond the first
        # three pairs of sigma points the measurement does not change, and they add nothing.
        columns = self._weights.spread * np.swapaxes(factor, 1, 2)[:, :3]
        seen = columns[:, :, :3] @ rotation
        centre = self.measurement.observe(points)
        outer = self.measurement.observe(points[:, None, :] + np.concatenate([seen, -seen], axis=1))
        deviations = self.measurement.difference(outer, np.broadcast_to(centre[:, None, :], outer.shape))
        mean, covariance = self._transformed(deviations)
        opposite = deviations[:, :3] - deviations[:, 3:]
        cross = self._weights.outer * np.swapaxes(columns, 1, 2) @ opposite
        bent = np.abs(mean[:, 0]) > self._widest_shift_m
        if bent.any():
            linear = self._linearised(points[bent], covariances[bent], rotation)
            mean[bent], covariance[bent], cross[bent] = 0.0, linear.covariance, linear.cross
        return Expectation(centre + mean, covariance, cross)

    def _linearised(self, points_m: FloatArray, covariances: FloatArray, rotation: FloatArray) -> Expectation:
        """The same by the measurement's Jacobian at points (n, 3), sensor frame."""
        jacobian = self.measurement.jacobian(points_m) @ rotation.T
        cross = covariances[:, :, :3] @ np.swapaxes(jacobian, 1, 2)
        return Expectation(self.measurement.observe(points_m), jacobian @ cross[:, :3], cross)

    def update(
        self,
        states: FloatArray,
        covariances: FloatArray,
        expected: Expectation,
        measured: FloatArray,
        noise: FloatArray,
    ) -> Correction:
        """Corrects n states by n measurements (n, k) with noise covariances (n, k, k)."""
        innovation = self.measurement.difference(measured, expected.mean)
        total = symmetrised(expected.covariance + noise)
        inverse = inverted(total)
        gain = expected.cross @ inverse
        nis = np.maximum(quadratic_form(innovation, inverse), 0.0)
        corrected = covariances - gain @ np.swapaxes(expected.cross, 1, 2)
        return Correction(
            state=states + turned(innovation, gain),
            covariance=cholesky_with_repair(symmetrised(corrected), self._notes)[1],
            nis=nis,
            log_likelihood=-0.5 * (nis + np.linalg.slogdet(2 * np.pi * total)[1]),
        )

    def _transformed(self, deviations: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (n, k), relative to the centre point's image, and covariance (n, k, k) of the images
        of the outer sigma points, given as deviations (n, p, k) from the centre's."""
        weights = self._weights
        mean = weights.outer * deviations.sum(axis=1)
        covariance = weights.outer * np.swapaxes(deviations, 1, 2) @ deviations
        return mean, covariance + weights.mean_term * mean[:, :, None] * mean[:, None, :]
