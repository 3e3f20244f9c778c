"""A second of a scene that is known exactly, through every stage, and one plan: does this installation compute?

A post walks past on flat ground, seen by 16 rings from a sensor that stands still. The rays are worked out here, so
that nothing but the stages themselves is needed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.perception.pipeline import Perception
from adcbf_cli.core.planning.planner import Outcome, Plan, Situation
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.prediction.predictor import Predictor
from adcbf_cli.core.replay.knowledge import Knowledge
from adcbf_cli.core.tracking.tracker import Tracker
from adcbf_cli.core.types import FloatArray, Frame, Notes, Predictions
from adcbf_cli.core.vehicles.vehicle import Vehicle

SCANS, PERIOD_NS = 15, 100_000_000
SENSOR_HEIGHT_M = 0.6
SPEED_MPS = 0.75
POST_RADIUS_M, POST_TOP_M = 0.25, 1.2
START_M, VELOCITY_MPS = np.array([2.2, -3.7]), np.array([0.0, 0.9])
"""Of the post: it crosses the vehicle's way just when the vehicle, driving on, would be there."""

NEAR_M, NEAR_MPS = 0.1, 0.3
"""What the tracker may be off at the end of so short a scene, several times what it is."""


PROGRESS_M = 1.0
"""How far the plan gets at least: farther than braking takes, less than any way past the post."""


@dataclass(frozen=True, slots=True)
class SelfTest:
    """What came out: errors of the post's track in position (m) and velocity (m/s), the plan's smallest distance (m)
    between vehicle and post, and what is wrong, in words; empty where nothing is. remarks: the planner's warnings."""

    position_error_m: float
    velocity_error_mps: float
    clearance_m: float
    problems: tuple[str, ...]
    remarks: tuple[str, ...] = ()


def predict_scene(config: Config) -> Predictions:
    """The last scan's predictions, after all have been clustered and tracked. Deterministic, as all of this is."""
    notes = Notes()
    perceive, track = Perception(config.perception, notes), Tracker(config.tracking, notes)
    predict = Predictor(config.prediction, config.tracking, notes)
    for index in range(SCANS):
        predictions = predict(track(perceive(_scan(index))))
    return predictions


def run_self_test(predictions: Predictions, config: Config, planner: str = "ad-cbf-mpc") -> SelfTest:
    """Holds the predictions of `predict_scene` against the truth, and plans past the post once with `planner`."""
    if len(predictions) != 1:
        return SelfTest(np.nan, np.nan, np.nan, (f"{len(predictions)} tracks of one post",))
    now_s = (SCANS - 1) * PERIOD_NS / 1e9
    step_s = np.arange(1, config.prediction.steps + 1) * config.prediction.step_s
    off_m = predictions.position_m[0, 0, :2] - (START_M + VELOCITY_MPS * (now_s + step_s[0]))
    off_mps = predictions.velocity_mps[0, 0] - VELOCITY_MPS
    notes = Notes()
    plan = plan_scene(predictions, config, planner, notes)
    post_m = START_M + VELOCITY_MPS * (now_s + config.planning.step_s * np.arange(len(plan.poses)))[:, None]
    gap_m = np.hypot(*(plan.poses[:, :2] - post_m).T) - POST_RADIUS_M - config.vehicle.body_radius_m
    found = float(np.hypot(*off_m)), float(np.hypot(*off_mps)), float(gap_m.min())
    return SelfTest(*found, _problems(*found, plan), tuple(notes.warnings))


def _problems(position_error_m: float, velocity_error_mps: float, clearance_m: float, plan: Plan) -> tuple[str, ...]:
    wrong = (
        (not position_error_m <= NEAR_M, f"the post's track is {position_error_m:.2f} m off"),
        (not velocity_error_mps <= NEAR_MPS, f"the post's track is {velocity_error_mps:.2f} m/s off"),
        (not np.isfinite(plan.inputs).all(), "the plan's inputs are not numbers"),
        (plan.outcome is not Outcome.SOLVED, f"the plan is not solved, but {plan.outcome}"),
        (not plan.poses[-1, 0] >= PROGRESS_M, f"the plan gets only {plan.poses[-1, 0]:.2f} m ahead"),
        (not clearance_m > 0, f"the plan comes {-clearance_m:.2f} m into the post"),
    )
    return tuple(text for is_wrong, text in wrong if is_wrong)


def plan_scene(predictions: Predictions, config: Config, planner: str, notes: Notes) -> Plan:
    """From the sensor's place, at the path's speed, along a path across the post's way. notes: the planner's."""
    knowledge = Knowledge(Notes())
    knowledge.update(predictions)
    planning, here = config.planning, np.zeros(3)
    seen = knowledge.obstacles(
        predictions.stamp_ns, here[:2], 10.0, planning.steps, planning.step_s, planning.uncertainty
    )
    path = ReferencePath(np.array([[0.0, 0.0], [6.0, 0.0]]), SPEED_MPS)
    situation = Situation(predictions.stamp_ns, here, np.array([SPEED_MPS, 0.0]), path, seen)
    return make_planner(planner, Vehicle.from_config(config.vehicle), planning, notes).plan(situation)


def _scan(index: int) -> Frame:
    """16 rings of half a degree, without noise: the ground and the post, whichever a ray meets first."""
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, 0.5)), np.radians(np.linspace(-25, 5, 16)))
    rays = np.column_stack(
        [np.cos(elevation.ravel()) * f(azimuth.ravel()) for f in (np.cos, np.sin)] + [np.sin(elevation.ravel())]
    )
    post_m = START_M + VELOCITY_MPS * (index * PERIOD_NS / 1e9)
    distance = np.minimum(_to_ground(rays), _to_post(rays, post_m))
    hit = distance < 30.0
    return Frame(
        index=index,
        stamp_ns=index * PERIOD_NS,
        points_m=rays[hit] * distance[hit, None],
        world_from_sensor=np.eye(4),
        planar=False,
        pose_known=True,
    )


def _to_ground(rays: FloatArray) -> FloatArray:
    """(n,) distances along rays (n, 3) from the sensor; infinite where they never meet."""
    fall = -rays[:, 2]
    return np.where(fall > 1e-9, SENSOR_HEIGHT_M / np.where(fall > 1e-9, fall, 1.0), np.inf)


def _to_post(rays: FloatArray, centre_m: FloatArray) -> FloatArray:
    a = rays[:, 0] ** 2 + rays[:, 1] ** 2
    b = rays[:, :2] @ centre_m
    root = b**2 - a * (centre_m @ centre_m - POST_RADIUS_M**2)
    distance = (b - np.sqrt(np.maximum(root, 0.0))) / a
    meets = (root > 0) & (distance > 0) & (distance * rays[:, 2] <= POST_TOP_M - SENSOR_HEIGHT_M)
    return np.where(meets, distance, np.inf)
