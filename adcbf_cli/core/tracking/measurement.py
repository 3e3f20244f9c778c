"""What a LiDAR measures of an obstacle's centre, as functions of the centre in the sensor's frame.

`Spherical` is the paper's measurement: range, azimuth, elevation. `Cartesian` is the centre itself
with the covariance that the spherical noise has there, for the plain Kalman filter. A planar laser
measures no elevation: for it both leave the vertical out, and the range is that within its plane.

Noise is given in metres along the line of sight, across it and vertically; angular noise grows
towards the sensor accordingly, bounded where the angles lose their meaning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.frames import wrap_angle
from adcbf_cli.core.types import FloatArray

MIN_RANGE_M = 0.05
"""Nearer to the sensor (or its axis) than this, angles are treated as at this distance."""


class Measurement(Protocol):
    """A measurement of dimension k of points (..., 3) in the sensor's frame."""

    @property
    def dimension(self) -> int: ...

    def observe(self, points_m: FloatArray) -> FloatArray:
        """(..., 3) -> (..., k)."""
        ...

    def difference(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """a - b, angles wrapped: (..., k)."""
        ...

    def jacobian(self, points_m: FloatArray) -> FloatArray:
        """(..., 3) -> (..., k, 3), of `observe`."""
        ...

    def noise(self, points_m: FloatArray, variance_m2: FloatArray, spread_m: FloatArray) -> FloatArray:
        """Noise covariance (n, k, k) at points (n, 3).

        variance_m2: (n, 3) along the line of sight, across it, vertically. spread_m: (n, s, 3) one
        more standard deviation along each of these vectors, zero for none.
        """
        ...


@dataclass(frozen=True, slots=True)
class Spherical:
    """(range, azimuth, elevation), or (range, azimuth) in its own plane for a planar laser."""

    planar: bool

    @property
    def dimension(self) -> int:
        return 2 if self.planar else 3

    def observe(self, points_m: FloatArray) -> FloatArray:
        x, y, z = points_m[..., 0], points_m[..., 1], points_m[..., 2]
        flat = np.hypot(x, y)
        azimuth = np.arctan2(y, x)
        if self.planar:
            return np.stack([flat, azimuth], axis=-1)
        return np.stack([np.hypot(flat, z), azimuth, np.arctan2(z, flat)], axis=-1)

    def difference(self, a: FloatArray, b: FloatArray) -> FloatArray:
        result = a - b
        result[..., 1] = wrap_angle(result[..., 1])
        return result

    def jacobian(self, points_m: FloatArray) -> FloatArray:
        x, y, z = points_m[..., 0], points_m[..., 1], points_m[..., 2]
        flat = np.maximum(np.hypot(x, y), MIN_RANGE_M)
        jacobian = np.zeros((*points_m.shape[:-1], self.dimension, 3))
        jacobian[..., 1, 0], jacobian[..., 1, 1] = -y / flat**2, x / flat**2
        if self.planar:
            jacobian[..., 0, 0], jacobian[..., 0, 1] = x / flat, y / flat
            return jacobian
        squared = flat**2 + z**2
        jacobian[..., 0, :] = points_m / np.sqrt(squared)[..., None]
        jacobian[..., 2, 0] = -x * z / (flat * squared)
        jacobian[..., 2, 1] = -y * z / (flat * squared)
        jacobian[..., 2, 2] = flat / squared
        return jacobian

    def noise(self, points_m: FloatArray, variance_m2: FloatArray, spread_m: FloatArray) -> FloatArray:
        flat = np.maximum(np.hypot(points_m[:, 0], points_m[:, 1]), MIN_RANGE_M)
        range_m = flat if self.planar else np.hypot(flat, points_m[:, 2])
        lever = np.stack([np.ones_like(flat), flat, range_m], axis=-1)[:, : self.dimension]
        spread = self.jacobian(points_m) @ np.swapaxes(spread_m, 1, 2)
        return _diagonal(variance_m2[:, : self.dimension] / lever**2) + spread @ np.swapaxes(spread, 1, 2)


@dataclass(frozen=True, slots=True)
class Cartesian:
    """The centre in the sensor's frame (x, y, z), or (x, y) for a planar laser."""

    planar: bool

    @property
    def dimension(self) -> int:
        return 2 if self.planar else 3

    def observe(self, points_m: FloatArray) -> FloatArray:
        return points_m[..., : self.dimension].copy()

    def difference(self, a: FloatArray, b: FloatArray) -> FloatArray:
        return a - b

    def jacobian(self, points_m: FloatArray) -> FloatArray:
        return np.broadcast_to(np.eye(3)[: self.dimension], (*points_m.shape[:-1], self.dimension, 3))

    def noise(self, points_m: FloatArray, variance_m2: FloatArray, spread_m: FloatArray) -> FloatArray:
        return noise_along_axes(points_m, variance_m2, spread_m)[:, : self.dimension, : self.dimension]


def noise_along_axes(points_m: FloatArray, variance_m2: FloatArray, spread_m: FloatArray) -> FloatArray:
    """The covariance (n, 3, 3) in the sensor's frame of noise given along and across the line of sight.

    The linearised conversion of spherical measurements (Bar-Shalom et al. 2001, sec. 10.4.3).
    """
    azimuth = np.arctan2(points_m[:, 1], points_m[:, 0])
    elevation = np.arctan2(points_m[:, 2], np.hypot(points_m[:, 0], points_m[:, 1]))
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    along = np.stack([ca * ce, sa * ce, se], axis=-1)
    across = np.stack([-sa, ca, np.zeros_like(ca)], axis=-1)
    upwards = np.stack([-ca * se, -sa * se, ce], axis=-1)
    axes = np.stack([along, across, upwards], axis=-1)
    covariance: FloatArray = (axes * variance_m2[:, None, :]) @ np.swapaxes(axes, 1, 2)
    return covariance + np.swapaxes(spread_m, 1, 2) @ spread_m


def nominal_variance(
    points_m: FloatArray, radius_m: FloatArray, height_m: FloatArray, config: TrackingConfig
) -> FloatArray:
    """Variance (n, 3) in m^2 of a centre along the line of sight, across it and vertically.

    The sensor's own noise plus a share of the obstacle's size: what is seen of a large obstacle
    changes from scan to scan, and its centre with it.
    """
    flat = np.hypot(points_m[:, 0], points_m[:, 1])
    range_m = np.hypot(flat, points_m[:, 2])
    by_radius = (config.sigma_extent_ratio * radius_m) ** 2
    by_height = (config.sigma_extent_ratio * 0.5 * height_m) ** 2
    return np.stack(
        [
            config.sigma_range_m**2 + by_radius,
            np.maximum(flat * config.sigma_azimuth_rad, config.sigma_range_m) ** 2 + by_radius,
            np.maximum(range_m * config.sigma_elevation_rad, config.sigma_range_m) ** 2 + by_height,
        ],
        axis=-1,
    )


def _diagonal(values: FloatArray) -> FloatArray:
    """(n, k) -> (n, k, k)."""
    matrices: FloatArray = values[:, :, None] * np.eye(values.shape[1])
    return matrices
