"""ROS messages into plain values: decoding with rosbags' type stores, header stamps, poses and transforms.

Only standard types are decoded here, with the definitions that rosbags ships, so a vendor type without a definition
never stands in the way and no definition out of a log is executed.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from adcbf_cli.core.frames import StampedTransform, clean_frame_id
from adcbf_cli.io.log_base import Message

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
LIVOX = ("livox_ros_driver/msg/CustomMsg", "livox_ros_driver2/msg/CustomMsg", "livox_interfaces/msg/CustomMsg")
ODOMETRY = "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
PATH = "nav_msgs/msg/Path"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSE_TYPES = (ODOMETRY, POSE, POSE_COVARIANCE, TRANSFORM)
LIDAR_TYPES = (POINT_CLOUD, *LIVOX, LASER_SCAN)


class Undecodable(Exception):
    """A message whose bytes do not fit its type."""


def ros2_type_name(name: str) -> str:
    """'sensor_msgs/PointCloud2' (ROS 1) -> 'sensor_msgs/msg/PointCloud2'; ROS 2 names stay."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


@cache
def _store(encoding: str) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if encoding == "ros1":
        store = get_typestore(Stores.ROS1_NOETIC)
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF[0]))
        return store
    return get_typestore(Stores.ROS2_HUMBLE)


def decode(message: Message) -> Any:
    """The message as an object with ROS field names. Raises Undecodable."""
    msgtype, encoding = message.connection.msgtype, message.connection.encoding
    msgtype = TF[0] if msgtype in TF else msgtype
    if encoding not in ("cdr", "ros1"):
        raise Undecodable(f"encoding '{encoding}' is not a ROS encoding")
    store = _store(encoding)
    if msgtype not in store.fielddefs:
        raise Undecodable(f"type {msgtype} is not known")
    from rosbags.serde import SerdeError

    try:
        if encoding == "ros1":
            return store.deserialize_ros1(message.data, msgtype)
        return store.deserialize_cdr(message.data, msgtype)
    except (SerdeError, ValueError, AssertionError, IndexError) as error:
        raise Undecodable(str(error)) from error


def stamp_ns(header: Any, log_ns: int) -> int:
    """A header's stamp in nanoseconds; the recording time where the driver left it zero."""
    stamp = int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
    return stamp or log_ns


def transforms(message: Message) -> Iterator[StampedTransform]:
    """The transforms of a TFMessage or any pose message (an Odometry is odom -> base).

    A pose without a child frame gets the child ''. Raises Undecodable; transforms with non-finite values or a
    zero quaternion are left out.
    """
    decoded = decode(message)
    for item in decoded.transforms if hasattr(decoded, "transforms") else (decoded,):
        if hasattr(item, "transform"):
            position, rotation = item.transform.translation, item.transform.rotation
        else:
            pose = item.pose.pose if hasattr(item.pose, "pose") else item.pose
            position, rotation = pose.position, pose.orientation
        xyz = np.array([position.x, position.y, position.z])
        xyzw = np.array([rotation.x, rotation.y, rotation.z, rotation.w])
        norm = float(np.linalg.norm(xyzw))
        if not np.isfinite(xyz).all() or not np.isfinite(norm) or norm < 1e-6:
            continue
        yield StampedTransform(
            stamp_ns(item.header, message.log_ns),
            clean_frame_id(item.header.frame_id),
            clean_frame_id(getattr(item, "child_frame_id", "")),
            xyz,
            xyzw / norm,
        )
