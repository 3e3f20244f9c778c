"""A small run folder to make views of, and what its tables say, read with pyarrow alone."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pyarrow.parquet as pq

SAMPLE = Path(__file__).resolve().parents[3] / "sample_data"


def adcbf(*arguments: str | Path) -> tuple[int, str, str]:
    """The command in this process: exit code, stdout, stderr."""
    from adcbf_cli.app import main

    out, err = io.StringIO(), io.StringIO()
    with patch.object(sys, "argv", ["adcbf", *map(str, arguments)]), redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as left:
            return int(left.code or 0), out.getvalue(), err.getvalue()
    return 0, out.getvalue(), err.getvalue()


Rows = list[dict[str, Any]]


def rows(path: Path, **equal: Any) -> Rows:
    return [row for row in pq.read_table(path).to_pylist() if all(row[key] == value for key, value in equal.items())]


def by_stamp(table: Rows) -> dict[int, Rows]:
    found: dict[int, Rows] = {}
    for row in table:
        found.setdefault(row["timestamp_ns"], []).append(row)
    return found


def first_seeds(run: Path, mode: str) -> Iterator[tuple[str, int]]:
    """Each planner with the first seed it drove with."""
    seen: set[str] = set()
    for row in rows(run / mode / "drives.parquet"):
        if row["planner"] not in seen:
            seen.add(row["planner"])
            yield row["planner"], row["seed"]
