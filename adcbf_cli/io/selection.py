"""What to read from a log: looks into its connections, first messages and transforms, and decides with reasons."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.frames import TfBuffer, clean_frame_id
from adcbf_cli.core.types import Notes
from adcbf_cli.io.detect import Candidate, choose_lidar, choose_pose
from adcbf_cli.io.log_base import Log
from adcbf_cli.io.placement import Extrinsic, Placement, parse_extrinsic
from adcbf_cli.io.pointcloud import ScanDecoder
from adcbf_cli.io.ros_messages import LIDAR_TYPES, POSE_TYPES, TF, Undecodable, transforms

_TF_PEEK = 2000
_TF_PEEK_NS = 5_000_000_000
"""So many messages of /tf, or so long a beginning of the log, are looked at to learn the tree."""

_WORLD_NAMES = ("odom", "map", "world", "earth")
"""Fixed frames, the smoothest first: odom does not jump when a localisation corrects itself."""

_BASE_NAMES = ("base_link", "base_footprint")
_UNNAMED_SENSOR = "sensor"


@dataclass(frozen=True)
class Selection:
    """What is taken from the log. pose: a topic, 'tf', 'poses file' or 'none'; reasons: what was taken, why, and
    which flag overrides it."""

    lidar: tuple[str, ...]
    pose: str
    world_frame: str
    sensor_frame: str
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class Plan:
    """A selection with what the reader needs to follow it."""

    selection: Selection
    placement: Placement
    sensor_frames: dict[str, str]
    tf_topics: tuple[str, ...]


def plan_reading(log: Log, config: ReadConfig, notes: Notes) -> Plan:
    """Choose topics and frames. Raises UsageError (ambiguous, unknown) and AdcbfError (no LiDAR)."""
    all_types = {connection.topic: connection.msgtype for connection in log.connections}
    lidars = lidar_candidates(log)
    lidar = choose_lidar(lidars, all_types, config.lidar)
    extrinsics = [parse_extrinsic(text) for text in config.extrinsics]
    frames = {item.topic: item.frame_id for item in lidars}
    sensors = {topic: _sensor_frame(frames[topic], extrinsics) for topic in lidar.topics}
    sensor = sensors[lidar.topics[0]]
    statics = static_transforms(log, extrinsics)
    poses = pose_candidates(log)
    tree = statics if _statics_suffice(statics, poses, sensors, config) else tf_tree(log, statics)
    world_by_tf = _tf_world(tree, sensor, config.world_frame)
    pose = choose_pose(poses, config.pose, all_types, world_by_tf is not None)
    source = pose.topics[0]
    if source == "none" and config.pose is None:
        notes.warn(f"no pose source ({pose.reason}): the sensor is taken to stand still; --pose names one")
    placement = _place(source, poses, tree, statics, world_by_tf, sensors, config, notes)
    reasons = (
        f"LiDAR {', '.join(lidar.topics)}: {lidar.reason} (--lidar)",
        f"pose {source}: {pose.reason} (--pose)",
        f"world frame {placement.world}, sensor frame {sensor} (--world-frame, --extrinsic)",
    )
    selection = Selection(lidar.topics, source, placement.world, sensor, reasons)
    tf_topics: tuple[str, ...] = ()
    if _follows_tf(placement, tree):
        tf_topics = tuple(c.topic for c in log.connections if c.msgtype in TF and not _is_static(c.topic))
    return Plan(selection, placement, sensors, tf_topics)


def _statics_suffice(
    statics: TfBuffer, poses: tuple[Candidate, ...], sensors: dict[str, str], config: ReadConfig
) -> bool:
    """Whether /tf need not be looked at: any pose topic that may be chosen reaches the sensors by static transforms."""
    if config.pose == "tf" or config.world_frame is not None or not poses:
        return False
    return all(
        pose.child_frame_id and statics.connected(pose.child_frame_id, frame)
        for pose in poses
        for frame in sensors.values()
    )


def _follows_tf(placement: Placement, tree: TfBuffer) -> bool:
    """Whether moving transforms have a part in placing the sensors."""
    if placement.source == "tf" or placement.world != placement.pose_frame:
        return True
    return any(linked and tree.moving(placement.child, frame) for frame, linked in placement.linked.items())


def lidar_candidates(log: Log) -> tuple[Candidate, ...]:
    """The log's topics of LiDAR types that have messages, with the frame of the first that can be decoded."""
    found = []
    for connection in log.connections:
        if connection.msgtype not in LIDAR_TYPES:
            continue
        decoder = ScanDecoder(connection.topic, Notes())
        for message in islice(log.messages((connection.topic,)), 5):
            try:
                frame_id = decoder.scan(message).frame_id
            except Undecodable:
                frame_id = ""
                continue
            break
        else:
            if log.count(connection.topic) == 0:
                continue
            frame_id = ""
        found.append(Candidate(connection.topic, connection.msgtype, frame_id))
    return tuple(found)


def pose_candidates(log: Log) -> tuple[Candidate, ...]:
    """The log's topics of pose types with at least two messages."""
    found = []
    for connection in log.connections:
        if connection.msgtype not in POSE_TYPES:
            continue
        first = list(islice(log.messages((connection.topic,)), 2))
        if len(first) < 2:
            continue
        try:
            pose = next(transforms(first[0]), None)
        except Undecodable:
            pose = None
        frame_id, child = (pose.parent, pose.child) if pose else ("", "")
        found.append(Candidate(connection.topic, connection.msgtype, frame_id, child))
    return tuple(found)


def _sensor_frame(frame_id: str, extrinsics: list[Extrinsic]) -> str:
    if frame_id:
        return frame_id
    children = {item.child for item in extrinsics} - {item.parent for item in extrinsics}
    return children.pop() if len(children) == 1 else _UNNAMED_SENSOR


def static_transforms(log: Log, extrinsics: list[Extrinsic]) -> TfBuffer:
    """The log's static transforms, collected up front, with the user's extrinsics on top."""
    buffer = TfBuffer()
    topics = [c.topic for c in log.connections if c.msgtype in TF and _is_static(c.topic)]
    for message in log.messages(topics) if topics else ():
        try:
            for item in transforms(message):
                buffer.add_static(item.parent, item.child, item.matrix())
        except Undecodable as error:
            log.lose(f"{message.connection.topic}: undecodable transforms ({error})")
    for extrinsic in extrinsics:
        buffer.add_static(extrinsic.parent, extrinsic.child, extrinsic.parent_from_child, fixed=True)
    return buffer


def tf_tree(log: Log, statics: TfBuffer, limit: int = _TF_PEEK, limit_ns: int = _TF_PEEK_NS) -> TfBuffer:
    """The static tree joined with the moving edges that the beginning of /tf shows."""
    tree = statics.copy_static()
    topics = [c.topic for c in log.connections if c.msgtype in TF and not _is_static(c.topic)]
    until_ns: int | None = None
    for message in islice(log.messages(topics), limit) if topics else ():
        until_ns = message.log_ns + limit_ns if until_ns is None else until_ns
        if message.log_ns > until_ns:
            break
        try:
            for item in transforms(message):
                tree.add(item)
        except Undecodable:
            continue
    return tree


def _is_static(topic: str) -> bool:
    return "static" in topic.rsplit("/", 1)[-1]


def _tf_world(tree: TfBuffer, sensor: str, asked: str | None) -> str | None:
    """The fixed frame in which tf carries the sensor; None where it does not."""
    line = tree.ancestors(sensor)[1:]
    if asked is not None:
        return clean_frame_id(asked) if tree.connected(clean_frame_id(asked), sensor) else None
    named = [name for name in _WORLD_NAMES if name in line and tree.moving(name, sensor)]
    if named:
        return named[0]
    if line and tree.moving(line[-1], sensor) and not tree.at_rest(line[-1], sensor):
        return line[-1]
    return None


def _place(
    source: str,
    poses: tuple[Candidate, ...],
    tree: TfBuffer,
    statics: TfBuffer,
    world_by_tf: str | None,
    sensors: dict[str, str],
    config: ReadConfig,
    notes: Notes,
) -> Placement:
    gap_ns = round(config.max_pose_gap_s * 1e9)
    primary = next(iter(sensors.values()))
    asked = clean_frame_id(config.world_frame) if config.world_frame else None
    if source == "none":
        linked = {frame: frame != primary and tree.connected(primary, frame) for frame in sensors.values()}
        _warn_unlinked(linked, primary, {primary}, notes)
        return Placement("none", asked or primary, asked or primary, primary, linked, statics, gap_ns)
    if source == "tf":
        if world_by_tf is None:
            known = ", ".join(tree.frames()) or "none"
            to = f"from '{asked}' to" if asked else "above"
            raise UsageError(f"--pose tf: the log's tf has no moving transform {to} '{primary}'; its frames: {known}")
        for frame in sensors.values():
            if not tree.connected(world_by_tf, frame):
                raise UsageError(
                    f"tf does not join '{frame}' to '{world_by_tf}'; give --extrinsic '{primary}>{frame}:x,y,z,r,p,y'"
                )
        return Placement("tf", world_by_tf, world_by_tf, primary, {}, statics, gap_ns)
    pose = next((item for item in poses if item.topic == source), Candidate(source, ""))
    pose_frame = pose.frame_id or "world"
    world = asked or pose_frame
    if world != pose_frame and not tree.connected(world, pose_frame):
        raise UsageError(f"--world-frame {world}: tf does not join it to '{pose_frame}', the frame of {source}")
    child = _pose_child(pose, tree, primary)
    linked = {frame: frame != child and tree.connected(child, frame) for frame in sensors.values()}
    _warn_unlinked(linked, child, {child}, notes)
    return Placement("topic", world, pose_frame, child, linked, statics, gap_ns)


def _pose_child(pose: Candidate, tree: TfBuffer, sensor: str) -> str:
    """The frame that a pose topic carries: its child frame, or for poses without one a frame of the topic's name, the
    robot's base, or whatever the extrinsics and static transforms say the sensor hangs on."""
    if pose.child_frame_id:
        return pose.child_frame_id
    base = pose.topic.rsplit("/", 1)[-1]
    for name in (base, *_BASE_NAMES):
        if name != sensor and tree.connected(name, sensor):
            return name
    root = tree.ancestors(sensor)[-1]
    return root if root != sensor and root != pose.frame_id else base


def _warn_unlinked(linked: dict[str, bool], child: str, same: set[str], notes: Notes) -> None:
    for frame, is_linked in linked.items():
        if not is_linked and frame not in same:
            notes.warn(
                f"no transform joins the sensor '{frame}' to '{child}': they are taken to be the same; "
                f"--extrinsic '{child}>{frame}:x,y,z,roll,pitch,yaw' tells otherwise"
            )
