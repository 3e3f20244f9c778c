"""The records that travel from stage to stage: structures of arrays, one record per LiDAR frame.

    Scan -> Frame -> Clusters -> Tracks -> Predictions

Time is int64 nanoseconds. Lengths are metres, angles radians. `world` is the frame of the pose
source (odom, map); `sensor` is the LiDAR's own frame at the frame's stamp. A 4 x 4 array named
`world_from_sensor` maps homogeneous sensor coordinates to world coordinates.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NO_ID = -1
"""In id arrays: there is none. Tables show it as null."""


@dataclass(frozen=True, slots=True)
class Scan:
    """One LiDAR message, decoded, still in its sensor's frame and not yet corrected for motion.

    points_m: (n, 3), finite; rows with NaN, Inf or the driver's "no return" are already gone,
        together with their times.
    offset_ns: (n,) int64, each point's time relative to `stamp_ns`, or None where not recorded.
    planar: True for a 2-D laser.
    """

    stamp_ns: int
    frame_id: str
    topic: str
    points_m: FloatArray
    offset_ns: IntArray | None
    planar: bool


@dataclass(frozen=True, slots=True)
class Frame:
    """A scan placed in the world: points (n, 3) in the sensor's frame, all as at `stamp_ns`.

    pose_known: False where no pose source covered this stamp; the sensor is then taken to stand
        at the world's origin.
    """

    index: int
    stamp_ns: int
    points_m: FloatArray
    world_from_sensor: FloatArray
    planar: bool
    pose_known: bool


@dataclass(frozen=True, slots=True)
class PointCounts:
    """How many points were left after each perception step of one frame."""

    read: int
    in_range: int
    smoothed: int
    above_ground: int
    clustered: int
    """Points that reached the clusterer: one per occupied grid cell."""


@dataclass(frozen=True, slots=True)
class PointLabels:
    """Optional point-wise result: points (k, 3) in the world, and each one's cluster id or NO_ID."""

    points_m: FloatArray
    cluster_id: IntArray


@dataclass(frozen=True, slots=True)
class Clusters:
    """The obstacles seen in one frame: n circles with a height.

    centre_m: (n, 3) world frame; centre_sensor_m: (n, 3) the same points in the sensor's frame.
    radius_m, height_m: (n,) the circle that stands for the obstacle, and its vertical extent.
    length_m, width_m, yaw_rad: (n,) the oriented rectangle around it in the world's xy plane,
        length >= width, yaw in (-pi/2, pi/2].
    points: (n,) occupied grid cells; probability: (n,) mean membership probability in [0, 1].
    split_from: (n,) the id shared by the pieces of one over-long cluster, NO_ID for a whole one.
    """

    frame_index: int
    stamp_ns: int
    world_from_sensor: FloatArray
    planar: bool
    pose_known: bool
    counts: PointCounts
    cluster_id: IntArray
    centre_m: FloatArray
    centre_sensor_m: FloatArray
    radius_m: FloatArray
    height_m: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    yaw_rad: FloatArray
    points: IntArray
    probability: FloatArray
    split_from: IntArray
    labels: PointLabels | None = None

    def __len__(self) -> int:
        return len(self.cluster_id)


class TrackStatus(enum.IntEnum):
    """A track's life: tentative until seen often enough, coasting while unseen, then ended."""

    TENTATIVE = 0
    CONFIRMED = 1
    COASTING = 2
    ENDED = 3


@dataclass(frozen=True, slots=True)
class Tracks:
    """The tracks alive in one frame, after its update (and those that end in it).

    state: (n, d) world frame; the first six are always x, y, z (m), vx, vy, vz (m/s); a constant-
        acceleration model adds ax, ay, az (m/s^2), a coordinated turn adds the turn rate (rad/s).
    covariance: (n, d, d), symmetric, positive definite.
    cluster_id: (n,) the cluster that updated it in this frame, NO_ID while it coasts.
    nis: (n,) normalised innovation squared of this update, NaN without one.
    manoeuvre: (n,) probability that the track is manoeuvring rather than keeping its course, or
        None where that is not known.
    """

    frame_index: int
    stamp_ns: int
    world_from_sensor: FloatArray
    model: str
    track_id: IntArray
    status: IntArray
    state: FloatArray
    covariance: FloatArray
    radius_m: FloatArray
    height_m: FloatArray
    is_static: BoolArray
    cluster_id: IntArray
    age_s: FloatArray
    hits: IntArray
    misses: IntArray
    nis: FloatArray
    manoeuvre: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.track_id)


@dataclass(frozen=True, slots=True)
class Predictions:
    """Where the confirmed tracks of one frame will be: n tracks, N steps of `step_s`.

    position_m: (n, N, 3); velocity_mps: (n, N, 2); covariance_m2: (n, N, 2, 2), of x and y, world.
    radius_m: (n,) the obstacle's own radius.
    sigma_radius_m: (n, N) what to add to the radius so that the predicted Gaussian's ellipse of
        the configured probability fits inside.
    conformal_radius_m: (n, N) the same by split-conformal calibration; NaN where too few
        calibration samples exist.
    """

    frame_index: int
    stamp_ns: int
    step_s: float
    track_id: IntArray
    is_static: BoolArray
    position_m: FloatArray
    velocity_mps: FloatArray
    covariance_m2: FloatArray
    radius_m: FloatArray
    sigma_radius_m: FloatArray
    conformal_radius_m: FloatArray

    def __len__(self) -> int:
        return len(self.track_id)


@dataclass(frozen=True, slots=True)
class IgnoredSectors:
    """Where a labelled frame says "do not care": k azimuth sectors in the sensor's frame.

    stamp_ns: (k,) int64; start_rad, end_rad: (k,), from start counter-clockwise to end.
    """

    stamp_ns: IntArray
    start_rad: FloatArray
    end_rad: FloatArray


@dataclass(frozen=True, slots=True)
class Truth:
    """Ground truth: m labelled positions, sorted by time.

    frame: "world" or "sensor", the frame that `position_m` (m, 3) and `yaw_rad` (m,) are in.
    track_id: (m,) int64; category: m names ("Car", "Pedestrian", ...).
    length_m, width_m, height_m, yaw_rad: (m,), NaN where the source does not tell.
    labelled_fov_rad: (start, end) azimuths in the sensor's frame that were labelled at all, or
        None for all around; what lies outside is neither right nor wrong.
    ignored: sectors within it that were not labelled, by stamp.
    exhaustive: whether everything that moves there is labelled; False for the poses of one object.
    """

    frame: str
    stamp_ns: IntArray
    track_id: IntArray
    category: tuple[str, ...]
    position_m: FloatArray
    yaw_rad: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    height_m: FloatArray
    labelled_fov_rad: tuple[float, float] | None = None
    source: str = ""
    ignored: IgnoredSectors | None = None
    exhaustive: bool = True

    def __len__(self) -> int:
        return len(self.stamp_ns)


@dataclass(frozen=True, slots=True)
class Loss:
    """Part of the input that could not be read: what it was, and how much where that is known."""

    what: str
    count: int | None = None


@dataclass(slots=True)
class Notes:
    """What a stage wants the user to know, gathered while it runs; the command shows it once.

    warnings: one line each, without repeats. losses: unreadable input (exit code 3).
    counters: named events, such as repaired factorisations.
    """

    warnings: list[str] = field(default_factory=list)
    losses: list[Loss] = field(default_factory=list)
    counters: dict[str, int] = field(default_factory=dict)

    def warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)

    def lose(self, what: str, count: int | None = None) -> None:
        self.losses.append(Loss(what, count))

    def count(self, name: str, by: int = 1) -> None:
        if by:
            self.counters[name] = self.counters.get(name, 0) + by
