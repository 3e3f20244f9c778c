"""Where a LiDAR sits on the vehicle, where a log does not say: the place that makes the surroundings sharpest.

    python benchmarks/mount.py LOG --pose TOPIC [--range 4] [--step 2]

All scans are laid into the world by the pose source, with the LiDAR shifted by x, y and turned by yaw from
the pose's frame, and with its clock shifted by a delay: a vehicle that drives at a steady speed cannot tell
a delay from a shift ahead, so both are sought together. Where they are wrong, what stands still is smeared as
the vehicle turns. The sharpness is the mean of the blurred density of points at the points; what moves adds
little to it. No other ground truth is looked at. It takes turns in the log.
"""

from __future__ import annotations

import measuring  # isort: skip - it limits the threads before numpy is imported
import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.types import FloatArray, Frame, IntArray, Notes
from adcbf_cli.io.frame_reader import FrameReader

CELL_M = 0.03
BLUR_CELLS = 2.0
STARTS_M = (-0.15, 0.0, 0.15)
FIRST_STEP = 0.05


@dataclass(frozen=True)
class Scans:
    """Points (n, 2) of all scans as the LiDAR sees them, each one's scan (n,), and the vehicle's course:
    time_s (k,) and pose (k, 3) x, y, unwrapped yaw at each scan."""

    xy_m: FloatArray
    scan: IntArray
    time_s: FloatArray
    pose: FloatArray

    @classmethod
    def collect(cls, frames: Sequence[Frame], range_m: float, step: int) -> Scans:
        """Every step-th scan's points up to range_m, and all poses."""
        placed = [frame.world_from_sensor for frame in frames]
        yaw = np.unwrap([np.arctan2(pose[1, 0], pose[0, 0]) for pose in placed])
        time_s = np.array([(frame.stamp_ns - frames[0].stamp_ns) / 1e9 for frame in frames])
        near = [frame.points_m[np.hypot(*frame.points_m[:, :2].T) <= range_m, :2] for frame in frames[::step]]
        scan = np.repeat(np.arange(0, len(frames), step), [len(points) for points in near])
        return cls(
            np.concatenate(near),
            scan,
            time_s,
            np.column_stack([[p[0, 3] for p in placed], [p[1, 3] for p in placed], yaw]),
        )

    def in_world(self, mount: FloatArray) -> FloatArray:
        """The points (n, 2), with the LiDAR at mount (x, y, yaw, delay in s) in the pose's frame."""
        time_s = self.time_s + mount[3]
        x, y, yaw = (np.interp(time_s, self.time_s, self.pose[:, axis])[self.scan] for axis in range(3))
        seen = turned(self.xy_m, mount[2]) + mount[:2]
        return np.column_stack([x, y]) + turned(seen, yaw)


def turned(xy_m: FloatArray, angle_rad: FloatArray | float) -> FloatArray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.column_stack([c * xy_m[:, 0] - s * xy_m[:, 1], s * xy_m[:, 0] + c * xy_m[:, 1]])


def sharpness(xy_m: FloatArray) -> float:
    """The mean over the points (n, 2) of how many others are near, blurred a little."""
    cell = np.floor((xy_m - xy_m.min(axis=0)) / CELL_M).astype(np.int64)
    shape = tuple((cell.max(axis=0) + 1).tolist())
    count = np.bincount(np.ravel_multi_index((cell[:, 0], cell[:, 1]), shape), minlength=shape[0] * shape[1])
    density = gaussian_filter(count.reshape(shape).astype(np.float64), BLUR_CELLS)
    return float((density**2).sum() / len(xy_m))


def fitted_mount(scans: Scans, start: FloatArray) -> tuple[FloatArray, float]:
    """The mount (x, y, yaw, delay) with the greatest sharpness near `start`, and that sharpness."""
    simplex = np.vstack([start, start + FIRST_STEP * np.eye(4)])
    found = minimize(
        lambda mount: -sharpness(scans.in_world(mount)),
        start,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxiter": 160, "xatol": 1e-3, "fatol": 1e-3},
    )
    return found.x, -float(found.fun)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("log", type=Path)
    parser.add_argument("--pose", required=True, metavar="TOPIC")
    parser.add_argument("--range", type=float, default=4.0, metavar="M", help="points up to here (default 4)")
    parser.add_argument("--step", type=int, default=2, metavar="N", help="every Nth scan (default 2)")
    chosen = parser.parse_args(arguments)
    with FrameReader(chosen.log, ReadConfig(pose=chosen.pose), Notes()) as reader:
        frames = [frame for frame in reader if frame.pose_known]
    scans = Scans.collect(frames, chosen.range, chosen.step)
    rows: list[list[object]] = [["as it is", 0.0, 0.0, 0.0, 0.0, sharpness(scans.in_world(np.zeros(4)))]]
    for start in STARTS_M:
        mount, found = fitted_mount(scans, np.array([start, 0.0, 0.0, 0.0]))
        rows.append([f"from x = {start:g} m", *np.round(mount, 3).tolist(), found])
    print(measuring.markdown(["start", "x_m", "y_m", "yaw_rad", "delay_s", "sharpness"], rows))


if __name__ == "__main__":
    main()
