"""Which topics to take: pure functions from what a log holds to a choice with its reasons.

LiDAR: sensors before clouds that were computed from them, 3-D before 2-D, the names that drivers use before others.
Pose: odometry before pose topics before /tf before a localiser's corrections. Where two are equally good nothing is
guessed: the caller gets a UsageError that lists them with the flag for each.
"""

from __future__ import annotations

from dataclasses import dataclass

from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.io.ros_messages import LASER_SCAN, LIDAR_TYPES, ODOMETRY, POSE_COVARIANCE, POSE_TYPES

DRIVER_TOPICS = frozenset(
    {
        "velodyne_points",
        "points_raw",
        "points",
        "lidar_points",
        "os_cloud_node/points",
        "os1_cloud_node/points",
        "ouster/points",
        "rslidar_points",
        "hesai/pandar",
        "pandar",
        "pandar_points",
        "livox/lidar",
        "livox/points",
        "lidar/points",
        "scan",
        "base_scan",
        "front_laser/scan",
        "laser_scan",
    }
)
"""Names under which drivers publish the sensor's own data."""

_DERIVED_WORDS = (
    *("filtered", "project", "ground", "obstacle", "segment", "cluster", "downsample", "voxel", "map", "cropped"),
    *("accumulated", "registered", "stable", "assembled", "merged", "costmap", "deskew", "local"),
    *("depth", "camera", "stereo", "realsense", "rgbd", "zed"),
)
"""In a topic's name: computed from a LiDAR, or from a camera."""

_FIXED_FRAMES = frozenset({"map", "odom", "world", "earth", "odom_combined", "global"})

_NO_POSE_WORDS = ("goal", "target", "initialpose", "waypoint", "setpoint", "command", "cmd", "desired")

RAW_PACKETS = {
    "velodyne_msgs/msg/VelodyneScan": "velodyne_pointcloud (velodyne_transform_node)",
    "velodyne_msgs/msg/VelodynePacket": "velodyne_pointcloud (velodyne_transform_node)",
    "pandar_msgs/msg/PandarScan": "hesai_ros_driver or nebula",
    "pandar_msgs/msg/PandarPacket": "hesai_ros_driver or nebula",
    "hesai_ros_driver/msg/UdpFrame": "hesai_ros_driver",
    "hesai_ros_driver/msg/UdpPacket": "hesai_ros_driver",
    "hesai_lidar/msg/PandarScan": "hesai_lidar",
    "nebula_msgs/msg/NebulaPackets": "nebula",
    "ouster_msgs/msg/PacketMsg": "ouster-ros (os_cloud)",
    "ouster_sensor_msgs/msg/PacketMsg": "ouster-ros (os_cloud)",
    "ouster_ros/msg/PacketMsg": "ouster-ros (os_cloud)",
    "rslidar_msg/msg/RslidarPacket": "rslidar_sdk",
    "rslidar_msgs/msg/rslidarScan": "rslidar_sdk",
    "rslidar_msgs/msg/rslidarPacket": "rslidar_sdk",
    "robosense_msgs/msg/RobosenseScan": "nebula",
    "robosense_msgs/msg/RobosensePacket": "nebula",
    "lslidar_msgs/msg/LslidarScan": "lslidar_driver",
    "lslidar_msgs/msg/LslidarPacket": "lslidar_driver",
}
"""Types that carry a LiDAR's undecoded packets, and the driver that turns them into clouds."""


@dataclass(frozen=True)
class Candidate:
    """A topic that could be taken. frame_id: of its first message; child_frame_id: of an odometry."""

    topic: str
    msgtype: str
    frame_id: str = ""
    child_frame_id: str = ""


@dataclass(frozen=True)
class Choice:
    """What was taken and why; `topics` is empty where there was nothing to take."""

    topics: tuple[str, ...]
    reason: str


def raw_packet_driver(msgtype: str) -> str | None:
    """The driver that decodes this packet type; None for a type that is no packet."""
    return RAW_PACKETS.get(msgtype)


def choose_lidar(candidates: tuple[Candidate, ...], all_types: dict[str, str], asked: tuple[str, ...]) -> Choice:
    """The LiDAR topics: those asked for, or the one best candidate.

    candidates: topics of LiDAR types with at least one message; all_types: every topic of the log with its type.
    Raises UsageError for unknown topics and ties, AdcbfError where the log holds no LiDAR.
    """
    if asked:
        return Choice(
            tuple(_asked_topic(name, candidates, all_types) for name in asked),
            "--lidar" if len(asked) == 1 else f"--lidar; fused into the frame of {asked[0]}",
        )
    if not candidates:
        raise AdcbfError(_no_lidar(all_types))
    ranked = sorted(candidates, key=lambda item: (_lidar_rank(item), item.topic))
    best = [item for item in ranked if _lidar_rank(item) == _lidar_rank(ranked[0])]
    if len(best) > 1:
        listed = ", ".join(f"--lidar {item.topic} ({_described(item)})" for item in best)
        raise UsageError(f"several LiDAR topics are equally good; choose one, or several to fuse: {listed}")
    chosen = best[0]
    return Choice((chosen.topic,), _lidar_reason(chosen, ranked[1:]))


def _asked_topic(name: str, candidates: tuple[Candidate, ...], all_types: dict[str, str]) -> str:
    topic = match_topic(name, all_types)
    if topic is None:
        usable = ", ".join(item.topic for item in candidates) or "none"
        raise UsageError(f"--lidar {name}: there is no such topic in the log; LiDAR topics are: {usable}")
    if topic not in {item.topic for item in candidates}:
        driver = raw_packet_driver(all_types[topic])
        if driver:
            raise UsageError(f"--lidar {name} holds raw packets ({all_types[topic]}); decode them first with {driver}")
        if all_types[topic] in LIDAR_TYPES:
            raise UsageError(f"--lidar {name}: the topic has no messages")
        raise UsageError(f"--lidar {name} is a {all_types[topic]}, not a PointCloud2, LaserScan or Livox CustomMsg")
    return topic


def match_topic(name: str, topics: dict[str, str]) -> str | None:
    """A topic by its name, with or without the leading slash."""
    return next((known for known in (name, f"/{name}", name.lstrip("/")) if known in topics), None)


def _lidar_rank(item: Candidate) -> tuple[int, int, int]:
    """Smaller is better: (derived, planar, not a driver's name)."""
    return int(is_derived(item)), int(item.msgtype == LASER_SCAN), int(item.topic.strip("/") not in DRIVER_TOPICS)


def is_derived(item: Candidate) -> bool:
    """A cloud in a fixed frame, or with a name that says it was computed: not the sensor's own data."""
    if item.topic.strip("/") in DRIVER_TOPICS:
        return item.frame_id in _FIXED_FRAMES
    name = item.topic.lower()
    return item.frame_id in _FIXED_FRAMES or any(word in name for word in _DERIVED_WORDS)


def _lidar_reason(chosen: Candidate, others: list[Candidate]) -> str:
    if not others:
        return "the only LiDAR topic"
    best, rank = _lidar_rank(others[0]), _lidar_rank(chosen)
    why = (
        "others are derived clouds"
        if best[0] > rank[0]
        else "3-D before 2-D"
        if best[1] > rank[1]
        else "the name a driver uses"
    )
    return f"{why}; not taken: {', '.join(item.topic for item in others)}"


def _described(item: Candidate) -> str:
    kind = item.msgtype.rsplit("/", 1)[-1]
    return f"{kind} in '{item.frame_id}'" if item.frame_id else kind


def _no_lidar(all_types: dict[str, str]) -> str:
    packets = [(topic, kind) for topic, kind in sorted(all_types.items()) if raw_packet_driver(kind)]
    if packets:
        topic, kind = packets[0]
        return (
            f"the log's LiDAR topic {topic} holds raw packets ({kind}), not point clouds; "
            f"decode them first with {raw_packet_driver(kind)}, recording its PointCloud2 topic"
        )
    silent = [topic for topic, kind in sorted(all_types.items()) if kind in LIDAR_TYPES]
    if silent:
        return f"the log's LiDAR topic {silent[0]} has no messages"
    listed = ", ".join(f"{topic} ({kind.rsplit('/', 1)[-1]})" for topic, kind in sorted(all_types.items()))
    return (
        f"the log holds no LiDAR topic (PointCloud2, LaserScan or Livox CustomMsg); its topics are: {listed or 'none'}"
    )


def choose_pose(
    candidates: tuple[Candidate, ...], asked: str | None, all_types: dict[str, str], tf_moves: bool
) -> Choice:
    """The pose source: a topic, 'tf' or 'none'.

    candidates: topics of pose types with at least two messages; tf_moves: whether /tf carries the sensor through a
    fixed frame. Raises UsageError for unknown topics and ties.
    """
    if asked is not None:
        if asked in ("tf", "none"):
            return Choice((asked,), f"--pose {asked}")
        topic = match_topic(asked, all_types)
        if topic is None or all_types[topic] not in POSE_TYPES:
            usable = ", ".join([*(item.topic for item in candidates), "tf", "none"])
            what = "there is no such topic in the log" if topic is None else f"is a {all_types[topic]}, not a pose"
            raise UsageError(f"--pose {asked}: {what}; possible are: {usable}")
        return Choice((topic,), "--pose")
    usable_topics = [item for item in candidates if not _is_command(item.topic)]
    tiers = {kind: [item for item in usable_topics if _pose_tier(item) == kind] for kind in _POSE_TIERS}
    for kind, tier in tiers.items():
        if kind == "localisation" and tf_moves:
            break
        if tier:
            return _best_pose(kind, tier, usable_topics)
    if tf_moves:
        return Choice(("tf",), "no odometry or pose topic; /tf carries the sensor")
    return Choice(("none",), "the log has no odometry, pose topic or moving tf that reaches the sensor")


_POSE_TIERS = ("odometry", "pose", "localisation")
"""The best first; /tf comes before a localiser's sparse corrections (PoseWithCovarianceStamped)."""


def _pose_tier(item: Candidate) -> str:
    if item.msgtype == ODOMETRY:
        return "odometry"
    return "localisation" if item.msgtype == POSE_COVARIANCE else "pose"


def _best_pose(kind: str, tier: list[Candidate], usable: list[Candidate]) -> Choice:
    """The one topic of a tier, or the one with the plain name. Raises UsageError where there are several."""
    named = [item for item in tier if item.topic.strip("/") == "odom"]
    chosen = named if named else tier
    if len(chosen) > 1:
        listed = ", ".join(f"--pose {item.topic}" for item in sorted(chosen, key=lambda item: item.topic))
        raise UsageError(
            f"several {kind} topics could be the sensor's; choose one: {listed}, or --pose none (standing still)"
        )
    others = [item.topic for item in usable if item is not chosen[0]]
    rest = f"; not taken: {', '.join(others)}" if others else ""
    return Choice((chosen[0].topic,), f"the {'only ' if len(tier) == 1 else ''}{kind} topic{rest}")


def _is_command(topic: str) -> bool:
    """Poses that somebody wants, not poses that were measured."""
    return any(word in topic.lower() for word in _NO_POSE_WORDS)
