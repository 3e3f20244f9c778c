"""Where the log's own vehicle was: the LiDAR's pose in the plane over time, its speed and its turn.

The pose is the sensor's, projected to the world's xy plane. Its yaw is the direction of the sensor's
x axis, unless the log shows that the sensor is mounted turned: then it is the direction of travel
(see MOUNT_TOLERANCE_RAD). Nothing corrects for where on the vehicle the sensor sits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Protocol

import numpy as np

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.frames import wrap_angle
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

MAX_GAP_NS = 1_000_000_000
"""Poses farther apart in time than this are not interpolated."""

WINDOW_NS = 250_000_000
"""Speed and yaw rate are slopes of straight lines fitted this far to both sides: a pose's noise of a
centimetre, differenced over a tenth of a second, would be a tenth of a metre a second."""

SLOW_MPS = 0.1
"""Below this the steering angle is taken as at this speed; standing, it would be anything."""

MOUNT_TOLERANCE_RAD = 0.35
"""A sensor whose x axis differs from the direction of travel by more than this, steadily, is turned."""
MOUNT_MIN_SPEED_MPS = 0.15
MOUNT_MIN_TRAVEL_M = 2.0
MOUNT_CONCENTRATION = 0.9
"""Steadily: the mean resultant length of the angle between the two, weighed by the way, over at least
MOUNT_MIN_TRAVEL_M driven faster than MOUNT_MIN_SPEED_MPS. Slower, a sensor off the axle that the vehicle
turns about moves sideways."""


class Posed(Protocol):
    """A record of one frame with the sensor's pose, such as `Clusters`."""

    @property
    def stamp_ns(self) -> int: ...

    @property
    def world_from_sensor(self) -> FloatArray: ...

    @property
    def pose_known(self) -> bool: ...


class LogPath:
    """The log's vehicle: T >= 1 poses in time.

    stamp_ns: (T,) ascending. pose: (T, 3) x, y (m), yaw (rad, continuous), world frame.
    speed_mps: (T,) along the yaw, negative in reverse; yaw_rate_radps: (T,); NaN where no other pose is
    near enough in time to tell. smooth_m: (T, 2) the positions on the fitted lines.
    mount_yaw_rad: the sensor's own yaw on the vehicle, taken off the poses; 0 where it looks ahead.
    """

    def __init__(self, stamp_ns: IntArray, pose: FloatArray) -> None:
        """AdcbfError where there are none. Poses at a stamp that is not later than the one before are left out."""
        stamps = np.asarray(stamp_ns, dtype=np.int64)
        if not len(stamps):
            raise AdcbfError("the log holds no scan: there is no time to drive in")
        later = np.concatenate([[True], stamps[1:] > np.maximum.accumulate(stamps)[:-1]])
        self.stamp_ns: IntArray = stamps[later]
        self.pose: FloatArray = np.array(pose, dtype=float)[later]
        self.pose[:, 2] = np.unwrap(self.pose[:, 2])
        middle, slope = _fitted(self.stamp_ns, self.pose)
        self.smooth_m: FloatArray = np.where(np.isfinite(middle[:, :2]), middle[:, :2], self.pose[:, :2])
        self.mount_yaw_rad = _mount_yaw(self.stamp_ns, self.pose, slope)
        self.pose[:, 2] -= self.mount_yaw_rad
        yaw = np.where(np.isfinite(middle[:, 2]), middle[:, 2], self.pose[:, 2]) - self.mount_yaw_rad
        self.speed_mps: FloatArray = slope[:, 0] * np.cos(yaw) + slope[:, 1] * np.sin(yaw)
        self.yaw_rate_radps: FloatArray = slope[:, 2]

    @classmethod
    def from_frames(cls, frames: Iterable[Posed]) -> LogPath:
        """From the records of a log (`Clusters`); frames without a known pose are left out. Where none has one,
        as in an object list, or where a sensor stood on its own: the log's times, with poses that are NaN."""
        rows = [(f.stamp_ns, f.pose_known, _planar(f.world_from_sensor)) for f in frames]
        stamps = np.array([stamp for stamp, _, _ in rows], dtype=np.int64)
        known = np.array([is_known for _, is_known, _ in rows], dtype=np.bool_)
        poses = np.array([pose for _, _, pose in rows]).reshape(-1, 3)
        return cls(stamps[known], poses[known]) if known.any() else cls(stamps, np.full_like(poses, np.nan))

    @property
    def mount_note(self) -> str | None:
        """What the user should know about how the sensor is mounted; None where it looks ahead."""
        if not self.mount_yaw_rad:
            return None
        return (
            f"the sensor's x axis is turned by {np.degrees(self.mount_yaw_rad):.0f} degrees from the direction of "
            "travel: it is taken to be mounted so, and the vehicle to drive forwards"
        )

    @property
    def known(self) -> bool:
        """Whether anything drove there at all."""
        return bool(np.isfinite(self.pose).any())

    @property
    def start_ns(self) -> int:
        return int(self.stamp_ns[0])

    @property
    def end_ns(self) -> int:
        return int(self.stamp_ns[-1])

    def at(self, stamp_ns: IntArray) -> FloatArray:
        """Poses (q, 3) at times (q,): linear in between, NaN outside and across gaps."""
        return self._between(np.atleast_1d(np.asarray(stamp_ns, dtype=np.int64)), self.pose)

    def motion_at(self, stamp_ns: IntArray) -> FloatArray:
        """(q, 2) speed (m/s) and yaw rate (rad/s) at times (q,), NaN where not known."""
        stamps = np.atleast_1d(np.asarray(stamp_ns, dtype=np.int64))
        return self._between(stamps, np.column_stack([self.speed_mps, self.yaw_rate_radps]))

    def inputs_at(self, stamp_ns: int, vehicle: Vehicle) -> FloatArray:
        """(2,) inputs with which this kind of vehicle would move as the log's did; zero where the log
        does not say. Not limited to what the vehicle can."""
        motion = np.nan_to_num(self.motion_at(np.array([stamp_ns])))
        inputs: FloatArray = inputs_of(motion, vehicle)[0]
        return inputs

    def _between(self, stamp_ns: IntArray, values: FloatArray) -> FloatArray:
        after = np.clip(np.searchsorted(self.stamp_ns, stamp_ns), 0, len(self.stamp_ns) - 1)
        exact = self.stamp_ns[after] == stamp_ns
        before = np.where(exact, after, np.maximum(after - 1, 0))
        gap = self.stamp_ns[after] - self.stamp_ns[before]
        share = (stamp_ns - self.stamp_ns[before]) / np.maximum(gap, 1)
        known = exact | ((stamp_ns > self.start_ns) & (stamp_ns < self.end_ns) & (gap <= MAX_GAP_NS))
        blended = values[before] + share[:, None] * (values[after] - values[before])
        result: FloatArray = np.where(exact[:, None], values[after], blended)
        return np.where(known[:, None], result, np.nan)


def _planar(world_from_sensor: FloatArray) -> tuple[float, float, float]:
    """x, y, yaw of a pose (4, 4)."""
    turn = world_from_sensor[:, 0]
    return float(world_from_sensor[0, 3]), float(world_from_sensor[1, 3]), math.atan2(turn[1], turn[0])


def inputs_of(motion: FloatArray, vehicle: Vehicle) -> FloatArray:
    """(..., 2) speed and yaw rate as the vehicle's inputs: the same, or speed and steering angle."""
    if vehicle.kind == "unicycle":
        return np.asarray(motion)
    speed = motion[..., 0]
    along = np.where(speed < 0, -1.0, 1.0) * np.maximum(np.abs(speed), SLOW_MPS)
    return np.stack([speed, np.arctan(vehicle.wheelbase_m * motion[..., 1] / along)], axis=-1)


def _fitted(stamp_ns: IntArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Straight lines through values (T, k) around each stamp: value and slope there, both (T, k).

    Each takes the samples within WINDOW_NS and the next one to either side, none beyond a gap; NaN
    where that is one sample.
    """
    middle, slope = np.full_like(values, np.nan), np.full_like(values, np.nan)
    stretch = np.concatenate([[0], np.cumsum(np.diff(stamp_ns) > MAX_GAP_NS)])
    start = np.searchsorted(stretch, stretch)
    end = np.searchsorted(stretch, stretch, side="right")
    here = np.arange(len(stamp_ns))
    first = np.maximum(np.minimum(np.searchsorted(stamp_ns, stamp_ns - WINDOW_NS), here - 1), start)
    last = np.minimum(np.maximum(np.searchsorted(stamp_ns, stamp_ns + WINDOW_NS, side="right"), here + 2), end)
    for i in here:
        window = slice(int(first[i]), int(last[i]))
        if window.stop - window.start < 2:
            continue
        time = (stamp_ns[window] - stamp_ns[i]) / 1e9
        centred = time - time.mean()
        slope[i] = centred @ values[window] / (centred @ centred)
        middle[i] = values[window].mean(axis=0) - slope[i] * time.mean()
    return middle, slope


def _mount_yaw(stamp_ns: IntArray, pose: FloatArray, slope: FloatArray) -> float:
    """The sensor's yaw on the vehicle: how far its x axis is turned from the direction of travel."""
    speed = np.hypot(slope[:, 0], slope[:, 1])
    fast: BoolArray = speed > MOUNT_MIN_SPEED_MPS
    if not fast.any():
        return 0.0
    step_s = np.minimum(np.gradient((stamp_ns - stamp_ns[0]) / 1e9), MAX_GAP_NS / 1e9)
    way_m = (speed * step_s)[fast]
    if way_m.sum() < MOUNT_MIN_TRAVEL_M:
        return 0.0
    turned = pose[fast, 2] - np.arctan2(slope[fast, 1], slope[fast, 0])
    mean = np.average(np.exp(1j * turned), weights=way_m)
    if np.abs(mean) < MOUNT_CONCENTRATION or np.abs(np.angle(mean)) <= MOUNT_TOLERANCE_RAD:
        return 0.0
    return float(wrap_angle(np.angle(mean)))
