"""Paths to drive and where to start."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.replay.log_path import LogPath
from adcbf_cli.core.replay.routes import (
    Start,
    check_duration,
    entries_for,
    log_start,
    logged_speed,
    map_box,
    reference_speed,
    route_between,
    route_from_log,
    start_of,
)
from adcbf_cli.core.replay.world import RecordedWorld, Samples
from adcbf_cli.core.vehicles.vehicle import Vehicle

SECOND = 1_000_000_000
CONFIG = Config()
VEHICLE = Vehicle.from_config(CONFIG.vehicle)
FIRST = Start(0, np.array([1.0, 2.0, np.pi / 2]), np.array([0.5, 0.0]))


def world(*centres: tuple[float, float], radius_m: float = 0.5) -> RecordedWorld:
    n = len(centres)
    samples = Samples.of(
        np.arange(n), np.zeros(n, dtype=np.int64), np.array(centres).reshape(n, 2), np.full(n, radius_m)
    )
    return RecordedWorld(samples, 0.5, standing=np.arange(n))


def test_reference_speed() -> None:
    assert reference_speed(CONFIG) == 0.75
    assert reference_speed(Config.model_validate({"vehicle": {"max_speed_mps": 0.5}})) == 0.5
    with pytest.raises(UsageError, match=r"reference_speed_mps is 1\.5, but the vehicle reaches 1 m/s"):
        reference_speed(Config.model_validate({"planning": {"reference_speed_mps": 1.5}}))


def test_the_logs_route_is_as_long_as_the_way_whatever_the_noise(log_along_x: Any) -> None:
    """1 cm of noise, also while standing for 10 s: the raw polyline would be metres longer."""
    path = log_along_x(0.5, 20.0)
    rng = np.random.default_rng(100)
    pose = np.concatenate([np.zeros((100, 3)), path.pose])
    pose[:, :2] += rng.normal(0, 0.01, (len(pose), 2))
    stamps = (SECOND // 10 * np.arange(len(pose))).astype(np.int64)
    route = route_from_log(LogPath(stamps, pose), 0.5)
    assert np.hypot(*np.diff(pose[:, :2], axis=0).T).sum() > 12.0
    assert route.length_m == pytest.approx(10.0, abs=0.15)


def test_the_logs_own_speed_leaves_out_standing(log_along_x: Any) -> None:
    path = log_along_x(0.8, 10.0)
    pose = np.concatenate([np.zeros((300, 3)), path.pose])
    stamps = (SECOND // 10 * np.arange(len(pose))).astype(np.int64)
    assert logged_speed(LogPath(stamps, pose)) == pytest.approx(0.8, abs=0.02)


def test_a_log_that_stood_still_has_no_route() -> None:
    still = LogPath(SECOND * np.arange(5), np.zeros((5, 3)))
    with pytest.raises(UsageError, match="single point"):
        route_from_log(still, 1.0)


def test_a_goal_outside_the_map_is_refused_with_the_map(log_along_x: Any) -> None:
    box = map_box(log_along_x(1.0, 10.0), world((3.0, 6.0)), 4.0)
    np.testing.assert_allclose([box.low_m, box.high_m], [[-4.0, -4.0], [14.0, 10.5]])
    route = route_between(np.zeros(2), np.array([13.9, 10.4]), 1.0, box)
    np.testing.assert_allclose(route.goal_m, [13.9, 10.4])
    with pytest.raises(UsageError, match=r"goal \(14\.1, 0\) .* x from -4\.0 to 14\.0 m, y from -4\.0 to 10\.5 m"):
        route_between(np.zeros(2), np.array([14.1, 0.0]), 1.0, box)
    with pytest.raises(UsageError, match=r"start \(nan, 0\)"):
        route_between(np.array([np.nan, 0.0]), np.zeros(2), 1.0, box)


def test_a_map_without_a_vehicle() -> None:
    nowhere = LogPath(np.array([0]), np.full((1, 3), np.nan))
    np.testing.assert_allclose(map_box(nowhere, world((3.0, 6.0)), 1.0).low_m, [1.5, 4.5])
    with pytest.raises(AdcbfError, match="no map"):
        map_box(nowhere, world(), 1.0)


def test_seed_0_starts_with_the_log(log_along_x: Any) -> None:
    path = ReferencePath(np.array([[0.0, 0.0], [9.0, 0.0]]), 0.75)
    first = log_start(log_along_x(3.0), path, VEHICLE)
    assert first.stamp_ns == 0
    np.testing.assert_allclose(first.pose, [0, 0, 0])
    np.testing.assert_allclose(first.inputs, [0.75, 0.0])
    assert start_of(0, first, world(), VEHICLE, CONFIG) is first
    own = log_start(log_along_x(3.0), ReferencePath(np.array([[2.0, 2.0], [2.0, 5.0]]), 0.75), VEHICLE, from_log=False)
    np.testing.assert_allclose(own.pose, [2.0, 2.0, np.pi / 2])
    np.testing.assert_allclose(own.inputs, [0.0, 0.0])


def test_other_seeds_start_to_the_side_and_later() -> None:
    starts = [start_of(seed, FIRST, world(), VEHICLE, CONFIG) for seed in range(1, 400)]
    aside = np.array([s.pose[0] - 1.0 for s in starts])
    delay_s = np.array([s.stamp_ns for s in starts]) / 1e9
    np.testing.assert_allclose([s.pose[1:] for s in starts], np.tile([2.0, np.pi / 2], (399, 1)))
    assert np.std(aside) == pytest.approx(0.3, abs=0.04)
    assert abs(np.mean(aside)) < 0.05
    assert 0.0 <= delay_s.min() < 0.05
    assert 1.95 < delay_s.max() <= 2.0
    # Ticks of all seeds fall together.
    np.testing.assert_allclose(delay_s * 30, np.round(delay_s * 30), atol=1e-6)


def test_a_seed_starts_all_planners_alike() -> None:
    class Named:
        def __init__(self, name: str) -> None:
            self.name = name

        def plan(self, situation: Any) -> Any:
            raise NotImplementedError

    path = ReferencePath(np.array([[0.0, 0.0], [9.0, 0.0]]), 0.75)
    entries = entries_for(["a", "b"], [0, 5, 9], Named, path, FIRST, world(), VEHICLE, CONFIG)
    assert [(e.planner.name, e.seed) for e in entries] == [(n, s) for n in "ab" for s in (0, 5, 9)]
    assert len({id(e.planner) for e in entries}) == 6
    for a, b in zip(entries[:3], entries[3:], strict=True):
        assert a.start_ns == b.start_ns
        np.testing.assert_array_equal(a.start_pose, b.start_pose)
    alone = entries_for(["b"], [9], Named, path, FIRST, world(), VEHICLE, CONFIG)[0]
    np.testing.assert_array_equal(alone.start_pose, entries[5].start_pose)
    assert [e.keep_stages for e in entries] == [True, False, False] * 2


def test_no_start_in_a_collision() -> None:
    """A wall at the right: without redrawing, half of the starts would be in it."""
    right = world((1.7, 2.0), radius_m=0.4)
    for seed in range(1, 40):
        start = start_of(seed, FIRST, right, VEHICLE, CONFIG)
        assert right.nearest(start.pose[:2], VEHICLE.body_radius_m, start.stamp_ns)[0] >= 0.0
    with pytest.raises(AdcbfError, match="seed 1: none of 100 starts"):
        start_of(1, FIRST, world((1.0, 2.0), radius_m=50.0), VEHICLE, CONFIG)


def test_a_drive_that_would_never_end_is_refused() -> None:
    """3 times 10 m at 0.9 mm/s, 30 times a second: just over a million steps."""
    points = np.array([[0.0, 0.0], [10.0, 0.0]])
    check_duration(ReferencePath(points, 0.00091), Config())
    with pytest.raises(UsageError, match="planning steps"):
        check_duration(ReferencePath(points, 0.00089), Config())


def test_a_goal_where_the_way_starts_is_refused() -> None:
    here = np.array([1.0, 1.0])
    with pytest.raises(UsageError, match="nothing to drive"):
        route_between(here, here + 0.01, 1.0, map_box(LogPath(np.array([0]), np.zeros((1, 3))), world(), 4.0))
