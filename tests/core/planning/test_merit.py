"""The one function that scores plans: against plain loops, hand-computed rows and brute force."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.planning.barrier import AdaptiveGamma, Barrier, FixedGamma, gamma_at
from adcbf_cli.core.planning.merit import barrier_rows, cheapest_decay, merit
from adcbf_cli.core.planning.problem import Instance, Problem
from adcbf_cli.core.types import FloatArray
from tests.core.planning.instances import (
    BARRIERS,
    KINDS,
    cruising,
    instance_of,
    problem_of,
    random_inputs,
    random_instance,
)


def merit_by_loops(problem: Problem, instance: Instance, inputs: FloatArray) -> float:
    """The definition in problem.py and barrier.py, term by term; decay by trying values."""
    weights, total, pose, before = problem.weights, 0.0, instance.pose, instance.last_inputs
    for k in range(problem.steps):
        following = problem.vehicle.step(pose, inputs[k], problem.step_s)
        target, factor = instance.reference[k + 1], weights.terminal if k == problem.steps - 1 else 1.0
        total += 0.5 * factor * weights.position * float(((following[:2] - target[:2]) ** 2).sum())
        total += 0.5 * factor * weights.heading * float((following[2] - target[2]) ** 2)
        total += 0.5 * weights.speed * float((inputs[k][0] - target[3]) ** 2)
        total += 0.5 * weights.turn * float((inputs[k][1] - target[4]) ** 2)
        rate = (inputs[k] - before) / (problem.step_s if k else problem.first_step_s)
        total += 0.5 * float(weights.accel * rate[0] ** 2 + weights.turn_accel * rate[1] ** 2)
        if problem.barrier.steps is None or k < problem.barrier.steps:
            total += sum(row_cost(problem, instance, i, k, pose, following) for i in range(len(instance)))
        pose, before = following, inputs[k]
    return total


def row_cost(problem: Problem, instance: Instance, i: int, k: int, pose: FloatArray, following: FloatArray) -> float:
    def height(at: FloatArray, stage: int) -> float:
        return float(((at[:2] - instance.obstacle_m[i, stage]) ** 2).sum() - instance.keep_out_m[i, stage] ** 2)

    barrier = problem.barrier
    if barrier.frozen and instance.gamma is not None:
        gamma = float(instance.gamma[i, k])
    else:
        distance = np.hypot(*(pose[:2] - instance.obstacle_m[i, k]))
        gamma = float(gamma_at(barrier.gamma, distance, instance.obstacle_radius_m[i]))
    floor = height(pose, k) - gamma if barrier.form == "printed" else (1 - gamma) * height(pose, k)
    if barrier.decay_weight is None:
        return problem.slack_weight * max(0.0, floor - height(following, k + 1))

    def cost(decay: FloatArray) -> FloatArray:
        left = problem.slack_weight * np.maximum(0.0, decay * floor - height(following, k + 1))
        return np.asarray(barrier.decay_weight * (decay - 1) ** 2 + left)

    coarse = np.linspace(0, 1, 2001)
    best = coarse[np.argmin(cost(coarse))]
    return float(cost(np.clip(best + np.linspace(-1e-3, 1e-3, 20001), 0, 1)).min())


@pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
@pytest.mark.parametrize("kind", KINDS)
def test_merit_is_its_definition(barrier: Barrier, kind: str) -> None:
    problem = problem_of(barrier, kind=kind)  # type: ignore[arg-type]
    for seed in range(4):
        instance = random_instance(problem, 100 + seed)
        inputs = random_inputs(problem, instance, seed)
        expected = merit_by_loops(problem, instance, inputs)
        assert merit(problem, instance, inputs) == pytest.approx(
            expected, rel=1e-9 if not barrier.decay_weight else 1e-4
        )


def test_a_hand_computed_row() -> None:
    """From the origin at 1 m/s towards a disc of r = 0.5 at x = 3, R = 1: h[0] = 9 - 1 = 8 and, 0.1 m on,
    h[1] = 2.9^2 - 1 = 7.41. With gamma = 0.1 the floor is 7.2, and the residual 0.21; with 0.05 it is 7.6,
    0.19 too high."""
    for value, residual, slack in ((0.1, 0.21, 0.0), (0.05, -0.19, 0.19)):
        problem = problem_of(Barrier(FixedGamma(value)), steps=2)
        rows = barrier_rows(problem, instance_of(problem, [(3, 0, 0, 0, 0.5)]), np.array([[1.0, 0.0], [1.0, 0.0]]))
        np.testing.assert_allclose(rows.barrier_m2[:2, 0], [8.0, 7.41], atol=1e-12)
        assert rows.residual_m2[0, 0] == pytest.approx(residual)
        assert rows.slack_m2[0, 0] == pytest.approx(slack, abs=1e-12)
        assert rows.decay[0, 0] == 1.0


def test_a_moving_obstacle_and_a_growing_radius_count_at_their_stages() -> None:
    """It comes at 1 m/s: d = 3, then 2.8; R grows from 1 to 1.2: h = 8, then 7.84 - 1.44 = 6.4."""
    problem = problem_of(Barrier(FixedGamma(0.5)), steps=1)
    instance = instance_of(problem, [(3, 0, -1, 0, 0.5)])
    instance = dataclasses.replace(instance, keep_out_m=np.array([[1.0, 1.2]]))
    rows = barrier_rows(problem, instance, np.array([[1.0, 0.0]]))
    np.testing.assert_allclose(rows.barrier_m2[:, 0], [8.0, 6.4], atol=1e-12)
    assert rows.residual_m2[0, 0] == pytest.approx(2.4)


def test_gamma_is_taken_where_the_stage_begins() -> None:
    problem = problem_of(Barrier(AdaptiveGamma()), steps=1)
    rows = barrier_rows(problem, instance_of(problem, [(2.2, 0, 0, 0, 0.3)]), np.array([[1.0, 0.0]]))
    assert rows.gamma[0, 0] == gamma_at(AdaptiveGamma(), np.array(2.2), np.array(0.3))


def test_distance_constraints_are_gamma_one() -> None:
    """MPC-DC: h[k + 1] >= 0, whatever h[k] was."""
    problem = problem_of(Barrier(FixedGamma(1.0)))
    instance = random_instance(problem, 5)
    rows = barrier_rows(problem, instance, cruising(problem))
    np.testing.assert_array_equal(rows.residual_m2, rows.barrier_m2[1:])


def test_stages_beyond_the_last_barrier_have_no_rows() -> None:
    problem = problem_of(Barrier(FixedGamma(0.1), steps=3))
    instance = instance_of(problem, [(0.6, 0, 0, 0, 0.5)])
    rows = barrier_rows(problem, instance, cruising(problem))
    assert (rows.slack_m2[:3] > 0).all()
    assert (rows.slack_m2[3:] == 0).all()
    assert np.isposinf(rows.residual_m2[3:]).all()
    assert (rows.decay[3:] == 1).all()


@settings(max_examples=200, deadline=None)
@given(st.floats(-5, 10), st.floats(-5, 10), st.floats(0.01, 100), st.floats(1, 1e4))
def test_the_cheapest_decay_is_the_cheapest(reached: float, floor: float, weight: float, slack_weight: float) -> None:
    def cost(decay: FloatArray) -> FloatArray:
        return np.asarray(weight * (decay - 1) ** 2 + slack_weight * np.maximum(0.0, decay * floor - reached))

    decay = cheapest_decay(np.array([reached]), np.array([floor]), weight, slack_weight)
    assert 0 <= decay[0] <= 1
    tried = cost(np.linspace(0, 1, 4001)).min()
    assert cost(decay)[0] <= tried + 1e-9 * max(1.0, tried)


def test_decay_bends_a_barrier_before_slack_breaks_it() -> None:
    """h[k + 1] = 7.41 under a floor of 7.6: w = 7.41 / 7.6 costs 10 (1 - w)^2 = 0.00625 and leaves no slack."""
    problem = problem_of(Barrier(FixedGamma(0.05), decay_weight=10.0), steps=1)
    rows = barrier_rows(problem, instance_of(problem, [(3, 0, 0, 0, 0.5)]), np.array([[1.0, 0.0]]))
    assert rows.decay[0, 0] == pytest.approx(7.41 / 7.6)
    assert rows.slack_m2[0, 0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
def test_merit_does_not_depend_on_where_the_world_begins(barrier: Barrier) -> None:
    problem = problem_of(barrier)
    instance, turn, shift = random_instance(problem, 7), 2.1, np.array([30.0, -12.0])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(poses: FloatArray) -> FloatArray:
        return np.column_stack([poses[:, :2] @ rotation.T + shift, poses[:, 2] + turn, poses[:, 3:]])

    turned = dataclasses.replace(
        instance,
        pose=moved(instance.pose[None])[0],
        reference=moved(instance.reference),
        obstacle_m=instance.obstacle_m @ rotation.T + shift,
    )
    inputs = random_inputs(problem, instance, 3)
    assert merit(problem, turned, inputs) == pytest.approx(merit(problem, instance, inputs), rel=1e-9)


def test_merit_does_not_depend_on_the_obstacles_order() -> None:
    problem = problem_of(BARRIERS["optimal decay"])
    instance, order = random_instance(problem, 8), np.array([3, 0, 5, 1, 4, 2])
    shuffled = dataclasses.replace(
        instance,
        obstacle_m=instance.obstacle_m[order],
        obstacle_radius_m=instance.obstacle_radius_m[order],
        keep_out_m=instance.keep_out_m[order],
    )
    inputs = random_inputs(problem, instance, 4)
    assert merit(problem, shuffled, inputs) == pytest.approx(merit(problem, instance, inputs), rel=1e-12)


def test_without_obstacles_only_tracking_is_left() -> None:
    problem = problem_of(Barrier(AdaptiveGamma(), decay_weight=10.0))
    assert merit(problem, instance_of(problem, []), cruising(problem)) == pytest.approx(0.0, abs=1e-12)
    assert merit(problem, instance_of(problem, [(0, 0, 0, 0, 0.3)]), cruising(problem)) > 10
