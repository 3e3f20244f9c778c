"""The path to follow, from CSV files and Path topics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adcbf_cli.core.errors import AdcbfError, UsageError
from adcbf_cli.io.reference import check_reference, read_reference
from tests.io.conftest import T0, LogMaker


def csv_file(tmp_path: Path, text: str) -> str:
    path = tmp_path / "route.csv"
    path.write_text(text)
    return str(path)


@pytest.mark.parametrize("header", ["x_m,y_m", "y, x", "time,x_m,y_m,z"])
def test_csv_columns_are_found_by_name(tmp_path: Path, header: str) -> None:
    order = {"x_m,y_m": "1,2\n3,4", "y, x": "2,1\n4,3", "time,x_m,y_m,z": "0,1,2,9\n1,3,4,9"}[header]
    points = read_reference(csv_file(tmp_path, f"# a comment\n{header}\n{order}\n"), tmp_path, None)
    np.testing.assert_array_equal(points, [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,2\n", "columns x_m and y_m"),
        ("x_m,y_m\n1,2\n3,nan\n", "row 3"),
        ("x_m,y_m\n1,2\n3\n", "row 3"),
        ("x_m,y_m\n1e99,2\n", "row 2"),
    ],
)
def test_what_is_no_path_is_named_before_any_work(tmp_path: Path, text: str, words: str) -> None:
    spec = csv_file(tmp_path, text)
    with pytest.raises(UsageError, match=words):
        read_reference(spec, tmp_path, None)
    with pytest.raises(UsageError, match=words):
        check_reference(spec)


def test_a_missing_file_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such reference"):
        read_reference(str(tmp_path / "none.csv"), tmp_path, None)


def path_message(maker: LogMaker, points: list[tuple[float, float]], frame: str = "odom") -> object:
    header = maker.header(T0, frame)
    poses = [
        maker.new(
            "geometry_msgs/msg/PoseStamped",
            header=header,
            pose=maker.new(
                "geometry_msgs/msg/Pose",
                position=maker.new("geometry_msgs/msg/Point", x=x, y=y, z=0.0),
                orientation=maker.new("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            ),
        )
        for x, y in points
    ]
    return maker.new("nav_msgs/msg/Path", header=header, poses=poses)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    maker = LogMaker()
    path = tmp_path / "drive.mcap"
    entries = [
        ("/plan", path_message(maker, []), T0),
        ("/plan", path_message(maker, [(0.0, 1.0), (2.0, 3.0)]), T0 + 1),
        ("/broken", path_message(maker, [(0.0, float("nan")), (2.0, 3.0)]), T0 + 2),
    ]
    maker.mcap(path, entries)
    return path


def test_the_first_path_with_points_counts(log: Path) -> None:
    np.testing.assert_array_equal(read_reference("topic:/plan", log, "odom"), [[0, 1], [2, 3]])


def test_another_frame_is_refused(log: Path) -> None:
    with pytest.raises(UsageError, match="--world-frame odom"):
        read_reference("topic:/plan", log, "map")


def test_an_unknown_topic_lists_the_path_topics(log: Path) -> None:
    with pytest.raises(UsageError, match="/broken, /plan"):
        read_reference("topic:/route", log, "odom")


def test_points_that_are_none_are_refused(log: Path) -> None:
    with pytest.raises(AdcbfError, match="NaN"):
        read_reference("topic:/broken", log, "odom")
