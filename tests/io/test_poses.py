"""Pose topics and pose files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.types import Notes
from adcbf_cli.io.poses import read_kitti_poses, read_pose_topic, read_tum, seconds_to_ns

T0 = 1_700_000_000_000_000_000


@pytest.mark.parametrize("kind", ["odometry", "pose", "covariance", "transform"])
def test_every_pose_type(make: Any, tmp_path: Path, kind: str) -> None:
    def message(i: int) -> Any:
        if kind == "odometry":
            return make.odometry((i, 2, 3), 0.1 * i, T0 + i, "/odom", "/base")
        if kind == "transform":
            return make.tf([("odom", "base", (i, 2, 3), 0.1 * i)], T0 + i).transforms[0]
        pose = make.pose((i, 2, 3), 0.1 * i, T0 + i, "odom")
        if kind == "pose":
            return pose
        inner = make.new("geometry_msgs/msg/PoseWithCovariance", pose=pose.pose, covariance=np.zeros(36))
        return make.new("geometry_msgs/msg/PoseWithCovarianceStamped", header=pose.header, pose=inner)

    entries = [("/p", message(i), T0 + 1000 - i) for i in range(4)]
    path = make.mcap(tmp_path / "log.mcap", entries)
    poses = read_pose_topic(path, "p", Notes())
    assert poses.stamp_ns.tolist() == [T0, T0 + 1, T0 + 2, T0 + 3]
    np.testing.assert_allclose(poses.position_m, [[i, 2, 3] for i in range(4)])
    np.testing.assert_allclose(Rotation.from_quat(poses.quaternion_xyzw).as_euler("xyz")[:, 2], [0, 0.1, 0.2, 0.3])
    assert poses.frame_id == "odom"
    assert poses.child == ("base" if kind in ("odometry", "transform") else "")


def test_topics_that_are_no_poses(make: Any, tmp_path: Path) -> None:
    path = make.mcap(tmp_path / "log.mcap", make.drive(3))
    with pytest.raises(UsageError, match="pose topics: /odom"):
        read_pose_topic(path, "/nothing", Notes())
    with pytest.raises(UsageError, match="PointCloud2"):
        read_pose_topic(path, "/points", Notes())


def test_tum_keeps_nanoseconds_and_normalises(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text("# c\n1700000000.000000002 1 2 3 0 0 0 2\n\n1700000000.000000001,4,5,6,0,0,1,0\n")
    poses = read_tum(path)
    assert poses.stamp_ns.tolist() == [T0 + 1, T0 + 2]
    np.testing.assert_array_equal(poses.position_m, [[4, 5, 6], [1, 2, 3]])
    np.testing.assert_array_equal(poses.quaternion_xyzw, [[0, 0, 1, 0], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    "text", ["1 2 3\n", "a 1 2 3 0 0 0 1\n", "1 1 2 3 0 0 0 0\n", "1 nan 2 3 0 0 0 1\n", "", "inf 1 2 3 0 0 0 1\n"]
)
def test_bad_tum_files_are_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.tum"
    path.write_text(text)
    with pytest.raises(AdcbfError) as caught:
        read_tum(path)
    assert "\n" not in str(caught.value)


def test_kitti_poses(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("1 0 0 1 0 1 0 2 0 0 1 3\n0 -1 0 4 1 0 0 5 0 0 1 6\n")
    poses = read_kitti_poses(path, np.array([10, 20]))
    assert poses.stamp_ns.tolist() == [10, 20]
    np.testing.assert_allclose(poses.position_m, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(Rotation.from_quat(poses.quaternion_xyzw[1]).as_euler("xyz"), [0, 0, np.pi / 2])
    path.write_text("2 0 0 1 0 1 0 2 0 0 1 3\n")
    with pytest.raises(AdcbfError, match="no rigid transforms"):
        read_kitti_poses(path, np.array([10]))


@pytest.mark.parametrize(
    ("text", "ns"),
    [("0", 0), ("1.5", 1_500_000_000), ("-1.25", -1_250_000_000), ("1700000000.123456789", T0 + 123456789)],
)
def test_decimal_seconds(text: str, ns: int) -> None:
    assert seconds_to_ns(text) == ns
    assert seconds_to_ns("1.7e9") == T0


def test_real_motion_capture(real_data: Callable[[str], Path]) -> None:
    poses = read_pose_topic(real_data("datmo/overtakes.bag"), "/red_pose", Notes())
    assert len(poses) == 3161
    assert poses.frame_id == "map"
    assert (np.diff(poses.stamp_ns) > 0).all()
