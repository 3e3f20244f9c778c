"""Ground truth files of every kind, good and bad."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.core.types import Notes
from adcbf_cli.io.truth import TruthContext, load_truth, read_truth

START_NS = 1_317_042_000_000_000_000
STEP_NS = 100_000_000


def context(count: int = 5, jitter_ns: int = 0, **more) -> TruthContext:
    """A run of `count` frames at 10 Hz."""
    index = np.arange(count)
    return TruthContext(index, START_NS + index * STEP_NS + jitter_ns, Path("absent.mcap"), **more)


def write(path: Path, text: str) -> str:
    path.write_text(text, encoding="utf-8")
    return str(path)


SIMULATED = "timestamp_ns,track_id,class,x_m,y_m,z_m,yaw_rad,length_m,width_m,height_m,vx_mps,vy_mps\n"


def test_the_simulators_csv(tmp_path: Path) -> None:
    rows = f"{START_NS + 7},3,person,1.5,-2,0.9,0.25,0.5,0.6,1.8,1,0\n{START_NS},4,wall,5,6,1,0,8,0.2,2,0,0\n"
    truth = load_truth(write(tmp_path / "t.csv", SIMULATED + rows), context(), Notes())
    assert truth.stamp_ns.tolist() == [START_NS, START_NS + 7], "sorted by time, and not moved to frames"
    assert truth.category == ("wall", "person")
    assert (truth.frame, truth.exhaustive, truth.labelled_fov_rad) == ("world", True, None)
    np.testing.assert_array_equal(truth.position_m[1], [1.5, -2.0, 0.9])
    row = (truth.yaw_rad[1], truth.length_m[1], truth.width_m[1], truth.height_m[1])
    assert row == (0.25, 0.5, 0.6, 1.8)


def test_a_csv_may_leave_out_what_it_does_not_know(tmp_path: Path) -> None:
    text = "# from a total station\nstamp_s, track_id, x_m, y_m, yaw_rad\n1317042000.123456789,1,2,3,\n"
    truth = load_truth(write(tmp_path / "t.csv", text), context(), Notes())
    assert truth.stamp_ns.tolist() == [1_317_042_000_123_456_789], "not a nanosecond lost"
    assert np.isnan([truth.yaw_rad[0], truth.length_m[0], truth.height_m[0]]).all()
    assert truth.position_m[0, 2] == 0.0
    assert truth.category == ("object",)


@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        ("x,1,2,3", "row 2: not a labelled position"),
        (f"{START_NS},1,nan,3", "row 2: not a labelled position"),
        (f"{START_NS},1,,3", "row 2: not a labelled position"),
        (f"{START_NS},one,2,3", "row 2: not a labelled position"),
        (f"{START_NS}", "row 2: not a labelled position"),
        (f"{START_NS},1,2,3\n{START_NS},1,2,4", "two positions at"),
        (f"{START_NS}{START_NS},1,2,3", "row 2: not a labelled position"),
        (f"{START_NS},{START_NS}{START_NS},2,3", "row 2: not a labelled position"),
        (f"{START_NS},1,1e300,3", "row 2: not a labelled position"),
        (f'{START_NS},1,2,3\n"{"x" * 200_000}', "not readable as CSV after row 2"),
    ],
)
def test_bad_rows_are_one_clear_line(tmp_path: Path, row: str, complaint: str) -> None:
    path = write(tmp_path / "t.csv", f"timestamp_ns,track_id,x_m,y_m\n{row}\n")
    with pytest.raises(AdcbfError, match=complaint) as error:
        load_truth(path, context(), Notes())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("a.csv", b"time,id\n1,2\n", "lacks the column stamp_s"),
        ("b.bin", bytes(range(256)), "not a text file"),
        ("c.txt", b"", "it is empty"),
        ("d.txt", b"hello world\n", "not a ground truth that is known"),
    ],
)
def test_what_is_no_ground_truth_is_said(tmp_path: Path, name: str, content: bytes, complaint: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(AdcbfError, match=complaint):
        load_truth(str(tmp_path / name), context(), Notes())
    with pytest.raises(UsageError, match="cannot be read"):
        load_truth(str(tmp_path / "absent.csv"), context(), Notes())
    with pytest.raises(UsageError, match="is a folder"):
        load_truth(str(tmp_path), context(), Notes())


def test_a_file_is_read_to_its_end_before_the_run_is_known(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(b"timestamp_ns,track_id,x_m,y_m\n" + b"1,1,2,3\n" * 2000 + b"\xff\xfe\n")
    with pytest.raises(AdcbfError, match="not readable as CSV"):
        read_truth(str(tmp_path / "t.csv"), Path("absent"))
    for stamp in ("9" * 25 + ".5", "1e30"):
        with pytest.raises(AdcbfError, match=r"line 1: .*time"):
            read_truth(write(tmp_path / "t.txt", f"{stamp} 1 2 0 0 0 0 1\n"), Path("absent"))
    with pytest.raises(AdcbfError, match="out of reach"):
        read_truth(write(tmp_path / "t.txt", "1.0 1 2 0 0 0 0 1e300\n"), Path("absent"))
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UsageError, match="no regular file"):
        read_truth(str(tmp_path / "pipe"), Path("absent"))


BOXES = (
    "frame,stamp_s,track_id,class,x_velo,y_velo,z_velo_center,yaw_velo,x_odom,y_odom,z_odom_center,yaw_odom,"
    "length,width,height,lidar_points_in_box\n"
)


def test_boxes_of_camera_frames_go_to_the_nearest_scan(tmp_path: Path) -> None:
    rows = [
        "0,1317042000.0,2,Van,10,10,-1,0.1,11,12,0.5,0.2,4.4,1.8,2.0,99",
        "1,1317042000.1,2,Van,10,-10,-1,0.1,11.5,12,0.5,0.2,4.4,1.8,2.0,99",
        "90,1317042009.0,2,Van,10,0,-1,0.1,50,12,0.5,0.2,4.4,1.8,2.0,99",
    ]
    notes = Notes()
    truth = load_truth(write(tmp_path / "t.csv", BOXES + "\n".join(rows)), context(jitter_ns=-30_000_000), notes)
    assert (truth.stamp_ns - START_NS + 30_000_000).tolist() == [0, STEP_NS]
    np.testing.assert_array_equal(truth.position_m[0], [11, 12, 0.5])
    assert truth.yaw_rad[0] == 0.2
    assert truth.labelled_fov_rad == pytest.approx((-math.pi / 4, math.pi / 4))
    assert any("1 labels have no scan" in w for w in notes.warnings)
    assert any("-45.0 to 45.0 degrees" in w for w in notes.warnings)
    with pytest.raises(AdcbfError, match="is it this log's ground truth"):
        load_truth(str(tmp_path / "t.csv"), context(jitter_ns=10**15), Notes())


def test_a_tum_trajectory_is_one_object(tmp_path: Path) -> None:
    half = math.sqrt(0.5)
    text = f"# time x y z qx qy qz qw\n1317042000.05 1 2 3 0 0 {half} {half}\n1317042000.15 2 2 3 0 0 0 1\n"
    truth = load_truth(write(tmp_path / "t.txt", text), context(), Notes())
    assert len(truth) == 2
    assert not truth.exhaustive
    np.testing.assert_allclose(truth.yaw_rad, [math.pi / 2, 0.0], atol=1e-12)
    np.testing.assert_allclose(truth.position_m[1], [2, 2, 3])


def test_a_topic_of_a_log_that_is_gone(tmp_path: Path) -> None:
    with pytest.raises(AdcbfError, match="log is gone"):
        load_truth("topic:/red_pose", context(), Notes())


# KITTI labels: camera looks along the Velodyne's x, so x_velo = z_camera, y_velo = -x_camera, z_velo = -y_camera.
CALIBRATION = """P2: 700 0 600 0 0 700 180 0 0 0 1 0
R_rect 1 0 0 0 1 0 0 0 1
Tr_velo_cam 0 -1 0 0 0 0 -1 -0.1 1 0 0 -0.3
"""


def label(frame: int, track: int, kind: str, box: str, place: str) -> str:
    return f"{frame} {track} {kind} 0 0 0.0 {box} {place}\n"


def kitti(tmp_path: Path, labels: str, calibration: str = CALIBRATION) -> str:
    for name in ("label", "calib"):
        (tmp_path / name).mkdir(exist_ok=True)
    write(tmp_path / "calib" / "0001.txt", calibration)
    return write(tmp_path / "label" / "0001.txt", labels)


def test_kitti_labels_reach_the_velodynes_frame(tmp_path: Path) -> None:
    """A car 10 m ahead of the camera and 2 m to its right, 1.5 m high, its front to the right."""
    car = label(1, 5, "Car", "0 0 10 10", "1.5 1.6 4.0 2.0 1.65 10.0 0.0")
    ignored = label(1, -1, "DontCare", "600 0 1300 10", "-1000 -1000 -1000 -10 -1 -1 -1")
    late = label(400, 5, "Car", "0 0 10 10", "1.5 1.6 4.0 2.0 1.65 10.0 0.0")
    notes = Notes()
    truth = load_truth(kitti(tmp_path, car + ignored + late), context(), notes)
    assert truth.frame == "sensor"
    assert truth.stamp_ns.tolist() == [START_NS + STEP_NS]
    # Camera: 0.3 m behind the Velodyne's origin as Tr says z_c = x_v - 0.3; y_c = -z_v - 0.1.
    np.testing.assert_allclose(truth.position_m[0], [10.3, -2.0, -(1.65 - 0.75) - 0.1], atol=1e-12)
    assert truth.yaw_rad[0] == pytest.approx(-math.pi / 2), "camera x, its heading, is the Velodyne's -y"
    assert (truth.length_m[0], truth.width_m[0], truth.height_m[0]) == (4.0, 1.6, 1.5)
    assert truth.labelled_fov_rad == pytest.approx((-math.atan(600 / 700), math.atan(600 / 700)))
    assert truth.ignored is not None
    assert (truth.ignored.start_rad[0], truth.ignored.end_rad[0]) == pytest.approx((-math.pi / 4, 0.0))
    assert "1 labels are of frames" in notes.warnings[0]
    shifted = load_truth(str(tmp_path / "label" / "0001.txt"), context(kitti_first_frame=398), Notes())
    assert shifted.stamp_ns.tolist() == [START_NS + 2 * STEP_NS]


def test_kitti_labels_that_cannot_be_read(tmp_path: Path) -> None:
    good = label(1, 5, "Car", "0 0 10 10", "1.5 1.6 4.0 2.0 1.65 10.0 0.0")
    with pytest.raises(AdcbfError, match="line 2: not a KITTI tracking label"):
        load_truth(kitti(tmp_path, good + good.replace("10.0", "far")), context(), Notes())
    with pytest.raises(AdcbfError, match="lacks R_rect"):
        load_truth(kitti(tmp_path, good, CALIBRATION.replace("R_rect", "R_other")), context(), Notes())
    with pytest.raises(AdcbfError, match="P2: not the numbers"):
        load_truth(kitti(tmp_path, good, CALIBRATION.replace("700", "wide")), context(), Notes())
    for broken in (("0 -1 0 0", "0 0 0 0"), ("-0.3", "nan"), ("P2: 700", "P2: 0"), ("P2: 700", "P2: nan")):
        with pytest.raises(AdcbfError, match=r"holds no rotation|not a camera"):
            load_truth(kitti(tmp_path, good, CALIBRATION.replace(*broken)), context(), Notes())
    with pytest.raises(AdcbfError, match="two labels in frame"):
        load_truth(kitti(tmp_path, good + good), context(), Notes())
    with pytest.raises(AdcbfError, match="line 1: not a KITTI"):
        load_truth(kitti(tmp_path, good.replace("10.0", "inf")), context(), Notes())
    with pytest.raises(AdcbfError, match="no label falls on a scan"):
        load_truth(kitti(tmp_path, good), context(kitti_first_frame=50), Notes())
    (tmp_path / "calib" / "0001.txt").unlink()
    with pytest.raises(AdcbfError, match="calibration is missing"):
        load_truth(str(tmp_path / "label" / "0001.txt"), context(), Notes())


def test_real_kitti_boxes_have_the_sizes_and_places_of_traffic(real_data: Callable[[str], Path]) -> None:
    path = real_data("kitti_labels/label/0001.txt")
    count = 447
    index = np.arange(count)
    truth = load_truth(str(path), TruthContext(index, index * STEP_NS, Path("absent")), Notes())
    cars = np.array([name == "Car" for name in truth.category])
    assert cars.sum() > 1000
    assert 3.0 < np.median(truth.length_m[cars]) < 5.0
    # Nearly everything is inside the camera's view (the centre of a near, cut-off car may not be).
    azimuth = np.arctan2(truth.position_m[:, 1], truth.position_m[:, 0])
    assert truth.labelled_fov_rad is not None
    inside = (azimuth > truth.labelled_fov_rad[0]) & (azimuth < truth.labelled_fov_rad[1])
    assert inside.mean() > 0.9
    bottom = truth.position_m[cars, 2] - truth.height_m[cars] / 2
    near = np.hypot(truth.position_m[cars, 0], truth.position_m[cars, 1]) < 20
    assert np.median(bottom[near]) == pytest.approx(-1.73, abs=0.25), "the Velodyne is 1.73 m above the road"


def test_real_motion_capture_is_read_from_the_log(real_data: Callable[[str], Path]) -> None:
    log = real_data("datmo/overtakes.bag")
    none = np.zeros(0, dtype=np.int64)
    truth = load_truth("topic:/red_pose", TruthContext(none, none, log, "map"), Notes())
    span_s = (truth.stamp_ns[-1] - truth.stamp_ns[0]) / 1e9
    assert 100 < len(truth) / span_s < 140, "motion capture at 120 Hz"
    assert not truth.exhaustive
    step = np.hypot(*np.diff(truth.position_m[:, :2], axis=0).T)
    assert np.quantile(step, 0.99) < 0.1
