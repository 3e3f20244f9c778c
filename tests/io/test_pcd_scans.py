"""PCD files against open3d and by hand; folders of scans with TUM and KITTI poses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.frames import transform_points
from adcbf_cli.core.types import Frame, Notes
from adcbf_cli.io.frame_reader import FrameReader
from adcbf_cli.io.pcd import lzf_decompress, parse_pcd, read_pcd
from adcbf_cli.io.pcd_folder import scan_times

HEADER = "VERSION .7\nFIELDS x y z intensity ring _\nSIZE 4 4 8 4 2 1\nTYPE F F F F U U\nCOUNT 1 1 1 1 1 3\n"
DTYPE = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f8"), ("intensity", "<f4"), ("ring", "<u2"), ("padding", "u1", (3,))]
)


def table(count: int) -> np.ndarray:
    rows = np.zeros(count, dtype=DTYPE)
    rng = np.random.default_rng(count)
    for name in ("x", "y", "z", "intensity"):
        rows[name] = rng.normal(size=count)
    rows["ring"] = rng.integers(0, 65536, count)
    return rows


def lzf_literals(data: bytes) -> bytes:
    """Valid LZF without any back reference."""
    pieces = [data[i : i + 32] for i in range(0, len(data), 32)]
    return b"".join(bytes([len(piece) - 1]) + piece for piece in pieces)


def encode(rows: np.ndarray, storage: str, tail: bytes = b"") -> bytes:
    head = f"# a comment\n{HEADER}WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\n"
    head += f"DATA {storage}\n"
    if storage == "ascii":
        lines = [
            " ".join([f"{row['x']:.9g} {row['y']:.9g} {row['z']:.17g} {row['intensity']:.9g} {row['ring']} 0 0 0"])
            for row in rows
        ]
        return head.encode() + "\n".join(lines).encode() + b"\n" + tail
    if storage == "binary":
        return head.encode() + rows.tobytes() + tail
    columns = b"".join(rows[name].tobytes() for name in DTYPE.names or ())
    packed = lzf_literals(columns)
    sizes = np.array([len(packed), len(columns)], dtype="<u4").tobytes()
    return head.encode() + sizes + packed + tail


@pytest.mark.parametrize("storage", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("count", [0, 1, 500])
@pytest.mark.parametrize("tail", [b"", b"# bytes after the last point\n"])
def test_every_storage_gives_the_same_points(storage: str, count: int, tail: bytes) -> None:
    rows = table(count)
    cloud = parse_pcd(encode(rows, storage, tail))
    for name in ("x", "y", "z", "intensity", "ring"):
        np.testing.assert_array_equal(cloud[name], rows[name])


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("ascii_text", [False, True])
def test_against_open3d(tmp_path: Path, compressed: bool, ascii_text: bool) -> None:
    open3d = pytest.importorskip("open3d")
    rng = np.random.default_rng(3)
    points = np.round(rng.normal(size=(3000, 3)) * 10, 1)
    points[1000:2000] = points[0]
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    path = tmp_path / "cloud.pcd"
    open3d.io.write_point_cloud(str(path), cloud, write_ascii=ascii_text, compressed=compressed)
    rows = read_pcd(path)
    np.testing.assert_allclose(np.stack([rows[n] for n in "xyz"], axis=1), points, rtol=1e-6)


@pytest.mark.parametrize(
    ("packed", "plain"),
    [
        (b"\x02abc", b"abc"),
        (b"\x02abc\x20\x02", b"abcabc"),  # length 1 + 2, 3 back
        (b"\x00a\xe0\x04\x00", b"a" + b"a" * 13),  # length 7 + 4 + 2, 1 back: a run
        (b"\x01ab\xe0\x00\x01", b"ab" + b"ababababa"),
    ],
)
def test_lzf_by_hand(packed: bytes, plain: bytes) -> None:
    assert lzf_decompress(packed, len(plain)) == plain


@given(st.binary(max_size=400), st.integers(0, 2000))
@settings(max_examples=200, deadline=None)
def test_lzf_of_garbage_never_grows_past_its_size(packed: bytes, size: int) -> None:
    outcome = b""
    try:
        outcome = lzf_decompress(packed, size)
    except ValueError:
        return
    assert len(outcome) == size


@given(st.data())
@settings(max_examples=200, deadline=None)
def test_damaged_files_are_one_error(data: st.DataObject) -> None:
    raw = bytearray(encode(table(20), data.draw(st.sampled_from(["ascii", "binary", "binary_compressed"]))))
    for _ in range(4):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    raw = raw[: data.draw(st.integers(0, len(raw)))]
    outcome = None
    try:
        outcome = parse_pcd(bytes(raw))
    except ValueError:
        return
    assert outcome.dtype.names is not None


def test_claimed_sizes_allocate_nothing() -> None:
    raw = encode(table(3), "binary").replace(b"POINTS 3", b"POINTS 999999999")
    with pytest.raises(ValueError, match="999999999 points need"):
        parse_pcd(raw)
    raw = encode(table(3), "ascii").replace(b"POINTS 3", b"POINTS 999999999")
    with pytest.raises(ValueError, match="do not fit"):
        parse_pcd(raw)


def test_real_scan_with_bytes_after_its_last_point(real_data: Callable[[str], Path]) -> None:
    cloud = read_pcd(real_data("nebula/xt32/1673400678101968885.pcd"))
    assert len(cloud) > 10_000
    assert {"x", "y", "z"} <= set(cloud.dtype.names or ())


# --- folders


def write_scans(folder: Path, stems: list[str]) -> Path:
    """Scan i sees a post at (5, 1, 0) in the world from (i, 0, 0), facing +x."""
    folder.mkdir()
    for i, stem in enumerate(stems):
        text = (
            f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 1\nHEIGHT 1\nPOINTS 1\nDATA ascii\n{5 - i} 1 0\n"
        )
        (folder / f"{stem}.pcd").write_text(text)
    return folder


def read(path: Path, **config: object) -> tuple[list[Frame], FrameReader, Notes]:
    notes = Notes()
    with FrameReader(path, ReadConfig.model_validate(config), notes) as reader:
        return list(reader), reader, notes


def check_post(frames: list[Frame], count: int) -> None:
    assert len(frames) == count
    for frame in frames:
        np.testing.assert_allclose(transform_points(frame.world_from_sensor, frame.points_m), [[5, 1, 0]], atol=1e-6)


def tum(count: int) -> str:
    return "# time x y z qx qy qz qw\n" + "".join(f"1700000000.{i}00000001 {i} 0 0 0 0 0 2\n" for i in range(count))


@pytest.mark.parametrize("place", ["scans/poses.txt", "scans/any.tum", "poses.txt"])
def test_tum_poses_in_or_beside_the_folder(tmp_path: Path, place: str) -> None:
    folder = write_scans(tmp_path / "scans", [f"1700000000.{i}00000001" for i in range(5)])
    (tmp_path / place).write_text(tum(5))
    frames, reader, notes = read(folder)
    check_post(frames, 5)
    assert frames[1].stamp_ns == 1_700_000_000_100_000_001
    assert reader.selection.pose == "poses file"
    assert reader.expected_frames == 5
    assert notes == Notes()


def test_tum_times_serve_scans_whose_names_hold_none(tmp_path: Path) -> None:
    folder = write_scans(tmp_path / "scans", [f"scan_{i}" for i in (1, 2, 9, 10, 11)])
    (folder / "poses.txt").write_text(tum(5))
    frames, _, notes = read(folder)
    check_post(frames, 5)
    assert notes == Notes()


def test_kitti_poses_are_one_a_scan(tmp_path: Path) -> None:
    folder = write_scans(tmp_path / "scans", [f"{i:06d}" for i in range(4)])
    lines = [f"1 0 0 {i} 0 1 0 0 0 0 1 0" for i in range(4)]
    (folder / "poses.txt").write_text("\n".join(lines))
    frames, _, notes = read(folder)
    check_post(frames, 4)
    assert [frame.stamp_ns for frame in frames] == [0, 100_000_000, 200_000_000, 300_000_000]
    assert "10 Hz is assumed" in notes.warnings[0]
    (folder / "poses.txt").write_text("\n".join(lines[:3]))
    with pytest.raises(AdcbfError, match="3 poses for 4 scans"):
        read(folder)


def test_without_poses_the_sensor_stands_still(tmp_path: Path) -> None:
    folder = write_scans(tmp_path / "scans", ["1700000000000000000", "1700000000100000000"])
    frames, reader, notes = read(folder)
    assert reader.selection.pose == "none"
    assert not frames[0].pose_known
    assert frames[1].stamp_ns - frames[0].stamp_ns == 100_000_000
    assert "stand still" in notes.warnings[0]


def test_a_mounted_sensor(tmp_path: Path) -> None:
    folder = write_scans(tmp_path / "scans", [f"1700000000.{i}" for i in range(2)])
    (folder / "poses.txt").write_text(tum(2))
    frames, _, _ = read(folder, extrinsics=["base>sensor:0,0,2,0,0,0"])
    np.testing.assert_allclose(frames[0].world_from_sensor[:3, 3], [0, 0, 2], atol=1e-6)


def test_a_damaged_scan_is_a_loss(tmp_path: Path) -> None:
    folder = write_scans(tmp_path / "scans", [f"1700000000.{i}" for i in range(3)])
    (folder / "1700000000.1.pcd").write_bytes(b"no header")
    frames, _, notes = read(folder, pose="none")
    assert len(frames) == 2
    assert notes.losses[0].count == 1


def test_ambiguous_and_missing_pose_files(tmp_path: Path) -> None:
    folder = write_scans(tmp_path / "scans", ["1", "2"])
    for name in ("a.tum", "b.tum"):
        (folder / name).write_text(tum(2))
    with pytest.raises(UsageError, match="several pose files"):
        read(folder)
    check_post(read(folder, pose=str(folder / "a.tum"))[0], 2)
    with pytest.raises(UsageError, match="no such file"):
        read(folder, pose="/odom")


@pytest.mark.parametrize(
    ("stems", "times"),
    [
        (["1581624663.149", "1581624663.25"], [1581624663_149000000, 1581624663_250000000]),
        (["frame1-1581624663_149", "frame2-1581624663_170"], [1581624663_149000000, 1581624663_170000000]),
        (["1673400472138016708", "1673400472238016708"], [1673400472138016708, 1673400472238016708]),
        (["1673400472138", "1673400472238"], [1673400472138000000, 1673400472238000000]),
        (["1673400472138016", "1673400472238016"], [1673400472138016000, 1673400472238016000]),
        (["000000", "000001"], None),
        (["1581624663.5", "1581624663.4"], None),
    ],
)
def test_times_in_file_names(stems: list[str], times: list[int] | None) -> None:
    stamps, named = scan_times(tuple(Path(f"{stem}.pcd") for stem in stems))
    assert named == (times is not None)
    assert stamps.tolist() == (times or [0, 100_000_000])
