"""A simulated world: casts rays into ground, static objects and movers, and knows the truth.

open3d finds which triangle a ray hits; the distance is then computed here in float64, so that it
does not depend on open3d's single precision or on the processor. Each mover's part is cast in its
own frame: rays are carried there by its pose at the instant that they fire, so everything moves
during a scan as it would.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.open3d_import import load_open3d
from adcbf_cli.core.simulation.objects import MovingThing, StaticThing, TruthBox, build_mover, build_static
from adcbf_cli.core.simulation.paths import ego_path, motion_along
from adcbf_cli.core.simulation.randomness import Purpose, generator
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.shapes import Mesh, merge
from adcbf_cli.core.simulation.terrain import HeightField, build_terrain
from adcbf_cli.core.types import NO_ID, BoolArray, FloatArray, IntArray

NS_PER_S = 1_000_000_000

GRAZING_M = 0.005
"""A larger difference between open3d's distance and the plane's comes from a ray along the triangle."""


@dataclass(frozen=True, slots=True)
class Hits:
    """range_m: rays' distances to what they hit first, inf for nothing; object_id: what that was, by
    its id in ground truth, NO_ID for the ground and for nothing. Both (columns, channels)."""

    range_m: FloatArray
    object_id: IntArray


class World:
    """Everything in a scenario but the ego's sensor. Ground truth ids count the movers first, then
    the static objects, in the scenario's order. Times are int64 ns in the log's clock."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.start_ns = scenario.start_time_s * NS_PER_S
        self.ground: HeightField = build_terrain(scenario.terrain, generator(seed, Purpose.TERRAIN))
        _check_on_ground(scenario, self.ground)
        self.movers: list[MovingThing] = [build_mover(spec, self.ground) for spec in scenario.movers]
        self.statics: list[StaticThing] = [
            build_static(spec, self.ground, generator(seed, Purpose.SHAPES, index))
            for index, spec in enumerate(scenario.objects)
        ]
        meshes = [self.ground.mesh(), *(thing.mesh for thing in self.statics)]
        self._static_body = _Body(merge(*meshes))
        owners = [NO_ID, *(len(self.movers) + index for index in range(len(self.statics)))]
        self._static_owner = np.repeat(owners, [len(mesh.triangles) for mesh in meshes]).astype(np.int64)
        bodies: dict[int, _Body] = {}
        for mover in self.movers:
            for part in mover.parts:
                bodies.setdefault(id(part.mesh), _Body(part.mesh))
        self._part_bodies = [[bodies[id(part.mesh)] for part in mover.parts] for mover in self.movers]

    def seconds(self, time_ns: IntArray) -> FloatArray:
        """Log time -> seconds from the scenario's start."""
        return (np.asarray(time_ns) - self.start_ns) / NS_PER_S

    def cast(
        self, time_ns: IntArray, world_from_sensor: FloatArray, directions: FloatArray, max_range_m: float
    ) -> Hits:
        """Fire one scan: columns at times (c,) from poses (c, 4, 4), along unit directions (c, k, 3) in
        the sensor's frame. What is farther than max_range_m counts as nothing."""
        shape = directions.shape[:2]
        turned = directions @ np.swapaxes(world_from_sensor[:, :3, :3], 1, 2)
        aim = turned.reshape(-1, 3)
        origin = np.repeat(world_from_sensor[:, :3, 3], shape[1], axis=0)
        column = np.repeat(np.arange(shape[0]), shape[1])
        range_m, triangle = self._static_body.cast(origin, aim)
        owner = np.where(triangle >= 0, self._static_owner[triangle], NO_ID)
        time_s = self.seconds(time_ns)
        for number, (mover, bodies) in enumerate(zip(self.movers, self._part_bodies, strict=True)):
            for world_from_part, body in zip(mover.world_from_part(time_s), bodies, strict=True):
                near = np.flatnonzero(
                    body.may_be_hit(world_from_sensor[:, :3, 3], turned, world_from_part, max_range_m)
                )
                if len(near) == 0:
                    continue
                part_range = body.cast_moving(origin[near], aim[near], world_from_part[column[near]])
                closer = part_range < range_m[near]
                range_m[near[closer]] = part_range[closer]
                owner[near[closer]] = number
        far = range_m > max_range_m
        range_m[far], owner[far] = np.inf, NO_ID
        return Hits(range_m.reshape(shape), owner.reshape(shape))

    def truth(self, time_ns: IntArray) -> list[TruthBox]:
        """Every object's box at (n,) times; the list's index is the object's id."""
        time_s = self.seconds(time_ns)
        return self.movers_truth(time_s) + self.statics_truth(time_s)

    def movers_truth(self, time_s: FloatArray) -> list[TruthBox]:
        """The movers' boxes at (n,) seconds from the scenario's start."""
        return [thing.truth(time_s) for thing in self.movers]

    def statics_truth(self, time_s: FloatArray) -> list[TruthBox]:
        """The boxes of what stands, at (n,) seconds from the scenario's start."""
        return [thing.truth(time_s) for thing in self.statics]


class _Body:
    """A rigid mesh, ready for ray casting in its own frame."""

    def __init__(self, mesh: Mesh) -> None:
        open3d = load_open3d()
        self._tensor = open3d.core.Tensor
        self._scene: Any = open3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(mesh.vertices_m, dtype=np.float32)), self._tensor(mesh.triangles)
        )
        corners = mesh.vertices_m[mesh.triangles]
        self._corner = corners[:, 0]
        self._normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
        self._middle = (low + high) / 2
        self._radius_m = float(np.sqrt(((mesh.vertices_m - self._middle) ** 2).sum(axis=1).max()))

    def cast(self, origin: FloatArray, aim: FloatArray) -> tuple[FloatArray, IntArray]:
        """(n, 3) origins and unit directions in the body's frame -> (n,) ranges, inf for a miss, and
        (n,) triangle numbers, -1 for a miss."""
        rays = np.concatenate([origin, aim], axis=1).astype(np.float32)
        answer = self._scene.cast_rays(self._tensor(rays), nthreads=1)
        found = answer["t_hit"].numpy().astype(np.float64)
        hit = np.isfinite(found)
        triangle = np.where(hit, answer["primitive_ids"].numpy().astype(np.int64), -1)
        range_m = np.full(len(origin), np.inf)
        corner, normal = self._corner[triangle[hit]], self._normal[triangle[hit]]
        range_m[hit] = _distance_to_plane(origin[hit], aim[hit], corner, normal, found[hit])
        return range_m, triangle

    def cast_moving(self, origin: FloatArray, aim: FloatArray, world_from_body: FloatArray) -> FloatArray:
        """World rays (n, 3) against the body at each ray's own pose (n, 4, 4) -> (n,) ranges."""
        rotation = world_from_body[:, :3, :3]
        local_origin = np.einsum("nij,ni->nj", rotation, origin - world_from_body[:, :3, 3])
        local_aim = np.einsum("nij,ni->nj", rotation, aim)
        return self.cast(local_origin, local_aim)[0]

    def may_be_hit(
        self, origin: FloatArray, aim: FloatArray, world_from_body: FloatArray, max_range_m: float
    ) -> BoolArray:
        """Which rays, from (c, 3) along (c, k, 3) in the world, pass through the body's bounding sphere
        at its (c, 4, 4) poses: (c k,)."""
        middle = world_from_body[:, :3, :3] @ self._middle + world_from_body[:, :3, 3]
        towards = middle - origin
        along = (aim @ towards[:, :, None])[:, :, 0]
        squared = _dot(towards, towards)[:, None]
        reach = self._radius_m + 1e-3
        inside = squared <= reach**2
        passes = (along > 0) & (squared - along**2 <= reach**2) & (along - reach <= max_range_m)
        return np.asarray(inside | passes).reshape(-1)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,) scalar products of (n, 3) vectors."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])


def _distance_to_plane(
    origin: FloatArray, aim: FloatArray, corner: FloatArray, normal: FloatArray, found_m: FloatArray
) -> FloatArray:
    """(n,) distances along rays to the planes of the triangles that they are known to hit. A ray that
    grazes its triangle, so that the plane gives no sound distance, keeps the one that was found."""
    approach = _dot(normal, aim)
    gap = _dot(normal, corner - origin)
    exact = gap / np.where(approach == 0, np.inf, approach)
    return np.where(np.abs(exact - found_m) < GRAZING_M, exact, found_m)


def _check_on_ground(scenario: Scenario, ground: HeightField) -> None:
    """Raises UsageError for a path or an object that leaves the terrain."""
    times = np.linspace(0.0, scenario.duration_s, 1000)
    paths = [("route" if scenario.ego.path is None else "ego.path", ego_path(scenario))]
    paths += [(f"movers.{index}.path", mover.path) for index, mover in enumerate(scenario.movers)]
    for key, path in paths:
        motion = motion_along(path, times)
        if not ground.covers(motion.x_m, motion.y_m).all():
            raise UsageError(f"{key}: leaves the terrain; raise terrain.size_m or move terrain.centre_m")
    for index, thing in enumerate(scenario.objects):
        ends = [thing.from_m, thing.to_m] if thing.kind == "wall" else [thing.at_m]
        spots = np.array(ends)
        if not ground.covers(spots[:, 0], spots[:, 1]).all():
            raise UsageError(f"objects.{index}: lies off the terrain; raise terrain.size_m or move terrain.centre_m")
