"""From known obstacles to the problem's: held or predicted, which of them matter, which are nearest.

A column is one obstacle as the problem sees it: centres over the horizon, and the distance to keep.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from adcbf_cli.core.planning.barrier import gamma_at
from adcbf_cli.core.planning.problem import Obstacles, Problem
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

ObstacleSet = Literal["held", "predicted", "paper"]
"""held: where they are now, for the whole horizon. predicted: where they will be. paper: both for what
moves (the paper's i = 1..2n), once for what stands still."""


@dataclass(frozen=True, slots=True)
class Columns:
    """n columns: track_id (n,), centre_m (n, N + 1, 2), radius_m (n,) own radii, keep_out_m (n, N + 1)."""

    track_id: IntArray
    centre_m: FloatArray
    radius_m: FloatArray
    keep_out_m: FloatArray

    def __len__(self) -> int:
        return len(self.track_id)

    def taken(self, which: BoolArray | IntArray) -> Columns:
        return Columns(self.track_id[which], self.centre_m[which], self.radius_m[which], self.keep_out_m[which])


def columns_of(seen: Obstacles, obstacle_set: ObstacleSet, keep_m: float, most_margin_m: float) -> Columns:
    """All columns of the obstacles seen.

    keep_m: the vehicle's own radius and the safety distance. most_margin_m: predicted columns keep the
    prediction's uncertainty away as well, up to this much; a held one is where it was measured.
    """
    keep = np.repeat(seen.radius_m[:, None] + keep_m, seen.position_m.shape[1], axis=1)
    held = Columns(seen.track_id, np.repeat(seen.position_m[:, :1], keep.shape[1], axis=1), seen.radius_m, keep)
    if obstacle_set == "held":
        return held
    wider = keep + np.minimum(seen.margin_m, most_margin_m)
    predicted = Columns(seen.track_id, seen.position_m, seen.radius_m, wider)
    if obstacle_set == "predicted":
        return predicted
    moving = held.taken(~np.asarray(seen.is_static, dtype=bool))
    return Columns(
        np.concatenate([predicted.track_id, moving.track_id]),
        np.concatenate([predicted.centre_m, moving.centre_m]),
        np.concatenate([predicted.radius_m, moving.radius_m]),
        np.concatenate([predicted.keep_out_m, moving.keep_out_m]),
    )


def can_bind(problem: Problem, pose: FloatArray, last: FloatArray, columns: Columns) -> BoolArray:
    """(n,) whether any way of driving from `pose` (3,) and inputs `last` (2,) on could bring a barrier row
    of the column below zero.

    With d the least centre distance that top speed allows at stage k and s the most by which it may
    shrink in the step, h[k + 1] - (1 - gamma) h[k] is at least gamma (d^2 - R^2) - 2 d s + s^2 (less what R
    grows by), which rises with d from s / gamma on, and gamma rises with d too.
    """
    barrier = problem.barrier
    if barrier.form == "printed":
        return np.ones(len(columns), dtype=bool)
    limits = problem.vehicle
    top_mps = max(abs(float(speed)) for speed in (limits.input_min[0], limits.input_max[0], last[0]))
    reach_m = top_mps * problem.step_s * np.arange(columns.centre_m.shape[1])
    late = columns.centre_m[:, -2] - pose[:2]
    reached = np.hypot(late[:, 0], late[:, 1]) - reach_m[-2] <= columns.keep_out_m[:, -2]
    if reached.all():  # then each can bind at the last row, and the others need no look
        return np.asarray(reached)
    gap = columns.centre_m - pose[:2]
    least_m = np.hypot(gap[..., 0], gap[..., 1]) - reach_m
    least_m = np.maximum(least_m[:, :-1], 0.0)
    moved = np.diff(columns.centre_m, axis=1)
    shrink_m = np.hypot(moved[..., 0], moved[..., 1]) + top_mps * problem.step_s
    gamma = gamma_at(barrier.gamma, least_m, columns.radius_m[:, None])
    gamma = np.minimum(np.maximum(gamma, 0.0), 1.0)  # np.clip, in half the time on little
    keep_m = columns.keep_out_m
    grown = keep_m[:, 1:] ** 2 - keep_m[:, :-1] ** 2
    residual = gamma * (least_m**2 - keep_m[:, :-1] ** 2) - 2 * least_m * shrink_m + shrink_m**2 - grown
    safe = (residual > 0) & (gamma * least_m > shrink_m) & (least_m > keep_m[:, :-1])
    return np.asarray(~safe.all(axis=1))


def nearest(columns: Columns, poses: FloatArray, most: int) -> tuple[Columns, int]:
    """The columns of the `most` obstacles that come closest to poses (N + 1, 3) at the same stages, and
    how many obstacles that leaves out."""
    if len(columns) <= most:
        return columns, 0
    gap = columns.centre_m - poses[:, :2]
    closest = (np.hypot(gap[..., 0], gap[..., 1]) - columns.keep_out_m).min(axis=1, initial=np.inf)
    ids, owner = np.unique(columns.track_id, return_inverse=True)
    if len(ids) <= most:
        return columns, 0
    of_obstacle = np.full(len(ids), np.inf)
    np.minimum.at(of_obstacle, owner, closest)
    kept = np.zeros(len(ids), dtype=bool)
    kept[np.argsort(of_obstacle, kind="stable")[:most]] = True
    return columns.taken(kept[owner]), len(ids) - most
