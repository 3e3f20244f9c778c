"""The ground as a height field: a square grid of triangles that is both what the rays hit and what
wheels and feet stand on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.simulation.poses import poses
from adcbf_cli.core.simulation.scenario import Terrain
from adcbf_cli.core.simulation.shapes import Mesh
from adcbf_cli.core.types import BoolArray, FloatArray

WAVES = 48
"""Plane waves whose sum is the roughness: enough to look random in all directions."""


@dataclass(frozen=True, slots=True)
class HeightField:
    """heights_m: (k, k), first index along x; its corner (0, 0) is at corner_m; cells are squares,
    cut into two triangles along the diagonal from their lower left to their upper right corner."""

    corner_m: tuple[float, float]
    cell_m: float
    heights_m: FloatArray

    def covers(self, x_m: FloatArray, y_m: FloatArray) -> BoolArray:
        """Whether (n,) points lie over the ground."""
        side = self.cell_m * (len(self.heights_m) - 1)
        u, v = x_m - self.corner_m[0], y_m - self.corner_m[1]
        inside: BoolArray = (u >= 0) & (u <= side) & (v >= 0) & (v <= side)
        return inside

    def height_m(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """The ground's height (the mesh's own, not a smoothed one) at points of any shape; outside,
        the nearest edge triangle goes on."""
        last = len(self.heights_m) - 2
        u = (np.asarray(x_m) - self.corner_m[0]) / self.cell_m
        v = (np.asarray(y_m) - self.corner_m[1]) / self.cell_m
        i = np.clip(np.floor(u), 0, last).astype(np.int64)
        j = np.clip(np.floor(v), 0, last).astype(np.int64)
        u, v = u - i, v - j
        low, high = self.heights_m[i, j], self.heights_m[i + 1, j + 1]
        right, left = self.heights_m[i + 1, j], self.heights_m[i, j + 1]
        below_diagonal = low + u * (right - low) + v * (high - right)
        above_diagonal = low + v * (left - low) + u * (high - left)
        return np.where(u >= v, below_diagonal, above_diagonal)

    def mesh(self) -> Mesh:
        """The ground's triangles, facing up."""
        count = len(self.heights_m)
        steps = np.arange(count) * self.cell_m
        x, y = np.meshgrid(self.corner_m[0] + steps, self.corner_m[1] + steps, indexing="ij")
        vertices = np.column_stack([x.ravel(), y.ravel(), self.heights_m.ravel()])
        number = np.arange(count * count, dtype=np.uint32).reshape(count, count)
        low, right = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
        left, high = number[:-1, 1:].ravel(), number[1:, 1:].ravel()
        triangles = np.concatenate([np.column_stack([low, right, high]), np.column_stack([low, high, left])])
        return Mesh(vertices, triangles)


def build_terrain(terrain: Terrain, rng: np.random.Generator) -> HeightField:
    """The height field that a scenario describes: a plane through height 0 at the terrain's centre,
    plus bumps of random plane waves with wavelengths in [wavelength, 4 wavelength]."""
    half = terrain.size_m / 2
    cells = int(np.ceil(terrain.size_m / terrain.cell_m)) if terrain.kind == "bumps" else 1
    cell_m = terrain.size_m / cells
    corner = (terrain.centre_m[0] - half, terrain.centre_m[1] - half)
    offset = np.linspace(-half, half, cells + 1)
    u, v = offset[:, None], offset[None, :]
    rise = np.tan(np.deg2rad(terrain.slope_deg))
    uphill = np.deg2rad(terrain.uphill_deg)
    heights = rise * (np.cos(uphill) * u + np.sin(uphill) * v)
    if terrain.kind == "bumps" and terrain.amplitude_m > 0:
        bumps = _bumps(u, v, terrain.wavelength_m, rng)
        heights = heights + bumps * (terrain.amplitude_m / np.abs(bumps).max())
    return HeightField(corner, cell_m, np.round(heights, 6))


def _bumps(u: FloatArray, v: FloatArray, shortest_m: float, rng: np.random.Generator) -> FloatArray:
    """A sum of WAVES plane waves over the grid u (k, 1), v (1, k); longer waves are higher."""
    total = np.zeros((u.shape[0], v.shape[1]))
    for _ in range(WAVES):
        wavelength = shortest_m * 4 ** rng.uniform()
        direction, phase = rng.uniform(0, 2 * np.pi, size=2)
        number = 2 * np.pi / wavelength
        argument_u = number * np.cos(direction) * u + phase
        argument_v = number * np.sin(direction) * v
        wave = np.sin(argument_u) * np.cos(argument_v) + np.cos(argument_u) * np.sin(argument_v)
        total += wavelength * wave
    return total


def rest_on_wheels(
    ground: HeightField, x_m: FloatArray, y_m: FloatArray, yaw_rad: FloatArray, wheelbase_m: float, track_m: float
) -> FloatArray:
    """(n, 4, 4) world_from_base of a four-wheeled body at (n,) places: the origin between the wheels
    at their mean height, pitch and roll from the ground under the wheels."""
    forward = np.array([1, 1, -1, -1]) * wheelbase_m / 2
    leftward = np.array([1, -1, 1, -1]) * track_m / 2
    cos, sin = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    wheel_x = x_m[:, None] + cos * forward - sin * leftward
    wheel_y = y_m[:, None] + sin * forward + cos * leftward
    front_left, front_right, rear_left, rear_right = ground.height_m(wheel_x, wheel_y).T
    pitch = -np.arctan2((front_left + front_right - rear_left - rear_right) / 2, wheelbase_m)
    roll = np.arctan2((front_left + rear_left - front_right - rear_right) / 2, track_m)
    z = (front_left + front_right + rear_left + rear_right) / 4
    return poses(x_m, y_m, z, yaw_rad, pitch, roll)
