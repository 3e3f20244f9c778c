"""Hand-made recordings: a vehicle that drives straight, things that stand or move, what was seen of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from adcbf_cli.core.planning.planner import Outcome, Plan, Situation
from adcbf_cli.core.replay.log_path import LogPath
from adcbf_cli.core.types import Predictions
from adcbf_cli.core.vehicles.vehicle import Vehicle

SECOND = 1_000_000_000


class StraightDriver:
    """Plans to go on with constant inputs, whatever is there."""

    def __init__(self, vehicle: Vehicle, speed_mps: float, turn: float = 0.0, name: str = "straight") -> None:
        self.name = name
        self.vehicle = vehicle
        self.inputs = np.array([speed_mps, turn])
        self.situations: list[Situation] = []

    def plan(self, situation: Situation) -> Plan:
        self.situations.append(situation)
        inputs = np.tile(self.inputs, (30, 1))
        return Plan(Outcome.SOLVED, inputs, self.vehicle.roll_out(situation.pose, inputs, 0.1), None)


@pytest.fixture
def driver() -> type[StraightDriver]:
    return StraightDriver


@pytest.fixture
def log_along_x() -> Callable[..., LogPath]:
    """A vehicle that drives along the x axis from the origin, a pose each 0.1 s."""

    def make(speed_mps: float = 1.0, duration_s: float = 10.0) -> LogPath:
        time_s = np.arange(round(duration_s * 10) + 1) / 10
        pose = np.column_stack([speed_mps * time_s, np.zeros_like(time_s), np.zeros_like(time_s)])
        return LogPath(np.round(time_s * 1e9).astype(np.int64), pose)

    return make


@pytest.fixture
def predicted() -> Callable[..., Predictions]:
    """Predictions of things that keep their velocity: positions (n, 2) at the stamp, velocities (n, 2)."""

    def make(stamp_ns: int, place_m: object, moving_mps: object, **changes: object) -> Predictions:
        position = np.asarray(place_m, dtype=float).reshape(-1, 2)
        velocity = np.asarray(moving_mps, dtype=float).reshape(-1, 2)
        n, steps = len(position), 5
        ahead = position[:, None] + velocity[:, None] * (0.1 * np.arange(1, steps + 1))[None, :, None]
        values = {
            "track_id": np.arange(n, dtype=np.int64),
            "is_static": np.hypot(velocity[:, 0], velocity[:, 1]) == 0.0,
            "position_m": np.concatenate([ahead, np.zeros((n, steps, 1))], axis=-1),
            "velocity_mps": np.repeat(velocity[:, None], steps, axis=1),
            "covariance_m2": np.tile(np.eye(2), (n, steps, 1, 1)),
            "radius_m": np.full(n, 0.3),
            "sigma_radius_m": np.tile(0.1 * np.arange(1, steps + 1), (n, 1)),
            "conformal_radius_m": np.tile(0.2 * np.arange(1, steps + 1), (n, 1)),
        }
        return Predictions(frame_index=0, stamp_ns=stamp_ns, step_s=0.1, **{**values, **changes})

    return make
