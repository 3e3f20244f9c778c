"""Where things are, how far away they are, and when they would be met."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adcbf_cli.core.replay.world import RecordedWorld, Samples
from adcbf_cli.core.types import NO_ID

SECOND = 1_000_000_000


def circles(position_m: list[list[float]], radius_m: float = 1.0) -> RecordedWorld:
    """Standing circles, sampled once each at time 0."""
    n = len(position_m)
    samples = Samples.of(np.arange(n), np.zeros(n, dtype=np.int64), np.array(position_m), np.full(n, radius_m))
    return RecordedWorld(samples, 0.5)


def box(length_m: float, width_m: float, yaw_rad: float, centre: tuple[float, float] = (0.0, 0.0)) -> RecordedWorld:
    one = np.ones(1)
    samples = Samples.of(
        np.array([7]),
        np.array([0]),
        np.array([centre]),
        0.5 * np.hypot(length_m, width_m) * one,
        length_m=length_m * one,
        width_m=width_m * one,
        yaw_rad=yaw_rad * one,
    )
    return RecordedWorld(samples, 0.5)


def test_distance_to_circles() -> None:
    clearance = circles([[3, 4], [0, 0]]).clearance(np.array([[0.0, 0.0]]), 0.5, 0)
    np.testing.assert_allclose(clearance, [[5 - 1 - 0.5, -1.5]])


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((3.0, 0.0), 1.0),  # ahead of the front
        ((0.0, 2.0), 1.0),  # beside
        ((5.0, 5.0), 5.0),  # off the corner (2, 1): 3-4-5
        ((0.0, 0.5), -0.5),  # inside, nearest to the long side
        ((1.9, 0.0), -0.1),  # inside, nearest to the front
    ],
)
def test_distance_to_a_rectangle(point: tuple[float, float], expected: float) -> None:
    """4 m by 2 m around the origin; the same turned with the point."""
    assert box(4, 2, 0.0).clearance(np.array([point]), 0.0, 0)[0, 0] == pytest.approx(expected)
    for yaw in (0.4, 2.0, -1.1):
        c, s = np.cos(yaw), np.sin(yaw)
        turned = np.array([[c * point[0] - s * point[1], s * point[0] + c * point[1]]])
        assert box(4, 2, yaw).clearance(turned, 0.25, 0)[0, 0] == pytest.approx(expected - 0.25)


def test_overlap_is_negative_and_touching_is_zero() -> None:
    world = box(4, 2, 0.0)
    assert world.clearance(np.array([[2.3, 0.0]]), 0.3, 0)[0, 0] == pytest.approx(0.0)
    assert world.clearance(np.array([[2.2, 0.0]]), 0.3, 0)[0, 0] == pytest.approx(-0.1)


def test_nearest_and_nothing() -> None:
    assert circles([[10, 0], [0, 3]]).nearest(np.zeros(2), 0.5, 0) == (pytest.approx(1.5), 1)
    distance, whose = circles([[10, 0]]).nearest(np.zeros(2), 0.5, SECOND)
    assert np.isnan(distance)
    assert whose == NO_ID


def moving(stamps_s: list[float], x: list[float], standing: bool = False) -> RecordedWorld:
    n = len(x)
    samples = Samples.of(
        np.zeros(n),
        np.round(np.array(stamps_s) * 1e9).astype(np.int64),
        np.column_stack([x, np.zeros(n)]),
        np.full(n, 0.5),
    )
    return RecordedWorld(samples, 0.5, np.array([0]) if standing else None)


def test_interpolated_between_samples_and_never_across_a_gap() -> None:
    world = moving([0.0, 0.4, 1.0, 1.2], [0.0, 0.8, 9.0, 9.2])
    assert world.at(SECOND // 10).centre_m[0, 0] == pytest.approx(0.2)
    assert len(world.at(7 * SECOND // 10)) == 0
    assert world.at(11 * SECOND // 10).centre_m[0, 0] == pytest.approx(9.1)
    assert len(world.at(2 * SECOND)) == 0


def test_velocity_from_positions_does_not_cross_a_gap() -> None:
    world = moving([0.0, 0.4, 1.0, 1.2], [0.0, 0.8, 9.0, 9.2])
    assert world.at(4 * SECOND // 10).velocity_mps[0].tolist() == pytest.approx([2.0, 0.0])
    assert world.at(SECOND).velocity_mps[0].tolist() == pytest.approx([1.0, 0.0])


def test_what_stands_is_there_before_between_and_after() -> None:
    world = moving([1.0, 1.2, 5.0, 5.2], [3.0, 3.0, 3.1, 3.1], standing=True)
    for stamp_s, x in ((0.0, 3.0), (1.1, 3.0), (3.0, 3.1), (1000.0, 3.1)):
        objects = world.at(round(stamp_s * 1e9))
        assert objects.centre_m[:, 0].tolist() == pytest.approx([x])
        assert objects.velocity_mps.tolist() in ([[0.0, 0.0]], [[pytest.approx(0.0), 0.0]])


def test_worlds_are_told_apart_by_what_was_there_and_when() -> None:
    def world(shift_m: float = 0.0, later_ns: int = 0, order: int = 1, standing: bool = False) -> RecordedWorld:
        stamps, place = np.array([0, 1, 2]) * 10**9 + later_ns, np.array([[0.0, 1.0], [0.5, 1.0], [1.0, 1.0 + shift_m]])
        samples = Samples.of(np.full(3, 4), stamps[::order], place[::order], np.full(3, 0.3))
        return RecordedWorld(samples, 1.5, np.array([4]) if standing else None)

    same = world().sha256
    assert world(order=-1).sha256 == same
    assert world(shift_m=1e-9).sha256 == same, "less than any machine agrees on"
    others = {world(shift_m=1e-3).sha256, world(later_ns=1).sha256, world(standing=True).sha256}
    assert len(others | {same}) == 4


def test_an_empty_world() -> None:
    none = np.zeros(0, dtype=np.int64)
    world = RecordedWorld(Samples.of(none, none, np.zeros((0, 2)), np.zeros(0)), 0.5)
    assert len(world) == 0
    assert world.bounds() is None
    assert np.isnan(world.nearest(np.zeros(2), 0.3, 0)[0])
    assert np.isnan(world.at(0).time_to_collision(np.zeros(2), np.ones(2), 0.3))


def test_time_to_collision_head_on_beside_and_away() -> None:
    objects = circles([[10.0, 0.0]]).at(0)
    assert objects.time_to_collision(np.zeros(2), np.array([2.0, 0.0]), 1.0) == pytest.approx((10 - 2) / 2)
    assert np.isnan(objects.time_to_collision(np.zeros(2), np.array([-2.0, 0.0]), 1.0))
    assert np.isnan(objects.time_to_collision(np.array([0.0, 2.1]), np.array([2.0, 0.0]), 1.0))
    # The offset 1.2 of a contact circle of radius 2: touched 1.6 before the centre.
    grazing = objects.time_to_collision(np.array([0.0, 1.2]), np.array([2.0, 0.0]), 1.0)
    assert grazing == pytest.approx((10 - 1.6) / 2)
    assert objects.time_to_collision(np.array([9.0, 0.0]), np.array([1.0, 0.0]), 1.0) == 0.0


def test_time_to_collision_counts_the_things_own_motion() -> None:
    world = moving([0.0, 0.1, 0.2], [10.0, 9.7, 9.4])
    assert world.at(0).time_to_collision(np.zeros(2), np.array([2.0, 0.0]), 0.5) == pytest.approx(9.0 / 5.0)


def test_driving_along_a_wall_is_no_collision_course() -> None:
    """A circle around the wall would hold the vehicle."""
    wall = box(20.0, 0.2, 0.0, (0.0, 1.0)).at(0)
    assert np.isnan(wall.time_to_collision(np.array([-5.0, 0.3]), np.array([1.0, 0.0]), 0.3))
    meets = wall.time_to_collision(np.array([0.0, -3.0]), np.array([0.0, 1.0]), 0.3)
    assert meets == pytest.approx(3.9 - 0.3, abs=0.1)


@given(
    length=st.floats(0.05, 30),
    width=st.floats(0.05, 30),
    yaw=st.floats(-3, 3),
    along=st.floats(-0.5, 0.5),
    across=st.floats(-0.5, 0.5),
)
def test_discs_cover_their_rectangle(length: float, width: float, yaw: float, along: float, across: float) -> None:
    centre, _, radius = box(length, width, yaw, (3.0, -2.0)).at(0).discs
    c, s = np.cos(yaw), np.sin(yaw)
    point = np.array([3 + c * along * length - s * across * width, -2 + s * along * length + c * across * width])
    assert (np.hypot(*(centre - point).T) <= radius + 1e-9).any()


@given(turn=st.floats(-3, 3), x=st.floats(-50, 50), y=st.floats(-50, 50), px=st.floats(-9, 9), py=st.floats(-9, 9))
def test_clearance_does_not_depend_on_the_frame(turn: float, x: float, y: float, px: float, py: float) -> None:
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    shift = np.array([x, y])
    point = np.array([px, py])
    here = box(4, 2, 0.3, (1.0, -1.0)).clearance(point[None], 0.3, 0)[0, 0]
    centre = rotation @ np.array([1.0, -1.0]) + shift
    there = box(4, 2, 0.3 + turn, (centre[0], centre[1])).clearance((rotation @ point + shift)[None], 0.3, 0)[0, 0]
    assert there == pytest.approx(here, abs=1e-9)
