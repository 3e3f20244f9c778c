"""The CasADi problem against the numpy definitions: model, objective, constraints, padding, layout."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from adcbf_cli.core.planning.barrier import Barrier
from adcbf_cli.core.planning.merit import barrier_rows, merit
from adcbf_cli.core.planning.ocp import STATE, Ocp, build, stage_functions
from adcbf_cli.core.planning.problem import Instance
from adcbf_cli.core.planning.solvers.program import bounds, bucket, inputs_of, parameters, variables
from adcbf_cli.core.types import FloatArray
from tests.core.planning.instances import (
    BARRIERS,
    KINDS,
    instance_of,
    problem_of,
    random_inputs,
    random_instance,
)


def evaluated(ocp: Ocp, instance: Instance, inputs: FloatArray) -> tuple[float, FloatArray]:
    """Objective and constraints at the rolled-out point."""
    function = ca.Function("both", [ocp.nlp["x"], ocp.nlp["p"]], [ocp.nlp["f"], ocp.nlp["g"]])
    objective, rows = function(variables(ocp, instance, inputs), parameters(ocp, instance))
    return float(objective), np.asarray(rows).ravel()


@pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_objective_at_a_rolled_out_point_is_the_merit(barrier: Barrier, kind: str) -> None:
    """And the point, with the cheapest decay and slack, satisfies every constraint."""
    problem = problem_of(barrier, kind=kind)  # type: ignore[arg-type]
    ocp = build(problem, 8)
    for seed in range(3):
        instance = random_instance(problem, 200 + seed)
        inputs = random_inputs(problem, instance, seed)
        objective, rows = evaluated(ocp, instance, inputs)
        assert objective == pytest.approx(merit(problem, instance, inputs), rel=1e-10)
        limits = bounds(ocp, instance)
        assert (rows >= limits["lbg"] - 1e-8).all()
        assert (rows <= limits["ubg"] + 1e-8).all()
        point = variables(ocp, instance, inputs)
        assert (point >= limits["lbx"] - 1e-9).all()
        assert (point <= limits["ubx"] + 1e-9).all()
        np.testing.assert_array_equal(inputs_of(ocp, point), inputs)


def test_slack_is_needed_row_by_row() -> None:
    """Without the slacks, the rows that fail are those that `barrier_rows` says."""
    problem = problem_of(BARRIERS["adaptive"])
    instance = random_instance(problem, 210, nearest_m=0.8)
    inputs = random_inputs(problem, instance, 1)
    ocp = build(problem, 8)
    function = ca.Function("g", [ocp.nlp["x"], ocp.nlp["p"]], [ocp.nlp["g"]])
    rows = barrier_rows(problem, instance, inputs)
    assert 0 < np.count_nonzero(rows.slack_m2) < rows.slack_m2.size
    point = variables(ocp, instance, inputs)
    slack_at = np.flatnonzero(np.isin(point, rows.slack_m2[rows.slack_m2 > 0]))
    point[slack_at] = 0.0
    values = np.asarray(function(point, parameters(ocp, instance))).ravel()
    missing = np.maximum(bounds(ocp, instance)["lbg"] - values, 0.0)
    assert np.sort(missing[missing > 1e-9]) == pytest.approx(np.sort(rows.slack_m2[rows.slack_m2 > 1e-9]))


@pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
def test_padding_changes_nothing(barrier: Barrier) -> None:
    problem = problem_of(barrier)
    instance = random_instance(problem, 220, obstacles=3)
    inputs = random_inputs(problem, instance, 2)
    exact, padded = (evaluated(build(problem, slots), instance, inputs)[0] for slots in (3, 16))
    assert padded == pytest.approx(exact, rel=1e-12)


def test_buckets() -> None:
    sizes = {0: 0, 1: 4, 4: 4, 5: 8, 8: 8, 9: 16, 16: 16, 17: 32, 32: 32, 33: 64}
    assert {count: bucket(count) for count in sizes} == sizes


def test_every_constraint_knows_one_stage_and_the_gap_comes_first() -> None:
    """What FATROP relies on: the Jacobian's rows of stage k touch x[k], u[k] and, in the gap alone, -
    with the identity - x[k + 1]."""
    problem = problem_of(BARRIERS["optimal decay"], steps=4)
    ocp = build(problem, 4)
    jacobian = ca.Function("j", [ocp.nlp["x"], ocp.nlp["p"]], [ca.jacobian(ocp.nlp["g"], ocp.nlp["x"])])
    instance = random_instance(problem, 230, obstacles=4)
    dense = np.asarray(
        ca.DM(jacobian(variables(ocp, instance, random_inputs(problem, instance, 3)), parameters(ocp, instance)))
    )
    row = column = 0
    for k in range(problem.steps):
        width = ocp.states[k] + ocp.controls[k]
        gap, rest = slice(row, row + STATE), slice(row + STATE, row + STATE + ocp.rows[k])
        following = slice(column + width, column + width + STATE)
        np.testing.assert_array_equal(dense[gap, following], np.eye(STATE))
        outside = np.ones(dense.shape[1], dtype=bool)
        outside[column : column + width] = False
        assert not dense[rest][:, outside].any()
        assert all(ocp.equality[gap])
        outside[following] = False
        assert not dense[gap][:, outside].any()
        row, column = rest.stop, column + width
    assert row == len(ocp.equality) == ocp.nlp["g"].numel()


@pytest.mark.parametrize("kind", KINDS)
def test_the_model_is_the_vehicles_step_with_right_derivatives(kind: str) -> None:
    """Also at a turn of exactly and nearly zero, where sin(x) / x needs its series."""
    problem = problem_of(BARRIERS["adaptive"], kind=kind)  # type: ignore[arg-type]
    functions, vehicle = stage_functions(problem), problem.vehicle
    rng = np.random.default_rng(9)
    for turn in (0.0, 1e-9, 1e-3, 0.19999, 0.2, 0.7, -1.3):
        pose, inputs = rng.uniform(-2, 2, 3), np.array([rng.uniform(-1, 1), turn])
        reached, by_pose, by_inputs = (np.asarray(out) for out in functions.step(pose, inputs))
        np.testing.assert_allclose(reached.ravel(), vehicle.step(pose, inputs, problem.step_s), atol=1e-14)
        point = np.concatenate([pose, inputs])
        numeric = central(lambda at: vehicle.step(at[:3], at[3:], problem.step_s), point)
        np.testing.assert_allclose(np.hstack([by_pose, by_inputs]), numeric, atol=1e-8)


@pytest.mark.parametrize("barrier", BARRIERS.values(), ids=BARRIERS)
def test_a_row_is_the_merits_row_with_right_derivatives(barrier: Barrier) -> None:
    problem = problem_of(barrier, steps=1)
    functions, rng = stage_functions(problem), np.random.default_rng(11)
    for _ in range(10):
        instance = instance_of(problem, [(*rng.uniform(-2, 2, 2), *rng.normal(size=2), rng.uniform(0.1, 0.6))])
        obstacle, keep_out = instance.obstacle_m[0], instance.keep_out_m[0]
        given = [obstacle[0], obstacle[1], keep_out[0], keep_out[1], instance.obstacle_radius_m[0], 0.3]

        def residual(inputs: FloatArray, instance: Instance = instance) -> FloatArray:
            return barrier_rows(problem, instance, inputs[None]).residual_m2[0]

        inputs = rng.uniform(-1, 1, 2)
        value, by_pose, by_inputs = (np.asarray(out) for out in functions.row(np.zeros(3), inputs, *given))
        assert value.item() == pytest.approx(residual(inputs)[0], abs=1e-10)
        np.testing.assert_allclose(by_inputs, central(residual, inputs), atol=1e-7)
        numeric = central(lambda pose: np.asarray(functions.row(pose, inputs, *given)[0]).ravel(), np.zeros(3))  # noqa: B023
        np.testing.assert_allclose(by_pose, numeric, atol=1e-7)


def central(function: object, point: FloatArray, step: float = 1e-6) -> FloatArray:
    """Central differences, (outputs, inputs)."""
    columns = []
    for i in range(len(point)):
        offset = np.zeros_like(point)
        offset[i] = step
        columns.append((function(point + offset) - function(point - offset)) / (2 * step))  # type: ignore[operator]
    return np.column_stack(columns)


def test_derivatives_are_finite_on_an_obstacles_centre() -> None:
    problem = problem_of(BARRIERS["adaptive"])
    outputs = stage_functions(problem).row([0, 0, 0], [0.5, 0], [0, 0], [0, 0], 0.8, 0.8, 0.3, 1.0)
    assert all(np.isfinite(np.asarray(out)).all() for out in outputs)
