"""Batched tracking and prediction against one filterpy filter a track, in the same process.

    python benchmarks/tracking.py [--json] [--repeats 15]

Four things are timed, for 1, 20 and 100 tracks: one unscented update with its prediction to the next
scan; the horizon of 30 steps with covariance, as `adcbf predict` makes it; the whole stage of `adcbf
predict`, which is that horizon, sigma radii, and conformal radii from the past, against the bare loop for
the horizon; and the same horizon by one unscented transform a step (what the coordinated turn needs). The
plain side is filterpy's
UnscentedKalmanFilter in a Python loop. Figures are medians; both sides must agree first.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Callable
from time import perf_counter

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

from adcbf_cli.core.config import PredictionConfig, TrackingConfig
from adcbf_cli.core.frames import wrap_angle
from adcbf_cli.core.prediction.predictor import Predictor
from adcbf_cli.core.prediction.propagation import Propagator
from adcbf_cli.core.tracking.filters import BatchFilter
from adcbf_cli.core.types import FloatArray, Notes, Tracks, TrackStatus

STEPS, STEP_S = 30, 0.1
TRACK_COUNTS = (1, 20, 100)
SETTLED_FRAMES = 60
"""From then on every frame meets predictions of the whole horizon."""


def scene(n: int, dimension: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """States (n, d) around the sensor, covariances, and one measurement each (range, azimuth, elevation)."""
    rng = np.random.default_rng(0)
    azimuth, distance = rng.uniform(-np.pi, np.pi, n), rng.uniform(3, 20, n)
    states = np.zeros((n, dimension))
    states[:, 0], states[:, 1] = distance * np.cos(azimuth), distance * np.sin(azimuth)
    states[:, 3:5] = rng.normal(0, 1, (n, 2))
    covariances = np.tile(0.02 * np.eye(dimension), (n, 1, 1))
    measured = np.column_stack([distance, azimuth, np.zeros(n)]) + rng.normal(0, 0.005, (n, 3))
    return states, covariances, measured


def observe(x: FloatArray) -> FloatArray:
    flat = np.hypot(x[0], x[1])
    return np.array([np.hypot(flat, x[2]), np.arctan2(x[1], x[0]), np.arctan2(x[2], flat)])


def difference(a: FloatArray, b: FloatArray) -> FloatArray:
    result = a - b
    result[1] = wrap_angle(result[1])
    return result


def wrapped_mean(sigmas: FloatArray, weights: FloatArray) -> FloatArray:
    mean = weights @ sigmas
    mean[1] = sigmas[0, 1] + weights @ wrap_angle(sigmas[:, 1] - sigmas[0, 1])
    return mean


def plain_filters(
    config: TrackingConfig, states: FloatArray, covariances: FloatArray, noise: FloatArray
) -> list[UnscentedKalmanFilter]:
    kalman = BatchFilter(config, False, Notes())
    d = kalman.motion.dimension
    transition = kalman.motion.jacobian(states[:1], STEP_S)

    def move(x: FloatArray, dt: float) -> FloatArray:
        return transition @ x if kalman.motion.linear else kalman.motion.propagate(x[None], dt)[0]

    filters = []
    for state, covariance in zip(states, covariances, strict=True):
        points = MerweScaledSigmaPoints(d, config.ukf_alpha, config.ukf_beta, config.ukf_kappa)
        ukf = UnscentedKalmanFilter(d, 3, STEP_S, observe, move, points, z_mean_fn=wrapped_mean, residual_z=difference)
        ukf.x, ukf.P = state.copy(), covariance.copy()
        ukf.Q, ukf.R = kalman.motion.process_noise(STEP_S), noise
        filters.append(ukf)
    return filters


def median_ms(work: Callable[[], object], repeats: int) -> float:
    work()
    spent = []
    for _ in range(repeats):
        start = perf_counter()
        work()
        spent.append(perf_counter() - start)
    return 1e3 * float(np.median(spent))


def update_case(n: int, repeats: int) -> tuple[float, float]:
    """(batched, plain) ms for one prediction to the next scan and one update of n tracks."""
    config = TrackingConfig(cruise_ratio=1.0)
    states, covariances, measured = scene(n, 6)
    noise = np.diag([0.05, 0.01, 0.02]) ** 2
    kalman = BatchFilter(config, False, Notes())

    def batched() -> FloatArray:
        x, p = kalman.predict(states, covariances, STEP_S, kalman.motion.process_noise(STEP_S))
        expected = kalman.expect(x, p, np.eye(4))
        return kalman.update(x, p, expected, measured, np.tile(noise, (n, 1, 1))).state

    filters = plain_filters(config, states, covariances, noise)

    def plain() -> FloatArray:
        for ukf, state, covariance, z in zip(filters, states, covariances, measured, strict=True):
            ukf.x, ukf.P = state.copy(), covariance.copy()
            ukf.predict()
            ukf.update(z)
        return np.stack([ukf.x for ukf in filters])

    require_agreement(batched(), plain())
    return median_ms(batched, 3 * repeats), median_ms(plain, repeats)


def horizon_case(n: int, model: str, repeats: int) -> tuple[float, float]:
    """(batched, plain) ms for 30 predicted steps with covariance of n tracks."""
    config = TrackingConfig(model=model, cruise_ratio=1.0)
    propagator = Propagator(config, STEPS, STEP_S, Notes())
    states, covariances, _ = scene(n, 7 if model == "ct" else 6)
    filters = plain_filters(config, states, covariances, np.eye(3))

    def batched() -> FloatArray:
        return propagator(states, covariances, None).position_m

    def plain() -> FloatArray:
        result = np.zeros((n, STEPS, 3))
        for i, ukf in enumerate(filters):
            ukf.x, ukf.P = states[i].copy(), covariances[i].copy()
            for k in range(STEPS):
                ukf.predict()
                result[i, k] = ukf.x[:3]
        return result

    require_agreement(batched(), plain())
    return median_ms(batched, 3 * repeats), median_ms(plain, max(repeats // 3, 3))


def moving_tracks(n: int, frame: int) -> Tracks:
    """A frame of n tracks, every fourth of which stands, seen again and again with other velocities."""
    rng = np.random.default_rng(frame)
    states, covariances, _ = scene(n, 6)
    states[:, 3:5] += rng.normal(0, 0.2, (n, 2))
    ones = np.ones(n)
    return Tracks(
        frame_index=frame,
        stamp_ns=round(frame * STEP_S * 1e9),
        world_from_sensor=np.eye(4),
        model="cv",
        track_id=np.arange(n),
        status=np.full(n, TrackStatus.CONFIRMED),
        state=states,
        covariance=covariances,
        radius_m=0.3 * ones,
        height_m=ones,
        is_static=np.arange(n) % 4 == 3,
        cluster_id=np.arange(n),
        age_s=ones,
        hits=np.full(n, 9),
        misses=np.zeros(n, dtype=np.int64),
        nis=ones,
        manoeuvre=0.5 * ones,
    )


def stage_case(n: int, repeats: int) -> tuple[float, float]:
    """(batched, plain) ms a frame for the stage with its calibration, and for the bare horizon in a loop."""
    config = TrackingConfig(cruise_ratio=1.0)
    predictor = Predictor(PredictionConfig(steps=STEPS, step_s=STEP_S), config, Notes())
    spent = []
    for frame in range(SETTLED_FRAMES + 3 * repeats):
        tracks = moving_tracks(n, frame)
        start = perf_counter()
        predictor(tracks)
        spent.append(perf_counter() - start)
    _, plain_ms = horizon_case(n, "cv", repeats)
    return 1e3 * float(np.median(spent[SETTLED_FRAMES:])), plain_ms


def require_agreement(batched: FloatArray, plain: FloatArray) -> None:
    worst = float(np.abs(batched - plain).max())
    if worst > 1e-5:
        sys.exit(f"benchmarks/tracking.py: the two sides differ by {worst:.1e} m; timing them would mean nothing")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.add_argument("--repeats", type=int, default=15)
    arguments = parser.parse_args()
    rows = []
    for n in TRACK_COUNTS:
        cases = {
            "update": update_case(n, arguments.repeats),
            "horizon_cv": horizon_case(n, "cv", arguments.repeats),
            "stage": stage_case(n, arguments.repeats),
            "horizon_ct": horizon_case(n, "ct", arguments.repeats),
        }
        for name, (batched, plain) in cases.items():
            rows.append(
                {"case": name, "tracks": n, "batched_ms": batched, "filterpy_ms": plain, "ratio": plain / batched}
            )
    if arguments.json:
        print(json.dumps({"benchmark": "tracking", "python": platform.python_version(), "rows": rows}, indent=2))
        return
    print(f"{'case':12}{'tracks':>8}{'batched ms':>12}{'filterpy ms':>13}{'ratio':>8}")
    for row in rows:
        print(
            f"{row['case']:12}{row['tracks']:>8}{row['batched_ms']:>12.3f}{row['filterpy_ms']:>13.2f}{row['ratio']:>8.1f}"
        )


if __name__ == "__main__":
    main()
