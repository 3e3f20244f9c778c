"""The things in a simulated world: what shape each is, where each part of it is at a time, and the
box that ground truth gives for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.simulation import shapes
from adcbf_cli.core.simulation.paths import Motion, motion_along
from adcbf_cli.core.simulation.poses import compose, poses
from adcbf_cli.core.simulation.scenario import Box, Cylinder, Person, Rock, Tree, Vehicle, Wall
from adcbf_cli.core.simulation.shapes import Mesh
from adcbf_cli.core.simulation.terrain import HeightField, rest_on_wheels
from adcbf_cli.core.types import FloatArray

UNDERGROUND_M = 0.3
"""How far trunks, walls and boxes reach into the ground, so that no slope shows a gap below them."""

LEG_SWING_RAD = 0.4


@dataclass(frozen=True, slots=True)
class TruthBox:
    """One object's box: class name, size, and centre, yaw and velocity in the world at n times (n,)."""

    category: str
    length_m: float
    width_m: float
    height_m: float
    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray
    yaw_rad: FloatArray
    vx_mps: FloatArray
    vy_mps: FloatArray


@dataclass(frozen=True, slots=True)
class StaticThing:
    """A mesh in the world and its box: (length, width, height), centre and yaw."""

    category: str
    mesh: Mesh
    size_m: tuple[float, float, float]
    centre_m: tuple[float, float, float]
    yaw_rad: float

    def truth(self, time_s: FloatArray) -> TruthBox:
        zero = np.zeros_like(time_s)
        x, y, z = self.centre_m
        return TruthBox(self.category, *self.size_m, zero + x, zero + y, zero + z, zero + self.yaw_rad, zero, zero)


def build_static(thing: Tree | Rock | Wall | Box, ground: HeightField, rng: np.random.Generator) -> StaticThing:
    """A scenario's static object, set on the ground."""
    if isinstance(thing, Wall):
        return _wall(thing, ground)
    x, y = thing.at_m
    z = float(ground.height_m(np.array(x), np.array(y)))
    at = np.array([x, y, z])
    if isinstance(thing, Tree):
        middle = thing.trunk_height_m + thing.crown_height_m / 2
        axes = (thing.crown_radius_m, thing.crown_radius_m, thing.crown_height_m / 2)
        trunk = shapes.cylinder(thing.trunk_radius_m, -UNDERGROUND_M, middle)
        mesh = shapes.merge(trunk, shapes.ellipsoid(axes, (0.0, 0.0, middle)))
        height = thing.trunk_height_m + thing.crown_height_m
        size = (2 * thing.trunk_radius_m, 2 * thing.trunk_radius_m, height)
        yaw = 0.0
    else:
        size = thing.size_m
        yaw = float(np.deg2rad(thing.yaw_deg))
        mesh = shapes.rock(size, rng) if isinstance(thing, Rock) else shapes.box(*size[:2], -UNDERGROUND_M, size[2])
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return StaticThing(thing.kind, mesh.placed(turn, at), size, (x, y, z + size[2] / 2), yaw)


def _wall(wall: Wall, ground: HeightField) -> StaticThing:
    ends = np.array([wall.from_m, wall.to_m])
    along = ends[1] - ends[0]
    length = float(np.hypot(*along))
    across = np.array([-along[1], along[0]]) / length * wall.thickness_m / 2
    corners = np.array([ends[0] - across, ends[1] - across, ends[1] + across, ends[0] + across])
    spots = ends[0] + np.linspace(0, 1, 64)[:, None] * along
    below = ground.height_m(spots[:, 0], spots[:, 1])
    base = below[[0, -1, -1, 0]]
    deepest = float(np.min(below - np.linspace(below[0], below[-1], 64)))
    mesh = shapes.prism(corners, base + deepest - UNDERGROUND_M, base + wall.height_m)
    middle = ends.mean(axis=0)
    centre = (float(middle[0]), float(middle[1]), float((below[0] + below[-1]) / 2 + wall.height_m / 2))
    return StaticThing(
        "wall", mesh, (length, wall.thickness_m, wall.height_m), centre, float(np.arctan2(along[1], along[0]))
    )


@dataclass(frozen=True, slots=True)
class Part:
    """A rigid piece of a mover. A leg swings about the y axis through hinge_m (in the mover's frame),
    with swing_sign +1 or -1; other parts have sign 0."""

    mesh: Mesh
    hinge_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    swing_sign: int = 0


@dataclass(frozen=True, slots=True)
class MovingThing:
    """A mover with its parts and the ground that it moves on."""

    spec: Person | Vehicle | Cylinder
    parts: tuple[Part, ...]
    size_m: tuple[float, float, float]
    ground: HeightField

    def motion(self, time_s: FloatArray) -> Motion:
        return motion_along(self.spec.path, time_s)

    def world_from_part(self, time_s: FloatArray) -> list[FloatArray]:
        """Each part's (n, 4, 4) pose at (n,) times from the scenario's start."""
        return world_from_parts([self], time_s)

    def truth(self, time_s: FloatArray) -> TruthBox:
        motion = self.motion(time_s)
        base = _world_from_movers([self], [motion])[0]
        centre = base[:, :3, 3] + base[:, :3, 2] * (self.size_m[2] / 2)
        return TruthBox(
            self.spec.kind, *self.size_m, centre[:, 0], centre[:, 1], centre[:, 2], motion.yaw_rad, motion.vx_mps,
            motion.vy_mps,
        )  # fmt: skip


def world_from_parts(movers: list[MovingThing], time_s: FloatArray) -> list[FloatArray]:
    """The (n, 4, 4) poses of all parts, mover by mover, at (n,) times from the scenario's start. The movers
    stand on one ground, and are placed together: a call costs more than its numbers."""
    motions = [mover.motion(time_s) for mover in movers]
    bases = _world_from_movers(movers, motions)
    placed: list[FloatArray] = []
    legs: list[tuple[int, Part, FloatArray]] = []
    for mover, motion, base in zip(movers, motions, bases, strict=True):
        for part in mover.parts:
            if part.swing_sign != 0 and isinstance(mover.spec, Person):
                phase = 2 * np.pi * motion.travelled_m / mover.spec.stride_m
                legs.append((len(placed), part, part.swing_sign * LEG_SWING_RAD * np.sin(phase)))
            placed.append(base)
    if legs:
        _swing(placed, legs)
    return placed


def _swing(placed: list[FloatArray], legs: list[tuple[int, Part, FloatArray]]) -> None:
    """Turns legs, given by their place in the list, about their hinges by (n,) angles."""
    swing = np.concatenate([angle for _, _, angle in legs])
    hinge = np.repeat([part.hinge_m for _, part, _ in legs], len(swing) // len(legs), axis=0)
    zero = np.zeros_like(swing)
    base = np.concatenate([placed[index] for index, _, _ in legs])
    swung = compose(base, poses(hinge[:, 0], hinge[:, 1], hinge[:, 2], zero, swing, zero))
    for (index, _, _), leg in zip(legs, np.split(swung, len(legs)), strict=True):
        placed[index] = leg


def _world_from_movers(movers: list[MovingThing], motions: list[Motion]) -> list[FloatArray]:
    """Each mover's (n, 4, 4) poses, standing on the ground that is under it: upright, or on its wheels."""
    bases: dict[int, FloatArray] = {}
    upright = [index for index, mover in enumerate(movers) if not isinstance(mover.spec, Vehicle)]
    if upright:
        ground = movers[upright[0]].ground
        x, y, yaw = (
            np.concatenate([getattr(motions[index], name) for index in upright]) for name in ("x_m", "y_m", "yaw_rad")
        )
        zero = np.zeros_like(x)
        standing = poses(x, y, ground.height_m(x, y), yaw, zero, zero)
        bases.update(zip(upright, np.split(standing, len(upright)), strict=True))
    for index, (mover, motion) in enumerate(zip(movers, motions, strict=True)):
        if index not in bases:
            wheelbase, track = 0.6 * mover.size_m[0], 0.9 * mover.size_m[1]
            bases[index] = rest_on_wheels(mover.ground, motion.x_m, motion.y_m, motion.yaw_rad, wheelbase, track)
    return [bases[index] for index in range(len(movers))]


def build_mover(spec: Person | Vehicle | Cylinder, ground: HeightField) -> MovingThing:
    """A scenario's mover, as meshes in its own frame: origin on the ground, x forward."""
    if isinstance(spec, Person):
        size = (spec.depth_m, spec.width_m, spec.height_m)
        return MovingThing(spec, _person_parts(spec), size, ground)
    if isinstance(spec, Vehicle):
        body = shapes.box(spec.size_m[0], spec.size_m[1], spec.ground_clearance_m, spec.size_m[2])
        return MovingThing(spec, (Part(body),), spec.size_m, ground)
    round_body = shapes.cylinder(spec.radius_m, -0.05, spec.height_m)
    return MovingThing(spec, (Part(round_body),), (2 * spec.radius_m, 2 * spec.radius_m, spec.height_m), ground)


def _person_parts(person: Person) -> tuple[Part, ...]:
    """Torso and head in one, and two legs that hang from the hips. Proportions are an adult's."""
    height, half_width = person.height_m, person.width_m / 2
    hip, shoulder = 0.5 * height, 0.85 * height
    torso = shapes.capsule(half_width, hip - 0.05 * height, shoulder, depth_ratio=person.depth_m / person.width_m)
    head = shapes.ellipsoid((0.055 * height, 0.05 * height, 0.08 * height), (0.0, 0.0, 0.92 * height))
    leg = shapes.capsule(0.045 * height, -hip, 0.0)
    hips = [(side * half_width * 0.45, side) for side in (1, -1)]
    legs = [Part(leg, (0.0, offset, hip), side) for offset, side in hips]
    return (Part(shapes.merge(torso, head)), *legs)
