"""Makes small logs in every container, from plain Python values, with the reference writers (mcap, rosbags)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

T0 = 1_700_000_000_000_000_000
SECOND = 1_000_000_000
NUMPY_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}

Entry = tuple[str, Any, int]
"""Topic, message, recording time."""


class LogMaker:
    """Builds ROS messages and writes them into logs. ros1=True: with ROS 1's header and encoding."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self.ros2 = get_typestore(Stores.ROS2_HUMBLE)
        self.ros1 = get_typestore(Stores.ROS1_NOETIC)
        self.ros1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
        point = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line\n"
        livox = (
            "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n"
            "livox_ros_driver2/CustomPoint[] points\n"
        )
        for store in (self.ros1, self.ros2):
            store.register(get_types_from_msg(point, "livox_ros_driver2/msg/CustomPoint"))
            store.register(get_types_from_msg(livox, "livox_ros_driver2/msg/CustomMsg"))
            store.register(get_types_from_msg("uint8 left\nstring note\n", "vendor_msgs/msg/Bump"))

    def new(self, msgtype: str, /, ros1: bool = False, **fields: Any) -> Any:
        return (self.ros1 if ros1 else self.ros2).types[msgtype](**fields)

    def header(self, stamp_ns: int, frame_id: str, ros1: bool = False) -> Any:
        seq = {"seq": 0} if ros1 else {}
        stamp = self.new("builtin_interfaces/msg/Time", ros1, sec=stamp_ns // SECOND, nanosec=stamp_ns % SECOND)
        return self.new("std_msgs/msg/Header", ros1, **seq, stamp=stamp, frame_id=frame_id)

    def cloud(
        self,
        rows: np.ndarray[Any, Any],
        stamp_ns: int = T0,
        frame_id: str = "lidar",
        ros1: bool = False,
        **changes: Any,
    ) -> Any:
        """A PointCloud2 of a structured array (n,) or (h, w); its dtype gives the layout."""
        grid = np.atleast_2d(rows)
        assert rows.dtype.fields is not None
        fields = []
        big = False
        for name, (kind, offset, *_) in rows.dtype.fields.items():
            base, shape = kind.subdtype or (kind, ())
            big = big or base.byteorder == ">"
            fields.append(
                self.new(
                    "sensor_msgs/msg/PointField",
                    ros1,
                    name=name,
                    offset=offset,
                    datatype=NUMPY_CODES[base.str[1:]],
                    count=int(np.prod(shape, dtype=int)),
                )
            )
        values = {
            "header": self.header(stamp_ns, frame_id, ros1),
            "height": grid.shape[0],
            "width": grid.shape[1],
            "fields": fields,
            "is_bigendian": big,
            "point_step": rows.dtype.itemsize,
            "row_step": rows.dtype.itemsize * grid.shape[1],
            "data": np.frombuffer(grid.tobytes(), dtype=np.uint8),
            "is_dense": False,
        }
        return self.new("sensor_msgs/msg/PointCloud2", ros1, **{**values, **changes})

    def points(self, xyz: Any, stamp_ns: int = T0, frame_id: str = "lidar", ros1: bool = False) -> Any:
        """A plain x, y, z float32 cloud."""
        table = np.atleast_2d(np.asarray(xyz, dtype=np.float32))
        rows = np.zeros(len(table), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
        for i, name in enumerate("xyz"):
            rows[name] = table[:, i]
        return self.cloud(rows, stamp_ns, frame_id, ros1)

    def laser(
        self, ranges: Sequence[float], stamp_ns: int = T0, frame_id: str = "laser", ros1: bool = False, **changes: Any
    ) -> Any:
        values = {
            "header": self.header(stamp_ns, frame_id, ros1),
            "angle_min": -0.5,
            "angle_max": 0.5,
            "angle_increment": 0.1,
            "time_increment": 0.0,
            "scan_time": 0.1,
            "range_min": 0.1,
            "range_max": 10.0,
            "ranges": np.asarray(ranges, dtype=np.float32),
            "intensities": np.zeros(0, dtype=np.float32),
        }
        return self.new("sensor_msgs/msg/LaserScan", ros1, **{**values, **changes})

    def pose_parts(self, xyz: Any, yaw: float, ros1: bool = False) -> tuple[Any, Any, Any]:
        x, y, z = (float(value) for value in xyz)
        point = self.new("geometry_msgs/msg/Point", ros1, x=x, y=y, z=z)
        vector = self.new("geometry_msgs/msg/Vector3", ros1, x=x, y=y, z=z)
        turn = self.new(
            "geometry_msgs/msg/Quaternion", ros1, x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
        )
        return point, vector, turn

    def pose(self, xyz: Any, yaw: float, stamp_ns: int, frame_id: str = "map", ros1: bool = False) -> Any:
        point, _, turn = self.pose_parts(xyz, yaw, ros1)
        pose = self.new("geometry_msgs/msg/Pose", ros1, position=point, orientation=turn)
        return self.new("geometry_msgs/msg/PoseStamped", ros1, header=self.header(stamp_ns, frame_id, ros1), pose=pose)

    def odometry(
        self, xyz: Any, yaw: float, stamp_ns: int, frame_id: str = "odom", child: str = "base_link", ros1: bool = False
    ) -> Any:
        pose = self.pose(xyz, yaw, stamp_ns, frame_id, ros1)
        zero = self.new("geometry_msgs/msg/Vector3", ros1, x=0.0, y=0.0, z=0.0)
        twist = self.new("geometry_msgs/msg/Twist", ros1, linear=zero, angular=zero)
        return self.new(
            "nav_msgs/msg/Odometry",
            ros1,
            header=pose.header,
            child_frame_id=child,
            pose=self.new("geometry_msgs/msg/PoseWithCovariance", ros1, pose=pose.pose, covariance=np.zeros(36)),
            twist=self.new("geometry_msgs/msg/TwistWithCovariance", ros1, twist=twist, covariance=np.zeros(36)),
        )

    def tf(self, edges: Iterable[tuple[str, str, Any, float]], stamp_ns: int, ros1: bool = False) -> Any:
        """edges: (parent, child, xyz, yaw)."""
        items = []
        for parent, child, xyz, yaw in edges:
            _, vector, turn = self.pose_parts(xyz, yaw, ros1)
            transform = self.new("geometry_msgs/msg/Transform", ros1, translation=vector, rotation=turn)
            items.append(
                self.new(
                    "geometry_msgs/msg/TransformStamped",
                    ros1,
                    header=self.header(stamp_ns, parent, ros1),
                    child_frame_id=child,
                    transform=transform,
                )
            )
        return self.new("tf2_msgs/msg/TFMessage", ros1, transforms=items)

    def encode(self, message: Any, ros1: bool = False) -> bytes:
        kind = message.__msgtype__
        return bytes(self.ros1.serialize_ros1(message, kind) if ros1 else self.ros2.serialize_cdr(message, kind))

    def mcap(
        self,
        path: Path,
        entries: Iterable[Entry],
        compression: str = "none",
        chunk_bytes: int = 1 << 20,
        ros1: bool = False,
        **options: Any,
    ) -> Path:
        from mcap.writer import CompressionType, Writer

        with path.open("wb") as stream:
            writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType[compression.upper()], **options)
            writer.start()
            channels: dict[str, int] = {}
            for topic, message, log_ns in entries:
                if topic not in channels:
                    kind = message.__msgtype__
                    text = (self.ros1 if ros1 else self.ros2).generate_msgdef(kind, 1 if ros1 else 2)[0]
                    name = kind.replace("/msg/", "/") if ros1 else kind
                    schema = writer.register_schema(name, "ros1msg" if ros1 else "ros2msg", text.encode())
                    channels[topic] = writer.register_channel(topic, "ros1" if ros1 else "cdr", schema)
                writer.add_message(channels[topic], log_ns, self.encode(message, ros1), log_ns)
            writer.finish()
        return path

    def bag(self, path: Path, entries: Iterable[Entry], compression: str = "none", chunk_bytes: int = 1 << 20) -> Path:
        from rosbags.rosbag1 import Writer

        writer = Writer(path)
        if compression != "none":
            writer.set_compression(Writer.CompressionFormat[compression.upper()])
        writer.chunk_threshold = chunk_bytes
        with writer:
            connections: dict[str, Any] = {}
            for topic, message, log_ns in entries:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=self.ros1)
                writer.write(connections[topic], log_ns, self.encode(message, ros1=True))
        return path

    def rosbag2(self, folder: Path, entries: Iterable[Entry], storage: str = "sqlite3", compression: str = "") -> Path:
        """compression: '', 'file' or 'message' (zstd)."""
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

        plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
        writer = Writer(folder, version=9, storage_plugin=plugin)
        if compression:
            writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
        with writer:
            connections: dict[str, Any] = {}
            for topic, message, log_ns in entries:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=self.ros2)
                writer.write(connections[topic], log_ns, self.encode(message))
        return folder

    def drive(self, scans: int = 10, ros1: bool = False, padding: int = 0) -> list[Entry]:
        """A robot that drives along x at 1 m/s with its LiDAR 0.5 m ahead of and 1 m above its base, past a post at
        (5, 2, 1) in odom: scans and odometry at 10 Hz, one vendor message in between."""
        entries: list[Entry] = [
            ("/tf_static", self.tf([("base_link", "lidar", (0.5, 0.0, 1.0), 0.0)], T0, ros1), T0),
        ]
        for i in range(scans):
            at = T0 + i * SECOND // 10
            x = 0.1 * i
            entries.append(("/odom", self.odometry((x, 0.0, 0.0), 0.0, at, ros1=ros1), at))
            cloud = [[5.0 - x - 0.5, 2.0, 0.0]] + [[1.0 + k, -3.0, 0.5] for k in range(padding)]
            entries.append(("/points", self.points(cloud, at, ros1=ros1), at + 1000))
            note = "x" * (i % 256)
            entries.append(("/bump", self.new("vendor_msgs/msg/Bump", ros1, left=i % 256, note=note), at + 2000))
        return entries


@pytest.fixture(scope="session")
def make() -> LogMaker:
    return LogMaker()
