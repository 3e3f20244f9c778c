"""Rigid transforms as 4 x 4 arrays named `target_from_source`, quaternions as (x, y, z, w), time
as int64 nanoseconds."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.types import BoolArray, FloatArray, IntArray


def identity() -> FloatArray:
    return np.eye(4)


def rotation_from_quaternion(xyzw: FloatArray) -> FloatArray:
    """(..., 4) quaternions (x, y, z, w), any non-zero norm -> (..., 3, 3) rotation matrices."""
    q = np.asarray(xyzw, dtype=np.float64)
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_rotation(rotation: FloatArray) -> FloatArray:
    """(3, 3) rotation matrix -> (x, y, z, w) with w >= 0."""
    from scipy.spatial.transform import Rotation

    q: FloatArray = Rotation.from_matrix(rotation).as_quat()
    return q if q[3] >= 0 else -q


def pose_matrix(position_m: FloatArray, quaternion_xyzw: FloatArray) -> FloatArray:
    """The transform with this translation and rotation, 4 x 4."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_quaternion(quaternion_xyzw)
    matrix[:3, 3] = position_m
    return matrix


def invert(transform: FloatArray) -> FloatArray:
    """The inverse of a rigid transform, by transposing its rotation."""
    inverse = np.eye(4)
    rotation = transform[:3, :3].T
    inverse[:3, :3] = rotation
    inverse[:3, 3] = -rotation @ transform[:3, 3]
    return inverse


def transform_points(transform: FloatArray, points_m: FloatArray) -> FloatArray:
    """(n, 3) points, mapped by a 4 x 4 rigid transform."""
    return points_m @ transform[:3, :3].T + transform[:3, 3]


def level_rotation(world_from_sensor: FloatArray) -> FloatArray:
    """The 3 x 3 rotation from the sensor's frame to the levelled sensor frame: same origin and
    heading, z along the world's z. It takes out a tilted mount and the vehicle's roll and pitch."""
    rotation = world_from_sensor[:3, :3]
    heading = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ rotation


def wrap_angle(angle_rad: FloatArray) -> FloatArray:
    """Angles folded into [-pi, pi)."""
    return (np.asarray(angle_rad) + np.pi) % (2 * np.pi) - np.pi


# --- motion over time


def clean_frame_id(name: str) -> str:
    """Frame ids without the leading slash (and the space) that ROS 1 allowed, and without control characters."""
    return "".join(character for character in name if character.isprintable()).strip().lstrip("/")


def slerp(start_xyzw: FloatArray, end_xyzw: FloatArray, fraction: FloatArray) -> FloatArray:
    """Spherical interpolation of unit quaternions, (n, 4), (n, 4), (n,) -> (n, 4), along the shorter arc.

    Shoemake 1985; below an angle of about 1e-4 rad the normalised linear form, which is then exact to
    rounding.
    """
    dot = np.sum(start_xyzw * end_xyzw, axis=-1)
    end = np.where(dot[..., None] < 0, -end_xyzw, end_xyzw)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    sine = np.sin(angle)
    near = sine < 1e-4
    safe = np.where(near, 1.0, sine)
    a = np.where(near, 1.0 - fraction, np.sin((1.0 - fraction) * angle) / safe)
    b = np.where(near, fraction, np.sin(fraction * angle) / safe)
    q = a[..., None] * start_xyzw + b[..., None] * end
    result: FloatArray = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return result


@dataclass(frozen=True, slots=True)
class StampedTransform:
    """parent_from_child at a time: position (3,) m, quaternion (4,) x, y, z, w; '' is an unnamed frame."""

    stamp_ns: int
    parent: str
    child: str
    position_m: FloatArray
    quaternion_xyzw: FloatArray

    def matrix(self) -> FloatArray:
        return pose_matrix(self.position_m, self.quaternion_xyzw)


_NO_SAMPLES: tuple[IntArray, FloatArray, FloatArray] = np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 4))


class Trajectory:
    """The pose of one frame in another over time: positions linear, rotations slerped in between.

    Samples may arrive a little out of order and repeated (the last one of equal stamps counts). `prune` drops
    what lies before a time, so that memory does not grow with the log.
    """

    def __init__(self) -> None:
        self._stamp_ns: list[int] = []
        self._samples: list[tuple[FloatArray, FloatArray]] = []
        self._arrays = _NO_SAMPLES
        """Of the first samples; those that were added at the end since then are still to be joined."""

    def __len__(self) -> int:
        return len(self._stamp_ns)

    @property
    def first_ns(self) -> int | None:
        return self._stamp_ns[0] if self._stamp_ns else None

    @property
    def last_ns(self) -> int | None:
        return self._stamp_ns[-1] if self._stamp_ns else None

    def add(self, stamp_ns: int, position_m: FloatArray, quaternion_xyzw: FloatArray) -> None:
        place = bisect_left(self._stamp_ns, stamp_ns)
        sample = (np.asarray(position_m, dtype=np.float64), np.asarray(quaternion_xyzw, dtype=np.float64))
        if place < len(self._stamp_ns):
            self._arrays = _NO_SAMPLES
        if place < len(self._stamp_ns) and self._stamp_ns[place] == stamp_ns:
            self._samples[place] = sample
        else:
            self._stamp_ns.insert(place, stamp_ns)
            self._samples.insert(place, sample)

    def at_rest(self) -> bool:
        """Whether all samples are one pose."""
        _, positions, rotations = self._as_arrays()
        moved = np.abs(positions - positions[0]).max() > 1e-6
        turned = (1 - np.abs(rotations @ rotations[0])).max() > 1e-9
        return not (moved or turned)

    def prune(self, before_ns: int) -> None:
        """Drop samples that no time at or after `before_ns` needs."""
        keep_from = bisect_right(self._stamp_ns, before_ns) - 1
        if keep_from >= _PRUNE_BATCH:
            del self._stamp_ns[:keep_from], self._samples[:keep_from]
            self._arrays = _NO_SAMPLES

    def at(
        self, stamps_ns: IntArray, max_gap_ns: int, extrapolate_ns: int = 0, allow_rest: bool = False
    ) -> tuple[FloatArray, BoolArray]:
        """Poses at these times: (k, 4, 4) parent_from_child, and (k,) whether each is known.

        Unknown where no two samples at most `max_gap_ns` apart enclose the time. extrapolate_ns: how far beyond
        either end the motion of the last two samples is carried on. allow_rest: where the two samples are the same
        pose, a wider gap between them is bridged, and `max_gap_ns` beyond an end is known. Matrices of unknown
        times are the identity.
        """
        wanted = np.asarray(stamps_ns, dtype=np.int64)
        matrices = np.tile(np.eye(4), (len(wanted), 1, 1))
        if not self._stamp_ns:
            return matrices, np.zeros(len(wanted), dtype=np.bool_)
        stamps, positions, rotations = self._as_arrays()
        if len(stamps) == 1:
            known = np.abs(wanted - stamps[0]) <= (max_gap_ns if allow_rest else extrapolate_ns)
            matrices[known] = pose_matrix(positions[0], rotations[0])
            return matrices, known
        found = np.searchsorted(stamps, wanted, side="left")
        right = np.clip(found, 1, len(stamps) - 1)
        left = right - 1
        exact = wanted == stamps[np.clip(found, 0, len(stamps) - 1)]
        span = stamps[right] - stamps[left]
        beyond = np.maximum(stamps[0] - wanted, wanted - stamps[-1])
        known = exact | ((beyond <= extrapolate_ns) & (span <= max_gap_ns))
        if allow_rest:
            same = np.isclose(positions[left], positions[right], rtol=0, atol=1e-6).all(axis=1)
            same &= np.abs(np.sum(rotations[left] * rotations[right], axis=1)) > 1 - 1e-12
            known |= same & (beyond <= max_gap_ns)
        fraction = (wanted - stamps[left]) / span
        turned = slerp(rotations[left], rotations[right], fraction)
        moved = positions[left] + fraction[:, None] * (positions[right] - positions[left])
        matrices[known, :3, :3] = rotation_from_quaternion(turned[known])
        matrices[known, :3, 3] = moved[known]
        return matrices, known

    def _as_arrays(self) -> tuple[IntArray, FloatArray, FloatArray]:
        joined = len(self._arrays[0])
        if joined < len(self._stamp_ns):
            new = self._samples[joined:]
            tail = (
                np.array(self._stamp_ns[joined:], dtype=np.int64),
                np.array([position for position, _ in new]),
                np.array([rotation for _, rotation in new]),
            )
            stamps, positions, rotations = (np.concatenate(pair) for pair in zip(self._arrays, tail, strict=True))
            self._arrays = stamps, positions, rotations
        return self._arrays


_PRUNE_BATCH = 64
"""Pruning shifts the lists: do it in batches."""


class TfBuffer:
    """A tree of frames joined by static and moving transforms, with lookups between any two at any times.

    A frame has one parent. A static edge given by the user (`fixed`) cannot be replaced by the log.
    """

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._static: dict[str, FloatArray] = {}
        self._moving: dict[str, Trajectory] = {}
        self._fixed: set[str] = set()

    def add_static(self, parent: str, child: str, parent_from_child: FloatArray, fixed: bool = False) -> None:
        if (child in self._fixed and not fixed) or parent == child:
            return
        self._moving.pop(child, None)
        self._parent[child] = parent
        self._static[child] = parent_from_child
        if fixed:
            self._fixed.add(child)

    def add(self, transform: StampedTransform) -> None:
        """A moving edge. One that contradicts a static edge of the same child is left out."""
        child = transform.child
        if child in self._static or transform.parent == child:
            return
        if self._parent.get(child) != transform.parent:
            self._parent[child] = transform.parent
            self._moving[child] = Trajectory()
        self._moving[child].add(transform.stamp_ns, transform.position_m, transform.quaternion_xyzw)

    def edges(self) -> tuple[tuple[str, str, bool], ...]:
        """(parent, child, static), sorted."""
        return tuple(sorted((parent, child, child in self._static) for child, parent in self._parent.items()))

    def frames(self) -> tuple[str, ...]:
        return tuple(sorted(set(self._parent) | set(self._parent.values())))

    def ancestors(self, frame: str) -> tuple[str, ...]:
        """The frame itself, its parent, and so on up to the root (or until a loop closes)."""
        line = [frame]
        while (parent := self._parent.get(line[-1])) is not None and parent not in line:
            line.append(parent)
        return tuple(line)

    def connected(self, target: str, source: str) -> bool:
        return self._path(target, source) is not None

    def moving(self, target: str, source: str) -> bool:
        """Whether a moving edge lies between two connected frames."""
        up_down = self._path(target, source)
        return up_down is not None and any(child in self._moving for line in up_down for child in line)

    def at_rest(self, target: str, source: str) -> bool:
        """Whether no moving edge between two connected frames has shown any motion so far."""
        path = self._path(target, source) or ((), ())
        return all(self._moving[child].at_rest() for line in path for child in line if child in self._moving)

    def copy_static(self) -> TfBuffer:
        """A new buffer with the static edges only."""
        copy = TfBuffer()
        for child, transform in self._static.items():
            copy.add_static(self._parent[child], child, transform, fixed=child in self._fixed)
        return copy

    def last_ns(self, target: str, source: str) -> int | None:
        """Up to when all moving edges between two frames are known; None where there is none."""
        path = self._path(target, source) or ((), ())
        ends = [self._moving[child].last_ns for line in path for child in line if child in self._moving]
        known = [end for end in ends if end is not None]
        return min(known) if known else None

    def lookup(
        self, target: str, source: str, stamps_ns: IntArray, max_gap_ns: int, extrapolate_ns: int = 0
    ) -> tuple[FloatArray, BoolArray]:
        """target_from_source at each time: (k, 4, 4), and (k,) whether it is known."""
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        matrices = np.tile(np.eye(4), (len(stamps), 1, 1))
        known = np.ones(len(stamps), dtype=np.bool_)
        path = self._path(target, source)
        if path is None:
            return matrices, np.zeros(len(stamps), dtype=np.bool_)
        from_target, from_source = path
        for child in from_source:
            step, there = self._edge(child, stamps, max_gap_ns, extrapolate_ns)
            matrices, known = step @ matrices, known & there
        for child in reversed(from_target):
            step, there = self._edge(child, stamps, max_gap_ns, extrapolate_ns)
            matrices, known = invert_all(step) @ matrices, known & there
        return matrices, known

    def prune(self, before_ns: int) -> None:
        for trajectory in self._moving.values():
            trajectory.prune(before_ns)

    def _edge(self, child: str, stamps: IntArray, max_gap_ns: int, extrapolate_ns: int) -> tuple[FloatArray, BoolArray]:
        if child in self._static:
            return np.tile(self._static[child], (len(stamps), 1, 1)), np.ones(len(stamps), dtype=np.bool_)
        return self._moving[child].at(stamps, max_gap_ns, extrapolate_ns, allow_rest=True)

    def _path(self, target: str, source: str) -> tuple[tuple[str, ...], tuple[str, ...]] | None:
        """The children of the edges from target and from source up to their nearest common ancestor."""
        up_target, up_source = self.ancestors(target), self.ancestors(source)
        common = next((frame for frame in up_source if frame in up_target), None)
        if common is None:
            return None
        return up_target[: up_target.index(common)], up_source[: up_source.index(common)]


def invert_all(transforms: FloatArray) -> FloatArray:
    """(k, 4, 4) rigid transforms -> their inverses."""
    inverse = np.tile(np.eye(4), (len(transforms), 1, 1))
    rotation = np.swapaxes(transforms[:, :3, :3], 1, 2)
    inverse[:, :3, :3] = rotation
    inverse[:, :3, 3] = -np.einsum("kij,kj->ki", rotation, transforms[:, :3, 3])
    return inverse
