"""What is taken from a log, as a table of cases: topics in, choice and reason out."""

from __future__ import annotations

import pytest

from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.io.detect import Candidate, choose_lidar, choose_pose

CLOUD, SCAN = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/LaserScan"
ODOM, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
LOCALISED = "geometry_msgs/msg/PoseWithCovarianceStamped"


def lidars(*items: tuple[str, str, str]) -> tuple[Candidate, ...]:
    return tuple(Candidate(topic, kind, frame) for topic, kind, frame in items)


def types(candidates: tuple[Candidate, ...]) -> dict[str, str]:
    return {item.topic: item.msgtype for item in candidates}


@pytest.mark.parametrize(
    ("candidates", "chosen", "why"),
    [
        ([("/anything", CLOUD, "lidar")], "/anything", "only"),
        ([("/velodyne_points", CLOUD, "v"), ("/scan", SCAN, "v")], "/velodyne_points", "3-D before 2-D"),
        ([("/scan", SCAN, "l"), ("/stable_scan", SCAN, "l"), ("/cloud", CLOUD, "odom")], "/scan", "derived"),
        ([("/points_raw", CLOUD, "v"), ("/points_filtered", CLOUD, "v")], "/points_raw", "derived"),
        ([("/camera/depth/points", CLOUD, "cam"), ("/laser", SCAN, "l")], "/laser", "derived"),
        ([("/os_cloud_node/points", CLOUD, "os"), ("/other", CLOUD, "os")], "/os_cloud_node/points", "driver"),
        ([("/merged_cloud", CLOUD, "base_link")], "/merged_cloud", "only"),
    ],
)
def test_the_best_lidar(candidates: list[tuple[str, str, str]], chosen: str, why: str) -> None:
    found = lidars(*candidates)
    choice = choose_lidar(found, types(found), ())
    assert choice.topics == (chosen,)
    assert why in choice.reason


def test_equally_good_lidars_are_listed_in_a_fixed_order() -> None:
    found = lidars(("/b_scan", SCAN, "b"), ("/a_scan", SCAN, "a"))
    with pytest.raises(UsageError, match=r"--lidar /a_scan \(LaserScan in 'a'\), --lidar /b_scan") as one:
        choose_lidar(found, types(found), ())
    with pytest.raises(UsageError) as other:
        choose_lidar(found[::-1], types(found), ())
    assert str(one.value) == str(other.value)


def test_asked_topics() -> None:
    found = lidars(("/a", CLOUD, "a"), ("b", SCAN, "b"))
    all_types = {**types(found), "/packets": "velodyne_msgs/msg/VelodyneScan", "/imu": "sensor_msgs/msg/Imu"}
    assert choose_lidar(found, all_types, ("a", "/b")).topics == ("/a", "b")
    for asked, words in (("/c", "LiDAR topics are: /a, b"), ("/packets", "velodyne_pointcloud"), ("/imu", "Imu")):
        with pytest.raises(UsageError, match=words):
            choose_lidar(found, all_types, (asked,))


def test_no_lidar_lists_what_there_is() -> None:
    with pytest.raises(AdcbfError, match=r"/imu \(Imu\)"):
        choose_lidar((), {"/imu": "sensor_msgs/msg/Imu"}, ())
    with pytest.raises(AdcbfError, match="nebula"):
        choose_lidar((), {"/p": "pandar_msgs/msg/PandarScan"}, ())


@pytest.mark.parametrize(
    ("candidates", "tf_moves", "chosen"),
    [
        ([("/odom", ODOM)], True, "/odom"),
        ([("/vo", ODOM), ("/ego_pose", POSE)], True, "/vo"),
        ([("/vo", ODOM), ("/odom", ODOM)], False, "/odom"),
        ([("/ego_pose", POSE), ("/goal_pose", POSE), ("/initialpose", POSE)], False, "/ego_pose"),
        ([], True, "tf"),
        ([], False, "none"),
        ([("/move_base/goal", POSE)], False, "none"),
        ([("/amcl_pose", LOCALISED)], True, "tf"),
        ([("/amcl_pose", LOCALISED)], False, "/amcl_pose"),
        ([("/amcl_pose", LOCALISED), ("/slam_pose", POSE)], True, "/slam_pose"),
    ],
)
def test_the_best_pose(candidates: list[tuple[str, str]], tf_moves: bool, chosen: str) -> None:
    found = tuple(Candidate(topic, kind) for topic, kind in candidates)
    assert choose_pose(found, None, types(found), tf_moves).topics == (chosen,)


def test_equally_good_poses_are_listed() -> None:
    found = (Candidate("/red_pose", POSE), Candidate("/ego_pose", POSE))
    with pytest.raises(UsageError, match="--pose /ego_pose, --pose /red_pose, or --pose none"):
        choose_pose(found, None, types(found), True)
    assert choose_pose(found, "red_pose", types(found), True).topics == ("/red_pose",)
    for asked in ("/blue_pose", "/scan"):
        with pytest.raises(UsageError, match="possible are: /red_pose, /ego_pose, tf, none"):
            choose_pose(found, asked, {**types(found), "/scan": SCAN}, True)


def test_a_lidar_topic_without_messages_is_named() -> None:
    with pytest.raises(AdcbfError, match="LiDAR topic /points has no messages"):
        choose_lidar((), {"/points": "sensor_msgs/msg/PointCloud2", "/odom": "nav_msgs/msg/Odometry"}, ())
