"""Ground truth that is the robot itself: the slip of the hand that gives a poor score and no error."""

from __future__ import annotations

import numpy as np

from adcbf_cli.core.frames import invert_all
from adcbf_cli.core.types import FloatArray, IntArray, Truth

_SAME_TIME_NS = 20_000_000
_FIXED_M = 0.25
_DRIVEN_M = 2.0
_LEAST = 5


def rides_along(truth: Truth, stamp_ns: IntArray, world_from_sensor: FloatArray) -> tuple[int, ...]:
    """The objects that stay where they are in the sensor's frame while the sensor drives: parts of the vehicle.

    truth: in the world frame. stamp_ns, world_from_sensor: (n,) ascending and (n, 4, 4), of the run's frames. Nothing
    can be told of objects that few labels fall on a frame of, nor where the sensor stood.
    """
    if not len(stamp_ns):
        return ()
    before = np.clip(np.searchsorted(stamp_ns, truth.stamp_ns) - 1, 0, len(stamp_ns) - 1)
    after = np.minimum(before + 1, len(stamp_ns) - 1)
    nearer = np.abs(stamp_ns[after] - truth.stamp_ns) < np.abs(truth.stamp_ns - stamp_ns[before])
    frame = np.where(nearer, after, before)
    together = np.abs(stamp_ns[frame] - truth.stamp_ns) <= _SAME_TIME_NS
    sensor_from_world = invert_all(world_from_sensor)
    found = []
    for number in np.unique(truth.track_id[together]).tolist():
        rows = np.flatnonzero(together & (truth.track_id == number))
        poses = sensor_from_world[frame[rows]]
        local = np.einsum("nij,nj->ni", poses[:, :2, :3], truth.position_m[rows]) + poses[:, :2, 3]
        driven_m = np.ptp(world_from_sensor[frame[rows], :2, 3], axis=0).max()
        fixed = np.hypot(*local.std(axis=0)) <= _FIXED_M
        if len(rows) >= _LEAST and driven_m >= _DRIVEN_M and fixed:
            found.append(int(number))
    return tuple(found)
