"""The whole evaluation on runs built by hand, with numbers that can be checked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.config import EvaluationConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.evaluation.evaluate import evaluate
from adcbf_cli.core.evaluation.report import Report
from adcbf_cli.core.evaluation.scene import truth_in_world
from adcbf_cli.core.frames import pose_matrix
from adcbf_cli.core.types import IgnoredSectors, Notes, TrackStatus
from tests.core.evaluation.scenes import START_NS, STEP_NS, Labelled, Run, Seen, line

WALK = line(5.0, 2.0, vx=-0.5, vy=0.4)


def value(report: Report, name: str) -> float:
    result = report.metrics[name].value
    assert result is not None, name
    return result


def test_a_perfect_run() -> None:
    report = Run([Labelled(WALK)], [Seen(WALK)]).score()
    for name in ("tracking.rmse_x_m", "tracking.rmse_m", "tracking.nees", "prediction.rmse_y_m", "clear.motp_m"):
        assert value(report, name) == pytest.approx(0.0, abs=1e-9)
    for name in ("clear.mota", "hota.hota", "hota.loc_a", "detection.recall", "detection.track_recall"):
        assert value(report, name) == pytest.approx(1.0)
    for name in ("detection.precision", "detection.moving_precision", "prediction.coverage_50"):
        assert value(report, name) == pytest.approx(1.0)
    assert report.metrics["tracking.rmse_x_m"].n == 40
    assert report.metrics["detection.recall.person"].n == 40
    # Frame k has truth for 39 - k of its 30 steps: ten frames have all, the others fewer.
    assert report.metrics["prediction.rmse_x_m"].n == 10 * 30 + sum(range(30))
    assert report.metrics["prediction.fde_m.3.0s"].n == 10
    assert report.metrics["prediction.fde_m.1.0s"].n == 30


def test_prediction_errors_by_hand() -> None:
    """Predictions run 1 cm a step ahead in x and stay 2 cm off in y."""

    def ahead(t0: float, t: np.ndarray) -> np.ndarray:
        return WALK(t) + np.stack([0.1 * (t - t0), np.full_like(t, -0.02)], axis=-1)

    report = Run([Labelled(WALK)], [Seen(WALK, ahead=ahead)], count=70).score()
    weight = np.array([min(70 - k, 40 + 30 - k) for k in range(1, 31)])  # frames that have truth k steps on
    square = (0.01 * np.arange(1, 31)) ** 2
    assert value(report, "prediction.rmse_x_m") == pytest.approx(np.sqrt((weight * square).sum() / weight.sum()))
    assert value(report, "prediction.rmse_y_m") == pytest.approx(0.02)
    assert value(report, "prediction.rmse_x_m.2.0s") == pytest.approx(0.2)
    assert value(report, "prediction.fde_m.3.0s") == pytest.approx(np.hypot(0.3, 0.02))
    by_step = np.hypot(0.01 * np.arange(1, 11), 0.02)
    assert value(report, "prediction.ade_m.1.0s") == pytest.approx(by_step.mean())
    assert value(report, "prediction.nees.1.0s") == pytest.approx((0.1**2 + 0.02**2) / 0.1**2)
    # 50 % ellipse: |e| <= 0.1 sqrt(2 ln 2) = 0.1177 m; 90 %: 0.2146 m; the radius: 0.5 m.
    assert value(report, "prediction.coverage_50.1.0s") == 1.0
    assert value(report, "prediction.coverage_50.2.0s") == 0.0
    assert value(report, "prediction.coverage_90.2.0s") == 1.0
    assert value(report, "prediction.coverage_90.3.0s") == 0.0
    assert value(report, "prediction.coverage_sigma_radius") == 1.0
    still = (0.05 * np.arange(1, 31)) ** 2  # the object goes 5 cm a step in x
    assert value(report, "prediction.rmse_still_x_m") == pytest.approx(np.sqrt((weight * still).sum() / weight.sum()))
    assert report.objects[0]["predictions"] == 40
    assert report.objects[0]["last_step_error_m"] == pytest.approx(np.hypot(0.3, 0.02))
    conformal = report.metrics["prediction.coverage_conformal_radius"]
    assert (conformal.value, conformal.n) == (None, 0)


def test_bias_towards_the_sensor_is_named_and_removed() -> None:
    """A thing on a circle around the sensor, seen 0.3 m too near and 0.1 m to the left."""

    def circle(t: np.ndarray) -> np.ndarray:
        return 6 * np.stack([np.cos(0.8 * t), np.sin(0.8 * t)], axis=-1)

    def near(t: np.ndarray) -> np.ndarray:
        left = np.stack([-np.sin(0.8 * t), np.cos(0.8 * t)], axis=-1)
        return circle(t) * (5.7 / 6) + 0.1 * left

    unknown_yaw = Labelled(circle, yaw=lambda t: np.full_like(t, np.nan))
    report = Run([unknown_yaw], [Seen(near)], count=80).score()
    assert value(report, "clustering.bias_along_m") == pytest.approx(-0.3)
    assert value(report, "clustering.bias_across_m") == pytest.approx(0.1)
    assert value(report, "tracking.rmse_m") == pytest.approx(np.hypot(0.3, 0.1))
    assert value(report, "tracking.rmse_sight_corrected_m") == pytest.approx(0.0, abs=1e-9)
    assert value(report, "tracking.nees") == pytest.approx(10.0)
    assert value(report, "tracking.nees_sight_corrected") == pytest.approx(0.0, abs=1e-9)
    assert value(report, "prediction.rmse_sight_corrected_x_m") == pytest.approx(0.0, abs=1e-9)
    assert value(report, "prediction.rmse_x_m") > 0.1
    assert report.metrics["clustering.bias_body_x_m"].value is None
    assert report.metrics["tracking.rmse_body_corrected_m"].value is None


def test_what_the_filter_adds_is_told_from_what_clustering_gave() -> None:
    """Clusters sit 0.1 m to the left of a thing that comes straight on; the track lags 0.2 m behind them."""
    coming = line(9.0, 0.0, vx=-1.0)
    seen = Seen(line(9.2, -0.1, vx=-1.0), measured=line(9.0, -0.1, vx=-1.0))
    report = Run([Labelled(coming, yaw=lambda t: np.full_like(t, np.pi))], [seen]).score()
    assert value(report, "clustering.bias_body_x_m") == pytest.approx(0.0, abs=1e-9)
    assert value(report, "clustering.bias_body_y_m") == pytest.approx(0.1)
    assert value(report, "tracking.bias_body_x_m") == pytest.approx(-0.2)
    assert value(report, "clustering.rmse_m") == pytest.approx(0.1)
    assert value(report, "tracking.rmse_m") == pytest.approx(np.hypot(0.2, 0.1))
    assert report.objects[0]["bias_body_y_m"] == pytest.approx(0.1)
    assert report.objects[0]["track_rmse_m"] == pytest.approx(np.hypot(0.2, 0.1))


def test_bias_fixed_to_the_body_is_found_in_its_axes() -> None:
    """A vehicle that turns while its markers sit 0.4 m behind its centre."""

    def yaw(t: np.ndarray) -> np.ndarray:
        return 1.5 * t

    def behind(t: np.ndarray) -> np.ndarray:
        return WALK(t) - 0.4 * np.stack([np.cos(yaw(t)), np.sin(yaw(t))], axis=-1)

    report = Run([Labelled(WALK, yaw=yaw)], [Seen(behind)], count=60).score()
    assert value(report, "clustering.bias_body_x_m") == pytest.approx(-0.4)
    assert value(report, "clustering.bias_body_y_m") == pytest.approx(0.0, abs=1e-9)
    assert value(report, "tracking.rmse_body_corrected_m") == pytest.approx(0.0, abs=1e-9)
    assert value(report, "prediction.rmse_body_corrected_x_m") == pytest.approx(0.0, abs=1e-9)
    assert value(report, "tracking.rmse_sight_corrected_m") > 0.1


def test_bias_that_changes_with_the_side_seen_is_found_by_aspect() -> None:
    """A vehicle of which only the end that faces the sensor is seen, while the sensor passes it."""

    def end_seen(t: np.ndarray) -> np.ndarray:
        towards = np.where(t >= 18.0, 1.0, -1.0)  # the sensor starts behind the thing and ends up ahead of it
        return parked(t) + np.stack([0.5 * towards, 0 * t], axis=-1)

    parked = line(9.0, 2.0)
    poses = [pose_matrix(np.array([0.05 * k, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])) for k in range(360)]
    report = Run([Labelled(parked)], [Seen(end_seen)], count=360, steps=1, sensor=poses).score()
    assert value(report, "tracking.rmse_m") == pytest.approx(0.5)
    assert value(report, "tracking.rmse_body_corrected_m") > 0.49
    assert value(report, "tracking.rmse_aspect_corrected_m") < 0.01
    sectors = {row["from_deg"]: row["body_x_m"] for row in report.objects[0]["bias_by_aspect"]}
    assert sectors[180] == pytest.approx(-0.5)
    assert sectors[330] == pytest.approx(0.5)


def test_a_consistent_filter_is_called_consistent() -> None:
    rng = np.random.default_rng(5)
    noise = {}

    def noisy(t: np.ndarray) -> np.ndarray:
        return WALK(t) + np.array([noise.setdefault(round(float(x) * 10), rng.normal(0, 0.1, 2)) for x in t])

    report = Run([Labelled(WALK)], [Seen(noisy)], count=600, steps=1).score(
        EvaluationConfig(range_m=1000.0, horizons_s=(0.1,))
    )
    nees = report.metrics["tracking.nees"]
    assert nees.bounds is not None
    assert nees.bounds[0] < value(report, "tracking.nees") < nees.bounds[1]
    assert nees.bounds[0] < 2.0 < nees.bounds[1]
    for level in (50, 90, 95):
        assert value(report, f"tracking.coverage_{level}") == pytest.approx(level / 100, abs=0.06)


@pytest.mark.parametrize("turn", [0.7, np.pi])
def test_scores_do_not_depend_on_where_the_world_has_its_origin(turn: float) -> None:
    def turned(path):
        c, s = np.cos(turn), np.sin(turn)
        return lambda t: path(t) @ np.array([[c, s], [-s, c]]) + [700.0, -300.0]

    def off(t: np.ndarray) -> np.ndarray:
        return WALK(t) + np.stack([0.2 * np.sin(3 * t), 0.11 + 0 * t], axis=-1)

    def ahead(t0: float, t: np.ndarray) -> np.ndarray:
        return off(np.full_like(t, t0)) + np.outer(t - t0, [-0.4, 0.3])

    quaternion = np.array([0, 0, np.sin(turn / 2), np.cos(turn / 2)])
    there = [pose_matrix(np.array([700.0, -300.0, 0.0]), quaternion)] * 60
    here = Run([Labelled(WALK, yaw=lambda t: 0.3 * t)], [Seen(off, ahead=ahead)], count=60).score()
    turned_ahead = lambda t0, t: turned(lambda x: ahead(t0, x))(t)  # noqa: E731
    away = Run(
        [Labelled(turned(WALK), yaw=lambda t: 0.3 * t + turn)],
        [Seen(turned(off), ahead=turned_ahead)],
        count=60,
        sensor=there,
    ).score()
    for name, metric in here.metrics.items():
        along_axes = "rmse" in name and ("_x_m" in name or "_y_m" in name)
        if along_axes:
            continue
        if metric.value is None:
            assert away.metrics[name].value is None
        else:
            assert away.metrics[name].value == pytest.approx(metric.value, abs=1e-6), name


def test_static_tracks_without_a_label_are_no_errors_but_counted_apart() -> None:
    tree, ghost = line(8.0, -3.0), line(-6.0, 0.0, vx=1.0)
    report = Run([Labelled(WALK)], [Seen(WALK), Seen(tree, static=True), Seen(ghost)]).score()
    assert value(report, "clear.false_positives") == 40
    assert value(report, "clear.mota") == pytest.approx(0.0)
    assert value(report, "clear.false_positives_all_tracks") == 80
    assert value(report, "clear.mota_all_tracks") == pytest.approx(-1.0)
    assert value(report, "detection.precision") == pytest.approx(1 / 3)
    assert value(report, "detection.moving_precision") == pytest.approx(1 / 2)
    assert value(report, "hota.det_a") == pytest.approx(1 / 2)
    assert value(report, "hota.det_a_all_tracks") == pytest.approx(1 / 3)


def test_a_static_track_on_a_label_counts_as_found() -> None:
    standing = line(3.0, 3.0)
    report = Run([Labelled(standing)], [Seen(standing, static=True)]).score()
    assert value(report, "clear.mota") == 1.0
    assert value(report, "hota.hota") == pytest.approx(1.0)


def test_outside_range_view_and_sectors_nothing_is_right_or_wrong() -> None:
    far, behind = line(30.0, 0.0, vx=0.1), line(-5.0, 0.0, vx=-0.1)
    run = Run([Labelled(WALK), Labelled(far)], [Seen(WALK), Seen(behind), Seen(line(29.0, 5.0, vx=0.1))])
    run.fov_rad = (-1.5, 1.5)
    report = run.score(EvaluationConfig(range_m=20.0))
    assert value(report, "clear.false_positives_all_tracks") == 0
    assert report.metrics["detection.recall"].n == 40
    assert report.metrics["detection.precision"].n == 40
    assert value(report, "detection.precision") == 1.0
    everywhere = run.score(EvaluationConfig(range_m=20.0, truth_fov_deg=(-180.0, 180.0)))
    assert value(everywhere, "clear.false_positives") == 40

    truth = run.truth()
    sector = IgnoredSectors(START_NS + np.arange(20) * STEP_NS, np.full(20, 3.0), np.full(20, -3.0 + 2 * np.pi))
    ignoring = type(truth)(**{**{f: getattr(truth, f) for f in truth.__slots__}, "ignored": sector})
    config = EvaluationConfig(range_m=20.0, truth_fov_deg=(-180.0, 180.0))
    frames = range(run.count)
    scored = evaluate(map(run.clusters, frames), map(run.tracks, frames), tuple, ignoring, config, Notes())
    assert value(scored, "clear.false_positives") == 20


def test_scenery_counts_for_detection_only() -> None:
    wall = Labelled(line(0.0, 6.0), category="Wall", size=(10.0, 0.3))
    pieces = [Seen(line(x, 6.05), static=False) for x in (-4.0, 0.0, 4.0)]
    report = Run([Labelled(WALK), wall], [Seen(WALK), *pieces]).score()
    assert value(report, "detection.recall.Wall") == 1.0
    assert value(report, "detection.precision") == 1.0
    assert value(report, "clear.false_positives_all_tracks") == 0
    assert value(report, "clear.mota_all_tracks") == 1.0
    assert report.metrics["clear.mota"].n == 40
    assert report.objects[1]["frames_tracked"] is None
    assert report.metrics["tracking.rmse_m"].n == 40


def test_a_single_objects_poses_say_nothing_of_other_tracks() -> None:
    run = Run([Labelled(WALK)], [Seen(WALK), Seen(line(3.0, 0.0, vx=0.3))], exhaustive=False)
    report = run.score()
    for name in ("clear.mota", "clear.false_positives", "hota.hota", "detection.precision"):
        assert report.metrics[name].value is None
    assert value(report, "clear.misses") == 0
    assert value(report, "hota.ass_a") == 1.0
    known = run.score(EvaluationConfig(range_m=50.0, truth_exhaustive=True))
    assert value(known, "clear.false_positives") == 40


def test_misses_switches_and_tentative_tracks() -> None:
    first, second = Seen(WALK, frames=range(5, 20)), Seen(WALK, frames=range(25, 40))
    tentative = Seen(WALK, frames=range(5), status=TrackStatus.TENTATIVE)
    report = Run([Labelled(WALK)], [first, second, tentative]).score()
    assert value(report, "clear.misses") == 10
    assert value(report, "clear.switches") == 1
    assert value(report, "clear.fragmentations") == 1
    assert value(report, "clear.mota") == pytest.approx(1 - 11 / 40)
    assert value(report, "detection.recall") == pytest.approx(35 / 40)
    assert value(report, "detection.track_recall") == pytest.approx(30 / 40)
    assert report.objects[0]["frames_tracked"] == 30
    assert report.objects[0]["tracks"] == 2


def test_without_truth_predictions_meet_where_the_track_was_later_seen() -> None:
    def ahead(t0: float, t: np.ndarray) -> np.ndarray:
        return WALK(t) + np.array([0.03, -0.04])

    still = Seen(line(1.0, 1.0), static=True)
    report = Run([], [Seen(WALK, ahead=ahead, frames=range(20)), still]).score(with_truth=False)
    assert "prediction.rmse_x_m" not in report.metrics
    assert value(report, "later_seen.moving.fde_m.1.0s") == pytest.approx(0.05)
    assert report.metrics["later_seen.moving.fde_m.1.0s"].n == 10
    assert value(report, "later_seen.moving.rmse_x_m") == pytest.approx(0.03)
    assert report.metrics["later_seen.moving.rmse_x_m"].n == sum(range(20))
    assert report.metrics["later_seen.fde_m.1.0s"].n == 10 + 30
    assert value(report, "later_seen.fde_m.1.0s") == pytest.approx(0.05 * 10 / 40)
    assert value(report, "tracks.confirmed") == 2
    assert value(report, "tracks.life_s.median") == pytest.approx((1.9 + 3.9) / 2)
    assert value(report, "tracks.static_share") == pytest.approx(40 / 60)
    assert value(report, "tracks.speed_mps.median") == pytest.approx(np.hypot(0.5, 0.4))


def test_restarts_are_likely_fragments() -> None:
    parts = [Seen(WALK, frames=range(15)), Seen(WALK, frames=range(20, 40)), Seen(line(9.0, 9.0))]
    report = Run([], parts).score(with_truth=False)
    assert value(report, "tracks.restart_share") == pytest.approx(1 / 3)


def test_truth_in_the_sensors_frame_is_placed_by_the_runs_poses() -> None:
    poses = [
        pose_matrix(np.array([0.1 * k, 1.0, 0.0]), np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)])) for k in range(40)
    ]
    run = Run([Labelled(WALK, yaw=lambda t: t)], [Seen(WALK)], sensor=poses)
    world = run.truth()
    local = world.position_m.copy()
    for k, pose in enumerate(poses):
        local[k] = (world.position_m[k] - pose[:3, 3]) @ pose[:3, :3]
    values = {f: getattr(world, f) for f in world.__slots__}
    sensor = type(world)(**{**values, "frame": "sensor", "position_m": local, "yaw_rad": world.yaw_rad - np.pi / 2})
    stamps = [START_NS + k * STEP_NS for k in range(40)]
    back = truth_in_world(sensor, zip(stamps, poses, strict=True), Notes())
    np.testing.assert_allclose(back.position_m, world.position_m, atol=1e-12)
    np.testing.assert_allclose(np.cos(back.yaw_rad - world.yaw_rad), 1.0)
    notes = Notes()
    assert len(truth_in_world(sensor, zip(stamps[:10], poses[:10], strict=True), notes)) == 10
    assert "30 labels" in notes.warnings[0]
    with pytest.raises(AdcbfError, match="no label falls on a frame"):
        truth_in_world(sensor, [(0, np.eye(4))], Notes())


def test_records_of_different_runs_are_refused() -> None:
    run = Run([], [Seen(WALK)])
    for tracks in (map(run.tracks, range(1, 41)), map(run.tracks, range(20))):
        with pytest.raises(AdcbfError, match="not of the same frames"):
            evaluate(map(run.clusters, range(40)), tracks, tuple, None, EvaluationConfig(), Notes())


def test_truth_of_another_time_is_pointed_out() -> None:
    run = Run([Labelled(WALK, frames=range(1000, 1010))], [Seen(WALK)])
    report = run.score()
    assert report.metrics["clear.mota"].value is None
    assert report.metrics["detection.recall"].value is None
    assert any("no labelled object is within range" in w for w in run.notes.warnings)


def test_the_same_run_gives_the_same_report() -> None:
    first, second = (Run([Labelled(WALK)], [Seen(line(5.1, 2.0, -0.5, 0.4))], count=400).score() for _ in range(2))
    assert first.to_dict() == second.to_dict()
    interval = first.metrics["tracking.rmse_m"].interval
    assert interval is not None
    assert interval[0] <= value(first, "tracking.rmse_m") <= interval[1]
