"""The vehicle's exact step, its limits, and its braking."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.config import VehicleConfig
from adcbf_cli.core.types import FloatArray
from adcbf_cli.core.vehicles.vehicle import Vehicle

KINDS = ("unicycle", "ackermann")
STEP_S = 0.1


def vehicle(kind: str, **settings: float) -> Vehicle:
    return Vehicle.from_config(VehicleConfig.model_validate({"kind": kind, **settings}))


def integrated(model: Vehicle, pose: FloatArray, inputs: FloatArray, duration_s: float) -> FloatArray:
    """The pose by Runge-Kutta of fourth order over the textbook's differential equations, 200 small steps."""
    turn = inputs[1] if model.kind == "unicycle" else inputs[0] * np.tan(inputs[1]) / model.wheelbase_m

    def slope(at: FloatArray) -> FloatArray:
        return np.array([inputs[0] * np.cos(at[2]), inputs[0] * np.sin(at[2]), turn])

    small = duration_s / 200
    for _ in range(200):
        k1 = slope(pose)
        k2 = slope(pose + 0.5 * small * k1)
        k3 = slope(pose + 0.5 * small * k2)
        k4 = slope(pose + small * k3)
        pose = pose + small / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return pose


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("duration_s", [0.03, 0.1, 1.0])
def test_a_step_is_the_integral_of_the_motion(kind: str, duration_s: float) -> None:
    model, rng = vehicle(kind), np.random.default_rng(100)
    for _ in range(20):
        pose = rng.uniform(-5, 5, 3)
        inputs = rng.uniform([-2, -1.2], [2, 1.2])
        np.testing.assert_allclose(
            model.step(pose, inputs, duration_s), integrated(model, pose, inputs, duration_s), atol=1e-9
        )


@pytest.mark.parametrize("kind", KINDS)
def test_straight_ahead_is_no_special_case(kind: str) -> None:
    model = vehicle(kind)
    straight = model.step(np.array([1.0, 2.0, np.pi / 2]), np.array([0.5, 0.0]), 2.0)
    np.testing.assert_allclose(straight, [1.0, 3.0, np.pi / 2], atol=1e-12)
    nearly = model.step(np.array([1.0, 2.0, np.pi / 2]), np.array([0.5, 1e-12]), 2.0)
    np.testing.assert_allclose(nearly, straight, atol=1e-11)


def test_a_quarter_circle() -> None:
    pose = vehicle("unicycle").step(np.zeros(3), np.array([np.pi / 2, np.pi / 2]), 1.0)
    np.testing.assert_allclose(pose, [1.0, 1.0, np.pi / 2], atol=1e-12)


def test_steering_turns_about_the_rear_axles_extension() -> None:
    model = vehicle("ackermann", wheelbase_m=0.6)
    steer = 0.4
    radius = 0.6 / np.tan(steer)
    half_turn_s = np.pi * radius / 0.5
    pose = model.step(np.zeros(3), np.array([0.5, steer]), half_turn_s)
    np.testing.assert_allclose(pose, [0.0, 2 * radius, np.pi], atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_rolling_out_is_stepping(kind: str) -> None:
    model, rng = vehicle(kind), np.random.default_rng(101)
    inputs = rng.uniform([-1, -1], [1, 1], (25, 2))
    pose = np.array([3.0, -2.0, 2.9])
    poses = model.roll_out(pose, inputs, STEP_S)
    np.testing.assert_array_equal(poses[0], pose)
    for k in range(25):
        np.testing.assert_allclose(poses[k + 1], model.step(poses[k], inputs[k], STEP_S), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_motion_does_not_depend_on_where_the_world_begins(kind: str) -> None:
    model, rng = vehicle(kind), np.random.default_rng(102)
    inputs = rng.uniform([-1, -1], [1, 1], (20, 2))
    turn = 1.1
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    poses = model.roll_out(np.array([1.0, 2.0, 0.3]), inputs, STEP_S)
    start = np.append(rotation @ [1.0, 2.0] + [40.0, -7.0], 0.3 + turn)
    moved = model.roll_out(start, inputs, STEP_S)
    np.testing.assert_allclose(moved[:, :2], poses[:, :2] @ rotation.T + [40.0, -7.0], atol=1e-12)
    np.testing.assert_allclose(moved[:, 2], poses[:, 2] + turn, atol=1e-12)


def test_stepping_takes_many_at_once() -> None:
    model, rng = vehicle("ackermann"), np.random.default_rng(103)
    poses, inputs = rng.normal(size=(4, 5, 3)), rng.uniform(-1, 1, (4, 5, 2))
    stepped = model.step(poses, inputs, STEP_S)
    np.testing.assert_allclose(stepped[2, 3], model.step(poses[2, 3], inputs[2, 3], STEP_S), atol=1e-14)


def test_limits_come_from_the_kind_of_vehicle() -> None:
    config = VehicleConfig(min_speed_mps=-0.2, max_yaw_rate_radps=0.7, max_steer_rad=0.5, max_steer_rate_radps=0.9)
    unicycle = Vehicle.from_config(config)
    np.testing.assert_array_equal(unicycle.input_min, [-0.2, -0.7])
    np.testing.assert_array_equal(unicycle.rate_max, [1.0, 3.0])
    ackermann = Vehicle.from_config(config.model_copy(update={"kind": "ackermann"}))
    np.testing.assert_array_equal(ackermann.input_max, [1.0, 0.5])
    np.testing.assert_array_equal(ackermann.rate_max, [1.0, 0.9])


LIMITED = {
    "reached": ([0.55, 0.1], [0.5, 0.0], [0.55, 0.1]),
    "rate": ([0.9, -0.9], [0.5, 0.0], [0.6, -0.3]),
    "bound": ([3.0, 2.0], [0.95, 0.9], [1.0, 1.0]),
    "bound below": ([-1.0, 0.0], [0.05, 0.0], [0.0, 0.0]),
    "back from out of bounds": ([1.0, 0.0], [1.5, -1.2], [1.4, -0.9]),
    "back, though more was wanted": ([2.0, 0.0], [1.5, 0.0], [1.4, 0.0]),
}


@pytest.mark.parametrize(("wanted", "last", "expected"), LIMITED.values(), ids=LIMITED)
def test_inputs_are_limited_to_what_can_be_reached(
    wanted: list[float], last: list[float], expected: list[float]
) -> None:
    got = vehicle("unicycle").limited(np.array(wanted), np.array(last), STEP_S)
    np.testing.assert_allclose(got, expected, atol=1e-12)


some_inputs = st.lists(st.floats(-3, 3), min_size=2, max_size=2).map(np.array)


@settings(max_examples=60, deadline=None)
@given(st.lists(some_inputs, min_size=1, max_size=6).map(np.array), some_inputs)
def test_a_plan_is_limited_stage_by_stage_within_the_envelope(wanted: FloatArray, last: FloatArray) -> None:
    model = vehicle("unicycle", min_speed_mps=-0.5)
    plan = model.within_limits(wanted, last, STEP_S, 0.04)
    before = last
    for k, inputs in enumerate(plan):
        np.testing.assert_allclose(inputs, model.limited(wanted[k], before, 0.04 if k == 0 else STEP_S), atol=1e-12)
        before = inputs
    lowest, highest = model.envelope(last, len(wanted), STEP_S, 0.04)
    assert (plan >= lowest - 1e-12).all()
    assert (plan <= highest + 1e-12).all()
    np.testing.assert_allclose(model.within_limits(plan, last, STEP_S, 0.04), plan, atol=1e-12)


@settings(max_examples=80, deadline=None)
@given(st.sampled_from(KINDS), some_inputs)
def test_braking_stops_as_fast_as_the_rates_allow(kind: str, last: FloatArray) -> None:
    model = vehicle(kind, min_speed_mps=-0.5)
    plan = model.braking(last, 45, STEP_S, first_step_s=0.04)
    reach = model.rate_max * STEP_S + 1e-12
    assert (np.abs(plan[0] - last) <= model.rate_max * 0.04 + 1e-12).all()
    assert (np.abs(np.diff(plan, axis=0)) <= reach).all()
    assert (plan[-1] >= model.input_min).all()
    assert (plan[-1] <= model.input_max).all()
    stop = int(np.ceil(max(abs(last[0]) / model.rate_max[0] - 0.04, 0.0) / STEP_S + 1e-9))
    np.testing.assert_allclose(plan[stop + 1 :, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(plan[:, 0]), np.maximum(abs(last[0]) - 0.04 - STEP_S * np.arange(45), 0.0))


def test_a_unicycle_brakes_on_its_arc() -> None:
    """Speed 0.8, yaw rate 0.4: the radius stays 2 m while it moves."""
    plan = vehicle("unicycle").braking(np.array([0.8, 0.4]), 10, STEP_S)
    np.testing.assert_allclose(plan[:7, 1] / plan[:7, 0], 0.5, atol=1e-12)
    np.testing.assert_array_equal(plan[8:], 0.0)


def test_a_unicycle_leaves_its_arc_where_its_yaw_rate_cannot_follow() -> None:
    """Speed 0.1 is gone at once; the yaw rate of 0.9 falls by 3 rad/s^2, no faster."""
    plan = vehicle("unicycle").braking(np.array([0.1, 0.9]), 4, STEP_S)
    np.testing.assert_allclose(plan, [[0, 0.6], [0, 0.3], [0, 0], [0, 0]], atol=1e-12)


def test_steering_stays_while_braking() -> None:
    plan = vehicle("ackermann").braking(np.array([0.8, 0.4]), 10, STEP_S)
    np.testing.assert_array_equal(plan[:, 1], 0.4)


def test_a_unicycle_that_turns_on_the_spot_stops_turning() -> None:
    plan = vehicle("unicycle").braking(np.array([0.0, -0.9]), 4, STEP_S)
    np.testing.assert_allclose(plan, [[0, -0.6], [0, -0.3], [0, 0], [0, 0]], atol=1e-12)
