"""A batch's datasets: read back by the readers that people use, and when a log counts as finished."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
import pyarrow.dataset as ds
import pytest

from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.io.batch_tables import BatchTables

METRICS = {
    "detection.recall": Metric(0.5, "1", 10, "object and frame", "share", interval=(0.25, 0.75)),
    "hota.hota": Metric(None, "1", 0, "object and frame", "share"),
}


def row(**rest: Any) -> dict[str, Any]:
    known: dict[str, Any] = {"path": "a.mcap", "command": "run", "status": "done", "exit_code": 0, "error": None}
    known |= {"source_sha256": "ab", "run_folder": "runs/log=a", "frames": 3, "span_s": 0.2}
    return known | {"warnings": ["w, 'x'"], "losses": [], "thresholds_missed": []} | rest


@pytest.fixture
def tables(tmp_path: Path) -> BatchTables:
    """Two logs, one of which failed."""
    found = BatchTables(tmp_path / "b.batch")
    found.write("a", "../a.mcap", "key a", row(), METRICS, {"detection.recall"})
    nothing = {"source_sha256": None, "run_folder": None, "frames": None, "span_s": None, "warnings": []}
    found.write("b", "../b.mcap", None, row(status="failed", exit_code=1, error="no LiDAR", **nothing), {}, set())
    return found


def test_duckdb_reads_them_as_one_dataset(tables: BatchTables) -> None:
    folder = tables.folder
    summary = duckdb.sql(
        f"SELECT log, status, error, frames FROM '{folder}/summary/**/*.parquet' ORDER BY log"
    ).fetchall()
    assert summary == [("a", "done", None, 3), ("b", "failed", "no LiDAR", None)]
    query = f"""SELECT s.log, m.metric, m.value, m.low, m.high
        FROM read_parquet('{folder}/summary/*/*.parquet', hive_partitioning = true) s
        LEFT JOIN read_parquet('{folder}/metrics/*/*.parquet', hive_partitioning = true) m
        ON s.log = m.log ORDER BY ALL"""
    assert duckdb.sql(query).fetchall() == [
        ("a", "detection.recall", 0.5, 0.25, 0.75),
        ("a", "hota.hota", None, None, None),
        ("b", None, None, None, None),
    ]


def test_pandas_and_pyarrow_read_them_as_one_dataset(tables: BatchTables) -> None:
    frame = pd.read_parquet(tables.folder / "summary").sort_values("log")
    assert frame["log"].astype(str).tolist() == ["a", "b"]
    assert frame["warnings"].map(list).tolist() == [["w, 'x'"], []]
    found = ds.dataset(tables.folder / "metrics", partitioning="hive").to_table(filter=ds.field("log") == "a")
    assert found["metric"].to_pylist() == list(METRICS)
    assert found["headline"].to_pylist() == [True, False]


def test_a_finished_log_has_its_row_again(tables: BatchTables) -> None:
    written = tables.write("a", "../a.mcap", "key a", row(), METRICS, {"detection.recall"})
    assert tables.finished("a", "key a") == written
    assert written["metrics"] == {"detection.recall": 0.5}
    assert list(written)[:2] == ["log", "path"]


def test_logs_are_known_by_where_they_are(tables: BatchTables) -> None:
    assert tables.names() == {tables.folder / "../a.mcap": "a", tables.folder / "../b.mcap": "b"}
    (tables.folder / "summary" / "log=b" / "part.parquet").write_bytes(b"torn")
    assert list(tables.names().values()) == ["a"]
    assert BatchTables(tables.folder / "not_there").names() == {}


def test_what_is_not_finished(tables: BatchTables) -> None:
    assert tables.finished("a", "another key") is None
    assert tables.finished("b", "key b") is None, "it failed"
    assert tables.finished("c", "key a") is None
    run = tables.run_folder("a")
    run.mkdir(parents=True)
    (run / "run.json").write_text("{}")
    assert tables.finished("a", "key a") is None, "another command made its run folder since"


@pytest.mark.parametrize("dataset", ["summary", "metrics"])
def test_a_damaged_or_missing_part_is_not_trusted(tables: BatchTables, dataset: str) -> None:
    part = tables.folder / dataset / "log=a" / "part.parquet"
    part.write_bytes(part.read_bytes()[:-20])
    assert tables.finished("a", "key a") is None
    part.unlink()
    assert tables.finished("a", "key a") is None


def test_other_logs_leave_the_datasets_but_keep_their_run_folders(tables: BatchTables) -> None:
    tables.run_folder("b").mkdir(parents=True)
    (tables.folder / "summary" / "notes").mkdir()
    assert tables.remove_others(["a"]) == ["b"]
    assert pd.read_parquet(tables.folder / "summary" / "log=a")["status"].tolist() == ["done"]
    assert not (tables.folder / "metrics" / "log=b").exists()
    assert tables.run_folder("b").is_dir()
    assert (tables.folder / "summary" / "notes").is_dir(), "what is not a log's stays"
