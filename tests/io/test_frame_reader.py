"""From logs to placed frames: transform chains by hand, motion correction, fusing, gaps, bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.frames import transform_points
from adcbf_cli.core.types import Frame, Notes
from adcbf_cli.io.frame_reader import MOST_SCANS, QUEUE_SCANS, FrameReader
from adcbf_cli.io.placement import parse_extrinsic

T0 = 1_700_000_000_000_000_000
SECOND = 1_000_000_000


def read(path: Path, **config: Any) -> tuple[list[Frame], FrameReader, Notes]:
    notes = Notes()
    with FrameReader(path, ReadConfig(**config), notes) as reader:
        return list(reader), reader, notes


def in_world(frame: Frame) -> np.ndarray:
    return transform_points(frame.world_from_sensor, frame.points_m)


@pytest.mark.parametrize("container", ["mcap", "mcap1", "bag", "sqlite3"])
def test_a_standing_post_stands_still_in_the_world(make: Any, tmp_path: Path, container: str) -> None:
    ros1 = container in ("mcap1", "bag")
    entries = make.drive(20, ros1)
    if container == "bag":
        path = make.bag(tmp_path / "log.bag", entries)
    elif container == "sqlite3":
        path = make.rosbag2(tmp_path / "log", entries)
    else:
        path = make.mcap(tmp_path / "log.mcap", entries, ros1=ros1)
    frames, reader, notes = read(path)
    assert notes == Notes()
    assert reader.expected_frames == 20
    assert (reader.selection.lidar, reader.selection.pose) == (("/points",), "/odom")
    assert (reader.selection.world_frame, reader.selection.sensor_frame) == ("odom", "lidar")
    assert [frame.index for frame in frames] == list(range(20))
    for i, frame in enumerate(frames):
        assert frame.stamp_ns == T0 + i * SECOND // 10
        np.testing.assert_allclose(in_world(frame), [[5, 2, 1]], atol=1e-6)
        assert frame.pose_known
        assert not frame.planar


def test_poses_between_odometry_are_interpolated(make: Any, tmp_path: Path) -> None:
    entries = [("/odom", make.odometry((float(i), 0, 0), 0.1 * i, T0 + i * SECOND), T0 + i * SECOND) for i in (0, 1)]
    entries.append(("/points", make.points([[1, 0, 0]], T0 + SECOND // 4, "base_link"), T0 + SECOND // 4))
    entries.sort(key=lambda entry: entry[2])
    frames, _, _ = read(make.mcap(tmp_path / "log.mcap", entries))
    expected = [[0.25 + np.cos(0.025), np.sin(0.025), 0]]
    np.testing.assert_allclose(in_world(frames[0]), expected, atol=1e-9)


def test_scans_wait_for_poses_that_are_recorded_later(make: Any, tmp_path: Path) -> None:
    """Poses of a SLAM that lags 0.5 s behind."""
    late = [(t, m, at + SECOND // 2 if t == "/odom" else at) for t, m, at in make.drive(30)]
    late.sort(key=lambda entry: entry[2])
    frames, _, notes = read(make.mcap(tmp_path / "log.mcap", late))
    assert len(frames) == 30
    assert notes == Notes()
    for frame in frames:
        np.testing.assert_allclose(in_world(frame), [[5, 2, 1]], atol=1e-6)


def test_scans_without_poses_are_dropped_and_told(make: Any, tmp_path: Path) -> None:
    entries = [e for e in make.drive(100) if e[0] != "/odom" or not 20 <= (e[2] - T0) // 100_000_000 < 60]
    frames, _, notes = read(make.mcap(tmp_path / "log.mcap", entries))
    missing = {round((frame.stamp_ns - T0) / 1e8) for frame in frames} ^ set(range(100))
    # The scan 0.1 s after the last pose still gets the motion carried on.
    assert missing == set(range(21, 60))
    assert "39 scans dropped" in notes.warnings[0]
    assert not notes.losses
    patient, _, _ = read(tmp_path / "log.mcap", max_pose_gap_s=5.0)
    assert len(patient) == 100


@pytest.mark.parametrize("offset_from_end", [False, True])
def test_motion_correction_makes_a_wall_flat(make: Any, tmp_path: Path, offset_from_end: bool) -> None:
    """A sensor that moves 2 m/s towards a wall at x = 10 and turns 0.5 rad/s while it sweeps for 0.1 s."""
    sweep = 0.1
    times = np.linspace(0, sweep, 400)
    bearings = np.linspace(-0.4, 0.4, 400)
    start = T0 + 2 * SECOND
    pose_x, yaw = 2.0 * (2 + times), 0.5 * (2 + times)
    ranges = (10 - pose_x) / np.cos(bearings)
    world = np.stack([np.full(400, 10.0), ranges * np.sin(bearings)], axis=1)
    ahead = world - np.stack([pose_x, np.zeros(400)], axis=1)
    rows = np.zeros(400, dtype=[("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("time", "<f4")])
    rows["x"] = np.cos(yaw) * ahead[:, 0] + np.sin(yaw) * ahead[:, 1]
    rows["y"] = -np.sin(yaw) * ahead[:, 0] + np.cos(yaw) * ahead[:, 1]
    rows["time"] = times - sweep if offset_from_end else times
    stamp = start + int(sweep * 1e9) if offset_from_end else start
    entries = [("/points", make.cloud(rows, stamp, "base_link"), start)]
    for i in range(500):
        t = i / 100
        at = T0 + i * SECOND // 100
        entries.append(("/odom", make.odometry((2.0 * t, 0, 0), 0.5 * t, at), at))
    entries.sort(key=lambda entry: entry[2])
    path = make.mcap(tmp_path / "log.mcap", entries)
    (flat,), _, notes = read(path)
    assert notes == Notes()
    np.testing.assert_allclose(in_world(flat)[:, :2], world, atol=2e-5)
    (skewed,), _, _ = read(path, deskew=False)
    assert np.abs(in_world(skewed)[:, :2] - world).max() > 0.1


def two_lidars(make: Any, scans: int = 10, lag_ns: int = 30_000_000) -> Iterator[tuple[str, Any, int]]:
    """A robot driving at 1 m/s; its rear LiDAR looks backwards from 1 m behind the front one, lag_ns later."""
    static = make.tf([("base_link", "front", (0, 0, 0), 0.0), ("base_link", "rear", (-1, 0, 0), np.pi)], T0)
    yield "/tf_static", static, T0
    for i in range(scans * 10):
        at = T0 + i * SECOND // 100
        x = 0.01 * i
        yield "/odom", make.odometry((x, 0, 0), 0.0, at), at
        if i % 10 == 5:
            yield "/front/points", make.points([[5 - x, 1, 0]], at, "front"), at
        if (at - T0 - lag_ns) % (SECOND // 10) == SECOND // 20 and at - lag_ns > T0:
            # A post at (-4, 2) in the world, seen from the rear sensor, whose x axis points backwards.
            yield "/rear/points", make.points([[4 + (x - 1), -2, 0]], at, "rear"), at


def test_two_lidars_are_fused_with_their_motion(make: Any, tmp_path: Path) -> None:
    path = make.mcap(tmp_path / "log.mcap", two_lidars(make))
    with pytest.raises(UsageError, match=r"--lidar /front/points.*--lidar /rear/points"):
        read(path)
    frames, reader, notes = read(path, lidar=("/front/points", "rear/points"))
    assert reader.selection.lidar == ("/front/points", "/rear/points")
    assert notes == Notes()
    assert len(frames) == 10
    for frame in frames:
        np.testing.assert_allclose(in_world(frame), [[5, 1, 0], [-4, 2, 0]], atol=1e-6)


def test_standing_lidars_are_fused_by_their_extrinsics(make: Any, tmp_path: Path) -> None:
    entries = []
    for i in range(4):
        at = T0 + i * SECOND // 10
        entries.append(("/left", make.laser([1.0], at, "left", angle_min=0.0), at))
        entries.append(("/right", make.laser([1.0], at + 2000, "right", angle_min=0.0), at + 2000))
    path = make.mcap(tmp_path / "log.mcap", entries)
    frames, _, notes = read(path, lidar=("/left", "/right"))
    assert any("--extrinsic 'left>right:" in warning for warning in notes.warnings)
    np.testing.assert_allclose(frames[0].points_m, [[1, 0, 0], [1, 0, 0]], atol=1e-9)
    mounts = ("base>left:0,1,0,0,0,0", "base>right:0,-1,0,0,0,1.5707963267948966")
    frames, _, notes = read(path, lidar=("/left", "/right"), extrinsics=mounts, pose="none")
    assert notes == Notes()
    assert all(frame.planar for frame in frames)
    np.testing.assert_allclose(frames[0].points_m, [[1, 0, 0], [0, -1, 0]], atol=1e-9)


def test_a_partner_too_far_in_time_is_left_out_and_told(make: Any, tmp_path: Path) -> None:
    entries = [e for e in two_lidars(make, 20) if e[0] != "/rear/points" or e[2] < T0 + SECOND]
    frames, _, notes = read(make.mcap(tmp_path / "log.mcap", entries), lidar=("/front/points", "/rear/points"))
    assert len(frames) == 20
    assert {len(frame.points_m) for frame in frames} == {1, 2}
    assert any("no partner" in warning for warning in notes.warnings)


def test_memory_is_bounded_however_long_the_log(make: Any, tmp_path: Path) -> None:
    """Scans whose poses end early, and poses without scans, must not pile up."""
    entries = [e for e in make.drive(400) if e[0] != "/odom" or e[2] < T0 + 5 * SECOND]
    entries += [
        ("/odom", make.odometry((0, 0, 0), 0.0, T0 + 900 * SECOND + i * SECOND // 10), T0 + 50 * SECOND + i)
        for i in range(3000)
    ]
    path = make.mcap(tmp_path / "log.mcap", entries)
    notes = Notes()
    with FrameReader(path, ReadConfig(), notes) as reader:
        events = reader._source.events
        waiting = [0]

        def watched() -> Iterator[Any]:
            for event in events():
                yield event
                waiting.append(len(reader._placement.poses))

        reader._source.events = watched  # type: ignore[method-assign]
        frames = list(reader)
    assert len(frames) == 51
    assert max(waiting) < 800
    assert "349 scans dropped" in notes.warnings[0]


@pytest.mark.parametrize(("gap_s", "most"), [(1.0, QUEUE_SCANS), (5.0, 52), (1e3, MOST_SCANS)])
def test_the_queue_gives_up_on_poses_that_never_come(make: Any, tmp_path: Path, gap_s: float, most: int) -> None:
    entries = [e for e in make.drive(300) if e[0] != "/odom" or e[2] < T0 + SECOND]
    notes = Notes()
    taken: list[int] = []
    config = ReadConfig(max_pose_gap_s=gap_s)
    with FrameReader(make.mcap(tmp_path / "log.mcap", entries), config, notes) as reader:
        inner = reader._frame

        def watched(scan: Any, waiting: Any) -> Any:
            taken.append(len(waiting.scans))
            return inner(scan, waiting)

        reader._frame = watched  # type: ignore[method-assign]
        list(reader)
    assert max(taken) == most


def test_stamps_that_go_back_are_dropped_and_told(make: Any, tmp_path: Path) -> None:
    entries = make.drive(10)
    entries += [(t, m, at + SECOND) for t, m, at in make.drive(5) if t == "/points"]
    frames, _, notes = read(make.mcap(tmp_path / "log.mcap", entries))
    assert len(frames) == 10
    assert "5 scans dropped: their stamps do not increase" in notes.warnings


def test_without_a_pose_source_the_sensor_stands_still_with_a_warning(make: Any, tmp_path: Path) -> None:
    entries = [("scan", make.laser([1.0] * 11, T0 + i * SECOND, "/laser", ros1=True), T0 + i) for i in range(3)]
    frames, reader, notes = read(make.bag(tmp_path / "log.bag", entries))
    assert reader.selection.pose == "none"
    assert [frame.pose_known for frame in frames] == [False] * 3
    assert all(frame.planar for frame in frames)
    np.testing.assert_array_equal(frames[0].world_from_sensor, np.eye(4))
    assert "stand still" in notes.warnings[0]
    assert "--pose" in notes.warnings[0]


def test_a_pose_without_link_to_the_sensor_is_the_sensors_with_a_warning(make: Any, tmp_path: Path) -> None:
    entries = []
    for i in range(5):
        at = T0 + i * SECOND // 10
        entries.append(("/ego_pose", make.pose((3, 4, 0), np.pi / 2, at), at))
        entries.append(("/scan", make.laser([1.0], at, "laser", angle_min=0.0), at))
    path = make.mcap(tmp_path / "log.mcap", entries)
    frames, reader, notes = read(path)
    assert reader.selection.pose == "/ego_pose"
    np.testing.assert_allclose(in_world(frames[0]), [[3, 5, 0]], atol=1e-9)
    assert "--extrinsic 'ego_pose>laser:" in notes.warnings[0]
    frames, _, notes = read(path, extrinsics=("ego_pose>laser:1,0,0,0,0,1.5707963267948966",))
    assert notes == Notes()
    np.testing.assert_allclose(in_world(frames[0]), [[2, 5, 0]], atol=1e-9)
    standing, _, notes = read(path, pose="none")
    assert not standing[0].pose_known
    assert notes == Notes()


def test_poses_from_tf_alone(make: Any, tmp_path: Path) -> None:
    entries = [("/tf_static", make.tf([("base_link", "lidar", (0, 0, 1), 0.0)], T0), T0)]
    for i in range(20):
        at = T0 + i * SECOND // 10
        edges = [("/map", "/odom", (100, 0, 0), 0.0), ("odom", "base_link", (0.1 * i, 0, 0), 0.0)]
        entries.append(("/tf", make.tf(edges, at), at))
        entries.append(("/points", make.points([[5 - 0.1 * i, 0, 0]], at), at))
    path = make.mcap(tmp_path / "log.mcap", entries)
    frames, reader, notes = read(path)
    assert (reader.selection.pose, reader.selection.world_frame) == ("tf", "odom")
    assert notes == Notes()
    assert len(frames) == 20
    for frame in frames:
        np.testing.assert_allclose(in_world(frame), [[5, 0, 1]], atol=1e-6)
    frames, _, _ = read(path, world_frame="map")
    np.testing.assert_allclose(in_world(frames[3]), [[105, 0, 1]], atol=1e-6)


def test_odometry_seen_from_another_fixed_frame(make: Any, tmp_path: Path) -> None:
    entries = [*make.drive(10), ("/tf_static", make.tf([("map", "odom", (0, 7, 0), 0.0)], T0), T0)]
    frames, _, _ = read(make.mcap(tmp_path / "log.mcap", entries), world_frame="map")
    np.testing.assert_allclose(in_world(frames[4]), [[5, 9, 1]], atol=1e-6)
    with pytest.raises(UsageError, match="mars"):
        read(tmp_path / "log.mcap", world_frame="mars")


def test_undecodable_scans_are_a_counted_loss(make: Any, tmp_path: Path) -> None:
    entries = make.drive(10)
    rows = np.ones(3, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    bad = make.cloud(rows, width=99)
    entries += [("/points", bad, T0 + 2 * SECOND), ("/points", bad, T0 + 3 * SECOND)]
    frames, _, notes = read(make.mcap(tmp_path / "log.mcap", entries))
    assert len(frames) == 10
    assert [loss.count for loss in notes.losses] == [2]
    assert "/points" in notes.losses[0].what


def test_an_empty_scan_is_an_empty_frame(make: Any, tmp_path: Path) -> None:
    rows = np.zeros(0, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    entries = [("/points", make.cloud(rows, T0), T0), ("/points", make.points([[1, 2, 3]], T0 + SECOND), T0 + SECOND)]
    frames, _, _ = read(make.mcap(tmp_path / "log.mcap", entries))
    assert [frame.points_m.shape for frame in frames] == [(0, 3), (1, 3)]


def test_roll_pitch_yaw_turn_about_the_fixed_axes_in_this_order() -> None:
    """R = Rz(yaw) Ry(pitch) Rx(roll), as in ROS: rolling y up to z, then pitching z to x, then yawing x to y."""
    quarter = np.pi / 2
    extrinsic = parse_extrinsic(f"/base>lidar:1,2,3,{quarter},{quarter},{quarter}")
    assert (extrinsic.parent, extrinsic.child) == ("base", "lidar")
    np.testing.assert_allclose(extrinsic.parent_from_child @ [0, 1, 0, 1], [1, 3, 3, 1], atol=1e-12)
    roll_then_yaw = parse_extrinsic(f"a>b:0,0,0,{quarter},0,{quarter}").parent_from_child
    np.testing.assert_allclose(roll_then_yaw @ [0, 1, 0, 1], [0, 0, 1, 1], atol=1e-12)
    np.testing.assert_allclose(roll_then_yaw @ [1, 0, 0, 1], [0, 1, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    "text", ["base>lidar:1,2,3", "base:1,2,3,4,5,6", "a>a:0,0,0,0,0,0", "a>b:1,2,3,4,5,x", "a>b:1,2,3,4,5,nan", ""]
)
def test_malformed_extrinsics_are_told(make: Any, tmp_path: Path, text: str) -> None:
    path = make.mcap(tmp_path / "log.mcap", make.drive(3))
    with pytest.raises(UsageError, match="parent>child:x,y,z,roll,pitch,yaw"):
        read(path, extrinsics=(text,))


def test_a_log_of_raw_packets_names_the_driver(real_data: Callable[[str], Path]) -> None:
    with pytest.raises(AdcbfError, match="velodyne_pointcloud"):
        read(real_data("nebula/vlp16/1673400471837873222"))


def test_real_city_street(real_data: Callable[[str], Path]) -> None:
    frames, reader, notes = read(real_data("kitti0000/kitti0000_a.mcap"))
    assert notes == Notes()
    assert len(frames) == reader.expected_frames == 77
    assert (reader.selection.pose, reader.selection.sensor_frame) == ("/odom", "velo_link")
    assert all(50_000 < len(frame.points_m) < 70_000 for frame in frames)
    travelled = frames[-1].world_from_sensor[:2, 3] - frames[0].world_from_sensor[:2, 3]
    assert 20 < float(np.hypot(*travelled)) < 40


def test_real_scaled_cars(real_data: Callable[[str], Path]) -> None:
    path = real_data("datmo/overtakes.bag")
    with pytest.raises(UsageError, match="--pose /ego_pose, --pose /red_pose"):
        read(path)
    frames, _, notes = read(path, pose="/ego_pose")
    assert len(frames) == 339
    assert len(notes.warnings) == 1
    assert "--extrinsic" in notes.warnings[0]


def test_real_uncalibrated_motion_capture(real_data: Callable[[str], Path]) -> None:
    """Empty frame ids; the sensor hangs on base_link by a static transform; the pose topic starts late."""
    frames, reader, notes = read(real_data("datmo/two_robots.bag"), pose="robot_1")
    assert (reader.selection.pose, reader.selection.world_frame) == ("/robot_1", "world")
    assert len(frames) > 300
    assert not notes.losses


def test_real_three_lasers_as_one(real_data: Callable[[str], Path]) -> None:
    path = real_data("leg_tracker/negative_2.bag")
    with pytest.raises(UsageError, match="--lidar /left_scan"):
        read(path)
    frames, _, notes = read(path, lidar=("/left_scan", "/right_scan"))
    assert len(frames) == 435
    assert any("left_laser>right_laser" in warning for warning in notes.warnings)


@pytest.mark.parametrize(
    ("name", "count", "pose"),
    [
        ("leg_tracker/positive_1.bag", 400, "none"),
        ("tamu_people/example1", 117, "tf"),
        ("neato/neato_c-mawn/person_follower_bag", 172, "/odom"),
    ],
)
def test_real_lasers(real_data: Callable[[str], Path], name: str, count: int, pose: str) -> None:
    frames, reader, notes = read(real_data(name))
    assert (len(frames), reader.selection.pose) == (count, pose)
    assert all(frame.planar for frame in frames)
    assert not notes.losses
