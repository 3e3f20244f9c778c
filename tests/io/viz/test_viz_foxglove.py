"""The log for Foxglove, read back with mcap's reader and decoded by the schemas that it carries itself."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.stats import chi2

from tests.io.viz.viz_runs import adcbf, by_stamp, first_seeds, rows

Messages = dict[str, list[tuple[int, Any]]]
"""By topic: log time and message."""

NUMPY = {1: "u1", 6: "<i4", 7: "<f4"}


def read(path: Path) -> Messages:
    found: Messages = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


@pytest.fixture(scope="module")
def messages(viz_run: Path) -> Messages:
    return read(viz_run / "viz.foxglove.mcap")


def xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def yaw(turn: Any) -> float:
    return float(2 * np.arctan2(turn.z, turn.w))


def points(cloud: Any) -> np.ndarray:
    fields = {field.name: (NUMPY[field.type], field.offset) for field in cloud.fields}
    kinds = [kind for kind, _ in fields.values()]
    offsets = [offset for _, offset in fields.values()]
    layout = np.dtype({"names": list(fields), "formats": kinds, "offsets": offsets, "itemsize": cloud.point_stride})
    return np.frombuffer(cloud.data, layout)


def visible(updates: list[tuple[int, Any]]) -> Iterator[tuple[int, set[str]]]:
    """What a viewer shows after each update: by the rules of SceneUpdate, and of lifetimes."""
    shown: dict[str, tuple[int, int]] = {}
    for now, update in updates:
        for deletion in update.deletions:
            assert deletion.type == deletion.MATCHING_ID
            if deletion.id in shown and shown[deletion.id][0] < deletion.timestamp.ToNanoseconds():
                del shown[deletion.id]
        for entity in update.entities:
            at = entity.timestamp.ToNanoseconds()
            shown[entity.id] = (at, at + entity.lifetime.ToNanoseconds())
        yield now, {name for name, (_, end) in shown.items() if end >= now}


def test_times_ascend_and_are_the_tables(viz_run: Path, messages: Messages) -> None:
    stamps = [row["timestamp_ns"] for row in rows(viz_run / "frames.parquet")]
    for topic in ("/cloud", "/clusters", "/tracks", "/predictions"):
        assert [at for at, _ in messages[topic]] == stamps
    for sent in messages.values():
        assert sorted(at for at, _ in sent) == [at for at, _ in sent]


def test_clusters_are_the_tables_rectangles(viz_run: Path, messages: Messages) -> None:
    table = by_stamp(rows(viz_run / "clusters.parquet"))
    for at, update in messages["/clusters"]:
        assert [entity.id for entity in update.entities] == [str(row["cluster_id"]) for row in table.get(at, [])]
        for entity, row in zip(update.entities, table.get(at, []), strict=True):
            (box,) = entity.cubes
            assert entity.frame_id == "odom"
            assert xyz(box.pose.position) == (row["x_m"], row["y_m"], row["z_m"])
            assert yaw(box.pose.orientation) == pytest.approx(row["yaw_rad"], abs=1e-9)
            assert xyz(box.size) == pytest.approx((row["length_m"], row["width_m"], row["height_m"]), abs=0.05)


def test_tracks_show_size_speed_and_covariance(viz_run: Path, messages: Messages) -> None:
    table = by_stamp(rows(viz_run / "tracks.parquet"))
    moving = 0
    for at, update in messages["/tracks"]:
        alive = [row for row in table.get(at, []) if row["status"] != "ended"]
        assert [entity.id for entity in update.entities] == [str(row["track_id"]) for row in alive]
        for entity, row in zip(update.entities, alive, strict=True):
            body, around = entity.cylinders
            assert xyz(body.pose.position) == (row["x_m"], row["y_m"], row["z_m"])
            assert body.size.x == body.size.y == 2 * row["radius_m"]
            covariance = np.array([[row["cov_xx_m2"], row["cov_xy_m2"]], [row["cov_xy_m2"], row["cov_yy_m2"]]])
            edge = np.array([around.size.x / 2, 0.0])
            turn = yaw(around.pose.orientation)
            edge = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ edge
            assert edge @ np.linalg.solve(covariance, edge) == pytest.approx(chi2.ppf(0.95, 2), rel=1e-6)
            area = np.pi * around.size.x * around.size.y / 4
            assert area == pytest.approx(np.pi * chi2.ppf(0.95, 2) * np.sqrt(np.linalg.det(covariance)), rel=1e-6)
            speed = float(np.hypot(row["vx_mps"], row["vy_mps"]))
            assert bool(entity.arrows) == (speed >= 0.05 and not row["is_static"])
            for arrow, text in zip(entity.arrows, entity.texts, strict=True):
                assert text.text == f"{row['track_id']}  {speed:.1f} m/s"
                moving += 1
                assert arrow.shaft_length + arrow.head_length == pytest.approx(speed, abs=1e-9)
                assert yaw(arrow.pose.orientation) == pytest.approx(np.arctan2(row["vy_mps"], row["vx_mps"]), abs=1e-9)
    assert moving > 20


def test_what_has_vanished_from_the_tables_vanishes_from_the_view(viz_run: Path, messages: Messages) -> None:
    tracks = [row for row in rows(viz_run / "tracks.parquet") if row["status"] != "ended"]
    clusters = rows(viz_run / "clusters.parquet")
    predictions = rows(viz_run / "predictions.parquet", step=1)
    for topic, table, key in (
        ("/tracks", tracks, "track_id"),
        ("/clusters", clusters, "cluster_id"),
        ("/predictions", predictions, "track_id"),
    ):
        there = by_stamp(table)
        ever: set[str] = set()
        for at, shown in visible(messages[topic]):
            assert shown == {str(row[key]) for row in there.get(at, [])}
            ever |= shown
        assert len(ever) > len(shown), f"nothing vanished from {topic}: this showed nothing"


def test_predictions_are_cylinders_as_wide_as_the_margin_asks(viz_run: Path, messages: Messages) -> None:
    table = by_stamp(rows(viz_run / "predictions.parquet"))
    checked = 0
    for at, update in messages["/predictions"]:
        steps = {(str(row["track_id"]), row["step"]): row for row in table.get(at, [])}
        for entity in update.entities:
            still = steps[entity.id, 30]["is_static"]
            shown = [30] if still else [10, 20, 30]
            assert len(entity.cylinders) == len(shown)
            for cylinder, step in zip(entity.cylinders, shown, strict=True):
                row = steps[entity.id, step]
                margin = row["conformal_radius_m"] if row["conformal_radius_m"] is not None else row["sigma_radius_m"]
                assert xyz(cylinder.pose.position) == (row["x_m"], row["y_m"], row["z_m"])
                assert cylinder.size.x == pytest.approx(2 * (row["radius_m"] + margin), rel=1e-12)
                checked += 1
            (line,) = entity.lines
            assert [xyz(point) for point in line.points] == [
                tuple(steps[entity.id, step][name] for name in ("x_m", "y_m", "z_m")) for step in range(1, 31)
            ]
    assert checked > 100


def test_the_cloud_is_the_logs_and_labelled(viz_run: Path, messages: Messages, tmp_path: Path) -> None:
    """Labels against those that the clusterer itself gives each point."""
    log = viz_run / json.loads((viz_run / "run.json").read_text())["source"]["path"]
    code, _, err = adcbf("cluster", log, "-o", tmp_path / "labels.adcbf", "--range", "12", "--labels")
    assert code == 0, err
    labelled = by_stamp(rows(tmp_path / "labels.adcbf" / "points.parquet"))
    frames = {row["timestamp_ns"]: row for row in rows(viz_run / "frames.parquet")}
    transforms = dict(sensor_poses(messages))
    right = total = shown = 0
    for at, cloud in messages["/cloud"]:
        dots = points(cloud)
        assert len(dots) == frames[at]["points_read"]
        assert cloud.frame_id == "lidar"
        world = np.column_stack([dots[name] for name in "xyz"]) @ transforms[at][:3, :3].T + transforms[at][:3, 3]
        where = {tuple(place): label for place, label in zip(world.round(3), dots["cluster_id"], strict=True)}
        for row in labelled[at]:
            got = where.get(tuple(np.round([row["x_m"], row["y_m"], row["z_m"]], 3)))
            if got is not None and row["cluster_id"] is not None:
                total += 1
                right += got == row["cluster_id"]
        shown += int((dots["cluster_id"] >= 0).sum())
    given = sum(row["cluster_id"] is not None for found in labelled.values() for row in found)
    assert total > 0.8 * given
    assert right / total > 0.95
    assert shown / given == pytest.approx(1.0, abs=0.05)


def sensor_poses(messages: Messages) -> Iterator[tuple[int, np.ndarray]]:
    from scipy.spatial.transform import Rotation

    for at, transform in messages["/tf"]:
        if transform.child_frame_id == "lidar":
            assert transform.parent_frame_id == "odom"
            turn = transform.rotation
            pose = np.eye(4)
            pose[:3, :3] = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
            pose[:3, 3] = xyz(transform.translation)
            yield at, pose


def test_a_track_keeps_its_colour_everywhere(viz_run: Path, messages: Messages) -> None:
    colours: dict[int, set[tuple[int, ...]]] = {}
    for _, update in (*messages["/tracks"], *messages["/predictions"]):
        for entity in update.entities:
            colour = entity.cylinders[0].color
            rgb = tuple(round(255 * part) for part in (colour.r, colour.g, colour.b))
            colours.setdefault(int(entity.id), set()).add(rgb)
    updated = {
        (row["timestamp_ns"], row["cluster_id"]): row["track_id"]
        for row in rows(viz_run / "tracks.parquet")
        if row["cluster_id"] is not None
    }
    for at, cloud in messages["/cloud"]:
        for dot in np.unique(points(cloud)[["cluster_id", "track_id", "red", "green", "blue"]]):
            track = int(dot["track_id"])
            assert track == updated.get((at, int(dot["cluster_id"])), -1)
            if track >= 0:
                colours.setdefault(track, set()).add((int(dot["red"]), int(dot["green"]), int(dot["blue"])))
    assert all(len(seen) == 1 for seen in colours.values())
    assert len({next(iter(seen)) for seen in colours.values()}) == len(colours)


@pytest.mark.parametrize("mode", ["replay", "open_loop"])
def test_plans_and_driven_paths_are_the_first_seeds(mode: str, viz_run: Path, messages: Messages) -> None:
    for planner, seed in first_seeds(viz_run, mode):
        topic = f"/{mode}/{planner.replace('-', '_')}"
        driven = rows(viz_run / mode / "trajectories.parquet", planner=planner, seed=seed)
        stages = by_stamp(rows(viz_run / mode / "plan_stages.parquet", planner=planner, seed=seed))
        plans = messages.get(f"{topic}/plan", [])
        assert [at for at, _ in plans] == list(stages)
        for at, plan in plans:
            assert [(pose.position.x, pose.position.y) for pose in plan.poses] == [
                (row["x_m"], row["y_m"]) for row in stages[at]
            ]
        if mode == "open_loop" and planner != "logged":
            assert f"{topic}/driven" not in messages, "a plan along the log drives nowhere"
            continue
        at, path = messages[f"{topic}/driven"][-1]
        assert at == driven[-1]["timestamp_ns"]
        assert [(pose.position.x, pose.position.y) for pose in path.poses] == [(r["x_m"], r["y_m"]) for r in driven]
        where = {r["timestamp_ns"]: (r["x_m"], r["y_m"]) for r in driven}
        for at, update in messages[f"{topic}/vehicle"]:
            assert xyz(update.entities[0].cylinders[0].pose.position)[:2] == where[at]
        assert len(messages[f"{topic}/vehicle"]) == len(driven)


def test_the_sensors_way_is_the_tables(viz_run: Path, messages: Messages) -> None:
    frames = rows(viz_run / "frames.parquet")
    at, path = messages["/driven"][-1]
    assert at == frames[-1]["timestamp_ns"]
    assert [xyz(pose.position) for pose in path.poses] == [
        (row["sensor_x_m"], row["sensor_y_m"], row["sensor_z_m"]) for row in frames
    ]
    gaps = np.diff([at for at, _ in messages["/driven"]])
    assert gaps[:-1].min() >= 500_000_000


def test_a_planner_keeps_its_colour_in_the_layout(viz_run: Path) -> None:
    layout = json.loads((viz_run / "viz.foxglove-layout.json").read_text())
    shown = layout["configById"][layout["layout"]]["topics"]
    assert shown["/replay/dwa/plan"]["gradient"] == shown["/open_loop/dwa/plan"]["gradient"]
    assert shown["/replay/dwa/plan"]["gradient"] != shown["/replay/pure_pursuit/plan"]["gradient"]


def test_the_layout_shows_the_topics_that_there_are(viz_run: Path, messages: Messages) -> None:
    layout = json.loads((viz_run / "viz.foxglove-layout.json").read_text())
    panel = layout["configById"][layout["layout"]]
    drawn = {topic for topic in messages if topic != "/tf"}
    assert drawn <= {topic for topic, shown in panel["topics"].items() if shown["visible"]}
    assert panel["followTf"] in {transform.child_frame_id for _, transform in messages["/tf"]}


def test_nothing_in_the_file_depends_on_the_clock(viz_run: Path) -> None:
    with (viz_run / "viz.foxglove.mcap").open("rb") as stream:
        reader = make_reader(stream)
        first = pq.read_table(viz_run / "frames.parquet")["timestamp_ns"][0].as_py()
        assert reader.get_header().library == "adcbf"
        for _, _, message in reader.iter_messages():
            assert first <= message.log_time == message.publish_time < first + 60_000_000_000
