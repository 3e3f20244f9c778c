"""The way out that keeps the most room, where no plan keeps clear of what moves.

Merit is a bad guide there: it adds up what every stage violates, and every stage's barrier is violated by what comes
fast, however far it still is, so that the cheapest plan is to slow down and be hit. So a search goes forward in time,
a layer of states at a time: each state is driven on with a set of wanted inputs, held for a period, and those states
are kept that at their worst moment came least too near to what is known.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.planning.columns import Columns
from adcbf_cli.core.planning.problem import Problem
from adcbf_cli.core.types import FloatArray, IntArray

HELD_S = 0.5
"""Wanted inputs are held for so long, and followed as fast as the vehicle's rates allow."""

WIDTH = 96
"""States kept a layer."""

SPEEDS = (0.0, 1 / 3, 2 / 3, 1.0)
TURNS = (-1.0, -0.5, 0.0, 0.5, 1.0)
"""Inputs that are tried, as shares of the bounds."""

CELL = np.array([0.08, 0.08, 0.15, 0.2, 0.5])
"""States (x, y in m, yaw in rad, inputs in their units) in the same cell of this size lead to the same: the best is
kept."""

SPREAD = np.array([0.15, 0.15, 0.3])
"""States (x, y, yaw) that are kept although better ones are there are as far apart as this."""

ROOM_STEP_M = 0.02
"""States that differ less in room are told apart by how near they are to the reference."""


@dataclass(frozen=True, slots=True)
class _Layer:
    """n states of one stage: poses (n, 3), inputs (n, 2) applied last, the room (n,) at their worst so far; of which
    state of the layer before they are children (n,), and the inputs (n, stages, 2) since then."""

    pose: FloatArray
    inputs: FloatArray
    room_m: FloatArray
    parent: IntArray
    driven: FloatArray


def room_m(poses: FloatArray, columns: Columns) -> FloatArray:
    """(K,) by how much K ways (K, N + 1, 3) keep farther from the columns than they should, at their worst. More room
    than asked for is not better: at most 0."""
    gap = columns.centre_m[None] - poses[:, None, :, :2]
    spare = np.hypot(gap[..., 0], gap[..., 1]) - columns.keep_out_m[None]
    return np.asarray(np.minimum(spare.min(axis=(1, 2), initial=np.inf), 0.0))


def roomy_ways(
    problem: Problem, pose: FloatArray, last: FloatArray, columns: Columns, reference: FloatArray
) -> FloatArray:
    """(K, N, 2) inputs of the ways that the search kept, within the vehicle's limits, the roomiest first.

    pose: (3,) and last: (2,) the inputs applied up to now. reference: (N + 1, 5) where the vehicle should be.
    """
    held = max(round(HELD_S / problem.step_s), 1)
    root = np.zeros(1, dtype=np.int64)
    layers = [_Layer(pose[None], last[None], np.zeros(1), root, np.zeros((1, 0, 2)))]
    for stage in range(0, problem.steps, held):
        stages = min(held, problem.steps - stage)
        children = _driven_on(problem, layers[-1], columns, stage, stages)
        layers.append(_kept(children, reference[stage + stages]))
    state = np.arange(len(layers[-1].parent))
    parts = []
    for layer in layers[:0:-1]:
        parts.append(layer.driven[state])
        state = layer.parent[state]
    return np.concatenate(parts[::-1], axis=1)


def _driven_on(problem: Problem, layer: _Layer, columns: Columns, stage: int, stages: int) -> _Layer:
    """All children of a layer at `stage`, so many stages later."""
    vehicle, step_s = problem.vehicle, problem.step_s
    first_s = problem.first_step_s if stage == 0 else step_s
    parent, aim = _choices(problem, layer.inputs, first_s + (stages - 1) * step_s)
    pose, inputs, room = layer.pose[parent], layer.inputs[parent], layer.room_m[parent]
    driven = np.empty((len(parent), stages, 2))
    for k in range(stages):
        reach = vehicle.rate_max * (first_s if k == 0 else step_s)
        inputs = np.clip(aim, inputs - reach, inputs + reach)
        driven[:, k] = inputs
        pose = vehicle.step(pose, inputs, step_s)
        gap = pose[:, None, :2] - columns.centre_m[:, stage + k + 1]
        spare = np.hypot(gap[..., 0], gap[..., 1]) - columns.keep_out_m[:, stage + k + 1]
        room = np.minimum(room, spare.min(axis=1, initial=np.inf))
    return _Layer(pose, inputs, room, parent, driven)


def _choices(problem: Problem, inputs: FloatArray, period_s: float) -> tuple[IntArray, FloatArray]:
    """What is tried from states with inputs (n, 2): the state (c,) and wanted inputs (c, 2), without those that come to
    the same within the period."""
    vehicle = problem.vehicle
    low, high = vehicle.input_min, vehicle.input_max
    speeds = sorted({share * float(high[0]) for share in SPEEDS} | {float(low[0])})
    wanted = np.array(list(itertools.product(speeds, (share * float(high[1]) for share in TURNS))))
    reach = vehicle.rate_max * period_s
    state = np.repeat(np.arange(len(inputs)), len(wanted))
    aim = np.tile(wanted, (len(inputs), 1))
    arrived = np.clip(aim, inputs[state] - reach, inputs[state] + reach)
    fresh = _firsts(np.column_stack([state, arrived]))
    return state[fresh], aim[fresh]


def _kept(children: _Layer, reference: FloatArray) -> _Layer:
    """WIDTH of different cells: half of them the best, half spread over the plane, since what is good now may lead
    nowhere. The roomiest first."""
    away = np.hypot(*(children.pose[:, :2] - reference[:2]).T)
    order = np.lexsort((away, -np.round(children.room_m / ROOM_STEP_M)))
    order = order[_firsts(np.round(np.column_stack([children.pose, children.inputs])[order] / CELL))]
    best, rest = order[: WIDTH // 2], order[WIDTH // 2 :]
    spread = rest[_firsts(np.round(children.pose[rest] / SPREAD))][: WIDTH - len(best)]
    kept = np.concatenate([best, spread])
    return _Layer(*(getattr(children, name)[kept] for name in _Layer.__slots__))


def _firsts(rows: FloatArray) -> IntArray:
    """(k,) the first of each set of equal rows (n, d), in order."""
    return np.sort(np.unique(rows, axis=0, return_index=True)[1])
