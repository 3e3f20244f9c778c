"""The recording for Rerun, read back with Rerun's own reader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from tests.io.viz.viz_runs import by_stamp, first_seeds, rows

chunks = pytest.importorskip("rerun.chunk", reason="Rerun's SDK is not installed: pip install 'adcbf[rerun]'")

Recording = dict[str, pa.Table]
"""By entity: its rows in the order of time, with the columns `time` and Rerun's components."""


@pytest.fixture(scope="module")
def recording(viz_run: Path) -> Recording:
    found: dict[str, list[pa.RecordBatch]] = {}
    for chunk in chunks.RrdReader(viz_run / "viz.rrd").stream().to_chunks():
        found.setdefault(chunk.entity_path, []).append(chunk.to_record_batch().replace_schema_metadata(None))
    return {
        path: pa.concat_tables([pa.Table.from_batches([batch]) for batch in batches]).sort_by("time")
        for path, batches in found.items()
    }


def times(table: pa.Table) -> list[int]:
    return table["time"].cast(pa.int64()).to_pylist()  # type: ignore[no-any-return]


def places(recording: Recording, path: str, component: str) -> dict[int, np.ndarray]:
    """By time, (n, 3) of a component."""
    table = recording[path]
    values = table[component].to_pylist()
    return {at: np.array(row).reshape(-1, 3) for at, row in zip(times(table), values, strict=True)}


def test_every_frame_has_the_tables_things(viz_run: Path, recording: Recording) -> None:
    stamps = [row["timestamp_ns"] for row in rows(viz_run / "frames.parquet")]
    tracks = [row for row in rows(viz_run / "tracks.parquet") if row["status"] != "ended"]
    for path, component, table in (
        ("/world/clusters/box", "Boxes3D:centers", rows(viz_run / "clusters.parquet")),
        ("/world/tracks/cylinder", "Cylinders3D:centers", tracks),
    ):
        shown, there = places(recording, path, component), by_stamp(table)
        for at in stamps:
            want = [[row[name] for name in ("x_m", "y_m", "z_m")] for row in there.get(at, [])]
            assert shown[at] == pytest.approx(np.array(want).reshape(-1, 3), abs=1e-5)
        assert [at for at in shown if at not in stamps] == [stamps[-1] + 1_000_000_000]
        assert not len(shown[stamps[-1] + 1_000_000_000]), "what is drawn ends with the log"


def test_predictions_end_where_the_tables_say(viz_run: Path, recording: Recording) -> None:
    table = recording["/world/predictions/line"]
    there = by_stamp(rows(viz_run / "predictions.parquet", step=30))
    for at, strips in zip(times(table), table["LineStrips3D:strips"].to_pylist(), strict=True):
        ends = np.array([strip[-1] for strip in strips]).reshape(-1, 3)
        want = [[row[name] for name in ("x_m", "y_m", "z_m")] for row in there.get(at, [])]
        assert ends == pytest.approx(np.array(want).reshape(-1, 3), abs=1e-5)


def test_the_cloud_hangs_on_the_sensor(viz_run: Path, recording: Recording) -> None:
    frames = rows(viz_run / "frames.parquet")
    cloud = recording["/world/frames/lidar/cloud"]
    assert times(cloud) == [row["timestamp_ns"] for row in frames]
    assert pc.list_value_length(cloud["Points3D:positions"]).to_pylist() == [row["points_read"] for row in frames]
    ids = [len(row) for row in cloud["track_id"].to_pylist()]
    assert ids == [row["points_read"] for row in frames]
    sensor = places(recording, "/world/frames/lidar", "Transform3D:translation")
    for row in frames:
        want = [[row["sensor_x_m"], row["sensor_y_m"], row["sensor_z_m"]]]
        assert sensor[row["timestamp_ns"]] == pytest.approx(np.array(want), abs=1e-5)


def test_nothing_that_is_drawn_in_the_world_is_moved_by_a_transform(recording: Recording) -> None:
    moving = [path for path, table in recording.items() if "Transform3D:translation" in table.column_names]
    below = {path for path in recording for mover in moving if path.startswith(f"{mover}/")}
    assert len(moving) > 1
    assert below == {"/world/frames/lidar/cloud"}


def test_plans_and_paths_are_the_tables(viz_run: Path, recording: Recording) -> None:
    for planner, seed in first_seeds(viz_run, "replay"):
        topic = f"/world/replay/{planner.replace('-', '_')}"
        driven = rows(viz_run / "replay" / "trajectories.parquet", planner=planner, seed=seed)
        stages = by_stamp(rows(viz_run / "replay" / "plan_stages.parquet", planner=planner, seed=seed))
        if stages:
            table = recording[f"{topic}/plan"]
            assert times(table) == list(stages)
            for at, strips in zip(times(table), table["LineStrips3D:strips"].to_pylist(), strict=True):
                want = [[row["x_m"], row["y_m"]] for row in stages[at]]
                assert np.array(strips[0])[:, :2] == pytest.approx(np.array(want), abs=1e-5)
        (last,) = recording[f"{topic}/driven"]["LineStrips3D:strips"].to_pylist()[-1]
        assert np.array(last)[:, :2] == pytest.approx(np.array([[row["x_m"], row["y_m"]] for row in driven]), abs=1e-5)


def test_only_the_scans_time_is_a_timeline(recording: Recording) -> None:
    for table in recording.values():
        assert {name for name in table.column_names if pa.types.is_timestamp(table.schema.field(name).type)} == {"time"}
        assert not {"log_time", "log_tick"} & set(table.column_names)
