"""LiDAR messages into scans: PointCloud2 in every layout, LaserScan, Livox CustomMsg.

What counts as no return and is dropped, together with its time: NaN, infinity, and the point (0, 0, 0) that drivers
write for missing echoes; of a laser scan what lies outside [range_min, range_max).
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from adcbf_cli.core.frames import clean_frame_id
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray, Notes, Scan
from adcbf_cli.io.log_base import Message
from adcbf_cli.io.point_times import TIME_FIELDS, PointTimes
from adcbf_cli.io.ros_messages import LASER_SCAN, LIVOX, POINT_CLOUD, Undecodable, decode, stamp_ns

_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8", 9: "i8", 10: "u8", 11: "u1"}
"""sensor_msgs/PointField's datatypes; 9 to 11 are newer (INT64, UINT64, BOOLEAN)."""


class ScanDecoder:
    """Decodes one LiDAR topic; remembers the unit of its point times."""

    def __init__(self, topic: str, notes: Notes) -> None:
        self._times = PointTimes(topic, notes)

    def scan(self, message: Message) -> Scan:
        """One message -> Scan. Raises Undecodable."""
        msgtype = message.connection.msgtype
        if msgtype in LIVOX:
            return livox_scan(message)
        decoded = decode(message)
        if msgtype == POINT_CLOUD:
            return self._cloud(decoded, message)
        if msgtype == LASER_SCAN:
            return laser_scan(decoded, message)
        raise Undecodable(f"{msgtype} is not a LiDAR type")

    def _cloud(self, cloud: Any, message: Message) -> Scan:
        stamp = stamp_ns(cloud.header, message.log_ns)
        rows = cloud_rows(cloud)
        points, kept = finite_points([rows[name] for name in ("x", "y", "z")])
        name = next((name for name in TIME_FIELDS if name in (rows.dtype.names or ())), None)
        offsets = None
        if name is not None and rows.dtype[name].subdtype is None:
            column = rows[name] if kept is None else rows[name][kept]
            offsets = self._times.offsets_ns(name, column, stamp)
        planar = len(points) > 2 and bool(np.ptp(points[:, 2]) == 0.0)
        return Scan(stamp, clean_frame_id(cloud.header.frame_id), message.connection.topic, points, offsets, planar)


def cloud_rows(cloud: Any) -> np.ndarray[Any, Any]:
    """A sensor_msgs/PointCloud2's points as a structured array (height * width,), fields by name.

    Offsets may be unaligned, rows padded, numbers big-endian. Raises Undecodable where the sizes contradict
    the data.
    """
    height, width = int(cloud.height), int(cloud.width)
    point_step, row_step = int(cloud.point_step), int(cloud.row_step)
    count = height * width
    dtype = cloud_dtype(cloud.fields, point_step, bool(cloud.is_bigendian))
    if count == 0:
        return np.zeros(0, dtype=dtype)
    if row_step < width * point_step:
        # Some drivers leave row_step at 0 in clouds of one row.
        if height != 1:
            raise Undecodable(f"row_step {row_step} is less than width {width} times point_step {point_step}")
        row_step = width * point_step
    data = memoryview(cloud.data)
    needed = (height - 1) * row_step + width * point_step
    if needed > len(data):
        raise Undecodable(f"{height} x {width} points of {point_step} bytes need {needed} bytes, it has {len(data)}")
    if row_step == width * point_step:
        return np.frombuffer(data, dtype=dtype, count=count)
    grid = np.ndarray((height, width), dtype=dtype, buffer=data, strides=(row_step, point_step))
    return grid.reshape(count)


def cloud_dtype(fields: Any, point_step: int, big_endian: bool) -> np.dtype[Any]:
    """The structured dtype of a PointCloud2's points. Raises Undecodable where fields do not fit or x, y, z lack."""
    order = ">" if big_endian else "<"
    names, formats, offsets = [], [], []
    for item in fields:
        code = _DATATYPES.get(int(item.datatype))
        times = max(1, int(item.count))
        if code is None or item.name in names or not item.name:
            continue
        if int(item.offset) + np.dtype(code).itemsize * times > point_step:
            raise Undecodable(f"field '{item.name}' reaches beyond point_step {point_step}")
        names.append(item.name)
        formats.append((f"{order}{code}", (times,)) if times > 1 else f"{order}{code}")
        offsets.append(int(item.offset))
    missing = [name for name in ("x", "y", "z") if name not in names]
    if missing:
        raise Undecodable(f"no field {', '.join(missing)}: its fields are {', '.join(names) or 'none'}")
    try:
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step})
    except ValueError as error:
        raise Undecodable(f"its fields make no layout: {error}") from error


def finite_points(columns: list[np.ndarray[Any, Any]]) -> tuple[FloatArray, BoolArray | None]:
    """x, y, z columns (n,) -> (m, 3) float64 points that are returns, and the (n,) mask, None where all are."""
    with np.errstate(over="ignore", invalid="ignore"):  # also the casts: damaged bytes hold signalling NaNs
        x, y, z = (np.ascontiguousarray(column, dtype=np.float64) for column in columns)
        square = x * x
        square += y * y
        square += z * z
    kept = (square > 0.0) & (square < np.inf)
    if kept.all():
        return np.stack([x, y, z], axis=1), None
    return np.stack([x[kept], y[kept], z[kept]], axis=1), kept


def laser_scan(scan: Any, message: Message) -> Scan:
    """A sensor_msgs/LaserScan as points in the scan plane, with times stamp + i * time_increment."""
    with np.errstate(invalid="ignore"):
        ranges = np.asarray(scan.ranges, dtype=np.float64)
    beams = np.arange(len(ranges))
    farthest = float(scan.range_max)
    nearest = float(scan.range_min)
    with np.errstate(invalid="ignore"):
        kept = np.isfinite(ranges) & (ranges > 0)
        kept &= ranges >= nearest if np.isfinite(nearest) else True
        kept &= ranges < farthest if np.isfinite(farthest) and farthest > 0 else True
    angle = float(scan.angle_min) + beams[kept] * float(scan.angle_increment)
    if not np.isfinite(angle).all():
        raise Undecodable("its angles are not finite")
    points = np.zeros((int(kept.sum()), 3))
    points[:, 0] = ranges[kept] * np.cos(angle)
    points[:, 1] = ranges[kept] * np.sin(angle)
    step_s = float(scan.time_increment)
    offsets: IntArray | None = None
    if np.isfinite(step_s) and 0 < step_s * len(ranges) <= 2.0:
        offsets = np.rint(beams[kept] * (step_s * 1e9)).astype(np.int64)
    stamp = stamp_ns(scan.header, message.log_ns)
    return Scan(stamp, clean_frame_id(scan.header.frame_id), message.connection.topic, points, offsets, True)


def livox_scan(message: Message) -> Scan:
    """A livox_ros_driver(2)/CustomMsg. Its points are read in one piece: a packed row of uint32 offset_time (ns),
    float32 x, y, z, three uint8; ROS 1 packs rows at 19 bytes, CDR aligns them to 20."""
    data = memoryview(message.data)
    cdr = message.connection.encoding == "cdr"
    order = "<"
    start = 0
    if cdr:
        if len(data) < 4:
            raise Undecodable("it is too short")
        order = "<" if data[1] & 1 else ">"
        data = data[4:]
    try:
        start = 0 if cdr else 4  # ROS 1 headers begin with a sequence number.
        seconds, nanoseconds, name_bytes = struct.unpack_from(f"{order}III", data, start)
        position = start + 12 + name_bytes
        if position > len(data):
            raise Undecodable("its frame id is cut off")
        frame_id = bytes(data[start + 12 : position]).rstrip(b"\0").decode("utf-8", "replace")
        position = _aligned(position, 8, cdr)
        # timebase (uint64, ns), point_num, lidar_id, 3 reserved bytes; the sequence's own length counts.
        position += 8 + 4 + 1 + 3
        position = _aligned(position, 4, cdr)
        (count,) = struct.unpack_from(f"{order}I", data, position)
    except struct.error as error:
        raise Undecodable("it is too short") from error
    position += 4
    stride = 20 if cdr else 19
    if count and position + (count - 1) * stride + 19 > len(data):
        raise Undecodable(f"{count} points do not fit into its {len(data)} bytes")
    row = np.dtype(
        {
            "names": ["offset_time", "x", "y", "z"],
            "formats": [f"{order}u4", f"{order}f4", f"{order}f4", f"{order}f4"],
            "offsets": [0, 4, 8, 12],
            "itemsize": 16,
        }
    )
    rows = np.ndarray((count,), dtype=row, buffer=data[position:] if count else bytes(16), strides=(stride,))
    points, kept = finite_points([rows[name] for name in ("x", "y", "z")])
    offsets = rows["offset_time"].astype(np.int64)
    stamp = seconds * 1_000_000_000 + nanoseconds or message.log_ns
    offsets = offsets if kept is None else offsets[kept]
    return Scan(stamp, clean_frame_id(frame_id), message.connection.topic, points, offsets, False)


def _aligned(position: int, size: int, cdr: bool) -> int:
    return -(-position // size) * size if cdr else position
