"""The compiled interior-point method against PIQP on random programmes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from adcbf_cli.core.planning.solvers import compiling, packing, stage_qp
from adcbf_cli.core.planning.solvers.compiling import kept, source_key
from adcbf_cli.core.planning.solvers.packing import (
    CAP,
    FAR_X,
    FAR_Y,
    GIVE,
    NEAR_X,
    NEAR_Y,
    PER_ROW,
    SIDES,
    VALUE,
    StageQp,
)
from adcbf_cli.core.planning.solvers.piqp_qp import solve_by_piqp
from adcbf_cli.core.types import FloatArray

Solve = Callable[[StageQp, float, float, int], tuple[FloatArray, int]]


@pytest.fixture(scope="module")
def solve() -> Solve:
    key = source_key(compiling, packing, stage_qp)

    def call(qp: StageQp, mu_start: float, mu_end: float, max_steps: int) -> tuple[FloatArray, int]:
        _ = key
        return stage_qp.solve_qp(qp, mu_start, mu_end, max_steps)

    return kept(call)


def random_qp(seed: int, stages: int = 12, row_stages: int = 12, rows: int = 5, soft: float = 1.0) -> StageQp:
    """A vehicle-like programme; about `soft` of five rows give."""
    rng = np.random.default_rng(seed)
    motion = rng.normal(0.0, 0.1, (stages, 8))
    motion[:, [2, 7]] += 0.1
    row = rng.normal(0.0, 1.0, (row_stages, PER_ROW, rows))
    row[:, VALUE] = rng.normal(0.5, 0.5, (row_stages, rows))
    row[:, CAP] = rng.choice([2.0, 50.0, 1000.0], (row_stages, rows))
    row[:, GIVE] = rng.uniform(0.01, 1.0, (row_stages, rows)) * (rng.random((row_stages, rows)) < soft / 5.0)
    return StageQp(
        motion=motion,
        pose=np.hstack([rng.normal(0.0, 2.0, (stages, 3)), rng.uniform(0.0, 2.0, (stages, 3))]),
        inputs=np.hstack(
            [
                *(rng.normal(0.0, 1.0, (stages, 2)), rng.uniform(0.01, 1.0, (stages, 2))),
                *(rng.normal(0.0, 1.0, (stages, 2)), rng.uniform(0.01, 5.0, (stages, 2))),
            ]
        ),
        room=rng.choice([0.0, 0.05, 0.5, 2.0], (stages, SIDES), p=[0.05, 0.25, 0.35, 0.35]),
        rows=row,
    )


def moves(qp: StageQp, step: FloatArray) -> FloatArray:
    return np.diff(step[:, :2], axis=0, prepend=np.zeros((1, 2)))


def objective(qp: StageQp, step: FloatArray) -> float:
    inputs, poses, change = step[:, :2], step[:, 2:], moves(qp, step)
    total = (qp.pose[:, :3] * poses + 0.5 * qp.pose[:, 3:] * poses**2).sum()
    total += (qp.inputs[:, :2] * inputs + 0.5 * qp.inputs[:, 2:4] * inputs**2).sum()
    total += (qp.inputs[:, 4:6] * change + 0.5 * qp.inputs[:, 6:] * change**2).sum()
    before = np.vstack([np.zeros(3), poses[:-1]])
    for k, row in enumerate(qp.rows):
        reached = row[VALUE] + row[NEAR_X] * poses[k, 0] + row[NEAR_Y] * poses[k, 1]
        short = np.maximum(-(reached + row[FAR_X] * before[k, 0] + row[FAR_Y] * before[k, 1]), 0.0)
        bend = row[CAP] * row[GIVE]  # beyond it the price no longer rises
        quadratic = 0.5 * np.minimum(short, bend) ** 2 / np.where(row[GIVE] > 0, row[GIVE], 1.0)
        total += (quadratic + row[CAP] * np.maximum(short - bend, 0.0)).sum()
    return float(total)


def worst_excess(qp: StageQp, step: FloatArray) -> float:
    inputs, change = step[:, :2], moves(qp, step)[1:]
    sides = [-qp.room[:, :2] - inputs, inputs - qp.room[:, 2:4], -qp.room[1:, 4:6] - change, change - qp.room[1:, 6:]]
    return max(float(side.max()) for side in sides)


def worst_gap(qp: StageQp, step: FloatArray) -> float:
    """How far poses are from where the inputs lead."""
    poses = np.vstack([np.zeros(3), step[:, 2:]])
    led = poses[:-1] + np.einsum("kij,kj->ki", qp.motion[:, 2:].reshape(-1, 3, 2), step[:, :2])
    led[:, :2] += poses[:-1, 2:] * qp.motion[:, :2]
    return float(np.abs(led - poses[1:]).max())


@pytest.mark.parametrize("row_stages", [0, 5, 12])
def test_the_minimum_is_piqps(solve: Solve, row_stages: int) -> None:
    for seed in range(40):
        qp = random_qp(seed, row_stages=row_stages)
        step, taken = solve(qp, 10.0, 1e-7, 80)
        other = solve_by_piqp(qp)
        assert np.abs(other).max() > 0, "PIQP gave up"
        assert taken < 80
        assert worst_excess(qp, step) < 2e-5  # HARD_GIVE times multipliers of 1000 and more
        assert worst_gap(qp, step) < 1e-9
        assert objective(qp, step) == pytest.approx(objective(qp, other), rel=1e-4, abs=1e-4)


def test_the_start_does_not_matter(solve: Solve) -> None:
    for seed in range(10):
        qp = random_qp(seed, soft=0.0)
        values = [objective(qp, solve(qp, mu, 1e-8, 80)[0]) for mu in (0.01, 1.0, 100.0)]
        np.testing.assert_allclose(values, values[0], rtol=1e-4)


def test_one_input_by_hand(solve: Solve) -> None:
    """One stage along x: 1/2 (p - 1)^2 with p = 0.1 u; a row p <= 0.02 of price 0.5; u <= 3.

    The pull towards p = 1 is 1 - p > 0.5 for all that u can reach, so the row gives way and u = 3.
    At a price of 2 the row holds, u = 0.2.
    """
    rows = np.zeros((1, PER_ROW, 1))
    rows[0, VALUE], rows[0, NEAR_X] = 0.02, -1.0
    qp = StageQp(
        motion=np.array([[0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.1]]),
        pose=np.array([[-1.0, 0.0, 0.0, 1.0, 1.0, 1.0]]),
        inputs=np.zeros((1, 8)),
        room=np.full((1, SIDES), 3.0),
        rows=rows,
    )
    for price, expected in ((0.5, 3.0), (2.0, 0.2)):
        rows[0, CAP] = price
        step, _ = solve(qp, 1.0, 1e-11, 80)
        np.testing.assert_allclose(step[0], [expected, 0.0, 0.1 * expected, 0.0, 0.0], atol=1e-6)


def test_numbers_that_are_not_finite_end_the_method(solve: Solve) -> None:
    qp = random_qp(0)
    qp.pose[3, 0] = np.nan
    step, taken = solve(qp, 10.0, 1e-7, 80)
    assert taken == 0
    assert not step.any()


def test_what_is_kept_depends_on_every_source() -> None:
    assert source_key(packing, stage_qp) == source_key(packing, stage_qp)
    assert source_key(packing, stage_qp) != source_key(packing, compiling)


def test_without_a_place_to_keep_it_a_function_is_compiled_all_the_same() -> None:
    """Numba keeps nothing of a function without a file."""
    scope: dict[str, Callable[[float], float]] = {}
    exec("def double(value):\n    return 2.0 * value", scope)
    assert kept(scope["double"])(4.0) == 8.0
