"""Driving metrics against drives whose numbers can be worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adcbf_cli.core.config import PlanningConfig, ReplayConfig
from adcbf_cli.core.evaluation.driving import BY_NAME, LOGGED, METRICS, applicable, score_drive
from adcbf_cli.core.evaluation.driving_evidence import Applies
from adcbf_cli.core.replay import open_loop as open_loop_module
from adcbf_cli.core.replay.records import Drive, Result
from tests.core.evaluation.driving_scenes import NAN, START_NS, drive_of, stages_of, steps_of, turned

PAGE = Path(__file__).resolve().parents[3] / "docs" / "driving-metrics.md"
REPLAY = ReplayConfig()
PLANNING = PlanningConfig()


def score(drive: Drive, name: str, replay: ReplayConfig = REPLAY, planning: PlanningConfig = PLANNING) -> float | None:
    return score_drive(drive, replay, planning)[name]


def test_the_declarations_are_one_a_name_and_documented() -> None:
    assert len(BY_NAME) == len(METRICS)
    page = PAGE.read_text()
    for m in METRICS:
        unit = "-" if m.unit == "1" else m.unit
        row = f"| `{m.name}` | {unit} | {m.better} | {m.applies} | {m.window} | {m.definition} |"
        assert row in page, f"docs/driving-metrics.md lacks this row, or says it otherwise:\n{row}"
    rows = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")]
    assert sorted(rows) == sorted(BY_NAME), "the page has no rows of metrics that are gone"


def test_the_log_own_driver_goes_by_one_name() -> None:
    assert LOGGED == open_loop_module.LOGGED


def test_arriving() -> None:
    drive = drive_of([2.0] * 11)
    assert score(drive, "nav_time_s") == pytest.approx(1.0)
    assert score(drive, "path_length_m") == pytest.approx(2.0), "ten periods: the last tick's input is not driven"
    assert [score(drive, name) for name in ("success", "collision", "timeout")] == [1.0, 0.0, 0.0]


@pytest.mark.parametrize("result", [Result.COLLISION, Result.TIMEOUT])
def test_a_failed_drive_has_no_time_and_no_length(result: Result) -> None:
    drive = drive_of([2.0] * 11, result=result)
    assert score(drive, "nav_time_s") is None
    assert score(drive, "path_length_m") is None
    assert score(drive, "success") == 0.0
    assert score(drive, result.value) == 1.0


def test_clearance_is_judged_wherever_it_is_known() -> None:
    """After the recording's end too: what stands there still stands."""
    drive = drive_of(
        [1.0] * 6,
        clearance_m=np.array([NAN, 0.5, 0.1, -0.05, 0.15, NAN]),
        ttc_s=np.array([NAN, 4.0, 2.5, 3.0, NAN, NAN]),
        recorded=np.array([True] * 3 + [False] * 3),
    )
    assert score(drive, "min_dist_m") == -0.05
    assert score(drive, "min_ttc_s") == 2.5
    assert score(drive, "time_below_clearance_s") == pytest.approx(0.3), "ticks 2, 3 and 4"
    assert score(drive, "time_below_clearance_s", ReplayConfig(clearance_m=0.12)) == pytest.approx(0.2)


def test_the_last_tick_stands_for_no_time() -> None:
    drive = drive_of([1.0] * 3, clearance_m=np.array([1.0, 1.0, 0.0]), recorded=np.array([True, True, True]))
    assert score(drive, "time_below_clearance_s") == 0.0
    after = replace(drive, recorded=np.array([True, False, False]))
    assert score(after, "after_recording_s") == pytest.approx(0.1)


def test_without_obstacles_nothing_is_said_of_them() -> None:
    scores = score_drive(drive_of([1.0] * 20), REPLAY, PLANNING)
    for name in ("min_dist_m", "min_ttc_s", "time_below_clearance_s", "vel_var", "barrier_min_m2", "gamma_min"):
        assert scores[name] is None, name
    for name in ("diverged_from_log_s", "diverged_share", "ref_time_s", "plan_ref_time_s", "plan_error_1s_m"):
        assert scores[name] is None, name


def test_velocity_variance_near_obstacles() -> None:
    drive = drive_of([1.0, 0.5, 0.2, 0.8, 9.0], clearance_m=np.array([1.0, 1.9, 2.1, 0.3, NAN]))
    near = [1.0, 0.5, 0.8]
    assert score(drive, "vel_var") == pytest.approx(np.var(near))
    assert score(drive, "vel_var", ReplayConfig(near_m=0.5)) is None, "one tick varies by nothing"
    assert score(drive_of([0.7] * 5, clearance_m=np.ones(5)), "vel_var") == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("period_s", [0.1, 1 / 30, 0.02, 0.08])
def test_a_steady_drive_has_no_jerk_and_a_parabola_its_own(period_s: float) -> None:
    t = period_s * np.arange(round(4 / period_s))
    steady = drive_of(np.full(len(t), 0.8), period_s=period_s)
    assert score(steady, "jerk_max_mps3") == pytest.approx(0.0, abs=1e-12)
    assert score(steady, "yaw_accel_max_radps2") == pytest.approx(0.0, abs=1e-12)
    ramp = drive_of(0.3 * t, period_s=period_s)
    assert score(ramp, "jerk_max_mps3") == pytest.approx(0.0, abs=1e-7), "constant acceleration"
    parabola = drive_of(0.5 * 0.6 * t**2, period_s=period_s)
    assert score(parabola, "jerk_rms_mps3") == pytest.approx(0.6, rel=1e-6)
    assert score(parabola, "jerk_max_mps3") == pytest.approx(0.6, rel=1e-6)
    turning = drive_of(np.ones(len(t)), -0.7 * t, period_s)
    assert score(turning, "yaw_accel_rms_radps2") == pytest.approx(0.7, rel=1e-6)
    assert score(turning, "yaw_accel_max_radps2") == pytest.approx(0.7, rel=1e-6)


def test_a_step_of_acceleration_is_spread_over_the_window() -> None:
    """v is 1 and then falls at 1 m/s^2: v(t+w) - 2 v(t) + v(t-w) is -0.5 at the break, over 0.25 s^2."""
    t = 0.1 * np.arange(31)
    drive = drive_of(np.where(t < 1.5, 1.0, 1.0 - (t - 1.5)))
    assert score(drive, "jerk_max_mps3") == pytest.approx(2.0)
    values = [-max(0.0, 0.5 - abs(x - 1.5)) / 0.25 for x in t[5:-5]]
    assert score(drive, "jerk_rms_mps3") == pytest.approx(math.sqrt(np.mean(np.square(values))))


def test_a_drive_shorter_than_the_window_has_no_jerk() -> None:
    assert score(drive_of(np.arange(10.0) ** 2), "jerk_rms_mps3") is None
    assert score(drive_of(np.arange(11.0) ** 2), "jerk_rms_mps3") == pytest.approx(200.0), "one tick has both sides"


def test_yaw_acceleration_does_not_jump_where_yaw_wraps() -> None:
    drive = drive_of(np.ones(80), np.full(80, 1.0))
    wrapped = drive.pose.copy()
    wrapped[:, 2] = np.angle(np.exp(1j * wrapped[:, 2]))
    assert wrapped[:, 2].min() < -3, "it does wrap"
    assert score(replace(drive, pose=wrapped), "yaw_accel_max_radps2") == pytest.approx(0.0, abs=1e-9)


def test_uneven_ticks_of_a_log_are_taken_as_lines_between_them() -> None:
    t = np.cumsum(np.tile([0.08, 0.12, 0.1], 12))
    t = t - t[0]
    drive = drive_of(0.4 * t, stamp_ns=START_NS + np.round(t * 1e9).astype(np.int64), steps=None, stages=None)
    assert score(drive, "jerk_max_mps3") == pytest.approx(0.0, abs=1e-6)


def test_distance_from_the_reference() -> None:
    drive = drive_of([1.0] * 4, reference_m=np.array([0.0, 0.3, 0.4, 0.0]))
    assert score(drive, "reference_rms_m") == pytest.approx(0.25)
    assert score(drive, "reference_max_m") == 0.4


def test_freezing() -> None:
    speed = [0.0, 0.02, 0.04, 0.5, 0.04, 0.0, 0.0, 0.5, 0.0, 0.0]
    drive = drive_of(speed)
    assert score(drive, "freezing_s") == pytest.approx(0.4), "ticks 4, 5, 6, 8; not the start, and 9 lasts no time"
    at_goal = replace(drive, along_m=np.where(np.arange(10) < 8, 0.0, 99.8))
    assert score(at_goal, "freezing_s") == pytest.approx(0.3), "waiting at the goal is not freezing"
    beside = replace(at_goal, reference_m=np.where(np.arange(10) < 8, 0.0, 0.5))
    assert score(beside, "freezing_s") == pytest.approx(0.4), "beside the goal it is"
    covered = replace(drive, goal_reachable=np.arange(10) < 5)
    assert score(covered, "freezing_s") == pytest.approx(0.1), "tick 4: later something stands on the goal"
    assert score(replace(drive, goal_reachable=np.zeros(10, dtype=bool)), "freezing_s") is None


def test_a_vehicle_that_never_starts_is_frozen() -> None:
    assert score(drive_of([0.0] * 11, result=Result.TIMEOUT), "freezing_s") == pytest.approx(1.0)
    assert score(drive_of([-0.5] * 11), "freezing_s") == 0.0, "reversing is no freezing"


def test_divergence_from_the_log() -> None:
    drive = drive_of([1.0] * 6, log_m=np.array([NAN, 0.2, 1.0, 1.1, 0.5, 2.0]))
    assert score(drive, "diverged_from_log_s") == pytest.approx(0.3)
    assert score(drive, "diverged_share") == pytest.approx(2 / 5)
    near = ReplayConfig(divergence_m=5.0)
    assert score(drive, "diverged_from_log_s", near) is None
    assert score(drive, "diverged_share", near) == 0.0


def ladder(*outcomes: str) -> Drive:
    return drive_of([1.0] * len(outcomes), steps=steps_of(len(outcomes), outcome=outcomes))


def test_rates_of_the_ladder() -> None:
    drive = ladder("solved", "relaxed", "relaxed", "braked", "stopped", "stopped", "stopped", "solved", "solved", "")
    assert score(drive, "relaxed_rate") == pytest.approx(2 / 9), "no step was planned at the last tick"
    assert score(drive, "braked_rate") == pytest.approx(1 / 9)
    assert score(drive, "stopped_rate") == pytest.approx(3 / 9)


def test_infeasible_steps_are_a_share_of_those_that_were_optimised() -> None:
    steps = steps_of(5, feasible=np.array([1.0, 0.0, NAN, 1.0, 0.0]))
    assert score(drive_of([1.0] * 5, steps=steps), "infeasible_rate") == 0.5
    assert score(drive_of([1.0] * 5, steps=steps_of(5, feasible=np.full(5, NAN))), "infeasible_rate") is None


@pytest.mark.parametrize(("at", "found"), [(9, 1.0), (10, 1.0), (38, 1.0), (39, 0.0), (8, 0.0)])
@pytest.mark.parametrize("outcome", ["relaxed", "braked", "stopped"])
def test_collision_after_a_fallback(at: int, found: float, outcome: str) -> None:
    """40 ticks 0.1 s apart; tick 9 is 3.0 s before the collision at tick 39, whose own
    step comes too late."""
    outcomes = ["solved"] * 40
    outcomes[at] = outcome
    drive = drive_of([1.0] * 40, steps=steps_of(40, outcome=tuple(outcomes)), result=Result.COLLISION)
    assert score(drive, "collision_after_fallback") == found
    assert score(replace(drive, result=Result.SUCCESS), "collision_after_fallback") == 0.0


def test_barrier_gamma_and_violation() -> None:
    barrier = np.array([[NAN, NAN, NAN], [2.0, 0.5, -0.25]])
    gamma = np.array([[NAN, NAN, NAN], [0.1, 0.4, NAN]])
    steps = steps_of(2, violation_m2=np.array([NAN, 0.3]), decay=np.array([NAN, 0.8]), dropped=np.array([0, 3]))
    drive = drive_of([1.0] * 2, steps=steps, stages=stages_of(2, 2, barrier_m2=barrier, gamma=gamma))
    scores = score_drive(drive, REPLAY, PLANNING)
    assert scores["barrier_min_m2"] == -0.25
    assert (scores["gamma_min"], scores["gamma_max"]) == (0.1, 0.4)
    assert (scores["violation_max_m2"], scores["decay_min"]) == (0.3, 0.8)
    assert scores["dropped_rate"] == 0.5


def test_solve_times_and_deadline() -> None:
    times = np.append(np.arange(1.0, 101.0), NAN)
    drive = drive_of([1.0] * 101, steps=steps_of(101, solve_ms=times))
    scores = score_drive(drive, REPLAY, PlanningConfig(rate_hz=12.5))
    assert scores["solve_p50_ms"] == pytest.approx(50.5)
    assert scores["solve_p95_ms"] == pytest.approx(95.05)
    assert scores["solve_p99_ms"] == pytest.approx(99.01)
    assert scores["solve_max_ms"] == 100.0
    assert scores["deadline_missed_rate"] == pytest.approx(0.2), "81 to 100 ms miss 80 ms; 80 does not"


def open_loop(errors: np.ndarray) -> Drive:
    ticks = len(errors)
    return drive_of([1.0] * ticks, result=None, plan_error_m=errors, steps=steps_of(ticks))


def test_plan_errors_at_their_horizons() -> None:
    errors = np.array([np.arange(31.0), np.arange(31.0) * 3, np.full(31, NAN)])
    drive = open_loop(errors)
    assert score(drive, "plan_error_1s_m") == pytest.approx(20.0), "step 10 of two plans: 10 and 30"
    assert score(drive, "plan_error_2s_m") == pytest.approx(40.0)
    assert score(drive, "plan_error_3s_m") == pytest.approx(60.0)
    assert score(open_loop(errors[:, :30]), "plan_error_3s_m") is None, "beyond the horizon"
    between = score(drive, "plan_error_1s_m", planning=PlanningConfig(step_s=0.3))
    assert between == pytest.approx(20.0 / 3), "a third of the way from step 3 to 4"


def test_each_kind_of_drive_has_its_metrics_and_no_others() -> None:
    closed = drive_of([1.0] * 30, clearance_m=np.ones(30))
    logged = replace(closed, planner="logged", result=None, steps=None, stages=None)
    opened = replace(closed, result=None, plan_error_m=np.ones((30, 31)))
    for drive, missing in (
        (closed, {Applies.OPEN}),
        (logged, {Applies.CLOSED, Applies.PLANNED, Applies.OPEN}),
        (opened, {Applies.DRIVEN, Applies.CLOSED}),
    ):
        scores = score_drive(drive, REPLAY, PLANNING)
        assert list(scores) == list(BY_NAME)
        assert all(scores[m.name] is None for m in METRICS if m.applies in missing)
        for applies in set(Applies) - missing:
            assert any(scores[m.name] is not None for m in METRICS if m.applies is applies), applies
    assert score(logged, "nav_time_s") == pytest.approx(2.9), "the log's driver arrives by definition"
    assert {m.applies for m in applicable("plan", "mine")} == {Applies.PLANNED, Applies.OPEN}
    assert {m.applies for m in applicable("plan", "logged")} == {Applies.DRIVEN}
    assert {m.applies for m in applicable("replay", "mine")} == {Applies.DRIVEN, Applies.CLOSED, Applies.PLANNED}


@pytest.mark.parametrize("ticks", [0, 1, 2])
def test_a_drive_of_hardly_any_ticks_has_scores(ticks: int) -> None:
    for value in score_drive(drive_of([0.0] * ticks, clearance_m=np.ones(ticks)), REPLAY, PLANNING).values():
        assert value is None or math.isfinite(value)


def random_drive(seed: int, ticks: int = 60) -> Drive:
    rng = np.random.default_rng(seed)
    some = np.where(rng.random(ticks) < 0.3, NAN, 1.0)
    return drive_of(
        rng.uniform(0, 1, ticks),
        rng.normal(size=ticks),
        clearance_m=rng.uniform(0, 3, ticks) * some,
        reference_m=rng.uniform(0, 1, ticks),
        log_m=rng.uniform(0, 2, ticks) * some,
        steps=steps_of(ticks, conflict=rng.random(ticks) < 0.3, deviation_m=rng.uniform(0, 0.5, ticks)),
    )


@given(st.integers(0, 10_000), st.floats(-10, 10), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.integers(0, 10**15))
def test_where_and_when_it_was_driven_does_not_matter(
    seed: int, angle: float, dx: float, dy: float, later_ns: int
) -> None:
    drive = random_drive(seed)
    before = score_drive(drive, REPLAY, PLANNING)
    after = score_drive(turned(drive, angle, (dx, dy), later_ns), REPLAY, PLANNING)
    for name, value in before.items():
        assert after[name] == (None if value is None else pytest.approx(value, rel=1e-6, abs=1e-8)), name


@given(st.integers(0, 10_000), st.floats(0.1, 10))
def test_lengths_scale_with_the_world(seed: int, factor: float) -> None:
    """A world `factor` times as large, driven as much faster: lengths and speeds scale, times and angles do not."""
    drive = random_drive(seed)
    larger = replace(
        drive,
        pose=drive.pose * [factor, factor, 1],
        inputs=drive.inputs * [factor, 1],
        clearance_m=drive.clearance_m * factor,
        reference_m=drive.reference_m * factor,
        along_m=drive.along_m * factor,
        log_m=drive.log_m * factor,
        reference_length_m=drive.reference_length_m * factor,
        reference_speed_mps=drive.reference_speed_mps * factor,
    )
    lengths = ("near_m", "clearance_m", "divergence_m", "goal_tolerance_m", "freeze_speed_mps")
    scaled = ReplayConfig(**{name: getattr(REPLAY, name) * factor for name in lengths})
    before, after = score_drive(drive, REPLAY, PLANNING), score_drive(larger, scaled, PLANNING)
    powers = {"m": 1, "m/s3": 1, "m2/s2": 2, "s": 0, "rad/s2": 0}
    for m in METRICS:
        if m.applies is Applies.DRIVEN or m.name.startswith("diverged"):
            expected = before[m.name]
            power = powers.get(m.unit, 0)
            assert after[m.name] == (None if expected is None else pytest.approx(expected * factor**power, rel=1e-6))
