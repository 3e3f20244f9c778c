"""Formulas on plain arrays: errors in useful axes, consistency and coverage of a 2-D Gaussian."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.types import FloatArray

COVERAGE_LEVELS = (0.5, 0.9, 0.95)


def rotate(vector_m: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """(..., 2) vectors turned counter-clockwise by (...) angles."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y = vector_m[..., 0], vector_m[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def bearing(from_m: FloatArray, to_m: FloatArray) -> FloatArray:
    """(...) direction in the world's xy plane from (..., 2+) points to (..., 2+) points, radians."""
    offset = to_m[..., :2] - from_m[..., :2]
    angle: FloatArray = np.arctan2(offset[..., 1], offset[..., 0])
    return angle


def mahalanobis2(error_m: FloatArray, covariance_m2: FloatArray) -> FloatArray:
    """e' P^-1 e, (...) from (..., 2) errors and (..., 2, 2) covariances; NaN where P is singular.

    Averaged over samples this is the NEES (Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2),
    2 for a consistent filter in the plane.
    """
    a, b, d = covariance_m2[..., 0, 0], covariance_m2[..., 0, 1], covariance_m2[..., 1, 1]
    x, y = error_m[..., 0], error_m[..., 1]
    determinant = a * d - b * b
    square = d * x * x - 2 * b * x * y + a * y * y
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(determinant > 0, square / determinant, np.nan)


def ellipse_threshold(probability: float) -> float:
    """The Mahalanobis distance squared within which a 2-D Gaussian has this probability:
    chi-square with 2 degrees of freedom, -2 ln(1 - p)."""
    return float(-2.0 * np.log1p(-probability))


def nees_bounds(n: int, dimensions: int = 2) -> tuple[float, float] | None:
    """Where the mean of n independent NEES values of a consistent filter lies with 95 %
    probability: chi-square quantiles with n * dimensions degrees of freedom, over n."""
    if not n:
        return None
    from scipy.special import gammaincinv  # a chi-square quantile, without the second that scipy.stats takes to load

    low, high = 2 * gammaincinv(n * dimensions / 2, [0.025, 0.975]) / n
    return float(low), float(high)


def covered(inside_squared: FloatArray, threshold: float) -> FloatArray:
    """1.0 where a squared distance is within the threshold, 0.0 beyond, NaN where unknown."""
    return np.where(np.isnan(inside_squared), np.nan, (inside_squared <= threshold).astype(np.float64))
