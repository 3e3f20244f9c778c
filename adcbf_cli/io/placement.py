"""Where the sensor is: the pose source, the transforms between its frame and the sensor's, and the extrinsics.

world <-- pose source (odometry, pose topic, tf or pose file) --> child <-- tf, --extrinsic --> sensor
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.frames import StampedTransform, TfBuffer, Trajectory, clean_frame_id, pose_matrix
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

EXTRAPOLATE_NS = 100_000_000
"""How far past the first or last pose the motion is carried on: an end of a scan, or a scan at a log's end."""


@dataclass(frozen=True)
class Extrinsic:
    """parent_from_child, from the user."""

    parent: str
    child: str
    parent_from_child: FloatArray


def parse_extrinsic(text: str) -> Extrinsic:
    """'parent>child:x,y,z,roll,pitch,yaw' in metres and radians (fixed axes: roll about x first). Raises UsageError."""
    wanted = "it is written 'parent>child:x,y,z,roll,pitch,yaw' in metres and radians"
    frames, colon, numbers = text.partition(":")
    parent, arrow, child = frames.partition(">")
    parent, child = clean_frame_id(parent), clean_frame_id(child)
    if not colon or not arrow or not parent or not child or parent == child:
        raise UsageError(f"--extrinsic '{text}': {wanted}")
    try:
        values = np.array([float(number) for number in numbers.split(",")])
    except ValueError as error:
        raise UsageError(f"--extrinsic '{text}': {error}; {wanted}") from error
    if values.shape != (6,) or not np.isfinite(values).all():
        raise UsageError(f"--extrinsic '{text}': six finite numbers are needed; {wanted}")
    from scipy.spatial.transform import Rotation

    quaternion = Rotation.from_euler("xyz", values[3:]).as_quat()
    return Extrinsic(parent, child, pose_matrix(values[:3], quaternion))


@dataclass
class Placement:
    """The sensors' poses in the world, fed with poses and transforms as they come.

    source: 'topic', 'tf' or 'none'. child: the frame that the pose source carries. world: the fixed frame.
    linked: per sensor frame, whether tf joins it to the child (else they are taken to be one).
    """

    source: str
    world: str
    pose_frame: str
    child: str
    linked: dict[str, bool]
    tf: TfBuffer
    max_gap_ns: int
    poses: Trajectory = field(default_factory=Trajectory)

    def add_pose(self, transform: StampedTransform) -> None:
        self.poses.add(transform.stamp_ns, transform.position_m, transform.quaternion_xyzw)

    def covered_ns(self, sensor: str) -> int | None:
        """Up to when the sensor's pose can be told; None where nothing moves or nothing has come yet."""
        ends: list[int | None] = []
        if self.source == "topic":
            ends.append(self.poses.last_ns)
            if self.world != self.pose_frame:
                ends.append(self.tf.last_ns(self.world, self.pose_frame))
            if self.linked[sensor]:
                ends.append(self.tf.last_ns(self.child, sensor))
        elif self.source == "tf":
            ends.append(self.tf.last_ns(self.world, sensor))
        known = [end for end in ends if end is not None]
        return min(known) if known else None

    def world_from_sensor(self, sensor: str, stamps_ns: IntArray) -> tuple[FloatArray, BoolArray]:
        """(k, 4, 4) poses of a sensor frame in the world, and (k,) whether each is known."""
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        if self.source == "tf":
            return self.tf.lookup(self.world, sensor, stamps, self.max_gap_ns, EXTRAPOLATE_NS)
        if self.source == "none":
            matrices, known = np.tile(np.eye(4), (len(stamps), 1, 1)), np.ones(len(stamps), dtype=np.bool_)
        else:
            matrices, known = self.poses.at(stamps, self.max_gap_ns, EXTRAPOLATE_NS)
            if self.world != self.pose_frame:
                outer, there = self.tf.lookup(self.world, self.pose_frame, stamps, self.max_gap_ns, EXTRAPOLATE_NS)
                matrices, known = outer @ matrices, known & there
        if self.linked[sensor]:
            mount, there = self.tf.lookup(self.child, sensor, stamps, self.max_gap_ns, EXTRAPOLATE_NS)
            matrices, known = matrices @ mount, known & there
        return matrices, known

    def prune(self, before_ns: int) -> None:
        """Forget poses and transforms that only times before this need."""
        self.poses.prune(before_ns)
        self.tf.prune(before_ns)
