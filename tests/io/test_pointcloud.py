"""LiDAR messages into scans: any layout that a PointCloud2 may have, laser scans, Livox."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.types import Notes, Scan
from adcbf_cli.io.log_base import Connection, Message
from adcbf_cli.io.pointcloud import ScanDecoder, finite_points
from adcbf_cli.io.ros_messages import Undecodable

T0 = 1_700_000_000_000_000_000


def decode(make: Any, message: Any, ros1: bool = False, notes: Notes | None = None) -> Scan:
    connection = Connection("/points", message.__msgtype__, "ros1" if ros1 else "cdr")
    decoder = ScanDecoder("/points", notes or Notes())
    return decoder.scan(Message(connection, T0 + 5, make.encode(message, ros1)))


@st.composite
def layouts(draw: st.DrawFn) -> tuple[np.ndarray, bool, str | None]:
    """A structured array in a random layout, whether ROS 1, and its time field (uint32 ns since the stamp)."""
    order = draw(st.sampled_from("<>"))
    real = draw(st.sampled_from(["f4", "f8"]))
    time_name = draw(st.sampled_from([None, "t", "offset_time"]))
    fields = [("x", real, ()), ("y", real, ()), ("z", real, ())]
    fields += [("t" if time_name == "t" else "offset_time", "u4", ())] if time_name else []
    extra = [("intensity", "f4", ()), ("ring", "u2", ()), ("tag", "u1", ()), ("normal", "f4", (3,)), ("i", "i2", ())]
    fields += draw(st.lists(st.sampled_from(extra), unique=True, max_size=4))
    fields = draw(st.permutations(fields))
    offsets, formats, place = [], [], 0
    for _, kind, shape in fields:
        place += draw(st.integers(0, 5))
        offsets.append(place)
        formats.append((order + kind, shape) if shape else order + kind)
        place += np.dtype(kind).itemsize * int(np.prod(shape, dtype=int))
    dtype = np.dtype(
        {
            "names": [name for name, *_ in fields],
            "formats": formats,
            "offsets": offsets,
            "itemsize": place + draw(st.integers(0, 7)),
        }
    )
    height, width = draw(st.sampled_from([(1, 0), (1, 1), (1, 7), (3, 5), (4, 0)]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rows = np.zeros((height, width), dtype=dtype)
    rows.view(np.uint8).reshape(-1)[:] = rng.integers(0, 256, rows.nbytes)
    for name in "xyz":
        rows[name] = rng.normal(size=rows.shape) * 30
    if time_name:
        rows[time_name] = rng.integers(0, 100_000_000, rows.shape)
    spoil = rng.random(rows.shape)
    rows["x"][spoil < 0.15] = np.nan
    rows["y"][(spoil > 0.15) & (spoil < 0.25)] = np.inf
    for name in "xyz":
        rows[name][(spoil > 0.25) & (spoil < 0.35)] = 0
    return rows, draw(st.booleans()), time_name


@given(layouts())
@settings(max_examples=150, deadline=None)
def test_any_layout_gives_its_points_and_times(make: Any, case: tuple[np.ndarray, bool, str | None]) -> None:
    rows, ros1, time_name = case
    notes = Notes()
    scan = decode(make, make.cloud(rows, T0, "lidar", ros1), ros1, notes)
    flat = rows.reshape(-1)
    expected, times = [], []
    for row in flat:
        point = [float(row[name]) for name in "xyz"]
        if all(np.isfinite(point)) and point != [0.0, 0.0, 0.0]:
            expected.append(point)
            times.append(int(row[time_name]) if time_name else 0)
    np.testing.assert_array_equal(scan.points_m, np.array(expected).reshape(-1, 3))
    assert scan.points_m.dtype == np.float64
    assert (scan.stamp_ns, scan.frame_id, scan.topic) == (T0, "lidar", "/points")
    assert not notes.warnings
    if time_name:
        assert scan.offset_ns is not None
        assert scan.offset_ns.dtype == np.int64
        assert scan.offset_ns.tolist() == times
    else:
        assert scan.offset_ns is None


def test_rows_padded_to_row_step(make: Any) -> None:
    dtype = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    rows = np.zeros((2, 2), dtype=dtype)
    rows["x"] = [[1, 2], [3, 4]]
    data = b"".join(row.tobytes() + b"\xff" * 5 for row in rows)
    message = make.cloud(rows, row_step=29, data=np.frombuffer(data, np.uint8))
    assert decode(make, message).points_m[:, 0].tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 1000},
        {"height": 2**31, "width": 2**31},
        {"point_step": 8},
        {"row_step": 1, "height": 3, "width": 1},
        {"data": np.zeros(3, np.uint8)},
        {"fields": []},
        {"point_step": 0},
    ],
)
def test_sizes_that_contradict_the_data_are_an_error(make: Any, changes: dict[str, Any]) -> None:
    rows = np.ones(3, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    with pytest.raises(Undecodable):
        decode(make, make.cloud(rows, **changes))


def test_bytes_of_no_message_are_an_error(make: Any) -> None:
    connection = Connection("/points", "sensor_msgs/msg/PointCloud2", "cdr")
    for data in (b"", b"\0", b"\0\1\0\0" + b"\xff" * 40, bytes(200)[:30]):
        with pytest.raises(Undecodable):
            ScanDecoder("/points", Notes()).scan(Message(connection, T0, data))


def with_times(make: Any, name: str, kind: str, values: np.ndarray, stamp_ns: int = T0) -> tuple[Scan, Notes]:
    rows = np.ones(len(values), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (name, kind)])
    rows[name] = values
    notes = Notes()
    return decode(make, make.cloud(rows, stamp_ns), notes=notes), notes


STEPS_NS = np.linspace(0, 100_000_000, 201).astype(np.int64)


@pytest.mark.parametrize(
    ("name", "kind", "values", "tolerance_ns"),
    [
        ("t", "<u4", STEPS_NS, 0),  # Ouster
        ("offset_time", "<u4", STEPS_NS, 0),  # Livox
        ("time", "<f4", STEPS_NS * 1e-9, 10),  # Velodyne
        ("time", "<f4", STEPS_NS * 1e-3, 10),  # microseconds
        ("timestamp", "<f8", T0 * 1e-9 + STEPS_NS * 1e-9, 300),  # Hesai, RoboSense: seconds since 1970
        ("timestamp", "<f8", (T0 + STEPS_NS).astype(float), 300),  # Livox driver 2: nanoseconds in a double
        ("time_stamp", "<f8", STEPS_NS * 1e-6, 10),  # milliseconds
        ("timeStamp", "<u4", STEPS_NS // 1000, 1000),  # microseconds
    ],
)
def test_units_and_references_of_point_times(
    make: Any, name: str, kind: str, values: np.ndarray, tolerance_ns: int
) -> None:
    scan, notes = with_times(make, name, kind, values)
    assert scan.offset_ns is not None
    assert np.abs(scan.offset_ns - STEPS_NS).max() <= tolerance_ns
    assert not notes.warnings


def test_times_before_the_stamp_are_negative(make: Any) -> None:
    scan, _ = with_times(make, "time", "<f4", (STEPS_NS - 100_000_000) * 1e-9)
    assert scan.offset_ns is not None
    assert np.abs(scan.offset_ns - (STEPS_NS - 100_000_000)).max() <= 10


def test_absolute_times_of_a_simulators_clock(make: Any) -> None:
    stamp = 5_000_000_000_000
    scan, _ = with_times(make, "timestamp", "<f8", 5000 + STEPS_NS * 1e-9, stamp)
    assert scan.offset_ns is not None
    assert np.abs(scan.offset_ns - STEPS_NS).max() <= 2


def test_times_of_another_clock_count_from_the_first_point_with_a_warning(make: Any) -> None:
    scan, notes = with_times(make, "timestamp", "<f8", 1.2e9 + STEPS_NS * 1e-9)
    assert scan.offset_ns is not None
    assert np.abs(scan.offset_ns - STEPS_NS).max() <= 300
    assert "another clock" in notes.warnings[0]


def test_the_unit_is_settled_once(make: Any) -> None:
    """A nearly empty later scan with a tiny span must not change the unit."""
    decoder = ScanDecoder("/points", Notes())
    connection = Connection("/points", "sensor_msgs/msg/PointCloud2", "cdr")
    offsets = []
    for values in (STEPS_NS // 1000, np.array([0, 40])):
        rows = np.ones(len(values), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("timestamp", "<u4")])
        rows["timestamp"] = values
        scan = decoder.scan(Message(connection, T0, make.encode(make.cloud(rows))))
        assert scan.offset_ns is not None
        offsets.append(scan.offset_ns.tolist())
    assert offsets[1] == [0, 40_000]


def test_laser_scan_by_hand(make: Any) -> None:
    nan, inf = float("nan"), float("inf")
    message = make.laser([1.0, nan, inf, 0.05, 10.0, 2.0, 0.0, -1.0, -inf], time_increment=0.001)
    scan = decode(make, message)
    angles = np.array([-0.5, 0.0])
    expected = np.array([[np.cos(angles[0]), np.sin(angles[0]), 0], [2, 0, 0]])
    np.testing.assert_allclose(scan.points_m, expected, atol=1e-7)
    assert scan.offset_ns is not None
    assert scan.offset_ns.tolist() == [0, 5_000_000]
    assert scan.planar


def test_laser_scan_without_limits_or_times(make: Any) -> None:
    scan = decode(make, make.laser([1.0, 50.0], range_max=0.0, range_min=float("nan"), time_increment=float("nan")))
    assert len(scan.points_m) == 2
    assert scan.offset_ns is None


@given(
    st.integers(0, 40), st.booleans(), st.text(st.characters(codec="ascii", exclude_categories=("Cc",)), max_size=12)
)
@settings(max_examples=60, deadline=None)
def test_livox_points(make: Any, count: int, ros1: bool, frame_id: str) -> None:
    rng = np.random.default_rng(count)
    xyz = rng.normal(size=(count, 3)).astype(np.float32)
    if count > 3:
        xyz[2] = 0
    times = rng.integers(0, 100_000_000, count)
    kind = "livox_ros_driver2/msg/CustomPoint"
    points = [
        make.new(
            kind, ros1, offset_time=int(t), x=float(p[0]), y=float(p[1]), z=float(p[2]), reflectivity=1, tag=2, line=3
        )
        for p, t in zip(xyz, times, strict=True)
    ]
    message = make.new(
        "livox_ros_driver2/msg/CustomMsg",
        ros1,
        header=make.header(T0, frame_id, ros1),
        timebase=T0,
        point_num=count,
        lidar_id=7,
        rsvd=np.zeros(3, np.uint8),
        points=points,
    )
    scan = decode(make, message, ros1)
    kept = (xyz != 0).any(axis=1)
    np.testing.assert_array_equal(scan.points_m, xyz[kept].astype(float))
    assert scan.offset_ns is not None
    assert scan.offset_ns.tolist() == times[kept].tolist()
    assert scan.stamp_ns == T0
    assert scan.frame_id == frame_id.strip().lstrip("/")


@given(st.integers(0, 200))
@settings(max_examples=60, deadline=None)
def test_cut_livox_messages_are_an_error_never_garbage(make: Any, cut: int) -> None:
    point = make.new(
        "livox_ros_driver2/msg/CustomPoint", offset_time=5, x=1.0, y=2.0, z=3.0, reflectivity=1, tag=2, line=3
    )
    message = make.new(
        "livox_ros_driver2/msg/CustomMsg",
        header=make.header(T0, "livox"),
        timebase=T0,
        point_num=9,
        lidar_id=7,
        rsvd=np.zeros(3, np.uint8),
        points=[point] * 9,
    )
    data = make.encode(message)
    connection = Connection("/livox", "livox_ros_driver2/msg/CustomMsg", "cdr")
    with pytest.raises(Undecodable):
        ScanDecoder("/livox", Notes()).scan(Message(connection, T0, data[: min(cut, len(data) - 2)]))


@pytest.mark.filterwarnings("error")
def test_signalling_nans_of_damaged_bytes_leave_quietly() -> None:
    columns = [np.array([0x7FA00000, 0x3F800000], dtype="<u4").view("<f4") for _ in "xyz"]
    points, kept = finite_points(columns)
    np.testing.assert_array_equal(points, [[1.0, 1.0, 1.0]])
    assert kept is not None
    assert kept.tolist() == [False, True]
