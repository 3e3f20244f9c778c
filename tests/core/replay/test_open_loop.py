"""Plans along a log, and the log's own driver."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.planning.reference import ReferencePath
from adcbf_cli.core.replay.log_path import LogPath
from adcbf_cli.core.replay.open_loop import LOGGED, check_speed, logged_drive, plan_along
from adcbf_cli.core.replay.world import RecordedWorld, Samples
from adcbf_cli.core.types import Notes, Predictions
from adcbf_cli.core.vehicles.vehicle import Vehicle

SECOND = 1_000_000_000
CONFIG = Config.model_validate({"vehicle": {"max_speed_mps": 2.0}})
VEHICLE = Vehicle.from_config(CONFIG.vehicle)
PATH = ReferencePath(np.array([[0.0, 0.0], [30.0, 0.0]]), 1.0)
WORLD = RecordedWorld(
    Samples.of(np.array([4]), np.array([0]), np.array([[5.0, 2.0]]), np.array([0.5])), 0.5, standing=np.array([4])
)

Make = Callable[..., Predictions]


@pytest.fixture
def plan(predicted: Make) -> Callable[..., Any]:
    def make(planners: list[Any], log_path: LogPath, **options: Any) -> Any:
        records = options.get("records", [predicted(0, [[5.0, 2.0]], [[0.0, 0.0]])])
        clock = itertools.count().__next__
        return plan_along(planners, records, WORLD, log_path, PATH, VEHICLE, CONFIG, clock, Notes())

    return make


def test_a_plan_that_does_what_the_log_did_has_no_error(plan: Any, driver: Any, log_along_x: Any) -> None:
    """Until the log ends: the last plan's stages are unknown but for its start."""
    exact, slow = plan([driver(VEHICLE, 1.0), driver(VEHICLE, 0.5, name="slow")], log_along_x(1.0, 10.0))
    np.testing.assert_allclose(exact.plan_error_m[0], np.zeros(31), atol=1e-9)
    np.testing.assert_allclose(slow.plan_error_m[0], 0.05 * np.arange(31), atol=1e-9)
    assert np.isnan(exact.plan_error_m[-1, 1:]).all()
    assert np.isfinite(exact.plan_error_m[-31]).all()
    assert (exact.planner, slow.planner) == ("straight", "slow")


def test_poses_and_inputs_are_the_logs(plan: Any, driver: Any, log_along_x: Any) -> None:
    planner = driver(VEHICLE, 0.2)
    (drive,) = plan([planner], log_along_x(1.5, 10.0))
    assert drive.result is None
    assert drive.period_s == pytest.approx(0.1)
    assert len(drive.stamp_ns) == 101
    np.testing.assert_allclose(drive.pose[:, 0], 0.15 * np.arange(101), atol=1e-9)
    np.testing.assert_allclose(drive.inputs, np.tile([1.5, 0.0], (101, 1)), atol=1e-9)
    np.testing.assert_allclose(drive.log_m, np.zeros(101), atol=1e-9)
    np.testing.assert_allclose([s.pose[0] for s in planner.situations], drive.pose[:, 0])
    assert drive.recorded.all()
    # Body 0.3 m, thing 0.5 m, 2 m aside of x = 5 (which no scan meets exactly).
    assert drive.clearance_m.min() == pytest.approx(np.hypot(0.05, 2.0) - 0.8)
    assert (drive.steps.obstacles[:3] == [0, 0, 0]).all()


def test_inputs_given_to_planners_are_within_bounds(plan: Any, driver: Any, log_along_x: Any) -> None:
    """2.05 m/s is 2.5 % above what this vehicle can: no error, but no planner is given it."""
    planner = driver(VEHICLE, 1.0)
    (drive,) = plan([planner], log_along_x(2.05, 5.0))
    assert {s.inputs[0] for s in planner.situations} == {2.0}
    np.testing.assert_allclose(drive.inputs[:, 0], 2.05)


def test_the_logged_driver_is_measured_alike(plan: Any, driver: Any, log_along_x: Any) -> None:
    (drive,) = plan([driver(VEHICLE, 1.0)], log_along_x())
    logged = logged_drive(log_along_x(), WORLD, PATH, VEHICLE, CONFIG)
    assert logged.planner == LOGGED
    assert logged.steps is None
    assert logged.stages is None
    assert logged.result is None
    for name in ("stamp_ns", "pose", "inputs", "clearance_m", "nearest_id", "ttc_s", "reference_m", "along_m"):
        np.testing.assert_array_equal(getattr(logged, name), getattr(drive, name))


def test_a_log_of_another_vehicle_is_refused(log_along_x: Any) -> None:
    with pytest.raises(UsageError, match=r"drove up to 8\.3 m/s, vehicle\.max_speed_mps is 2: .*max_speed_mps=9"):
        check_speed(log_along_x(8.3), CONFIG)
    with pytest.raises(UsageError, match=r"max_speed_mps=2\.2"):
        check_speed(log_along_x(2.15), CONFIG)
    forth_and_back = np.outer(0.5 * np.minimum(np.arange(19), 18 - np.arange(19)), [1, 0, 0])
    with pytest.raises(UsageError, match=r"reversed with up to 0\.5 m/s, .*min_speed_mps=-0\.5"):
        check_speed(LogPath(SECOND * np.arange(19), forth_and_back), CONFIG)


def test_a_moment_of_speeding_is_not(log_along_x: Any) -> None:
    """Of 601 scans, a jump of the pose touches four slopes: less than one in a hundred."""
    path = log_along_x(1.0, 60.0)
    pose = path.pose.copy()
    pose[300:, 0] += 0.5
    check_speed(LogPath(path.stamp_ns, pose), CONFIG)


def test_no_predictions_at_all_is_an_error(plan: Any, driver: Any, log_along_x: Any) -> None:
    with pytest.raises(AdcbfError, match="no predictions"):
        plan([driver(VEHICLE, 1.0)], log_along_x(), records=[])


def test_progress_is_found_again_after_a_gap(plan: Any, driver: Any) -> None:
    time_s = np.concatenate([np.arange(0, 3, 0.1), np.arange(15, 18, 0.1)])
    pose = np.column_stack([time_s, 0 * time_s, 0 * time_s])
    (drive,) = plan([driver(VEHICLE, 1.0)], LogPath(np.round(time_s * 1e9).astype(np.int64), pose))
    np.testing.assert_allclose(drive.along_m, time_s, atol=1e-9)
