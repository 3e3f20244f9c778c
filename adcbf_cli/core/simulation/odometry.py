"""The simulated pose source: the true pose, or one that drifts away from it in the plane.

Drift is a planar random walk: each step's translation and rotation, in the robot's own frame, get
Gaussian errors whose variance is proportional to the distance driven and the angle turned (the
sampled odometry model of Thrun, Burgard and Fox, Probabilistic Robotics, 2005, sec. 5.4, with
variances linear in the motion so that the result does not depend on the rate). Height, roll and
pitch stay true, as with an IMU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.frames import wrap_angle
from adcbf_cli.core.simulation.scenario import Odometry
from adcbf_cli.core.types import FloatArray


def as_recorded(values: FloatArray) -> list[float]:
    """To the nine decimals that a log gets: another processor's sine may differ in its last bit, the log's
    bytes must not. Adding zero turns -0.0 into 0.0."""
    return [float(value) for value in np.round(values, 9) + 0.0]


@dataclass(frozen=True, slots=True)
class Drift:
    """odom_from_world at (k,) times, as a planar shift and turn: x_m, y_m, yaw_rad (k,)."""

    time_s: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    yaw_rad: FloatArray

    def at(self, time_s: FloatArray) -> FloatArray:
        """(n, 4, 4) odom_from_world at (n,) times."""
        yaw = np.interp(time_s, self.time_s, self.yaw_rad)
        c, s = np.cos(yaw), np.sin(yaw)
        matrix = np.zeros((len(yaw), 4, 4))
        matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 0, 3] = c, -s, np.interp(time_s, self.time_s, self.x_m)
        matrix[:, 1, 0], matrix[:, 1, 1], matrix[:, 1, 3] = s, c, np.interp(time_s, self.time_s, self.y_m)
        matrix[:, 2, 2] = matrix[:, 3, 3] = 1.0
        return matrix


def simulate_drift(
    odometry: Odometry, time_s: FloatArray, world_from_base: FloatArray, rng: np.random.Generator
) -> Drift:
    """The drift along true poses (k, 4, 4) at (k,) times; none at the first."""
    x, y = world_from_base[:, 0, 3], world_from_base[:, 1, 3]
    heading = np.arctan2(world_from_base[:, 1, 0], world_from_base[:, 0, 0])
    dx, dy, turn = np.diff(x), np.diff(y), wrap_angle(np.diff(heading))
    distance = np.hypot(dx, dy)
    steps = rng.normal(size=(len(dx), 3))
    shift_sigma = odometry.translation_sigma_m_per_sqrt_m * np.sqrt(distance)
    turn_sigma = np.hypot(
        odometry.heading_sigma_rad_per_sqrt_m * np.sqrt(distance),
        odometry.heading_sigma_rad_per_sqrt_rad * np.sqrt(np.abs(turn)),
    )
    yaw_error = np.concatenate([[0.0], np.cumsum(turn_sigma * steps[:, 2])])
    odom_heading = heading + yaw_error
    along = np.cos(yaw_error[:-1]) * dx - np.sin(yaw_error[:-1]) * dy
    across = np.sin(yaw_error[:-1]) * dx + np.cos(yaw_error[:-1]) * dy
    c, s = np.cos(odom_heading[1:]), np.sin(odom_heading[1:])
    error_x, error_y = shift_sigma * steps[:, 0], shift_sigma * steps[:, 1]
    odom_x = x[0] + np.concatenate([[0.0], np.cumsum(along + c * error_x - s * error_y)])
    odom_y = y[0] + np.concatenate([[0.0], np.cumsum(across + s * error_x + c * error_y)])
    shift_x = odom_x - (np.cos(yaw_error) * x - np.sin(yaw_error) * y)
    shift_y = odom_y - (np.sin(yaw_error) * x + np.cos(yaw_error) * y)
    return Drift(time_s, shift_x, shift_y, yaw_error)
