"""Drives of a planner that goes straight on, through worlds made by hand."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.planning.planner import Details, Outcome, Plan, Situation
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.replay.closed_loop import replay
from adcbf_cli.core.replay.log_path import LogPath
from adcbf_cli.core.replay.records import Drive, Result
from adcbf_cli.core.replay.routes import Entry
from adcbf_cli.core.replay.world import RecordedWorld, Samples
from adcbf_cli.core.types import NO_ID, Notes, Predictions
from adcbf_cli.core.vehicles.vehicle import Vehicle

SECOND = 1_000_000_000
CONFIG = Config.model_validate({"planning": {"rate_hz": 10.0}, "perception": {"range_m": 5.0}})
VEHICLE = Vehicle.from_config(CONFIG.vehicle)
EMPTY = RecordedWorld(Samples.of(*(np.zeros(0, dtype=np.int64),) * 2, np.zeros((0, 2)), np.zeros(0)), 0.5)

Make = Callable[..., Predictions]


def standing(x: float, y: float, radius_m: float = 0.5) -> RecordedWorld:
    samples = Samples.of(np.array([4]), np.array([0]), np.array([[x, y]]), np.array([radius_m]))
    return RecordedWorld(samples, 0.5, standing=np.array([4]))


def crossing(start: tuple[float, float], velocity: tuple[float, float], radius_m: float = 0.5) -> RecordedWorld:
    """A disc of id 3 with constant velocity, sampled at 10 Hz for 20 s."""
    time_s = np.arange(201) / 10
    place = np.array(start) + time_s[:, None] * np.array(velocity)
    stamps = np.round(time_s * 1e9).astype(np.int64)
    return RecordedWorld(Samples.of(np.full(201, 3), stamps, place, np.full(201, radius_m)), 0.5)


def path_x(length_m: float = 5.95, speed_mps: float = 1.0) -> ReferencePath:
    return ReferencePath(np.array([[0.0, 0.0], [length_m, 0.0]]), speed_mps)


def entry(planner: Any, path: ReferencePath, speed_mps: float = 1.0, **changes: Any) -> Entry:
    values = {"seed": 0, "start_ns": 0, "start_pose": np.zeros(3), "start_inputs": np.array([speed_mps, 0.0])}
    return Entry(planner=planner, path=path, **{**values, **changes})


@pytest.fixture
def run(log_along_x: Callable[..., LogPath], predicted: Make) -> Callable[..., Drive]:
    def make(planner: Any, world: RecordedWorld, **options: Any) -> Drive:
        records = options.pop("records", None) or [predicted(0, [[50.0, 50.0]], [[0.0, 0.0]])]
        config = options.pop("config", CONFIG)
        notes = options.pop("notes", Notes())
        vehicle = Vehicle.from_config(config.vehicle)
        log_path = options.pop("log_path", None) or log_along_x()
        one = entry(planner, options.pop("path", path_x()), **options)
        return replay([one], records, world, log_path, vehicle, config, itertools.count().__next__, notes)[0]

    return make


def test_success_where_nothing_is_in_the_way(run: Any, driver: Any) -> None:
    """From rest at 0 with 1 m/s at once (its inputs are given): 5.95 m less 0.3 m tolerance is passed after 5.7 s."""
    drive = run(driver(VEHICLE, 1.0), EMPTY)
    assert drive.result is Result.SUCCESS
    assert len(drive.stamp_ns) == 58
    np.testing.assert_allclose(drive.pose[:, 0], 0.1 * np.arange(58), atol=1e-9)
    np.testing.assert_allclose(drive.along_m, drive.pose[:, 0], atol=1e-9)
    assert np.isnan(drive.clearance_m).all()
    assert (drive.nearest_id == NO_ID).all()
    assert drive.nominal_s == pytest.approx(5.95)


def test_a_wall_is_hit_when_it_must_be(run: Any, driver: Any) -> None:
    """A circle of 0.5 m at 3.05 m, body 0.3 m: contact at 2.25 m, found at the next tick, 2.3 m."""
    drive = run(driver(VEHICLE, 1.0), standing(3.05, 0.0))
    assert drive.result is Result.COLLISION
    assert drive.pose[-1, 0] == pytest.approx(2.3)
    np.testing.assert_allclose(drive.clearance_m[:-1], 2.25 - 0.1 * np.arange(23), atol=1e-9)
    assert drive.clearance_m[-1] < 0.0
    np.testing.assert_allclose(drive.ttc_s[:-1], 2.25 - 0.1 * np.arange(23), atol=1e-9)
    assert set(drive.nearest_id.tolist()) == {4}


def test_passing_a_wall_is_no_collision(run: Any, driver: Any) -> None:
    drive = run(driver(VEHICLE, 1.0), standing(3.0, 0.81))
    assert drive.result is Result.SUCCESS
    assert drive.clearance_m.min() == pytest.approx(0.01)
    assert np.isnan(drive.ttc_s).all()


def test_a_crossing_disc_is_met_at_the_right_time(run: Any, driver: Any) -> None:
    """It crosses x = 3 at t = 3 with 1 m/s, from below: the discs' gap closes along the diagonal."""
    drive = run(driver(VEHICLE, 1.0), crossing((3.0, -3.0), (0.0, 1.0)))
    assert drive.result is Result.COLLISION
    # |(3 - t, 3 - t)| = 0.8 at t = 3 - 0.8 / sqrt(2) = 2.434 s.
    assert (drive.stamp_ns[-1] - drive.stamp_ns[0]) / 1e9 == pytest.approx(2.5)
    assert drive.ttc_s[0] == pytest.approx(3 - 0.8 / np.sqrt(2))
    later = run(driver(VEHICLE, 1.0), crossing((3.0, -5.0), (0.0, 1.0)))
    assert later.result is Result.SUCCESS


def test_a_fast_vehicle_does_not_jump_through_things(run: Any, driver: Any) -> None:
    """20 m/s is 2 m a tick: a thin pole between two ticks is hit all the same."""
    config = Config.model_validate({"planning": {"rate_hz": 10.0}, "vehicle": {"max_speed_mps": 20.0}})
    vehicle = Vehicle.from_config(config.vehicle)
    options = {"config": config, "path": path_x(40.0, 20.0), "speed_mps": 20.0}
    drive = run(driver(vehicle, 20.0), standing(5.0, 0.0, 0.1), **options)
    assert drive.result is Result.COLLISION
    assert drive.pose[-1, 0] == pytest.approx(6.0)
    assert -0.05 < drive.clearance_m[-1] < 0.0
    assert drive.nearest_id[-1] == 4
    beside = run(driver(vehicle, 20.0), standing(5.0, 0.41, 0.1), **options)
    assert beside.result is Result.SUCCESS


def test_a_fast_disc_does_not_jump_through_the_vehicle(run: Any, driver: Any) -> None:
    """It passes the standing vehicle at 30 m/s, 3 m a tick."""
    drive = run(driver(VEHICLE, 0.0), crossing((-16.0, 0.0), (30.0, 0.0), 0.1), speed_mps=0.0)
    assert drive.result is Result.COLLISION
    assert (drive.stamp_ns[-1] - drive.stamp_ns[0]) / 1e9 == pytest.approx(0.6)


def test_a_start_in_a_collision_is_told(run: Any, driver: Any) -> None:
    notes = Notes()
    drive = run(driver(VEHICLE, 1.0), standing(0.5, 0.0), notes=notes)
    assert drive.result is Result.COLLISION
    assert len(drive.stamp_ns) == 1
    assert len(notes.warnings) == 1
    assert notes.warnings[0].startswith("seed 0 starts in a collision: its drives end where they begin")


def test_timeout(run: Any, driver: Any) -> None:
    """Standing: three times the nominal 5.95 s, at the next tick."""
    drive = run(driver(VEHICLE, 0.0), EMPTY, speed_mps=0.0)
    assert drive.result is Result.TIMEOUT
    assert (drive.stamp_ns[-1] - drive.stamp_ns[0]) / 1e9 == pytest.approx(17.9)


def test_the_goal_of_a_round_trip_is_not_reached_at_the_start(run: Any, driver: Any) -> None:
    loop = ReferencePath(np.array([[0, 0], [4, 0], [4, 4], [0, 4], [0, 0.0]]), 1.0)
    drive = run(driver(VEHICLE, 0.0), EMPTY, path=loop, speed_mps=0.0)
    assert drive.result is Result.TIMEOUT


def test_what_the_vehicle_cannot_do_is_not_done(run: Any, driver: Any) -> None:
    """1 m/s^2 at 10 Hz: 0.1, 0.2, ... m/s; a planner that asks for more is counted."""
    notes = Notes()
    drive = run(driver(VEHICLE, 5.0), EMPTY, speed_mps=0.0, notes=notes)
    np.testing.assert_allclose(drive.inputs[:12, 0], np.minimum(0.1 * np.arange(1, 13), 1.0))
    np.testing.assert_allclose(drive.pose[:4, 0], [0.0, 0.01, 0.03, 0.06])
    assert notes.counters["plans_beyond_the_vehicles_limits"] == len(drive.stamp_ns)


def test_inputs_that_are_no_numbers_brake(run: Any, driver: Any) -> None:
    planner, notes = driver(VEHICLE, 1.0), Notes()
    planner.inputs = np.array([np.nan, 0.0])
    config = Config.model_validate({"planning": {"rate_hz": 10.0}, "replay": {"timeout_factor": 1.1}})
    drive = run(planner, EMPTY, notes=notes, config=config)
    np.testing.assert_allclose(drive.inputs[:11, 0], 1.0 - 0.1 * np.arange(1, 12), atol=0.1)
    assert drive.inputs[-1, 0] == 0.0
    assert notes.counters["plans_without_finite_inputs"] == len(drive.stamp_ns)


def test_situations_hold_what_was_known_then(run: Any, driver: Any, predicted: Make) -> None:
    """Records at 0 and 0.5 s: ticks from 0.5 s on know the second one only."""
    records = [predicted(0, [[4.0, 1.0]], [[0.0, 0.0]]), predicted(SECOND // 2, [[4.0, 2.0]], [[0.0, 1.0]])]
    planner = driver(VEHICLE, 1.0)
    drive = run(planner, EMPTY, records=records)
    seen = [s.obstacles.position_m[0, 0, 1] for s in planner.situations[:8]]
    np.testing.assert_allclose(seen, [1.0] * 5 + [2.0, 2.1, 2.2])
    assert [s.stamp_ns for s in planner.situations] == drive.stamp_ns.tolist()
    np.testing.assert_allclose(planner.situations[3].pose, [0.3, 0, 0], atol=1e-9)
    np.testing.assert_allclose(planner.situations[3].inputs, [1.0, 0.0])
    assert planner.situations[0].obstacles.position_m.shape == (1, 31, 2)


def test_conflict_is_known_trouble_on_the_reference(run: Any, driver: Any, predicted: Make) -> None:
    """A standing track at x = 4.09 (radius 0.3): the reference comes within 0.3 + 0.3 + 0.2 m of it between
    x = 3.29 and 4.89, within the 3 s horizon from x = 0.29 on. Where the ego is nothing else is."""
    drive = run(driver(VEHICLE, 1.0), EMPTY, records=[predicted(0, [[4.09, 0.0]], [[0.0, 0.0]])], path=path_x(20.0))
    first = np.flatnonzero(drive.steps.conflict)[0]
    assert drive.pose[first, 0] == pytest.approx(0.3)
    elsewhere = np.abs(drive.pose[first:49, 0] - 4.09) > 0.3
    assert 0 < np.count_nonzero(~elsewhere) < 10
    np.testing.assert_array_equal(drive.steps.conflict[first:49], elsewhere)
    assert not drive.steps.conflict[49:].any()
    assert set(drive.steps.obstacles.tolist()) == {0, 1}


def test_deviation_is_the_plans_from_the_reference(run: Any, driver: Any) -> None:
    """A plan at half the reference's speed lags by 0.5 m/s * 3 s at its end."""
    drive = run(driver(VEHICLE, 0.5), EMPTY, speed_mps=0.5, path=path_x(20.0))
    assert drive.steps.deviation_m[0] == pytest.approx(1.5)


def test_distance_from_the_log_and_the_recordings_end(run: Any, driver: Any, log_along_x: Any) -> None:
    """The log's vehicle goes at 2 m/s for 3 s."""
    drive = run(driver(VEHICLE, 1.0), EMPTY, log_path=log_along_x(2.0, 3.0))
    np.testing.assert_allclose(drive.log_m[:31], 0.1 * np.arange(31), atol=1e-9)
    assert np.isnan(drive.log_m[31:]).all()
    assert drive.recorded.tolist() == [True] * 31 + [False] * (len(drive.stamp_ns) - 31)


def test_after_the_recording_what_stands_is_still_known(
    run: Any, driver: Any, predicted: Make, log_along_x: Any
) -> None:
    records = [predicted(0, [[5.0, 0.0], [4.0, 2.0]], [[0.0, 0.0], [0.0, 0.1]])]
    planner = driver(VEHICLE, 1.0)
    run(planner, standing(5.0, 0.0), records=records, log_path=log_along_x(1.0, 1.0))
    known = [s.obstacles.track_id.tolist() for s in planner.situations]
    assert known[10] == [0, 1]
    assert known[11] == [0]


def test_a_goal_within_an_obstacle_is_not_reachable(run: Any, driver: Any) -> None:
    drive = run(driver(VEHICLE, 1.0), crossing((6.0, -2.0), (0.0, 0.5)))
    # The disc of 0.5 m covers (6, 0) from 3 s to 5 s.
    at = (drive.stamp_ns / 1e9).round(3)
    np.testing.assert_array_equal(drive.goal_reachable, ~((at > 3.0) & (at < 5.0)))


def test_drives_do_not_depend_on_each_other(driver: Any, predicted: Make, log_along_x: Any) -> None:
    """Different starts in time and place, in one pass and one by one."""
    records = [predicted(k * SECOND // 10, [[4.0, 1.0 - 0.1 * k]], [[0.0, -1.0]]) for k in range(40)]
    world = crossing((4.0, 1.0), (0.0, -1.0))

    def entries() -> list[Entry]:
        return [
            entry(driver(VEHICLE, 1.0), path_x()),
            entry(driver(VEHICLE, 0.7), path_x(), seed=1, start_ns=730_000_000, start_pose=np.array([0, 0.2, 0.1])),
            entry(driver(VEHICLE, 0.4, 0.1), path_x(), seed=2, start_ns=1_000_000_000),
        ]

    def run_all(some: list[Entry]) -> list[Drive]:
        clock = itertools.count().__next__
        return replay(some, iter(records), world, log_along_x(), VEHICLE, CONFIG, clock, Notes())

    together = run_all(entries())
    for i, drive in enumerate(together):
        (alone,) = run_all([entries()[i]])
        assert (drive.seed, drive.result) == (alone.seed, alone.result)
        for name in ("stamp_ns", "pose", "inputs", "clearance_m", "ttc_s"):
            np.testing.assert_array_equal(getattr(drive, name), getattr(alone, name))
        np.testing.assert_array_equal(drive.steps.obstacles, alone.steps.obstacles)
        np.testing.assert_array_equal(drive.steps.conflict, alone.steps.conflict)


@pytest.mark.parametrize(("turn", "shift"), [(0.7, (30.0, -8.0)), (-2.5, (-1000.0, 400.0))])
def test_a_turned_and_shifted_world_gives_the_same_drive(
    driver: Any, predicted: Make, turn: float, shift: tuple[float, float]
) -> None:
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])

    def drive(rotation: np.ndarray, shift: np.ndarray, turn: float) -> Drive:
        def place(points: object) -> np.ndarray:
            return np.asarray(points, dtype=float) @ rotation.T + shift

        time_s = np.arange(101) / 10
        stamps = np.round(time_s * 1e9).astype(np.int64)
        log = np.column_stack([place(np.column_stack([time_s, 0 * time_s])), np.full(101, turn)])
        disc = place(np.array([4.0, -3.0]) + time_s[:, None] * np.array([0.0, 0.9]))
        world = RecordedWorld(Samples.of(np.full(101, 3), stamps, disc, np.full(101, 0.5)), 0.5)
        velocity = rotation @ np.array([0.0, 0.9])
        records = [predicted(int(t), disc[[k]], velocity[None]) for k, t in enumerate(stamps)]
        one = entry(
            driver(VEHICLE, 1.0, 0.05),
            ReferencePath(place([[0.0, 0.0], [6.0, 0.0]]), 1.0),
            start_pose=np.append(shift, turn),
        )
        clock = itertools.count().__next__
        return replay([one], records, world, LogPath(stamps, log), VEHICLE, CONFIG, clock, Notes())[0]

    here = drive(np.eye(2), np.zeros(2), 0.0)
    there = drive(rotation, np.array(shift), turn)
    assert here.result == there.result
    np.testing.assert_allclose((there.pose[:, :2] - shift) @ rotation, here.pose[:, :2], atol=1e-8)
    for name in ("clearance_m", "ttc_s", "reference_m", "along_m", "log_m"):
        np.testing.assert_allclose(getattr(there, name), getattr(here, name), atol=1e-8)
    np.testing.assert_array_equal(there.steps.conflict, here.steps.conflict)


def test_what_happens_later_changes_nothing_before(predicted: Make) -> None:
    """A disc that turns back after 1.5 s, or does not: until then real planners drive and plan alike."""
    time_s = np.arange(101) / 10
    stamps = np.round(time_s * 1e9).astype(np.int64)
    log_path = LogPath(stamps, np.column_stack([time_s, 0 * time_s, 0 * time_s]))

    def drive(name: str, turns_back: bool) -> Drive:
        side = np.where(turns_back & (time_s > 1.55), 2 * 1.5 - time_s, time_s)
        disc = np.column_stack([np.full(101, 4.0), -3.0 + 0.9 * side])
        world = RecordedWorld(Samples.of(np.full(101, 3), stamps, disc, np.full(101, 0.5)), 0.5)
        speeds = np.where(turns_back & (time_s > 1.55), -0.9, 0.9)
        moves = zip(stamps.tolist(), disc, speeds, strict=True)
        records = [predicted(stamp, [place], [[0.0, speed]]) for stamp, place, speed in moves]
        one = entry(make_planner(name, VEHICLE, CONFIG.planning, Notes()), path_x())
        clock = itertools.count().__next__
        return replay([one], records, world, log_path, VEHICLE, CONFIG, clock, Notes())[0]

    for name in ("ad-cbf-mpc", "dwa", "apf", "pure-pursuit"):
        on, back = drive(name, turns_back=False), drive(name, turns_back=True)
        until = int(np.searchsorted(on.stamp_ns, round(1.5e9), side="right"))
        for values in ("pose", "inputs", "clearance_m", "log_m"):
            np.testing.assert_array_equal(getattr(on, values)[:until], getattr(back, values)[:until])
        np.testing.assert_array_equal(on.stages.pose[:until], back.stages.pose[:until])
        assert not np.array_equal(on.clearance_m[until : until + 10], back.clearance_m[until : until + 10])


class Detailed:
    """Two obstacles in its problem, the first nearer at stage 0, the second after."""

    name = "detailed"

    def plan(self, situation: Situation) -> Plan:
        inputs = np.zeros((2, 2))
        details = Details(
            status="converged",
            start="shifted",
            iterations=3,
            merit=1.5,
            violation_m2=0.1,
            decay=0.9,
            feasible=False,
            track_id=np.array([11, 22]),
            barrier_m2=np.array([[1.0, 2.0], [3.0, 0.5], [4.0, 0.25]]),
            gamma=np.array([[0.1, 0.2], [0.3, 0.4]]),
            slack_m2=np.array([[0.0, 0.01], [0.02, 0.03]]),
            dropped=5,
        )
        return Plan(Outcome.RELAXED, inputs, np.tile(situation.pose, (3, 1)), details)


def test_what_a_planner_says_is_kept(run: Any) -> None:
    config = Config.model_validate({"planning": {"rate_hz": 10.0, "steps": 2}, "replay": {"timeout_factor": 1.01}})
    drive = run(Detailed(), EMPTY, config=config, speed_mps=0.0, path=path_x(1.0))
    assert set(drive.steps.outcome) == {"relaxed"}
    assert set(drive.steps.status) == {"converged"}
    assert (drive.steps.iterations[0], drive.steps.dropped[0], drive.steps.feasible[0]) == (3, 5, 0.0)
    assert (drive.steps.decay[0], drive.steps.violation_m2[0], drive.steps.merit[0]) == (0.9, 0.1, 1.5)
    assert drive.stages.barrier_m2[0].tolist() == [1.0, 0.5, 0.25]
    assert drive.stages.track_id[0].tolist() == [11, 22, 22]
    np.testing.assert_allclose(drive.stages.gamma[0], [0.1, 0.4, np.nan])
    np.testing.assert_allclose(drive.stages.slack_m2[0], [0.0, 0.03, np.nan])
    assert drive.stages.inputs.shape == (len(drive.stamp_ns), 3, 2)
    assert np.isnan(drive.stages.inputs[:, -1]).all()


def test_the_clock_is_read_around_planning_only(driver: Any, predicted: Make, log_along_x: Any) -> None:
    readings = iter(range(0, 10**9, 2_000_000))
    drive = replay(
        [entry(driver(VEHICLE, 1.0), path_x(), keep_stages=False)],
        [predicted(0, [[9.0, 9.0]], [[0, 0]])],
        EMPTY,
        log_along_x(),
        VEHICLE,
        CONFIG,
        readings.__next__,
        Notes(),
    )[0]
    assert set(drive.steps.solve_ms.tolist()) == {2.0}
    assert drive.stages is None


def test_no_predictions_at_all_is_an_error(driver: Any, log_along_x: Any) -> None:
    one = entry(driver(VEHICLE, 1.0), path_x())
    with pytest.raises(AdcbfError, match="no predictions"):
        replay([one], [], EMPTY, log_along_x(), VEHICLE, CONFIG, itertools.count().__next__, Notes())
