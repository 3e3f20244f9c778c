"""Two vehicles, one motion: along an arc whose yaw rate the inputs give.

Inputs are (v, omega) for the unicycle and (v, delta) for the Ackermann vehicle, held constant over
a step; then both drive a circular arc, which is integrated exactly. Limits are boxes on the inputs
and on their rate of change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from adcbf_cli.core.config import VehicleConfig
from adcbf_cli.core.types import FloatArray


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Kinematics and limits.

    input_min, input_max: (2,) speed (m/s) and, unicycle, yaw rate (rad/s) or, Ackermann, steering
        angle (rad). rate_max: (2,) how fast each may change, per second.
    body_radius_m: the circle around the pose that holds the vehicle.
    wheelbase_m: Ackermann; the pose is the rear axle's middle.
    """

    kind: Literal["unicycle", "ackermann"]
    input_min: FloatArray
    input_max: FloatArray
    rate_max: FloatArray
    body_radius_m: float
    wheelbase_m: float

    @staticmethod
    def from_config(config: VehicleConfig) -> Vehicle:
        if config.kind == "unicycle":
            turn, rate = config.max_yaw_rate_radps, config.max_yaw_accel_radps2
        else:
            turn, rate = config.max_steer_rad, config.max_steer_rate_radps
        return Vehicle(
            kind=config.kind,
            input_min=np.array([config.min_speed_mps, -turn]),
            input_max=np.array([config.max_speed_mps, turn]),
            rate_max=np.array([config.max_accel_mps2, rate]),
            body_radius_m=config.body_radius_m,
            wheelbase_m=config.wheelbase_m,
        )

    def yaw_rate(self, inputs: FloatArray) -> FloatArray:
        """Yaw rate (rad/s) that inputs (..., 2) give."""
        if self.kind == "unicycle":
            return inputs[..., 1]
        return inputs[..., 0] * np.tan(inputs[..., 1]) / self.wheelbase_m

    def step(self, pose: FloatArray, inputs: FloatArray, step_s: float | FloatArray) -> FloatArray:
        """Pose (..., 3) = x, y (m), yaw (rad) after `step_s`, one or (...,), with inputs (..., 2): exact.

        Eq. 1 of the paper is this to first order in `step_s`.
        """
        half = 0.5 * step_s * self.yaw_rate(inputs)
        chord = inputs[..., 0] * step_s * np.sinc(half / np.pi)
        direction = pose[..., 2] + half
        return np.stack(
            [
                pose[..., 0] + chord * np.cos(direction),
                pose[..., 1] + chord * np.sin(direction),
                pose[..., 2] + 2 * half,
            ],
            axis=-1,
        )

    def roll_out(self, pose: FloatArray, inputs: FloatArray, step_s: float) -> FloatArray:
        """Poses (N + 1, 3), the first being `pose` (3,), under inputs (N, 2) of `step_s` each."""
        half = 0.5 * step_s * self.yaw_rate(inputs)
        yaw = pose[2] + np.concatenate([[0.0], np.cumsum(2 * half)])
        chord = inputs[:, 0] * step_s * np.sinc(half / np.pi)
        direction = yaw[:-1] + half
        poses = np.empty((len(inputs) + 1, 3))
        poses[0] = pose
        poses[1:, 0] = pose[0] + np.cumsum(chord * np.cos(direction))
        poses[1:, 1] = pose[1] + np.cumsum(chord * np.sin(direction))
        poses[:, 2] = yaw
        return poses

    def roll_outs(self, pose: FloatArray, inputs: FloatArray, step_s: float) -> FloatArray:
        """(K, N + 1, 3) as `roll_out`, for K inputs (K, N, 2) from one pose (3,)."""
        half = 0.5 * step_s * self.yaw_rate(inputs)
        chord = inputs[..., 0] * step_s * np.sinc(half / np.pi)
        poses = np.empty((inputs.shape[0], inputs.shape[1] + 1, 3))
        poses[:, 0] = pose
        poses[:, 1:, 2] = 2 * half
        np.cumsum(poses[..., 2], axis=1, out=poses[..., 2])
        direction = poses[:, :-1, 2] + half
        poses[:, 1:, 0], poses[:, 1:, 1] = chord * np.cos(direction), chord * np.sin(direction)
        np.cumsum(poses[..., :2], axis=1, out=poses[..., :2])
        return poses

    def limited(self, wanted: FloatArray, last: FloatArray, period_s: float) -> FloatArray:
        """The inputs (2,) nearest to `wanted` that are in bounds and can be reached from `last` in `period_s`.

        From a `last` out of bounds the way back goes as fast as the rate allows.
        """
        reach = self.rate_max * period_s
        inside = np.clip(wanted, self.input_min, self.input_max)
        return np.clip(inside, last - reach, last + reach)

    def within_limits(self, wanted: FloatArray, last: FloatArray, step_s: float, first_step_s: float) -> FloatArray:
        """`limited` for each stage of `wanted` (N, 2) in turn, the first from `last` (2,) in `first_step_s`.

        In plain floats, which is ten times as fast as N numpy calls. `wanted` must be finite.
        """
        inputs = np.empty((len(wanted), 2))
        for i in range(2):
            low, high, value = float(self.input_min[i]), float(self.input_max[i]), float(last[i])
            reach = float(self.rate_max[i]) * first_step_s
            column = []
            for aim in wanted[:, i].tolist():
                inside = min(max(aim, low), high)
                value = min(max(inside, value - reach), value + reach)
                column.append(value)
                reach = float(self.rate_max[i]) * step_s
            inputs[:, i] = column
        return inputs

    def envelope(
        self, last: FloatArray, steps: int, step_s: float, first_step_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest inputs, (steps, 2) each, that are in bounds and can be reached from `last` by then.

        From a `last` out of bounds both are the way back, as in `limited`.
        """
        reach = self.rate_max * (first_step_s + step_s * np.arange(steps)[:, None])
        lowest = np.clip(self.input_min, last - reach, last + reach)
        highest = np.clip(self.input_max, last - reach, last + reach)
        return lowest, highest

    def braking(self, last: FloatArray, steps: int, step_s: float, first_step_s: float | None = None) -> FloatArray:
        """Inputs (steps, 2) that stop as fast as the limits allow: speed to zero, and a unicycle's yaw
        rate in proportion to it, so that the path keeps its curvature, as far as its rate allows; steering stays.

        first_step_s: how long the first change may take, where that differs from `step_s`.
        """
        first_s = step_s if first_step_s is None else first_step_s
        at_s = first_s + step_s * np.arange(steps)
        speed = np.sign(last[0]) * np.maximum(np.abs(last[0]) - self.rate_max[0] * at_s, 0.0)
        turn = np.full(steps, last[1])
        if self.kind == "unicycle":
            turn = last[1] * (speed / last[0] if last[0] else np.zeros(steps))
        lowest, highest = self.envelope(last, steps, step_s, first_s)
        return np.asarray(np.clip(np.column_stack([speed, turn]), lowest, highest))
