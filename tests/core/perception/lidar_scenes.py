"""Analytic LiDAR scans of simple worlds for the perception tests: exact rays against planes, upright
cylinders and upright boxes, with range noise. Everything is given in the frame whose origin is the
sensor and whose z points up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from adcbf_cli.core.types import Frame

Surface = Callable[[np.ndarray], np.ndarray]
"""Ray directions (n, 3) of unit length to the distance of the first hit (n,), inf without one."""


def plane(height_m: float, slope_x: float = 0.0, slope_y: float = 0.0) -> Surface:
    """z = slope_x x + slope_y y - height_m."""

    def hit(rays: np.ndarray) -> np.ndarray:
        fall = slope_x * rays[:, 0] + slope_y * rays[:, 1] - rays[:, 2]
        with np.errstate(divide="ignore"):
            distance = height_m / fall
        return np.where(fall > 1e-9, distance, np.inf)

    return hit


def cylinder(x_m: float, y_m: float, radius_m: float, bottom_m: float, top_m: float) -> Surface:
    def hit(rays: np.ndarray) -> np.ndarray:
        a = rays[:, 0] ** 2 + rays[:, 1] ** 2
        b = rays[:, 0] * x_m + rays[:, 1] * y_m
        c = x_m**2 + y_m**2 - radius_m**2
        root = b**2 - a * c
        with np.errstate(invalid="ignore", divide="ignore"):
            distance = (b - np.sqrt(root)) / a
        z = distance * rays[:, 2]
        return np.where((root > 0) & (distance > 0) & (z >= bottom_m) & (z <= top_m), distance, np.inf)

    return hit


def box(
    x_m: float, y_m: float, length_m: float, width_m: float, yaw_rad: float, bottom_m: float, top_m: float
) -> Surface:
    def hit(rays: np.ndarray) -> np.ndarray:
        c, s = np.cos(yaw_rad), np.sin(yaw_rad)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        direction = rays @ turn.T
        origin = turn @ np.array([-x_m, -y_m, 0.0])
        low = np.array([-length_m / 2, -width_m / 2, bottom_m]) - origin
        high = np.array([length_m / 2, width_m / 2, top_m]) - origin
        direction = np.where(np.abs(direction) < 1e-12, 1e-12, direction)
        near, far = np.minimum(low / direction, high / direction), np.maximum(low / direction, high / direction)
        enter, leave = near.max(axis=1), far.min(axis=1)
        return np.where((enter <= leave) & (enter > 0), enter, np.inf)

    return hit


@dataclass(frozen=True)
class Lidar:
    """A spinning LiDAR: its beams' elevations and the step between its columns."""

    elevation_deg: np.ndarray = field(default_factory=lambda: np.linspace(-25.0, 10.0, 32))
    azimuth_step_deg: float = 0.3
    noise_m: float = 0.02
    max_range_m: float = 60.0

    def scan(self, surfaces: list[Surface], rng: np.random.Generator) -> np.ndarray:
        azimuth = np.radians(np.arange(0.0, 360.0, self.azimuth_step_deg))
        elevation, azimuth = np.meshgrid(np.radians(self.elevation_deg), azimuth, indexing="ij")
        rays = np.stack(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
        ).reshape(-1, 3)
        distance = np.min([surface(rays) for surface in surfaces], axis=0)
        seen = distance < self.max_range_m
        distance = distance[seen] + rng.normal(0.0, self.noise_m, int(seen.sum()))
        return rays[seen] * distance[:, None]


LASER = Lidar(elevation_deg=np.zeros(1), azimuth_step_deg=0.5)
"""A 2-D laser."""


def frame(
    points_m: np.ndarray, world_from_sensor: np.ndarray | None = None, index: int = 0, planar: bool = False
) -> Frame:
    pose = np.eye(4) if world_from_sensor is None else world_from_sensor
    return Frame(index, index * 100_000_000, points_m, pose, planar, True)
