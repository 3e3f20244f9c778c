"""What a LiDAR fires, and what it makes of the ranges that come back.

Rays are grouped in columns that fire at one instant: all channels of a spinning LiDAR at one
azimuth, or a single ray of a 2-D laser.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.simulation.poses import poses
from adcbf_cli.core.simulation.scenario import Mount, PlanarLaser, SpinningLidar
from adcbf_cli.core.types import FloatArray, IntArray

COORDINATE_STEP_M = 1 / 512
"""Resolution of what is recorded, as coarse as a Velodyne's 2 mm. A power of two: such values are
exact in float32 and compress well."""


@dataclass(frozen=True, slots=True)
class FiringPattern:
    """directions: (columns, channels, 3) unit vectors in the sensor's frame; offset_ns: (columns,) each
    column's time after the scan's stamp; azimuth_rad: (columns,); period_ns: from scan to scan."""

    directions: FloatArray
    azimuth_rad: FloatArray
    offset_ns: IntArray
    period_ns: int


def firing_pattern(lidar: SpinningLidar | PlanarLaser) -> FiringPattern:
    """The rays of one scan. A spinning LiDAR spreads whole columns evenly over the circle, near the
    asked step; a 2-D laser steps exactly from its first azimuth and sweeps at the speed that would
    take it around in one period."""
    period_ns = round(1e9 / lidar.rate_hz)
    if isinstance(lidar, SpinningLidar):
        columns = max(1, round(360.0 / lidar.azimuth_step_deg))
        azimuth = np.deg2rad(lidar.start_azimuth_deg + np.arange(columns) * (360.0 / columns))
        elevation = np.deg2rad(np.array(_elevations_deg(lidar)))
    else:
        columns = int(np.floor((lidar.last_azimuth_deg - lidar.first_azimuth_deg) / lidar.azimuth_step_deg + 1e-9)) + 1
        azimuth = np.deg2rad(lidar.first_azimuth_deg + np.arange(columns) * lidar.azimuth_step_deg)
        elevation = np.zeros(1)
    turn = (azimuth - azimuth[0]) / (2 * np.pi)
    offset = np.zeros(columns) if lidar.instantaneous else turn * period_ns
    flat = np.cos(elevation)[None, :]
    x = np.cos(azimuth)[:, None] * flat
    y = np.sin(azimuth)[:, None] * flat
    z = np.broadcast_to(np.sin(elevation)[None, :], x.shape)
    return FiringPattern(np.stack([x, y, z], axis=-1), azimuth, np.round(offset).astype(np.int64), period_ns)


def _elevations_deg(lidar: SpinningLidar) -> tuple[float, ...]:
    if lidar.elevations_deg is not None:
        return lidar.elevations_deg
    return tuple(np.linspace(lidar.lowest_elevation_deg, lidar.highest_elevation_deg, lidar.channels).tolist())


def base_from_sensor(mount: Mount) -> FloatArray:
    """The sensor's 4 x 4 pose on base_link."""
    stack = poses(
        np.array([mount.x_m]),
        np.array([mount.y_m]),
        np.array([mount.height_m]),
        np.deg2rad([mount.yaw_deg]),
        np.deg2rad([mount.pitch_deg]),
        np.deg2rad([mount.roll_deg]),
    )
    return np.array(stack[0])


def measured_ranges(range_m: FloatArray, lidar: SpinningLidar | PlanarLaser, rng: np.random.Generator) -> FloatArray:
    """True ranges (columns, channels), inf without a hit -> measured ones, inf without a return.

    Gaussian noise, lost returns, and the sensor's range limits; the same number of random values is
    drawn whatever was hit.
    """
    noise = rng.normal(scale=lidar.range_sigma_m, size=range_m.shape) if lidar.range_sigma_m > 0 else 0.0
    lost = rng.uniform(size=range_m.shape) < lidar.dropout_probability
    measured = range_m + noise
    out = lost | ~np.isfinite(range_m) | (measured < lidar.min_range_m) | (measured > lidar.max_range_m)
    return np.where(out, np.inf, measured)


def quantise(value_m: FloatArray) -> FloatArray:
    """Lengths rounded to the recorded resolution."""
    return np.round(value_m / COORDINATE_STEP_M) * COORDINATE_STEP_M
