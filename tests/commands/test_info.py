"""`adcbf info` on made logs, on files that are no logs, and on every real file there is."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from adcbf_cli.commands.info import info
from adcbf_cli.core.errors import EXIT_DATA_LOST, AdcbfError

T0 = 1_700_000_000_000_000_000
STORE = get_typestore(Stores.ROS2_HUMBLE)


def new(msgtype: str, **fields: Any) -> Any:
    return STORE.types[msgtype](**fields)


def header(stamp_ns: int, frame_id: str) -> Any:
    stamp = new("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return new("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def laser(stamp_ns: int, frame_id: str) -> Any:
    numbers = {"angle_min": 0.0, "angle_max": 1.0, "angle_increment": 0.1, "time_increment": 0.0, "scan_time": 0.1}
    return new(
        "sensor_msgs/msg/LaserScan",
        header=header(stamp_ns, frame_id),
        **numbers,
        range_min=0.1,
        range_max=9.0,
        ranges=np.ones(11, np.float32),
        intensities=np.zeros(0, np.float32),
    )


def tf(stamp_ns: int, parent: str, child: str, x: float) -> Any:
    transform = new(
        "geometry_msgs/msg/Transform",
        translation=new("geometry_msgs/msg/Vector3", x=x, y=0.0, z=0.0),
        rotation=new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    item = new(
        "geometry_msgs/msg/TransformStamped",
        header=header(stamp_ns, parent),
        child_frame_id=child,
        transform=transform,
    )
    return new("tf2_msgs/msg/TFMessage", transforms=[item])


def write_log(path: Path, scan_topics: tuple[str, ...] = ("/scan",)) -> Path:
    """Two seconds of scans at 10 Hz with one left out, on a moving base."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        channels: dict[str, int] = {}

        def add(topic: str, message: Any, at: int) -> None:
            kind = message.__msgtype__
            if topic not in channels:
                schema = writer.register_schema(kind, "ros2msg", STORE.generate_msgdef(kind, 2)[0].encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], at, bytes(STORE.serialize_cdr(message, kind)), at)

        add("/tf_static", tf(T0, "base_link", "laser", 0.2), T0)
        for i in range(21):
            at = T0 + i * 100_000_000
            add("/tf", tf(at, "odom", "base_link", 0.1 * i), at)
            if i != 7:
                for topic in scan_topics:
                    add(topic, laser(at, "laser"), at)
        writer.finish()
    return path


def test_the_whole_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info(write_log(tmp_path / "log.mcap"))
    out = capsys.readouterr()
    assert out.err == ""
    assert "MCAP (uncompressed)" in out.out
    assert "42 messages, 2.0 s from 2023-11-14 22:13:20 UTC" in out.out
    row = next(line for line in out.out.splitlines() if line.strip().startswith("/scan"))
    assert row.split() == ["/scan", "sensor_msgs/msg/LaserScan", "20", "9.5", "0.200", "laser"]
    tree = out.out[out.out.index("Frames") :].splitlines()
    assert tree[1:4] == ["  odom", "     └─ base_link  (moving)", "        └─ laser  (static)"]
    assert "--lidar /scan --pose tf" in out.out


def test_json_is_one_document(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info(write_log(tmp_path / "log.mcap"), json_output=True)
    found = json.loads(capsys.readouterr().out)
    assert (found["messages"], found["start_ns"], found["end_ns"]) == (42, T0, T0 + 2_000_000_000)
    assert found["duration_s"] == pytest.approx(2.0)
    scan = next(topic for topic in found["topics"] if topic["name"] == "/scan")
    assert scan["rate_hz"] == pytest.approx(9.5)
    assert scan["largest_gap_s"] == pytest.approx(0.2)
    assert found["transforms"] == [
        {"parent": "base_link", "child": "laser", "how": "static"},
        {"parent": "odom", "child": "base_link", "how": "moving"},
    ]
    assert found["selection"]["lidar"] == ["/scan"]
    assert found["flags"] == ["--lidar", "/scan", "--pose", "tf"]
    assert found["problem"] is None


def test_an_ambiguous_log_is_shown_with_its_problem(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_log(tmp_path / "log.mcap", ("/left", "/right"))
    info(path)
    assert "--lidar /left" in capsys.readouterr().err
    info(path, json_output=True)
    found = json.loads(capsys.readouterr().out)
    assert found["selection"] is None
    assert "--lidar /right" in found["problem"]


def test_a_cut_log_ends_with_the_code_for_lost_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_log(tmp_path / "log.mcap")
    raw = path.read_bytes()
    path.write_bytes(raw[: raw.index(b"laser", len(raw) // 4)])
    with pytest.raises(typer.Exit) as ended:
        info(path)
    assert ended.value.exit_code == EXIT_DATA_LOST
    out = capsys.readouterr()
    assert "/scan" in out.out
    assert "lost:" in out.err


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("gt.csv", "timestamp_ns,track_id,x_m,y_m\n1,2,3,4\n", "--truth"),
        ("people.csv", "timestamp_ns,track_id,x_m,y_m\n1,2,3,4\n", "people.csv --start X,Y --goal X,Y"),
        ("0001.txt", "0 1 Car 0 0 -1.5 1 2 3 4 1.5 1.6 3.7 1 2 3 0.1\n", "--truth"),
        ("pose.tum", "1.0 1 2 3 0 0 0 1\n", "--pose FILE"),
        ("poses.txt", "1 0 0 1 0 1 0 2 0 0 1 3\n", "KITTI pose file"),
        ("calib.txt", "P0: 1 2 3\nTr_velo_cam 1 2\n", "calibration"),
        ("metadata.yaml", "rosbag2_bagfile_information:\n  version: 5\n", "the folder"),
        ("run.yaml", "tracking:\n  filter: ekf\n", "--config"),
        ("world.yaml", "duration_s: 3\nego: {}\nlidar: {}\n", "adcbf simulate"),
    ],
)
def test_files_that_other_options_take(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: str, words: str
) -> None:
    path = tmp_path / name
    path.write_text(content)
    info(path)
    out = capsys.readouterr()
    assert words in out.out
    assert out.out.count("\n") == 1
    info(path, json_output=True)
    assert words in json.loads(capsys.readouterr().out)["use"] + json.dumps(out.out)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.png", b"\x89PNG\r\n\x1a\n", "PNG image"),
        ("a.bin", b"\x00\x01\x02\x03" * 4, "binary point cloud"),
        ("a.feather", b"ARROW1\0\0", "Arrow"),
        ("a.clf.bz2", b"BZh91AY", "bzip2"),
        ("a.txt", b"some words\n", "not something that adcbf knows"),
        ("a.mcap", b"", "is empty"),
        ("nothing", None, "does not exist"),
    ],
)
def test_files_that_adcbf_has_no_use_for(tmp_path: Path, name: str, content: bytes | None, words: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(AdcbfError, match=words) as caught:
        info(path)
    assert "\n" not in str(caught.value)


REAL = [
    ("kitti0000/kitti0000_a.mcap", "--lidar /velodyne_points --pose /odom", ""),
    ("datmo/overtakes.bag", "map", "--pose /ego_pose, --pose /red_pose"),
    ("datmo/two_robots.bag", "/scan", "--pose /mocap_pose, --pose /robot_1, --pose /robot_2"),
    ("leg_tracker/negative_2.bag", "/left_scan", "--lidar /left_scan"),
    ("leg_tracker/positive_1.bag", "--lidar right_scan --pose none", "stand still"),
    ("tamu_people/example1", "--lidar /scan --pose tf", ""),
    ("neato/neato_c-mawn/person_follower_bag", "--lidar /scan --pose /odom", ""),
    ("nebula/vlp16/1673400471837873222", "velodyne_pointcloud", "raw packets"),
    ("nebula/xt32/1673400678101968885.pcd", "PCD scans", ""),
    ("evo/nav2_turtlebot.mcap", "/amcl_pose", "no LiDAR topic"),
    ("robot_localization/test1.bag", "NavSatFix", "no LiDAR topic"),
    ("kitti_labels/label/0001.txt", "--truth", ""),
    ("kitti0000/kitti0000_a_gt_tracks.csv", "--truth", ""),
]


@pytest.mark.parametrize(("name", "shown", "warned"), REAL)
def test_real_logs(
    real_data: Callable[[str], Path], capsys: pytest.CaptureFixture[str], name: str, shown: str, warned: str
) -> None:
    info(real_data(name))
    out = capsys.readouterr()
    assert shown in out.out
    assert warned in out.err


def test_every_real_file_gets_an_answer(real_data: Callable[[str], Path], capsys: pytest.CaptureFixture[str]) -> None:
    for path in sorted(real_data(".").rglob("*")):
        told = ""
        try:
            info(path, json_output=True)
            told = json.loads(capsys.readouterr().out)["kind"]
        except AdcbfError as error:
            told = str(error)
        assert told, path
        assert "\n" not in told, path
