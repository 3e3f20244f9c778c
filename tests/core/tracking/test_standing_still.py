"""The test for standing still: its fit, its hysteresis, drift of the viewpoint and of odometry."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.tracking.stillness import CAPACITY, Sightings, common_drift, fit_slopes, still

CONFIG = TrackingConfig()


def sightings_of(paths: np.ndarray, sensor: np.ndarray | None = None, dt: float = 0.1) -> Sightings:
    """Sightings of n paths (n, k, 2), one every dt, the last at time 0, from sensor positions (k, 2)."""
    n, k, _ = paths.shape
    result = Sightings.empty(n)
    places = np.zeros((k, 2)) if sensor is None else sensor
    for i in range(k):
        result.add(np.ones(n, dtype=bool), (i - k + 1) * dt, paths[:, i], places[i])
    return result


def walk(velocity: tuple[float, float], start: tuple[float, float] = (5.0, 0.0), k: int = 16) -> np.ndarray:
    return np.array(start) + np.arange(k)[:, None] * 0.1 * np.array(velocity)


def is_still(path: np.ndarray, radius: float = 0.3, was: bool = False, sensor: np.ndarray | None = None) -> bool:
    result = still(np.array([was]), sightings_of(path[None], sensor), 0.0, np.array([radius]), CONFIG)
    return bool(result[0])


def test_slope_equals_polyfit_with_its_standard_error() -> None:
    rng = np.random.default_rng(0)
    path = walk((0.4, -0.2)) + rng.normal(0, 0.05, (16, 2))
    slope = fit_slopes(sightings_of(path[None]), 0.0, 1.5)
    time = np.arange(-15, 1) * 0.1
    for axis in (0, 1):
        assert slope.velocity_mps[0, axis] == pytest.approx(np.polyfit(time, path[:, axis], 1)[0])
    residual = path - np.stack([np.polyval(np.polyfit(time, path[:, a], 1), time) for a in (0, 1)], axis=1)
    expected = np.sqrt((residual**2).sum() / (2 * 14) / ((time - time.mean()) ** 2).sum())
    assert slope.standard_error_mps[0] == pytest.approx(expected)
    assert slope.span_s[0] == pytest.approx(1.5)


def test_sightings_outlive_the_ring_buffer() -> None:
    slope = fit_slopes(sightings_of(walk((0.5, 0.0), k=3 * CAPACITY)[None]), 0.0, 1.5)
    assert slope.velocity_mps[0] == pytest.approx([0.5, 0.0])
    assert slope.count[0] == 16


def test_what_was_not_seen_does_not_count() -> None:
    record = sightings_of(walk((0.5, 0.0))[None])
    record.add(np.array([False]), 0.1, np.array([[99.0, 99.0]]), np.zeros(2))
    slope = fit_slopes(record, 0.1, 1.5)
    assert slope.count[0] == 15
    assert slope.velocity_mps[0] == pytest.approx([0.5, 0.0])


@pytest.mark.parametrize("speed", [0.0, 0.03])
def test_slow_is_still(speed: float) -> None:
    noise = np.random.default_rng(1).normal(0, 0.02, (16, 2))
    assert is_still(walk((speed, 0.0)) + noise)


@pytest.mark.parametrize("speed", [0.236, 1.3, 10.0])
def test_motion_is_not_still(speed: float) -> None:
    """0.236 m/s is the speed of the paper's equation 11."""
    noise = np.random.default_rng(2).normal(0, 0.01, (16, 2))
    assert not is_still(walk((0.0, speed)) + noise, was=False)
    assert not is_still(walk((0.0, speed)) + noise, was=True)


def test_hysteresis() -> None:
    """Just above what starts a standing track does; just below it a moving one goes on."""
    between = walk((0.0, 0.09))
    assert is_still(between, was=True)
    assert not is_still(between, was=False)


def test_noise_alone_does_not_stop_a_fast_track() -> None:
    """A slope of 1 m/s with a standard error as large is not known to stand still."""
    noise = np.random.default_rng(3).normal(0, 0.6, (16, 2))
    assert not is_still(walk((1.5, 0.0)) + noise, was=False)


@pytest.mark.parametrize(("share", "was"), [(0.5, True), (0.35, False)])
def test_a_visible_side_that_turns_with_the_viewpoint_is_still(share: float, was: bool) -> None:
    """An ego passes a standing disc of 1 m at 4 m, with 5 m/s; the centre of the visible side
    wanders at over 0.3 m/s. A small obstacle that wanders as much moves."""
    sensor = np.column_stack([np.linspace(-3.75, 3.75, 16), np.zeros(16)])
    disc = np.array([0.0, 4.0])
    towards = sensor - disc
    seen = disc + share * towards / np.linalg.norm(towards, axis=1, keepdims=True)
    assert np.linalg.norm(seen[-1] - seen[0]) / 1.5 > 0.3
    assert is_still(seen, radius=1.0, was=was, sensor=sensor)
    assert not is_still(seen, radius=0.1, was=was, sensor=sensor)


def test_what_comes_by_itself_is_not_excused_by_its_coming() -> None:
    """Towards a sensor that stands the line of sight shortens and turns, but by the obstacle's own way."""
    path = walk((-0.25, 0.1), start=(0.9, 0.2))
    assert not is_still(path, radius=0.5, was=True)
    assert is_still(walk((0.0, 0.0), start=(0.9, 0.2)), radius=0.5, was=True)


def test_what_creeps_is_found_out_in_time() -> None:
    """Beside an ego that passes, 0.11 m/s are within what 1.5 s may feign, and beyond what 3 s may."""
    sensor = np.column_stack([np.linspace(-1.5, 0.0, 31), np.zeros(31)])
    creeping = walk((0.11, 0.0), start=(1.0, 1.5), k=31)
    assert is_still(creeping[-16:], radius=0.35, was=True, sensor=sensor[-16:])
    assert not is_still(creeping, radius=0.35, was=True, sensor=sensor)


def test_what_crept_and_stopped_stands() -> None:
    """The long window still holds the way that was gone; nothing goes on."""
    path = np.concatenate([walk((0.25, 0.0), k=15), np.full((16, 2), walk((0.25, 0.0), k=15)[-1])])
    assert is_still(path, was=False)


def test_who_pauses_in_a_step_does_not_stand_yet() -> None:
    """Half a step at 0.3 m/s, half at 0.06: the newer half alone would stand. Without any motion in it, both stand."""
    first = walk((0.3, 0.0), k=15)
    path = np.concatenate([first, walk((0.06, 0.0), start=(first[-1, 0], 0.0))])
    assert is_still(path[-16:], was=False)
    assert not is_still(path, was=False)
    assert is_still(np.concatenate([first, walk((0.0, 0.0), start=(first[-1, 0], 0.0))]), was=False)


def test_drift_that_most_tracks_share_is_the_odometrys() -> None:
    """Twelve poles drift at 0.4 m/s under an ego at 5 m/s, one person walks through them."""
    rng = np.random.default_rng(4)
    poles = [walk((-0.4, 0.0), (x, y)) for x, y in rng.uniform(5, 15, (12, 2))]
    paths = np.stack([*poles, walk((-0.4, 1.2))]) + rng.normal(0, 0.01, (13, 16, 2))
    radius = np.full(13, 0.1)
    ego = np.column_stack([np.linspace(-7.5, 0, 16), np.zeros(16)])
    record = sightings_of(paths, ego)
    assert common_drift(fit_slopes(record, 0.0, 1.5), np.ones(13, bool)) == pytest.approx([-0.4, 0.0], abs=0.02)
    result = still(np.zeros(13, bool), record, 0.0, radius, CONFIG)
    assert result.tolist() == [True] * 12 + [False]
    standing_ego = still(np.zeros(13, bool), sightings_of(paths), 0.0, radius, CONFIG)
    assert not standing_ego.any(), "a crowd seen by a standing robot walks"
