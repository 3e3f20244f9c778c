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
from numpy.typing import NDArray

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.open3d_import import load_open3d
from adcbf_cli.core.simulation.objects import (
    MovingThing,
    StaticThing,
    TruthBox,
    build_mover,
    build_static,
    world_from_parts,
)
from adcbf_cli.core.simulation.paths import ego_path, motion_along, route_points
from adcbf_cli.core.simulation.randomness import Purpose, generator
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.shapes import Mesh, merge
from adcbf_cli.core.simulation.terrain import HeightField, build_terrain
from adcbf_cli.core.types import NO_ID, FloatArray, IntArray

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
        static = merge(*meshes)
        moving = {id(part.mesh): part.mesh for mover in self.movers for part in mover.parts}
        first = np.cumsum([len(mesh.triangles) for mesh in (static, *moving.values())]).tolist()
        self._planes = np.concatenate([_planes(mesh) for mesh in (static, *moving.values())])
        self._static_body = _Body(static, 0)
        bodies = {key: _Body(mesh, start) for (key, mesh), start in zip(moving.items(), first[:-1], strict=True)}
        self._bodies = [bodies[id(part.mesh)] for mover in self.movers for part in mover.parts]
        self._body_owner = np.repeat(np.arange(len(self.movers)), [len(mover.parts) for mover in self.movers])
        owners = [NO_ID, *(len(self.movers) + index for index in range(len(self.statics)))]
        self._static_owner = np.repeat(owners, [len(mesh.triangles) for mesh in meshes]).astype(np.int64)

    def seconds(self, time_ns: IntArray) -> FloatArray:
        """Log time -> seconds from the scenario's start."""
        return (np.asarray(time_ns) - self.start_ns) / NS_PER_S

    def cast(
        self, time_ns: IntArray, world_from_sensor: FloatArray, directions: FloatArray, max_range_m: float
    ) -> Hits:
        """Fire one scan: columns at times (c,) from poses (c, 4, 4), along unit directions (c, k, 3) in
        the sensor's frame. What is farther than max_range_m counts as nothing."""
        shape = directions.shape[:2]
        if len(time_ns) and (time_ns == time_ns[0]).all():  # one column, then, of all the rays
            time_ns, world_from_sensor = time_ns[:1], world_from_sensor[:1]
            directions = directions.reshape(1, -1, 3)
        aim = directions @ np.swapaxes(world_from_sensor[:, :3, :3], 1, 2)
        rays = _Rays(world_from_sensor[:, :3, 3], aim)
        range_m, owner = self._cast_static(rays, max_range_m)
        if self.movers:
            self._cast_movers(rays, self.seconds(time_ns), max_range_m, range_m, owner)
        far = range_m > max_range_m
        range_m[far], owner[far] = np.inf, NO_ID
        return Hits(range_m.reshape(shape), owner.reshape(shape))

    def _cast_static(self, rays: _Rays, max_range_m: float) -> tuple[FloatArray, IntArray]:
        """(n,) ranges to the ground and to what stands on it, inf for none, and (n,) ids."""
        found_m, triangle = self._static_body.cast(rays.packed())
        near = np.flatnonzero(found_m <= max_range_m + GRAZING_M)
        range_m, owner = np.full(len(found_m), np.inf), np.full(len(found_m), NO_ID, dtype=np.int64)
        origin, aim = rays.take(near)
        range_m[near] = _distance_to_plane(origin, aim, self._planes[triangle[near]], found_m[near])
        owner[near] = self._static_owner[triangle[near]]
        return range_m, owner

    def _cast_movers(
        self, rays: _Rays, time_s: FloatArray, max_range_m: float, range_m: FloatArray, owner: IntArray
    ) -> None:
        """Enters the movers in (n,) ranges and ids where they stand before what was hit there. Each ray goes
        to each part that it may hit as a ray of its own, in that part's frame."""
        pose = np.stack(world_from_parts(self.movers, time_s), axis=1)
        part, ray = self._near_parts(rays, pose, max_range_m)
        column = ray // rays.aim.shape[1]
        rotation, shift = pose[..., :3, :3], pose[..., :3, 3]
        local_origin = np.einsum("mpij,mpi->mpj", rotation, rays.origin_m[:, None] - shift)[column, part]
        local_aim = np.einsum("nij,ni->nj", rotation[column, part], rays.aim.reshape(-1, 3)[ray])
        packed = np.concatenate([local_origin, local_aim], axis=1, dtype=np.float32, casting="same_kind")
        found_m, triangle = np.full(len(ray), np.inf), np.zeros(len(ray), dtype=np.int64)
        bounds = np.searchsorted(part, np.arange(len(self._bodies) + 1)).tolist()
        for body, start, stop in zip(self._bodies, bounds[:-1], bounds[1:], strict=True):
            if start < stop:
                found_m[start:stop], triangle[start:stop] = body.cast(packed[start:stop])
        hit = np.flatnonzero(np.isfinite(found_m))
        planes = self._planes[triangle[hit]]
        part_range_m = _distance_to_plane(local_origin[hit], local_aim[hit], planes, found_m[hit])
        ray, part = ray[hit], part[hit]
        closer = np.flatnonzero(part_range_m < range_m[ray])
        closer = closer[np.lexsort((-part[closer], -part_range_m[closer]))]  # the nearest, entered last, stays
        range_m[ray[closer]] = part_range_m[closer]
        owner[ray[closer]] = self._body_owner[part[closer]]

    def _near_parts(self, rays: _Rays, pose: FloatArray, max_range_m: float) -> tuple[IntArray, IntArray]:
        """The pairs of a part and a ray that passes through its bounding sphere, by part and ray: two arrays.
        pose: (m, p, 4, 4) of each part as each column fires."""
        middle = np.array([body.middle_m for body in self._bodies])[:, :, None]
        reach = np.array([body.radius_m for body in self._bodies]) + 1e-3
        towards = (pose[..., :3, :3] @ middle)[..., 0] + pose[..., :3, 3] - rays.origin_m[:, None]
        squared = (towards**2).sum(axis=-1)
        tangent = np.where(squared > reach**2, np.sqrt(np.maximum(squared - reach**2, 0.0)), -np.inf)
        tangent[np.sqrt(squared) - reach > max_range_m] = np.inf
        along = towards @ np.swapaxes(rays.aim, 1, 2)
        passes = np.swapaxes(along >= tangent[:, :, None], 0, 1).reshape(-1)
        part, ray = np.divmod(np.flatnonzero(passes), rays.aim.shape[0] * rays.aim.shape[1])
        return part, ray

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


@dataclass(frozen=True, slots=True)
class _Rays:
    """Rays of m columns in the world, numbered column by column: origin_m (m, 3), aim (m, k, 3) unit vectors."""

    origin_m: FloatArray
    aim: FloatArray

    def take(self, rays: IntArray) -> tuple[FloatArray, FloatArray]:
        """Origins, (n, 3) or one for all of them (1, 3), and directions (n, 3) of these rays."""
        one = len(self.origin_m) == 1
        return self.origin_m if one else self.origin_m[rays // self.aim.shape[1]], self.aim.reshape(-1, 3)[rays]

    def packed(self) -> NDArray[np.float32]:
        """(m k, 6) all of them as open3d takes rays."""
        packed = np.empty((*self.aim.shape[:2], 6), dtype=np.float32)
        packed[:, :, :3], packed[:, :, 3:] = self.origin_m[:, None], self.aim
        return packed.reshape(-1, 6)


class _Body:
    """A rigid mesh, ready for ray casting in its own frame. Its triangles are numbered from `first` on.
    middle_m (3,), radius_m: its bounding sphere."""

    def __init__(self, mesh: Mesh, first: int) -> None:
        open3d = load_open3d()
        self._tensor = open3d.core.Tensor
        self._scene: Any = open3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(mesh.vertices_m, dtype=np.float32)), self._tensor(mesh.triangles)
        )
        self._first = first
        low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
        self.middle_m: FloatArray = (low + high) / 2
        self.radius_m = float(np.sqrt(((mesh.vertices_m - self.middle_m) ** 2).sum(axis=1).max()))

    def cast(self, rays: NDArray[np.float32]) -> tuple[FloatArray, IntArray]:
        """(n, 6) origins and unit directions in the body's frame -> (n,) rough ranges, inf for a miss, and
        (n,) triangle numbers, which mean nothing there."""
        answer = self._scene.cast_rays(self._tensor(rays), nthreads=1)
        return answer["t_hit"].numpy().astype(np.float64), answer["primitive_ids"].numpy() + np.int64(self._first)


def _planes(mesh: Mesh) -> FloatArray:
    """(t, 6) of each triangle a corner, and a normal as long as twice its area."""
    a, b, c = (mesh.vertices_m[mesh.triangles[:, corner]] for corner in range(3))
    return np.concatenate([a, np.cross(b - a, c - a)], axis=1)


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n,) scalar products of (n, 3) vectors."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])


def _distance_to_plane(origin: FloatArray, aim: FloatArray, planes: FloatArray, found_m: FloatArray) -> FloatArray:
    """(n,) distances along rays, from (n, 3) or (1, 3), to the planes (n, 6) of the triangles that they are
    known to hit. A ray that grazes its triangle, so that the plane gives no sound distance, keeps the one
    that was found."""
    corner, normal = planes[:, :3], planes[:, 3:]
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
    if scenario.route is not None and not ground.covers(*route_points(scenario.route).T).all():
        raise UsageError("route: leaves the terrain; raise terrain.size_m or move terrain.centre_m")
    for index, thing in enumerate(scenario.objects):
        ends = [thing.from_m, thing.to_m] if thing.kind == "wall" else [thing.at_m]
        spots = np.array(ends)
        if not ground.covers(spots[:, 0], spots[:, 1]).all():
            raise UsageError(f"objects.{index}: lies off the terrain; raise terrain.size_m or move terrain.centre_m")
