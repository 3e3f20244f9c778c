"""What the search for an escape sees, against the world that it stands for."""

from __future__ import annotations

import math

import numpy as np

from adcbf_cli.core.config import VehicleConfig
from adcbf_cli.core.replay.escape_world import CELL_M, FAR_M, LocalWorld, rounded_distance, way_to_goal
from adcbf_cli.core.replay.world import RecordedWorld, Samples
from adcbf_cli.core.vehicles.vehicle import Vehicle

SECOND = 1_000_000_000
VEHICLE = Vehicle.from_config(VehicleConfig())
BODY_M = VEHICLE.body_radius_m
POSE = np.array([2.0, -1.0, 0.7])


def recorded(seed: int = 0, things: int = 6) -> RecordedWorld:
    """Circles and turning rectangles with constant velocities, a sample each 0.1 s for 2 s."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(21) / 10
    start, velocity = rng.uniform(-3, 3, (things, 2)), rng.uniform(-1.5, 1.5, (things, 2))
    place = (start[:, None] + velocity[:, None] * time_s[:, None]).reshape(-1, 2)
    size = np.repeat(rng.uniform(0.2, 1.5, (things, 2)), 21, axis=0)
    round_ = np.repeat(np.arange(things) % 2 == 0, 21)
    turn = (rng.uniform(-np.pi, np.pi, things)[:, None] + rng.uniform(-2, 2, things)[:, None] * time_s).reshape(-1)
    return RecordedWorld(
        Samples.of(
            np.repeat(np.arange(things), 21),
            np.tile(np.round(time_s * SECOND).astype(np.int64), things),
            place,
            np.where(round_, 0.5 * size[:, 0], 0.5 * np.hypot(*size.T)),
            length_m=np.where(round_, np.nan, size[:, 0]),
            width_m=np.where(round_, np.nan, size[:, 1]),
            yaw_rad=np.where(round_, np.nan, turn),
        ),
        0.5,
    )


def test_distances_are_the_worlds_own():
    scene = recorded()
    local = LocalWorld(scene, POSE, 0, 1 / 30)
    things = local.moments(np.array([3, 17, 40]))
    points = np.random.default_rng(1).uniform(-4, 4, (50, 2))
    seen = local.point(points)
    for k, tick in enumerate((3, 17, 40)):
        expected = scene.at(round(tick * SECOND / 30)).clearance(points, 0.0)
        offset = seen[:, None] - things.place_m[:, k]
        found = rounded_distance(offset, things.yaw_rad[:, k], things.half_m, things.round_m)
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_first_touches_are_those_of_driving_in_small_steps():
    """Random drives among random things: the tick from which on each first overlaps one, by 20 looks a tick."""
    hit_at = []
    for seed in range(4):
        scene, ticks, rng = recorded(seed), 15, np.random.default_rng(100 + seed)
        local = LocalWorld(scene, np.zeros(3), 0, 1 / 30)
        stretch = local.stretch(0, ticks)
        start = np.column_stack([rng.uniform(-3, 3, (40, 2)), rng.uniform(-np.pi, np.pi, 40)])
        start = start[(scene.at(0).clearance(start[:, :2], BODY_M) > 0.05).all(axis=1)]
        applied = np.tile(np.array([1.0, 0.5]), (len(start), ticks, 1))
        poses = [start]
        for k in range(ticks):
            poses.append(VEHICLE.step(poses[-1], applied[:, k], 1 / 30))
        near = stretch.near(start, ticks / 30, BODY_M)
        touched, end_m = stretch.first_touch(VEHICLE, np.stack(poses, axis=1), applied, near, 0.0)
        expected = np.full(len(start), ticks)
        for part in reversed(range(1, 20 * ticks + 1)):
            tick = (part - 1) // 20
            here = VEHICLE.step(poses[tick], applied[:, tick], (part / 20 - tick) / 30)
            clear = scene.at(round(part / 20 * SECOND / 30)).clearance(here[:, :2], BODY_M).min(axis=1)
            expected[clear <= 0.0] = tick
        np.testing.assert_array_equal(touched, expected)
        clear = scene.at(round(ticks * SECOND / 30)).clearance(poses[-1][:, :2], BODY_M).min(axis=1)
        close = clear < ticks / 30
        np.testing.assert_allclose(end_m[close], clear[close], atol=1e-9)
        assert (end_m >= clear - 1e-9).all()
        hit_at += expected[expected < ticks].tolist()
    assert len(set(hit_at)) > 5, "too few of the drives touch anything"


def test_what_is_not_there_is_far():
    early = Samples.of(np.array([1, 1]), np.array([0, SECOND // 2]), np.zeros((2, 2)), np.full(2, 0.3))
    things = LocalWorld(RecordedWorld(early, 0.6), POSE, 0, 1 / 30).moments(np.array([0, 15, 16]))
    assert (things.place_m[0, :2] < 10.0).all()
    np.testing.assert_array_equal(things.place_m[0, 2], [FAR_M, FAR_M])


def test_the_way_to_the_goal_goes_around_what_stands():
    """A disc of 1 m with the body's 0.3 m in the middle of 6 m: two tangents and the arc between them, longer by
    what eight directions cost at most (8.3 %)."""
    still = Samples.of(np.array([1]), np.array([0]), np.array([[3.0, 0.0]]), np.array([1.0]))
    world = RecordedWorld(still, 0.5, standing=np.array([1]))
    local = LocalWorld(world, np.zeros(3), 0, 1 / 30)
    way = way_to_goal(local, np.array([6.0, 0.0]), 0.3, BODY_M, 300)
    reach = 1.0 + BODY_M
    around = 2 * math.sqrt(9.0 - reach**2) + reach * (np.pi - 2 * math.acos(reach / 3.0))
    metres = way.distance(np.array([[0.0, 0.0], [5.0, 0.0], [6.0, 0.0]]))
    assert around - 3 * CELL_M <= metres[0] <= 1.083 * around + CELL_M
    np.testing.assert_allclose(metres[1:], [1.0, 0.0], atol=2 * CELL_M)
    np.testing.assert_allclose(way.gap_m(np.array([[6.0, 0.5, 0.0], [6.0, 0.1, 0.0]])), [0.2, -0.2])


def test_what_moves_is_not_in_the_way_to_the_goal():
    times = np.arange(0, 11 * SECOND, SECOND)
    place = np.column_stack([np.full(11, 3.0), np.linspace(0, 5, 11)])
    world = RecordedWorld(Samples.of(np.ones(11, dtype=np.int64), times, place, np.full(11, 1.0)), 2.0)
    way = way_to_goal(LocalWorld(world, np.zeros(3), 0, 1 / 30), np.array([6.0, 0.0]), 0.3, BODY_M, 300)
    assert way.distance(np.zeros((1, 2)))[0] <= 6.0 + CELL_M
