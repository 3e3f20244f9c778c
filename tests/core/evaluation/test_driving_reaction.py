"""How soon a planner answers to conflicts, tick by tick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adcbf_cli.core.config import PlanningConfig, ReplayConfig
from adcbf_cli.core.evaluation.driving import score_drive
from adcbf_cli.core.evaluation.driving_reaction import Episode, episodes
from adcbf_cli.core.replay.records import Drive, Result
from tests.core.evaluation.driving_scenes import drive_of, steps_of

TICKS = 100


def between(first: int, last: int) -> np.ndarray:
    """True from tick `first` to tick `last`, both in it."""
    ticks = np.arange(TICKS)
    return (ticks >= first) & (ticks <= last)


def conflicting(conflict: np.ndarray, **columns: object) -> Drive:
    """A drive at the reference's 1.0 m/s on the reference, ten ticks a second."""
    steps = {k: columns.pop(k) for k in ("outcome", "deviation_m") if k in columns}
    speed = columns.pop("speed", np.ones(TICKS))
    return drive_of(speed, steps=steps_of(TICKS, conflict=conflict, **steps), **columns)


def scores(drive: Drive) -> tuple[float | None, float | None, float | None, float | None]:
    """ref_time_s, plan_ref_time_s, conflicts, conflicts_unanswered"""
    found = score_drive(drive, ReplayConfig(), PlanningConfig())
    return found["ref_time_s"], found["plan_ref_time_s"], found["conflicts"], found["conflicts_unanswered"]


def test_episodes() -> None:
    elapsed_s = 0.1 * np.arange(TICKS)
    conflict = between(20, 30) | between(35, 36) | between(60, 60) | between(99, 99)
    assert episodes(conflict, elapsed_s) == [Episode(10, 20, 36), Episode(50, 60, 60), Episode(89, 99, 99)]
    assert episodes(between(3, 4), elapsed_s) == [Episode(0, 3, 4)], "calm begins with the drive"
    assert episodes(between(99, 0), elapsed_s) == []


def test_slowing_down_answers() -> None:
    speed = np.where(between(44, 99), 0.85, 1.0)
    speed[43] = 0.95  # within the tolerance
    assert scores(conflicting(between(40, 70), speed=speed)) == (pytest.approx(0.4), None, 1, 0)


def test_speeding_up_beyond_the_reference_answers() -> None:
    ramp = np.where(between(0, 42), 0.7, np.where(between(43, 49), 1.0, 1.2))
    assert scores(conflicting(between(40, 70), speed=ramp))[0] == pytest.approx(1.0), "not when it reaches 1.0 m/s"


def test_coming_down_to_the_reference_speed_is_no_answer() -> None:
    speed = np.where(between(0, 42), 1.3, 1.0)
    assert scores(conflicting(between(40, 70), speed=speed)) == (None, None, 1, 1)


def test_a_tick_without_a_plan_is_no_answer() -> None:
    outcomes = ("solved",) * (TICKS - 1) + ("",)
    assert scores(conflicting(between(90, 99), outcome=outcomes)) == (None, None, 1, 1)


def test_turning_aside_answers() -> None:
    aside = np.where(between(46, 99), 0.15, 0.04)
    assert scores(conflicting(between(40, 70), reference_m=aside))[0] == pytest.approx(0.6)


@pytest.mark.parametrize("outcome", ["relaxed", "braked", "stopped"])
def test_falling_back_answers(outcome: str) -> None:
    outcomes = tuple(outcome if tick >= 42 else "solved" for tick in range(TICKS))
    assert scores(conflicting(between(40, 70), outcome=outcomes)) == (pytest.approx(0.2), pytest.approx(0.2), 1, 0)


def test_a_plan_answers_before_the_vehicle_does() -> None:
    deviation = np.where(between(41, 99), 0.3, 0.02)
    aside = np.where(between(45, 99), 0.2, 0.0)
    drive = conflicting(between(40, 70), deviation_m=deviation, reference_m=aside)
    assert scores(drive) == (pytest.approx(0.5), pytest.approx(0.1), 1, 0)


def test_starting_up_and_coming_back_to_the_path_is_no_avoidance() -> None:
    """From standstill and 0.6 m beside the path, deviating less and less: the conflict at tick 5 is
    answered at tick 15 only."""
    tick = np.arange(TICKS)
    speed = np.minimum(1.0, 0.1 * tick)
    aside = np.where(tick < 15, 0.6 * 0.9**tick, 0.9)
    drive = conflicting(between(5, 40), speed=speed, reference_m=aside, deviation_m=aside)
    assert scores(drive) == (pytest.approx(1.0), pytest.approx(1.0), 1, 0)


def test_avoidance_that_began_before_the_conflict_took_no_time() -> None:
    speed = np.where(between(35, 99), 0.7, 1.0)
    assert scores(conflicting(between(40, 70), speed=speed)) == (0.0, None, 1, 0)


def test_the_mean_is_over_answered_episodes_and_the_others_are_counted() -> None:
    conflict = between(10, 20) | between(40, 50) | between(70, 80)
    aside = np.where(between(12, 25) | between(74, 90), 0.5, 0.0)
    assert scores(conflicting(conflict, reference_m=aside)) == (pytest.approx(0.3), None, 3, 1)


def test_avoidance_that_lasts_from_the_episode_before_took_no_time() -> None:
    """0.5 m aside from tick 12 until 60, and back by then: the third episode finds that it is over."""
    conflict = between(10, 20) | between(40, 50) | between(75, 80)
    aside = np.where(between(12, 60), 0.5, 0.0)
    drive = conflicting(conflict, reference_m=aside, deviation_m=aside)
    assert scores(drive) == (pytest.approx((0.2 + 0.0) / 2), pytest.approx((0.2 + 0.0) / 2), 3, 1)
    interrupted = np.where(between(25, 25), 0.0, aside)
    assert scores(conflicting(conflict, reference_m=interrupted))[3] == 2, "back on the path for a moment"


def test_an_unanswered_collision() -> None:
    drive = conflicting(between(40, 99), result=Result.COLLISION)
    assert scores(drive) == (None, None, 1, 1)


def test_what_happens_at_the_collision_itself_comes_too_late() -> None:
    outcomes = ("solved",) * (TICKS - 1) + ("relaxed",)
    late = np.where(between(99, 99), 0.5, 0.0)
    columns = {"outcome": outcomes, "reference_m": late, "deviation_m": late, "result": Result.COLLISION}
    assert scores(conflicting(between(40, 99), **columns)) == (None, None, 1, 1)
    assert scores(conflicting(between(99, 99), **columns)) == (None, None, 1, 1)
    assert scores(conflicting(between(40, 99), **columns | {"result": Result.TIMEOUT}))[3] == 0


def test_without_conflicts_there_is_no_time_and_without_steps_no_count() -> None:
    quiet = conflicting(between(99, 0))
    assert scores(quiet) == (None, None, 0, 0)
    assert scores(replace(quiet, steps=None, stages=None, result=None)) == (None, None, None, None)
