"""Logs that are written read back as they were: with rosbags, and with the project's own reader."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.simulation.poses import poses
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.simulator import Simulator
from adcbf_cli.core.types import Frame, Notes, Scan
from adcbf_cli.io.frame_reader import FrameReader
from adcbf_cli.io.mcap_writer import LaserSweep, open_log
from adcbf_cli.io.simulation_log import write_log

START_NS = 1_700_000_000_123_456_789


def messages(path: Path) -> list[tuple[str, int, Any]]:
    with AnyReader([path]) as reader:
        return [
            (connection.topic, stamp, reader.deserialize(raw, connection.msgtype))
            for connection, stamp, raw in reader.messages()
        ]


def scan_of(points: np.ndarray, offset_ns: np.ndarray | None) -> Scan:
    return Scan(START_NS, "lidar", "/points", points, offset_ns, False)


def test_a_cloud_comes_back_with_its_times(tmp_path: Path):
    points = np.array([[1.5, -2.25, 0.125], [100.0, 0.001953125, -3.0]])
    with open_log(tmp_path / "a.mcap") as log:
        log.write_cloud(scan_of(points, np.array([0, 99_999_999])), START_NS + 100_000_000)
    ((topic, logged, cloud),) = messages(tmp_path / "a.mcap")
    assert (topic, logged) == ("/points", START_NS + 100_000_000)
    assert cloud.header.stamp.sec * 1_000_000_000 + cloud.header.stamp.nanosec == START_NS
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "t"]
    rows = cloud.data.view(np.dtype([("xyz", "<f4", 3), ("t", "<u4")]))
    np.testing.assert_array_equal(rows["xyz"], points)
    np.testing.assert_array_equal(rows["t"], [0, 99_999_999])


@pytest.mark.parametrize("count", [0, 3])
def test_a_cloud_without_times_has_no_field_for_them(tmp_path: Path, count: int):
    with open_log(tmp_path / "a.mcap") as log:
        log.write_cloud(scan_of(np.ones((count, 3)), None), START_NS)
    ((_, _, cloud),) = messages(tmp_path / "a.mcap")
    assert [field.name for field in cloud.fields] == ["x", "y", "z"]
    assert (cloud.width, len(cloud.data)) == (count, 12 * count)


def test_a_time_before_the_stamp_is_refused(tmp_path: Path):
    with pytest.raises(ValueError, match="before its scan"), open_log(tmp_path / "a.mcap") as log:
        log.write_cloud(scan_of(np.ones((1, 3)), np.array([-1])), START_NS)
    assert list(tmp_path.iterdir()) == []


def test_poses_and_transforms_come_back(tmp_path: Path):
    pose = poses(*(np.array([value]) for value in (1.0, -2.0, 3.0, 0.4, -0.1, 0.2)))[0]
    with open_log(tmp_path / "a.mcap") as log:
        log.write_transform("base_link", "lidar", START_NS, pose, static=True)
        log.write_odometry("/odom", "odom", "base_link", START_NS, pose, 0.75, -0.1)
        log.write_transform("odom", "base_link", START_NS, pose)
    by_topic = {topic: message for topic, _, message in messages(tmp_path / "a.mcap")}
    assert set(by_topic) == {"/odom", "/tf", "/tf_static"}
    odom = by_topic["/odom"]
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    assert (odom.twist.twist.linear.x, odom.twist.twist.angular.z) == (0.75, -0.1)
    for place, turn in (
        (odom.pose.pose.position, odom.pose.pose.orientation),
        (by_topic["/tf"].transforms[0].transform.translation, by_topic["/tf"].transforms[0].transform.rotation),
    ):
        assert (place.x, place.y, place.z) == (1.0, -2.0, 3.0)
        x, y, z, w = turn.x, turn.y, turn.z, turn.w
        np.testing.assert_allclose(
            [2 * (x * y + z * w), 1 - 2 * (y * y + z * z), 2 * (x * z - y * w)], pose[[1, 0, 2], 0], atol=1e-8
        )


def test_a_laser_scan_comes_back(tmp_path: Path):
    ranges = np.array([1.0, np.inf, 2.5])
    with open_log(tmp_path / "a.mcap") as log:
        sweep = LaserSweep(-0.5, 0.5, 0.01, 0.1, 0.3, 30.0)
        log.write_laser_scan("/scan", "laser", START_NS, START_NS, ranges, sweep)
    ((_, _, scan),) = messages(tmp_path / "a.mcap")
    np.testing.assert_array_equal(scan.ranges, ranges.astype(np.float32))
    assert (scan.angle_min, scan.angle_max, scan.angle_increment) == (-0.5, 0.5, 0.5)


def test_a_failure_leaves_nothing_behind(tmp_path: Path):
    target = tmp_path / "a.mcap"
    target.write_bytes(b"what was there")

    def interrupted_write() -> None:
        with open_log(target) as log:
            log.write_cloud(scan_of(np.ones((5, 3)), None), START_NS)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted_write()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]
    assert target.read_bytes() == b"what was there"


def simulated(lidar: dict[str, Any], **changes: Any) -> Simulator:
    scenario = {
        "duration_s": 1.0,
        "terrain": {"kind": "bumps", "size_m": 40, "slope_deg": 3},
        "objects": [{"kind": "box", "at_m": [4, 1], "size_m": [1, 1, 1]}],
        "ego": {"path": {"kind": "waypoints", "points_m": [[0, 0], [2, 1], [5, 0]], "speed_mps": 2.0, "smooth": True}},
        "lidar": lidar,
        "odometry": {"rate_hz": 200},
    }
    return Simulator(Scenario.model_validate(scenario | changes))


def read(path: Path, deskew: bool = True) -> tuple[list[Frame], Notes]:
    notes = Notes()
    with FrameReader(path, ReadConfig(deskew=deskew), notes) as reader:
        return list(reader), notes


SPINNING = {
    "kind": "spinning",
    "azimuth_step_deg": 2,
    "start_azimuth_deg": 0,
    "max_range_m": 15,
    "mount": {"height_m": 0.9, "x_m": 0.2, "pitch_deg": 5, "yaw_deg": 20},
}
PLANAR = {"kind": "planar", "mount": {"height_m": 0.3}}


@pytest.mark.parametrize("lidar", [SPINNING, PLANAR], ids=["spinning", "planar"])
@pytest.mark.parametrize("drift", [0.0, 0.003])
def test_the_reader_finds_the_simulators_frames(tmp_path: Path, lidar: dict[str, Any], drift: float):
    """Placed and corrected for motion by the reader, from the log alone, points come within 2 cm
    of where the simulator itself puts them (the ego pitches from facet to facet of the ground, the reader
    blends poses 10 ms apart); without the correction they are up to 0.1 m off."""
    changes = {"terrain": {"kind": "flat"}} if lidar is PLANAR else {}
    odometry = {"rate_hz": 200, "heading_sigma_rad_per_sqrt_m": drift}
    simulator = simulated(lidar, odometry=odometry, **changes)
    scans = list(simulator)
    write_log(tmp_path / "a.mcap", simulator, scans)
    frames, notes = read(tmp_path / "a.mcap")
    assert notes.losses == []
    assert len(frames) == len(scans) == 10
    for frame, scan in zip(frames, scans, strict=True):
        assert frame.stamp_ns == scan.frame.stamp_ns
        assert frame.planar == scan.frame.planar
        assert frame.pose_known
        np.testing.assert_allclose(frame.world_from_sensor, scan.frame.world_from_sensor, atol=1e-6)
        assert len(frame.points_m) == len(scan.frame.points_m)
        assert np.abs(frame.points_m - scan.frame.points_m).max() < 0.02
        assert np.abs(scan.scan.points_m - scan.frame.points_m).max() > 0.03


def test_without_motion_correction_the_reader_gives_the_raw_points(tmp_path: Path):
    simulator = simulated(SPINNING)
    scans = list(simulator)
    write_log(tmp_path / "a.mcap", simulator, scans)
    frames, _ = read(tmp_path / "a.mcap", deskew=False)
    for frame, scan in zip(frames, scans, strict=True):
        np.testing.assert_array_equal(frame.points_m, scan.scan.points_m)
