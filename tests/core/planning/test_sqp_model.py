"""The model that the SQP solvers linearise: against CasADi's derivatives, finite differences and numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adcbf_cli.core.planning.barrier import Barrier
from adcbf_cli.core.planning.merit import merit
from adcbf_cli.core.planning.ocp import stage_functions
from adcbf_cli.core.planning.problem import Instance, Problem
from adcbf_cli.core.planning.solvers.linearise import linearise, merit_of, roll_out
from adcbf_cli.core.planning.solvers.packing import (
    CAP,
    FAR_X,
    FAR_Y,
    GIVE,
    NEAR_X,
    NEAR_Y,
    VALUE,
    Scene,
    StageQp,
    empty_qp,
    pack_model,
    pack_scene,
)
from adcbf_cli.core.planning.solvers.stage_model import stage_model
from adcbf_cli.core.types import FloatArray
from tests.core.planning.instances import BARRIERS, KINDS, instance_of, problem_of, random_inputs, random_instance

barriers = pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
kinds = pytest.mark.parametrize("kind", KINDS)


def linearised(problem: Problem, instance: Instance, inputs: FloatArray) -> tuple[StageQp, Scene, FloatArray]:
    model, scene = pack_model(problem), pack_scene(problem, instance)
    poses = problem.vehicle.roll_out(instance.pose, inputs, problem.step_s)
    qp = empty_qp(model, scene)
    linearise(model, scene, inputs, poses, qp)
    return qp, scene, poses


def tangent(qp: StageQp, direction: FloatArray) -> FloatArray:
    """(N + 1, 3) how poses change to first order when the inputs go along `direction` (N, 2)."""
    moved = np.zeros((len(direction) + 1, 3))
    for k, (ax, ay, *b) in enumerate(qp.motion):
        moved[k + 1] = moved[k] + moved[k, 2] * np.array([ax, ay, 0.0]) + np.reshape(b, (3, 2)) @ direction[k]
    return moved


@kinds
@barriers
def test_merit_is_the_merit(barrier: Barrier, kind: str) -> None:
    problem = problem_of(barrier, kind=kind)  # type: ignore[arg-type]
    for seed in range(20):
        instance = random_instance(problem, seed, nearest_m=0.3)
        inputs = random_inputs(problem, instance, seed)
        model, scene, poses = pack_model(problem), pack_scene(problem, instance), np.empty((problem.steps + 1, 3))
        roll_out(model, scene, inputs, poses)
        expected = problem.vehicle.roll_out(instance.pose, inputs, problem.step_s)
        np.testing.assert_allclose(poses, expected, rtol=0, atol=1e-12)
        assert merit_of(model, scene, inputs, poses) == pytest.approx(merit(problem, instance, inputs), rel=1e-12)


@kinds
@pytest.mark.parametrize("name", [name for name, barrier in BARRIERS.items() if barrier.decay_weight is None])
def test_derivatives_are_casadis(name: str, kind: str) -> None:
    problem = problem_of(BARRIERS[name], kind=kind)  # type: ignore[arg-type]
    functions = stage_functions(problem)
    instance = random_instance(problem, 4, nearest_m=0.3)
    inputs = random_inputs(problem, instance, 4)
    inputs[3, 1] = 0.0  # straight, where sin(x) / x needs its series
    inputs[4, 1] = 1e-4
    qp, _, poses = linearised(problem, instance, inputs)
    for k in range(problem.steps):
        a = np.eye(3)
        a[:2, 2] = qp.motion[k, :2]
        b = qp.motion[k, 2:].reshape(3, 2)
        _, by_pose, by_inputs = (np.array(part) for part in functions.step(poses[k], inputs[k]))
        np.testing.assert_allclose(a, by_pose, atol=1e-10)
        np.testing.assert_allclose(b, by_inputs, atol=1e-10)
        for i in range(len(instance)) if k < len(qp.rows) else ():
            gamma = 0.0 if instance.gamma is None else instance.gamma[i, k]
            centres, keep_out = instance.obstacle_m[i, k : k + 2], instance.keep_out_m[i, k : k + 2]
            expected = functions.row(poses[k], inputs[k], *centres, *keep_out, instance.obstacle_radius_m[i], gamma)
            residual, by_pose, by_inputs = (np.array(part).ravel() for part in expected)
            row = qp.rows[k, :, i]
            near, far = np.array([row[NEAR_X], row[NEAR_Y], 0.0]), np.array([row[FAR_X], row[FAR_Y], 0.0])
            assert row[VALUE] == pytest.approx(residual[0], abs=1e-10)
            np.testing.assert_allclose(near @ a + far, by_pose, atol=1e-9)
            np.testing.assert_allclose(near @ b, by_inputs, atol=1e-9)


@kinds
@barriers
def test_the_model_touches_the_merit(barrier: Barrier, kind: str) -> None:
    """Along any direction of the inputs the model's slope at d = 0, priced by its caps and gives, is the merit's."""
    problem = problem_of(barrier, kind=kind)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    for seed in range(10):
        instance = random_instance(problem, seed, nearest_m=0.3)
        inputs, direction = random_inputs(problem, instance, seed), rng.normal(size=(problem.steps, 2))
        qp, _, _ = linearised(problem, instance, inputs)
        moved = tangent(qp, direction)
        change = np.diff(direction, axis=0, prepend=np.zeros((1, 2)))
        slope = (qp.pose[:, :3] * moved[1:]).sum() + (qp.inputs[:, :2] * direction).sum()
        slope += (qp.inputs[:, 4:6] * change).sum()
        for k, row in enumerate(qp.rows):
            short = np.maximum(-row[VALUE], 0.0)
            with np.errstate(divide="ignore", invalid="ignore"):
                price = np.where(row[GIVE] > 0, np.minimum(short / row[GIVE], row[CAP]), row[CAP] * (short > 0))
            near, far = moved[k + 1], moved[k]
            gain = row[NEAR_X] * near[0] + row[NEAR_Y] * near[1] + row[FAR_X] * far[0] + row[FAR_Y] * far[1]
            slope -= (price * gain).sum()
        step = 1e-6
        ahead, behind = (merit(problem, instance, inputs + sign * step * direction) for sign in (1, -1))
        assert slope == pytest.approx((ahead - behind) / (2 * step), rel=1e-5, abs=1e-4)


@kinds
@barriers
def test_numpy_and_compiled_models_are_one(barrier: Barrier, kind: str) -> None:
    problem = problem_of(barrier, kind=kind)  # type: ignore[arg-type]
    for seed in range(5):
        instance = random_instance(problem, seed, nearest_m=0.3)
        inputs = random_inputs(problem, instance, seed)
        compiled, scene, poses = linearised(problem, instance, inputs)
        plain = stage_model(pack_model(problem), scene, inputs, poses)
        for one, other in zip(compiled, plain, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_an_obstacle_at_the_vehicles_centre_has_finite_derivatives() -> None:
    problem = problem_of(BARRIERS["adaptive"])
    instance = instance_of(problem, [(0.0, 0.0, 0.0, 0.0, 0.4)])
    qp, _, _ = linearised(problem, instance, np.zeros((problem.steps, 2)))
    assert all(np.isfinite(part).all() for part in qp)


def test_limits_from_inputs_that_are_out_of_bounds_lead_back_as_fast_as_allowed() -> None:
    problem = problem_of(BARRIERS["adaptive"])  # 1 m/s at most; 1 m/s^2: 1/30 at first, then 0.1 a step
    instance = replace(instance_of(problem, []), last_inputs=np.array([1.25, -0.2]))
    scene = pack_scene(problem, instance)
    np.testing.assert_allclose(
        scene.high[:5, 0], 1.25 - 1 / 30 - np.array([0.0, 0.1, 0.2, 0.3, 0.4]).clip(max=1 / 4 - 1 / 30)
    )
    np.testing.assert_allclose(scene.low[:2, 0], [1.25 - 1 / 30, 0.0])
    np.testing.assert_allclose([scene.low[0, 1], scene.high[0, 1]], [-0.3, -0.1])
