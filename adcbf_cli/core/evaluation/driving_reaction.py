"""How soon a planner answers to a conflict: the paper's Ref-time, made precise.

A conflict is what the records call one: by what is known, keeping to the reference would bring the
vehicle closer to an obstacle than the safety distance within the horizon. Conflicts less than
CALM_S apart are one episode, so the CALM_S before an episode are free of any.

What the vehicle did in those CALM_S is how it drives when it avoids nothing: it may be speeding
up, coming back to the path or cutting a corner. Avoidance has begun at the first tick that departs
from that by more than the tolerance, or whose plan comes from the fallback ladder. Where this is so
at the episode's first tick already, the answer took no time. Nor did it where the departure that
answered the episode before has lasted until then.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.evaluation.driving_evidence import Applies, DriveMetric, Evidence
from adcbf_cli.core.evaluation.driving_planning import fell_back
from adcbf_cli.core.replay.records import Drive, Result
from adcbf_cli.core.types import BoolArray, FloatArray

CALM_S = 1.0
REACTION_M = 0.1
"""Departure of the vehicle, or of its plan, from the reference: sideways, or any way for a plan."""
REACTION_MPS = 0.1
"""Departure in speed."""


@dataclass(frozen=True, slots=True)
class Episode:
    """A conflict from tick `first` to tick `last`, both in it; the calm before starts at `calm`."""

    calm: int
    first: int
    last: int

    @property
    def before(self) -> slice:
        """The calm, with the tick at which it ends."""
        return slice(self.calm, self.first + 1)


def episodes(conflict: BoolArray, elapsed_s: FloatArray) -> list[Episode]:
    """The conflict episodes of (T,) ticks."""
    ticks = np.flatnonzero(conflict)
    if not ticks.size:
        return []
    new = np.append(True, np.diff(elapsed_s[ticks]) >= CALM_S)
    firsts, lasts = ticks[new], ticks[np.append(new[1:], True)]
    calms = np.searchsorted(elapsed_s, elapsed_s[firsts] - CALM_S)
    return [Episode(*map(int, row)) for row in zip(calms, firsts, lasts, strict=True)]


def vehicle_departs(drive: Drive, calm: slice, now: slice) -> BoolArray:
    """(ticks of `now`,) whether the vehicle drives otherwise than it did in the ticks of `calm`."""
    speed, aside_m, reference_mps = drive.inputs[:, 0], drive.reference_m, drive.reference_speed_mps
    slower = speed[now] < min(float(speed[calm].max()), reference_mps) - REACTION_MPS
    faster = speed[now] > max(float(speed[calm].min()), reference_mps) + REACTION_MPS
    return np.asarray(slower | faster | (aside_m[now] > aside_m[calm].min() + REACTION_M))


def plan_departs(drive: Drive, calm: slice, now: slice) -> BoolArray:
    """(ticks of `now`,) whether plans leave the reference more than they did in the ticks of `calm`."""
    if drive.steps is None:
        return np.zeros(now.stop - now.start, dtype=np.bool_)
    away_m = drive.steps.deviation_m
    return np.asarray(away_m[now] > away_m[calm].min() + REACTION_M)


def answers(evidence: Evidence, departs: Callable[[Drive, slice, slice], BoolArray]) -> list[float | None] | None:
    """Seconds from the start of each episode to its answer, None where none came; None as a whole
    where it is not known what was in conflict."""
    drive, elapsed_s = evidence.drive, evidence.elapsed_s
    if drive.steps is None:
        return None
    fallback = fell_back(evidence, drive.steps)
    last = len(elapsed_s) - (drive.result is Result.COLLISION)  # an answer at the collision is none
    found: list[float | None] = []
    newest: Episode | None = None  # of those that were judged by the calm before them
    for episode in episodes(drive.steps.conflict, elapsed_s):
        if newest and departs(drive, newest.before, slice(newest.last, episode.first + 1)).all():
            found.append(0.0)
            continue
        now = slice(episode.first, min(episode.last + 1, last))
        begun = np.flatnonzero(departs(drive, episode.before, now) | fallback[now])
        newest = episode
        found.append(float(elapsed_s[episode.first + begun[0]] - elapsed_s[episode.first]) if begun.size else None)
    return found


def _executed(evidence: Evidence) -> list[float | None] | None:
    return answers(evidence, vehicle_departs)


def _mean_answer(answered: list[float | None] | None) -> float | None:
    times = [time for time in answered or () if time is not None]
    return sum(times) / len(times) if times else None


def ref_time_s(evidence: Evidence) -> float | None:
    return _mean_answer(_executed(evidence))


def plan_ref_time_s(evidence: Evidence) -> float | None:
    return _mean_answer(answers(evidence, plan_departs))


def conflicts(evidence: Evidence) -> float | None:
    answered = _executed(evidence)
    return None if answered is None else float(len(answered))


def conflicts_unanswered(evidence: Evidence) -> float | None:
    answered = _executed(evidence)
    return None if answered is None else float(sum(time is None for time in answered))


REACTION: tuple[DriveMetric, ...] = (
    DriveMetric(
        "ref_time_s",
        "s",
        "lower",
        Applies.CLOSED,
        "conflict episodes that are answered",
        "Ref-time: mean time from an episode's first tick to the first at which the vehicle is 0.1 m farther from "
        "the reference path, or 0.1 m/s slower or faster, than it was in the 1 s before the episode, or the planner "
        "falls back",
        ref_time_s,
    ),
    DriveMetric(
        "plan_ref_time_s",
        "s",
        "lower",
        Applies.PLANNED,
        "conflict episodes that are answered",
        "mean time from an episode's first tick to the first whose plan deviates from the reference by 0.1 m more "
        "than the plans of the 1 s before the episode, or is a fallback",
        plan_ref_time_s,
    ),
    DriveMetric(
        "conflicts",
        "1",
        "neither",
        Applies.CLOSED,
        "drive",
        "number of conflict episodes: by what was known, keeping to the reference would have come closer to an "
        "obstacle than planning.safety_distance_m within the horizon; conflicts less than 1 s apart are one",
        conflicts,
    ),
    DriveMetric(
        "conflicts_unanswered",
        "1",
        "lower",
        Applies.CLOSED,
        "drive",
        "number of those that went by, or ended in a collision, without avoidance having begun",
        conflicts_unanswered,
    ),
)
