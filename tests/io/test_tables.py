"""Records survive the way through Parquet, whatever the frames hold; tables are whole or absent."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import NO_ID
from adcbf_cli.io import parquet, tables
from adcbf_cli.io.parquet import TableWriter
from adcbf_cli.io.schemas import SCHEMAS
from tests.records import make_clusters, make_predictions, make_tracks

counts_per_frame = st.lists(st.integers(0, 4), min_size=0, max_size=6)


def assert_same(record: Any, other: Any) -> None:
    for field in dataclasses.fields(record):
        ours, theirs = getattr(record, field.name), getattr(other, field.name)
        if isinstance(ours, np.ndarray):
            np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-12, err_msg=field.name)
            assert theirs.shape == ours.shape, field.name
        elif field.name != "labels":
            assert ours == theirs, field.name


def write_run(folder: Path, counts: list[int], dimension: int = 6, steps: int = 3) -> tuple[list[Any], ...]:
    rng = np.random.default_rng(1)
    records: tuple[list[Any], ...] = ([], [], [])
    with (
        TableWriter(folder / "frames.parquet", "frames", {}) as frames,
        TableWriter(folder / "clusters.parquet", "clusters", {}) as clusters,
        TableWriter(folder / "tracks.parquet", "tracks", {}) as tracks,
        TableWriter(folder / "predictions.parquet", "predictions", {}) as predictions,
    ):
        for i, n in enumerate(counts):
            seen = make_clusters(i, n, rng)
            followed = make_tracks(i, n, dimension, rng)
            ahead = make_predictions(i, n, steps, rng)
            frames.write(tables.frame_columns(seen))
            clusters.write(tables.cluster_columns(seen))
            tracks.write(tables.track_columns(followed))
            predictions.write(tables.prediction_columns(ahead))
            for kept, record in zip(records, (seen, followed, ahead), strict=True):
                kept.append(record)
    return records


@given(counts=counts_per_frame, dimension=st.sampled_from([6, 7, 9]))
@settings(max_examples=25, deadline=None)
def test_records_come_back_as_they_went(
    tmp_path_factory: pytest.TempPathFactory, counts: list[int], dimension: int
) -> None:
    folder = tmp_path_factory.mktemp("run")
    clusters, tracks, predictions = write_run(folder, counts, dimension)
    for ours, theirs in zip(clusters, tables.read_clusters(folder), strict=True):
        assert_same(ours, theirs)
    for ours, theirs in zip(tracks, tables.read_tracks(folder), strict=True):
        if len(ours):
            assert_same(dataclasses.replace(ours, world_from_sensor=theirs.world_from_sensor), theirs)
        else:
            assert len(theirs) == 0
    for ours, theirs in zip(predictions if any(counts) else [], tables.read_predictions(folder), strict=True):
        if len(ours):
            assert_same(ours, theirs)
        else:
            assert (len(theirs), theirs.stamp_ns, theirs.step_s) == (0, ours.stamp_ns, ours.step_s)


def test_frames_that_straddle_read_batches_stay_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clusters, _, _ = write_run(tmp_path, [3, 0, 4, 1, 4])
    monkeypatch.setattr(tables, "ROWS_READ", 2)
    for ours, theirs in zip(clusters, tables.read_clusters(tmp_path), strict=True):
        assert_same(ours, theirs)


def test_no_id_and_no_evidence_are_null_in_the_file(tmp_path: Path) -> None:
    write_run(tmp_path, [4])
    tracks = pq.read_table(tmp_path / "tracks.parquet")
    assert tracks["cluster_id"].to_pylist() == [None, 1, None, 3]
    assert tracks["nis"].to_pylist() == [None, 3.0, None, 3.0]
    predictions = pq.read_table(tmp_path / "predictions.parquet")
    assert predictions["conformal_radius_m"].null_count == 4
    clusters = pq.read_table(tmp_path / "clusters.parquet")
    assert clusters["split_from"].to_pylist() == [None, 7, 7, None]
    assert NO_ID not in clusters["split_from"].to_pylist()


def test_prediction_rows_are_sorted_and_name_their_target_time(tmp_path: Path) -> None:
    write_run(tmp_path, [2], steps=3)
    rows = pq.read_table(tmp_path / "predictions.parquet").to_pylist()
    assert [(r["track_id"], r["step"]) for r in rows] == [(100, 1), (100, 2), (100, 3), (101, 1), (101, 2), (101, 3)]
    assert rows[2]["target_ns"] - rows[2]["timestamp_ns"] == 300_000_000


def test_point_labels_become_rows(tmp_path: Path) -> None:
    record = make_clusters(0, 2, np.random.default_rng(0), with_labels=True)
    with TableWriter(tmp_path / "points.parquet", "points", {}) as writer:
        writer.write(tables.point_columns(record))
    assert pq.read_table(tmp_path / "points.parquet")["cluster_id"].to_pylist() == [None, None, 0, 0]


def test_an_empty_table_has_its_types(tmp_path: Path) -> None:
    with TableWriter(tmp_path / "tracks.parquet", "tracks", {"key": "k"}):
        pass
    table = pq.read_table(tmp_path / "tracks.parquet")
    assert len(table) == 0
    assert table.schema.names == SCHEMAS["tracks"].names
    metadata = parquet.table_metadata(tmp_path / "tracks.parquet")
    assert metadata is not None
    assert metadata["key"] == "k"


def test_a_failing_write_leaves_the_old_table_alone(tmp_path: Path) -> None:
    write_run(tmp_path, [2])
    before = (tmp_path / "clusters.parquet").read_bytes()
    record = make_clusters(0, 3, np.random.default_rng(5))
    with pytest.raises(KeyError), TableWriter(tmp_path / "clusters.parquet", "clusters", {}) as writer:
        writer.write({"timestamp_ns": record.cluster_id})
    assert (tmp_path / "clusters.parquet").read_bytes() == before
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("damage", [b"", b"PAR1", b"not parquet at all", None])
def test_metadata_of_what_is_no_table_is_none(tmp_path: Path, damage: bytes | None) -> None:
    path = tmp_path / "clusters.parquet"
    if damage is not None:
        path.write_bytes(damage)
    assert parquet.table_metadata(path) is None


def test_the_same_records_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_run(tmp_path / name, [3, 0, 2])
    for table in ("frames", "clusters", "tracks", "predictions"):
        assert (tmp_path / "a" / f"{table}.parquet").read_bytes() == (tmp_path / "b" / f"{table}.parquet").read_bytes()


def test_rows_that_wait_take_the_memory_of_their_numbers_and_little_more(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    records = [make_clusters(i, 1, rng) for i in range(4 * parquet.PIECES_HELD + 3)]
    with TableWriter(tmp_path / "frames.parquet", "frames", {}) as writer:
        for record in records:
            writer.write(tables.frame_columns(record))
            assert len(writer._pending) <= parquet.PIECES_HELD
    read = pq.ParquetFile(tmp_path / "frames.parquet")
    assert read.num_row_groups == 1
    assert read.read()["frame_index"].to_pylist() == list(range(len(records)))


def test_a_table_whose_pages_are_damaged_is_told_in_one_line(tmp_path: Path) -> None:
    """Its footer is whole, so that only reading finds it."""
    path = tmp_path / "timings.parquet"
    with TableWriter(path, "timings", {"key": "k"}) as writer:
        for frame in range(300):
            writer.write(tables.timing_columns(frame, frame, {"read": frame * 1_000_003}))
    data = bytearray(path.read_bytes())
    data[4 : len(data) // 3] = bytes(len(data) // 3 - 4)
    path.write_bytes(data)
    assert parquet.table_metadata(path) is not None
    with pytest.raises(AdcbfError, match=r"damaged .*--force") as error:
        parquet.read_table(path, ["time_ms", "frame_index"])
    assert "\n" not in str(error.value)


def test_a_table_of_other_columns_is_foreign_whatever_its_key(tmp_path: Path) -> None:
    with TableWriter(tmp_path / "tracks.parquet", "tracks", {"key": "k"}):
        pass
    path = tmp_path / "tracks.parquet"
    table = pq.read_table(path)
    assert parquet.table_metadata(path) is not None
    pq.write_table(table.drop_columns(["nis"]).replace_schema_metadata(table.schema.metadata), path)
    assert parquet.table_metadata(path) is None
