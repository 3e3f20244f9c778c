"""The ROS 2 bag, read back with mcap's reader and rosbags, by the message definitions that it carries itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.io.viz.viz_runs import adcbf, by_stamp, first_seeds, rows

Messages = dict[str, list[tuple[int, Any]]]
ADD, DELETE = 0, 2


def read(path: Path) -> tuple[Messages, dict[str, str]]:
    """By topic: log time and message; and each topic's type."""
    store = get_typestore(Stores.EMPTY)
    found: Messages = {}
    types: dict[str, str] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if schema.name not in store.fielddefs:
                store.register(get_types_from_msg(schema.data.decode(), schema.name))
            types[channel.topic] = schema.name
            decoded = store.deserialize_cdr(message.data, schema.name)
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found, types


@pytest.fixture(scope="module")
def bag(viz_run: Path) -> tuple[Messages, dict[str, str]]:
    return read(viz_run / "viz.ros2.mcap")


@pytest.fixture(scope="module")
def messages(bag: tuple[Messages, dict[str, str]]) -> Messages:
    return bag[0]


def stamp(header: Any) -> int:
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)


def test_rviz_finds_every_topic_and_its_type(viz_run: Path, bag: tuple[Messages, dict[str, str]]) -> None:
    config = yaml.safe_load((viz_run / "viz.rviz").read_text())["Visualization Manager"]
    kinds = {
        "sensor_msgs/msg/PointCloud2": "rviz_default_plugins/PointCloud2",
        "visualization_msgs/msg/MarkerArray": "rviz_default_plugins/MarkerArray",
        "nav_msgs/msg/Path": "rviz_default_plugins/Path",
    }
    shown = {one["Topic"]["Value"]: one["Class"] for one in config["Displays"] if "Topic" in one}
    for topic, msgtype in bag[1].items():
        if topic != "/tf":
            assert shown[topic] == kinds[msgtype]
    assert bag[1]["/tf"] == "tf2_msgs/msg/TFMessage"
    frames = {
        (transform.header.frame_id, transform.child_frame_id)
        for _, message in bag[0]["/tf"]
        for transform in message.transforms
    }
    assert (config["Global Options"]["Fixed Frame"], config["Views"]["Current"]["Target Frame"]) in frames


def test_topic_names_are_ros_names(messages: Messages) -> None:
    for topic in messages:
        for part in topic.removeprefix("/").split("/"):
            assert part.replace("_", "a").isalnum()
            assert not part[0].isdigit()


def test_markers_on_the_screen_are_the_tables_things(viz_run: Path, messages: Messages) -> None:
    tracks = [row for row in rows(viz_run / "tracks.parquet") if row["status"] != "ended"]
    for topic, table, key, kind in (
        ("/tracks", tracks, "track_id", "cylinder"),
        ("/clusters", rows(viz_run / "clusters.parquet"), "cluster_id", "box"),
        ("/predictions", rows(viz_run / "predictions.parquet", step=30), "track_id", "cylinder"),
    ):
        there = by_stamp(table)
        shown: dict[tuple[str, int], Any] = {}
        for at, array in messages[topic]:
            for marker in array.markers:
                assert stamp(marker.header) == at
                assert marker.action in (ADD, DELETE)
                if marker.action == DELETE:
                    del shown[marker.ns, marker.id]
                else:
                    shown[marker.ns, marker.id] = marker
            now = {row[key]: row for row in there.get(at, [])}
            assert {number for _, number in shown} == set(now)
            for (namespace, number), marker in shown.items():
                if namespace == kind and topic != "/predictions":
                    place = marker.pose.position
                    assert (place.x, place.y, place.z) == tuple(now[number][name] for name in ("x_m", "y_m", "z_m"))
                if topic == "/predictions" and namespace == "line":
                    last = marker.points[-1]
                    assert (last.x, last.y, last.z) == tuple(now[number][name] for name in ("x_m", "y_m", "z_m"))


def test_the_cloud_has_the_logs_points_in_their_tracks_colour(viz_run: Path, messages: Messages) -> None:
    frames = {row["timestamp_ns"]: row for row in rows(viz_run / "frames.parquet")}
    assert set(frames) == {at for at, _ in messages["/cloud"]}
    colours: dict[int, set[int]] = {}
    codes = {5: "<i4", 6: "<u4", 7: "<f4"}
    for at, cloud in messages["/cloud"]:
        layout = np.dtype(
            {
                "names": [field.name for field in cloud.fields],
                "formats": [codes[field.datatype] for field in cloud.fields],
                "offsets": [field.offset for field in cloud.fields],
                "itemsize": cloud.point_step,
            }
        )
        dots = cloud.data.view(layout)
        assert len(dots) == cloud.width == frames[at]["points_read"]
        for track, rgb in set(zip(dots["track_id"].tolist(), dots["rgb"].tolist(), strict=True)):
            colours.setdefault(track, set()).add(rgb & 0xFFFFFF)
    drawn: dict[int, int] = {}
    for _, array in messages["/tracks"]:
        for marker in array.markers:
            if marker.action == ADD:
                red, green, blue = (round(255 * part) for part in (marker.color.r, marker.color.g, marker.color.b))
                drawn[marker.id] = red << 16 | green << 8 | blue
    tracks = {track: seen for track, seen in colours.items() if track >= 0}
    assert len(tracks) > 5
    assert all(seen == {drawn[track]} for track, seen in tracks.items())


def test_obstacles_found_in_the_bag_are_those_of_the_run(viz_run: Path, tmp_path: Path) -> None:
    """The bag is a log too: its cloud, placed by its own tf, must hold the same obstacles."""
    again = tmp_path / "again.adcbf"
    code, _, err = adcbf("cluster", viz_run / "viz.ros2.mcap", "-o", again, "--range", "12")
    assert code == 0, err
    want, got = by_stamp(rows(viz_run / "clusters.parquet")), by_stamp(rows(again / "clusters.parquet"))
    found = total = 0
    for at, clusters in want.items():
        places = np.array([[row["x_m"], row["y_m"], row["z_m"]] for row in got[at]])
        for row in clusters:
            total += 1
            distance = np.linalg.norm(places - [row["x_m"], row["y_m"], row["z_m"]], axis=1).min()
            found += distance < 0.02
    assert total > 100
    assert found / total > 0.95


def test_paths_are_the_plans(viz_run: Path, messages: Messages) -> None:
    for planner, seed in first_seeds(viz_run, "replay"):
        stages = by_stamp(rows(viz_run / "replay" / "plan_stages.parquet", planner=planner, seed=seed))
        plans = messages.get(f"/replay/{planner.replace('-', '_')}/plan", [])
        assert [at for at, _ in plans] == list(stages)
        for at, path in plans:
            assert path.header.frame_id == "odom"
            assert [(p.pose.position.x, p.pose.position.y) for p in path.poses] == [
                (row["x_m"], row["y_m"]) for row in stages[at]
            ]
