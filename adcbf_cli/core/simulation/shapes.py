"""Triangle meshes of the things in a simulated world, as plain arrays.

Every mesh is closed and its triangles turn counter-clockwise seen from outside. Vertices are
rounded to a micrometre, so that a last-bit difference in a sine between machines does not reach
the log.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adcbf_cli.core.types import FloatArray

Triangles = NDArray[np.uint32]

ROUND_SEGMENTS = 96
"""Sides of a round cross-section: a circle of 0.5 m radius is right to 0.3 mm."""


@dataclass(frozen=True, slots=True)
class Mesh:
    """vertices_m: (v, 3) float64; triangles: (t, 3) uint32 indices."""

    vertices_m: FloatArray
    triangles: Triangles

    def placed(self, rotation: FloatArray, translation_m: FloatArray) -> Mesh:
        """The same mesh, rotated by a 3 x 3 matrix, then shifted."""
        return _mesh(self.vertices_m @ rotation.T + translation_m, self.triangles)


def merge(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices_m) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices_m for mesh in meshes]),
        np.concatenate([mesh.triangles + np.uint32(start) for mesh, start in zip(meshes, starts, strict=True)]),
    )


def _mesh(vertices_m: FloatArray, triangles: NDArray[np.integer]) -> Mesh:
    return Mesh(np.round(vertices_m, 6), triangles.astype(np.uint32))


_BOX_TRIANGLES = np.array(
    [
        [0, 2, 1], [0, 3, 2],  # bottom
        [4, 5, 6], [4, 6, 7],  # top
        [0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7],  # sides
    ]
)  # fmt: skip


def prism(corners_m: FloatArray, bottom_m: FloatArray, top_m: FloatArray) -> Mesh:
    """An upright block over a quadrilateral: (4, 2) corners counter-clockwise, (4,) heights of each."""
    vertices = np.concatenate([np.column_stack([corners_m, bottom_m]), np.column_stack([corners_m, top_m])])
    return _mesh(vertices, _BOX_TRIANGLES)


def box(length_m: float, width_m: float, bottom_m: float, top_m: float) -> Mesh:
    """An upright box, centred in x and y."""
    half = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) * [length_m, width_m]
    return prism(half, np.full(4, bottom_m), np.full(4, top_m))


def cylinder(radius_m: float, bottom_m: float, top_m: float) -> Mesh:
    """An upright cylinder around the z axis."""
    return _revolve(np.array([radius_m, radius_m]), np.array([bottom_m, top_m]))


def ellipsoid(semi_axes_m: tuple[float, float, float], centre_m: tuple[float, float, float]) -> Mesh:
    """An ellipsoid along the axes."""
    polar = np.linspace(0, np.pi, 26)[1:-1]
    unit = _revolve(np.sin(polar), -np.cos(polar), tip_bottom=-1.0, tip_top=1.0)
    return _mesh(unit.vertices_m * semi_axes_m + centre_m, unit.triangles)


def capsule(radius_m: float, bottom_m: float, top_m: float, depth_ratio: float = 1.0) -> Mesh:
    """An upright cylinder with round ends; its ends are at bottom and top. depth_ratio squeezes x."""
    round_m = min(radius_m, (top_m - bottom_m) / 2)
    polar = np.linspace(0, np.pi / 2, 9)[1:]
    ring = radius_m * np.sin(polar)
    rise = round_m * (1 - np.cos(polar))
    radii = np.concatenate([ring, ring[::-1]])
    heights = np.concatenate([bottom_m + rise, top_m - rise[::-1]])
    solid = _revolve(radii, heights, tip_bottom=bottom_m, tip_top=top_m)
    return _mesh(solid.vertices_m * [depth_ratio, 1.0, 1.0], solid.triangles)


def _revolve(
    radii_m: FloatArray, heights_m: FloatArray, tip_bottom: float | None = None, tip_top: float | None = None
) -> Mesh:
    """Rings of the given radii at rising heights, closed by a tip (or a flat lid) at both ends."""
    angle = 2 * np.pi * np.arange(ROUND_SEGMENTS) / ROUND_SEGMENTS
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [np.column_stack([r * circle, np.full(ROUND_SEGMENTS, z)]) for r, z in zip(radii_m, heights_m, strict=True)]
    bottom_z = heights_m[0] if tip_bottom is None else tip_bottom
    top_z = heights_m[-1] if tip_top is None else tip_top
    vertices = np.concatenate([*rings, [[0.0, 0.0, bottom_z], [0.0, 0.0, top_z]]])
    here = np.arange(ROUND_SEGMENTS)
    following = (here + 1) % ROUND_SEGMENTS
    faces = []
    for level in range(len(rings) - 1):
        low, high = level * ROUND_SEGMENTS, (level + 1) * ROUND_SEGMENTS
        faces.append(np.column_stack([low + here, low + following, high + following]))
        faces.append(np.column_stack([low + here, high + following, high + here]))
    bottom, top = len(vertices) - 2, len(vertices) - 1
    last = (len(rings) - 1) * ROUND_SEGMENTS
    faces.append(np.column_stack([following, here, np.full(ROUND_SEGMENTS, bottom)]))
    faces.append(np.column_stack([last + here, last + following, np.full(ROUND_SEGMENTS, top)]))
    return _mesh(vertices, np.concatenate(faces))


def rock(size_m: tuple[float, float, float], rng: np.random.Generator) -> Mesh:
    """An irregular lump whose part above z = 0 measures exactly size_m, centred in x and y.

    A sphere whose radius is modulated by a few random smooth waves, then scaled to size.
    """
    sphere = ellipsoid((1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    unit = sphere.vertices_m
    radius = np.ones(len(unit))
    for _ in range(6):
        direction = rng.normal(size=3) * 1.8
        radius += 0.08 * np.sin(unit @ direction + rng.uniform(0, 2 * np.pi))
    lump = unit * radius[:, None]
    shown = lump[lump[:, 2] >= 0]
    low, high = shown.min(axis=0), shown.max(axis=0)
    lump[:, :2] -= ((low + high) / 2)[:2]
    scale = np.array([size_m[0] / (high[0] - low[0]), size_m[1] / (high[1] - low[1]), size_m[2] / high[2]])
    return _mesh(lump * scale, sphere.triangles)
