"""Writes sensor logs as ROS 2 bags in MCAP: clouds, laser scans, odometry, tf.

The bytes depend on what is written and on nothing else: no clock, no library version in the
header. Chunks are compressed with zstd; another release of that library may compress differently.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adcbf_cli.core.frames import quaternion_from_rotation
from adcbf_cli.core.simulation.odometry import as_recorded
from adcbf_cli.core.types import FloatArray, Scan
from adcbf_cli.io.atomic import atomic_path

NS_PER_S = 1_000_000_000

CLOUD = "sensor_msgs/msg/PointCloud2"
LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"

LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n  deadline:\n    sec: 9223372036\n"
    "    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  liveliness: 1\n"
    "  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  avoid_ros_namespace_conventions: false"
)
"""rosbag2's notation for transient-local, so that a replayed /tf_static reaches late subscribers."""


@dataclass(frozen=True, slots=True)
class LaserSweep:
    """What a LaserScan message says besides its ranges; angles in rad, times in s."""

    first_rad: float
    step_rad: float
    ray_time_s: float
    scan_time_s: float
    min_range_m: float
    max_range_m: float


class LogWriter:
    """Serialises messages into an open MCAP writer. Get one from `open_log`.

    types: the message classes, by name.
    """

    def __init__(self, writer: Any) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._writer = writer
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self.types: dict[str, Any] = dict(self._store.types)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}

    def write_cloud(self, scan: Scan, log_ns: int) -> None:
        """A PointCloud2 of x, y, z (float32, m) and, where the scan has times, t (uint32, ns after the
        stamp). Offsets must not be negative."""
        names = ["x", "y", "z"] + (["t"] if scan.offset_ns is not None else [])
        layout = np.dtype([(name, "<u4" if name == "t" else "<f4") for name in names])
        rows = np.empty(len(scan.points_m), dtype=layout)
        for axis, name in enumerate("xyz"):
            rows[name] = scan.points_m[:, axis]
        if scan.offset_ns is not None:
            if (scan.offset_ns < 0).any():
                raise ValueError("a point's time must not lie before its scan's stamp")
            rows["t"] = scan.offset_ns
        fields = {name: (4 * place, layout[name].str) for place, name in enumerate(names)}
        self.write_points(scan.topic, self.header(scan.stamp_ns, scan.frame_id), rows, fields, log_ns)

    def write_points(
        self, topic: str, header: Any, rows: np.ndarray, fields: Mapping[str, tuple[int, str]], log_ns: int
    ) -> None:
        """A PointCloud2 of packed rows (n,) of a structured type; fields: by name, offset in bytes and numpy's type."""
        field = self.types["sensor_msgs/msg/PointField"]
        kinds = {"<f4": field.FLOAT32, "<i4": field.INT32, "<u4": field.UINT32}
        message = self.types[CLOUD](
            header=header,
            height=1,
            width=len(rows),
            fields=[
                field(name=name, offset=offset, datatype=kinds[kind], count=1)
                for name, (offset, kind) in fields.items()
            ],
            is_bigendian=False,
            point_step=rows.itemsize,
            row_step=rows.nbytes,
            data=rows.view(np.uint8).reshape(-1),
            is_dense=True,
        )
        self.write(topic, CLOUD, message, log_ns)

    def write_laser_scan(
        self, topic: str, frame_id: str, stamp_ns: int, log_ns: int, range_m: FloatArray, sweep: LaserSweep
    ) -> None:
        """A LaserScan; range_m (n,) holds inf where nothing came back."""
        message = self.types[LASER_SCAN](
            header=self.header(stamp_ns, frame_id),
            angle_min=sweep.first_rad,
            angle_max=sweep.first_rad + sweep.step_rad * (len(range_m) - 1),
            angle_increment=sweep.step_rad,
            time_increment=sweep.ray_time_s,
            scan_time=sweep.scan_time_s,
            range_min=sweep.min_range_m,
            range_max=sweep.max_range_m,
            ranges=range_m.astype(np.float32),
            intensities=np.zeros(0, dtype=np.float32),
        )
        self.write(topic, LASER_SCAN, message, log_ns)

    def write_odometry(
        self,
        topic: str,
        frame_id: str,
        child: str,
        stamp_ns: int,
        pose: FloatArray,
        speed_mps: float,
        turn_radps: float,
    ) -> None:
        """An Odometry message: pose (4, 4) of child in frame_id, forward speed and turn rate of child."""
        types = self.types
        vector = types["geometry_msgs/msg/Vector3"]
        forward, turn = as_recorded(np.array([speed_mps, turn_radps]))
        twist = types["geometry_msgs/msg/Twist"](
            linear=vector(x=forward, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=turn)
        )
        x, y, z = as_recorded(pose[:3, 3])
        place = types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z), orientation=self._quaternion(pose)
        )
        unknown = np.zeros(36)
        message = types[ODOMETRY](
            header=self.header(stamp_ns, frame_id),
            child_frame_id=child,
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=place, covariance=unknown),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=unknown),
        )
        self.write(topic, ODOMETRY, message, stamp_ns)

    def write_transform(self, parent: str, child: str, stamp_ns: int, pose: FloatArray, static: bool = False) -> None:
        """One transform (4 x 4, parent_from_child) on /tf or /tf_static."""
        types = self.types
        x, y, z = as_recorded(pose[:3, 3])
        transform = types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z), rotation=self._quaternion(pose)
        )
        stamped = types["geometry_msgs/msg/TransformStamped"](
            header=self.header(stamp_ns, parent), child_frame_id=child, transform=transform
        )
        topic = "/tf_static" if static else "/tf"
        self.write(topic, TF, types[TF](transforms=[stamped]), stamp_ns, latched=static)

    def _quaternion(self, pose: FloatArray) -> Any:
        x, y, z, w = as_recorded(quaternion_from_rotation(pose[:3, :3]))
        return self.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """A std_msgs/msg/Header."""
        seconds, rest = divmod(int(stamp_ns), NS_PER_S)
        stamp = self.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
        return self.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)

    def write(self, topic: str, msgtype: str, message: Any, log_ns: int, latched: bool = False) -> None:
        """Any message that ROS 2's common packages define, made of `types`; a topic's messages are all of one type."""
        if topic not in self._channels:
            metadata = {"offered_qos_profiles": LATCHED if latched else ""}
            self._channels[topic] = self._writer.register_channel(
                topic=topic, message_encoding="cdr", schema_id=self._schema(msgtype), metadata=metadata
            )
            self._sequence[topic] = 0
        self._writer.add_message(
            channel_id=self._channels[topic],
            log_time=int(log_ns),
            publish_time=int(log_ns),
            data=bytes(self._store.serialize_cdr(message, msgtype)),
            sequence=self._sequence[topic],
        )
        self._sequence[topic] += 1

    def _schema(self, msgtype: str) -> int:
        if msgtype not in self._schemas:
            text, _ = self._store.generate_msgdef(msgtype, ros_version=2)
            self._schemas[msgtype] = self._writer.register_schema(name=msgtype, encoding="ros2msg", data=text.encode())
        return self._schemas[msgtype]


@contextmanager
def open_log(path: Path) -> Iterator[LogWriter]:
    """A log to write, which appears at `path` when it is complete. Messages must come in the order of
    their log times for readers to be fast."""
    from mcap.writer import CompressionType, Writer

    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        writer: Any = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="adcbf")
        yield LogWriter(writer)
        writer.finish()
