"""Which tracks stand still: a test on where their clusters were seen lately.

A straight line is fitted to the measured centres of the last seconds. An obstacle moves where the
line's slope exceeds what three things may feign together: the least speed that counts as motion,
the slope's own standard error (from the fit's residuals, so that no sensor model is trusted), and
the drift of a seen surface's centre under a turning viewpoint. The last is the trap of a moving
ego: when the line of sight to an obstacle turns by an angle, the visible side turns with it, and
its centre may wander by a share of the obstacle's radius times that angle.

What creeps can hide behind these for as long as the time looked at is short. So twice that time is
looked at too: what went steadily farther than the least distance of the shorter one, error and drift
allowed for, moves. And who walks slowly pauses at each step: what moved over twice the time, and
still does a little, does not stand yet.

Odometry drifts too, and everything that stands still then moves alike. What most tracks do together
is taken out first, where the ego moves and it is small beside the ego's own speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.frames import wrap_angle
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

CAPACITY = 64
"""Sightings kept a track. A faster sensor than this over the window looks at a shorter past."""
MIN_SIGHTINGS = 5
STANDARD_ERRORS = 3.0
STAY_MOVING_FRACTION = 0.7
"""Hysteresis: a moving track stands still only well below the speed that sets it in motion."""
SLOWEST_CLEAR_MOTION = 3.0
"""A speed this many times the static one is motion for a track not yet called static, however noisy."""
RECENT_SHARE = 0.35
"""The newest share of the window, looked at alone: an obstacle that starts is noticed sooner there."""
RECENT_MIN_SPEED_FACTOR = 3.0
LONG_FACTOR = 2.0
"""Times the window: looked at for what creeps."""
WANDER_SHARE = 0.5
"""Of radius times turn: how far a seen side's centre wanders. That of a disc's near half, as it is, by 2 / pi; what is
left of it once sizes were learnt, by less than half of this for 99 % of what stands near a driving ego (simulated)."""
STEADY_SHARE = 0.5
"""What creeps goes on in the window with at least this share of its velocity over the long one, or it has stopped."""
PAUSING_SHARE = 0.3
"""Who pauses in a step goes on with at least this share of it: what stops goes on with less, a second later."""
SHORTEST_SHARE = 1 / 3
"""Of the window, that sightings must span before a track can be said to stand still."""
MIN_TRACKS_FOR_DRIFT = 8
MAX_DRIFT_SHARE = 0.15
"""Odometry wrong by more than this share of the ego's speed is not put right here."""


@dataclass(slots=True)
class Sightings:
    """Ring buffers of the last measured centres of n tracks, world xy, newest written at `cursor`.

    time_s: (n, CAPACITY), NaN where empty; position_m, sensor_m: (n, CAPACITY, 2).
    """

    time_s: FloatArray
    position_m: FloatArray
    sensor_m: FloatArray
    cursor: int = 0

    @classmethod
    def empty(cls, n: int) -> Sightings:
        return cls(np.full((n, CAPACITY), np.nan), np.zeros((n, CAPACITY, 2)), np.zeros((n, CAPACITY, 2)))

    def add(self, rows: BoolArray, time_s: float, position_m: FloatArray, sensor_m: FloatArray) -> None:
        """One more frame: rows (n,) were seen at position_m (n, 2) from sensor_m (2,)."""
        self.cursor = (self.cursor + 1) % CAPACITY
        self.time_s[:, self.cursor] = np.where(rows, time_s, np.nan)
        self.position_m[:, self.cursor] = np.where(rows[:, None], position_m, 0.0)
        self.sensor_m[:, self.cursor] = sensor_m

    def shift(self, rows: IntArray, by_m: FloatArray) -> None:
        """Moves all that was seen of tracks `rows` (k,) by (k, 2): their centre is now known better."""
        self.position_m[rows] += by_m[:, None, :]

    def select(self, rows: BoolArray) -> Sightings:
        return Sightings(self.time_s[rows], self.position_m[rows], self.sensor_m[rows], self.cursor)

    def put(self, rows: IntArray, new: Sightings) -> None:
        """Tracks `rows` (k,) have been seen as the k new ones, so far never."""
        self.time_s[rows], self.position_m[rows], self.sensor_m[rows] = new.time_s, new.position_m, new.sensor_m

    def grow(self, n: int) -> Sightings:
        """The same with n more tracks that were never seen."""
        new = Sightings.empty(n)
        return Sightings(
            np.concatenate([self.time_s, new.time_s]),
            np.concatenate([self.position_m, new.position_m]),
            np.concatenate([self.sensor_m, new.sensor_m]),
            self.cursor,
        )


@dataclass(frozen=True, slots=True)
class Slope:
    """Straight-line fits of n tracks: velocity (n, 2) and the standard error of each component
    (m/s), the time that the sightings span (s), their number, the viewpoint's turn (rad) between
    first and last, and the sensor's own velocity (n, 2) over the same time."""

    velocity_mps: FloatArray
    standard_error_mps: FloatArray
    span_s: FloatArray
    count: FloatArray
    turn_rad: FloatArray
    sensor_velocity_mps: FloatArray


def fit_slopes(sightings: Sightings, now_s: float, window_s: float) -> Slope:
    """Least-squares lines through each track's sightings within `window_s` before `now_s`."""
    return _fit(sightings, now_s, np.array([window_s]))[0]


def _fit(sightings: Sightings, now_s: float, windows_s: FloatArray) -> list[Slope]:
    """`fit_slopes` for each of w windows; all together, since few tracks cost calls rather than numbers."""
    age = now_s - sightings.time_s
    used = age <= windows_s[:, None, None] * (1 + 1e-9)
    weight = used.astype(np.float64)
    count = weight.sum(axis=-1)
    safe_count = np.maximum(count, 1.0)
    time = np.where(used, -age, 0.0)
    time = np.where(used, time - (time.sum(axis=-1) / safe_count)[..., None], 0.0)
    mean = (weight[..., None] * sightings.position_m).sum(axis=-2) / safe_count[..., None]
    centred = weight[..., None] * (sightings.position_m - mean[..., None, :])
    moment = np.maximum((time**2).sum(axis=-1), 1e-12)
    velocity = (time[..., None] * centred).sum(axis=-2) / moment[..., None]
    residual = centred - time[..., None] * velocity[..., None, :]
    variance = (residual**2).sum(axis=(-2, -1)) / np.maximum(2 * (count - 2), 1.0)
    first = np.where(used, age, -np.inf).argmax(axis=-1)
    last = np.where(used, age, np.inf).argmin(axis=-1)
    rows = np.arange(len(age))
    ends = np.take_along_axis(time, np.stack([first, last], axis=-1), axis=-1)
    span = np.where(count > 0, ends[..., 1] - ends[..., 0], 0.0)
    carried = sightings.sensor_m[rows, last] - sightings.sensor_m[rows, first]
    error = np.sqrt(variance / moment)
    turn = _viewpoint_turn(sightings, rows, first, last)
    sensor_velocity = carried / np.maximum(span, 1e-9)[..., None]
    return [Slope(*each) for each in zip(velocity, error, span, count, turn, sensor_velocity, strict=True)]


def still(
    was_still: BoolArray, sightings: Sightings, now_s: float, radius_m: FloatArray, config: TrackingConfig
) -> BoolArray:
    """(n,) which tracks stand still now, given which did a frame ago."""
    windows_s = np.array([1.0, RECENT_SHARE, LONG_FACTOR]) * config.static_window_s
    whole, recent, long = _fit(sightings, now_s, windows_s)
    least, size_m = config.static_speed_mps, WANDER_SHARE * radius_m
    known, drift = _known(whole, config)
    starts = _starts(whole, recent, drift, size_m, least) | _creeps(whole, long, drift, size_m, config)
    speed = np.linalg.norm(whole.velocity_mps - drift, axis=1)
    slow = speed <= SLOWEST_CLEAR_MOTION * least + _viewpoint_drift(whole, size_m)
    settled = speed < STAY_MOVING_FRACTION * _feigned_speed(whole, size_m, least)
    settled &= ~_pauses(whole, long, drift, size_m, config)
    result: BoolArray = np.where(was_still, ~starts, known & slow & settled & ~starts)
    return result


def known_to_move(sightings: Sightings, now_s: float, radius_m: FloatArray, config: TrackingConfig) -> BoolArray:
    """(n,) which tracks move beyond doubt: more than they would feign if their centre wandered by the whole radius."""
    whole, recent = _fit(sightings, now_s, np.array([1.0, RECENT_SHARE]) * config.static_window_s)
    return _starts(whole, recent, _known(whole, config)[1], radius_m, config.static_speed_mps)


def _known(whole: Slope, config: TrackingConfig) -> tuple[BoolArray, FloatArray]:
    """(n,) which tracks were seen long enough to say that they stand, and the drift (2,) that these share."""
    known = (whole.count >= MIN_SIGHTINGS) & (whole.span_s >= SHORTEST_SHARE * config.static_window_s)
    return known, common_drift(whole, known)


def _starts(whole: Slope, recent: Slope, drift: FloatArray, size_m: FloatArray, least_speed_mps: float) -> BoolArray:
    """(n,) which tracks were too fast to stand, over the window or, by far, over its newest part."""
    newest = _exceeds(recent, drift, size_m, RECENT_MIN_SPEED_FACTOR * least_speed_mps)
    return _exceeds(whole, drift, size_m, least_speed_mps) | newest


def _exceeds(slope: Slope, drift: FloatArray, size_m: FloatArray, least_speed_mps: float) -> BoolArray:
    """(n,) which tracks were faster than standing obstacles may seem, whose centres wander by size_m (n,) a radian."""
    speed = np.linalg.norm(slope.velocity_mps - drift, axis=1)
    feigned = _feigned_speed(slope, size_m, least_speed_mps)
    return np.asarray((slope.count >= MIN_SIGHTINGS) & (speed > feigned))


def _creeps(whole: Slope, long: Slope, drift: FloatArray, size_m: FloatArray, config: TrackingConfig) -> BoolArray:
    """(n,) which tracks went on steadily over the long window, and still do over the whole short one."""
    steady = _goes_on(whole, long, drift, STEADY_SHARE, config)
    return np.asarray(steady & _exceeds(long, drift, size_m, config.static_speed_mps / LONG_FACTOR))


def _pauses(whole: Slope, long: Slope, drift: FloatArray, size_m: FloatArray, config: TrackingConfig) -> BoolArray:
    """(n,) which tracks moved over the long window, and have slowed down over the short one but not stopped."""
    slowed = _goes_on(whole, long, drift, PAUSING_SHARE, config)
    return np.asarray(slowed & _exceeds(long, drift, size_m, config.static_speed_mps))


def _goes_on(whole: Slope, long: Slope, drift: FloatArray, share: float, config: TrackingConfig) -> BoolArray:
    """(n,) which tracks were seen over the long window, and have kept at least this share of their velocity over it."""
    velocity, lasting = whole.velocity_mps - drift, long.velocity_mps - drift
    kept = (velocity * lasting).sum(axis=1) >= share * (lasting**2).sum(axis=1)
    return np.asarray(kept & (long.span_s > config.static_window_s))


def common_drift(slope: Slope, known: BoolArray) -> FloatArray:
    """The velocity (2,) that most tracks share because the ego's odometry is wrong; zero where few
    tracks are known or where it is too large to be that."""
    if np.count_nonzero(known) < MIN_TRACKS_FOR_DRIFT:
        return np.zeros(2)
    drift: FloatArray = np.median(slope.velocity_mps[known], axis=0)
    ego: FloatArray = np.median(slope.sensor_velocity_mps[known], axis=0)
    plausible = np.linalg.norm(drift) <= MAX_DRIFT_SHARE * np.linalg.norm(ego)
    return drift if plausible else np.zeros(2)


def _viewpoint_drift(slope: Slope, size_m: FloatArray) -> FloatArray:
    drift: FloatArray = size_m * slope.turn_rad / np.maximum(slope.span_s, 1e-9)
    return drift


def _feigned_speed(slope: Slope, size_m: FloatArray, least_speed_mps: float) -> FloatArray:
    """The speed that a standing obstacle may show, at most."""
    return least_speed_mps + STANDARD_ERRORS * slope.standard_error_mps + _viewpoint_drift(slope, size_m)


def _viewpoint_turn(sightings: Sightings, rows: IntArray, first: IntArray, last: IntArray) -> FloatArray:
    """How far the line of sight turned, plus the relative change of range, between two sightings; no more than the
    sensor's own way at that distance makes of both. What comes by itself is not excused by its coming."""
    position, sensor = sightings.position_m, sightings.sensor_m
    start, end = position[rows, first] - sensor[rows, first], position[rows, last] - sensor[rows, last]
    bearing = np.arctan2(end[..., 1], end[..., 0]) - np.arctan2(start[..., 1], start[..., 0])
    near = np.maximum(np.hypot(start[..., 0], start[..., 1]), 0.1)
    far = np.maximum(np.hypot(end[..., 0], end[..., 1]), 0.1)
    seen = np.abs(wrap_angle(bearing)) + np.abs(np.log(far / near))
    way = sensor[rows, last] - sensor[rows, first]
    own = np.sqrt(2.0) * np.hypot(way[..., 0], way[..., 1]) / np.minimum(near, far)
    turn: FloatArray = np.minimum(np.minimum(seen, own), 2.0)
    return turn
