"""`score_blocks.parquet`: what the metrics in report.json are made of, so that two runs on one log can be paired."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from adcbf_cli.core.evaluation.blocks import Blocks, Form
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.io.parquet import METADATA_KEY, SCHEMA_VERSION, TableWriter
from adcbf_cli.io.report import JSON_NAME
from adcbf_cli.io.schemas import SCHEMAS

BLOCKS_NAME = "score_blocks.parquet"
_TABLE = "score_blocks"


def write_score_blocks(folder: Path, metrics: Mapping[str, Metric]) -> None:
    """Writes the blocks of the metrics that have any, for the report.json that is in the folder."""
    with TableWriter(folder / BLOCKS_NAME, _TABLE, {"report_sha256": _digest(folder / JSON_NAME)}) as writer:
        for name, metric in metrics.items():
            blocks = metric.blocks
            if blocks is not None:
                count = len(blocks.keys)
                writer.write(
                    {
                        "metric": pa.array([name] * count),
                        "block": blocks.keys,
                        "sum": blocks.sums,
                        "count": blocks.counts,
                        "dealt": np.full(count, blocks.dealt),
                        "form": pa.array([blocks.form] * count),
                    }
                )


def read_score_blocks(folder: Path) -> dict[str, Blocks]:
    """The blocks by metric; none where there are none for the report.json that is in the folder."""
    path = folder / BLOCKS_NAME
    try:
        table = pq.ParquetFile(path).read()
        metadata: Any = json.loads((table.schema.metadata or {}).get(METADATA_KEY, b"null"))
        ours = isinstance(metadata, dict) and metadata.get("schema_version") == SCHEMA_VERSION
        if not ours or metadata.get("report_sha256") != _digest(folder / JSON_NAME):
            return {}
    except (OSError, pa.ArrowException, ValueError):
        return {}
    if not table.schema.equals(SCHEMAS[_TABLE]):
        return {}
    columns = {name: table[name].to_numpy() for name in table.schema.names}
    if not set(columns["form"]) <= set(get_args(Form)):
        return {}
    names = columns["metric"]
    starts = [i for i in range(len(names)) if i == 0 or names[i] != names[i - 1]]
    return {str(names[i]): _blocks(columns, slice(i, j)) for i, j in pairwise([*starts, len(names)])}


def _blocks(columns: Mapping[str, Any], rows: slice) -> Blocks:
    return Blocks(
        keys=columns["block"][rows],
        sums=columns["sum"][rows],
        counts=columns["count"][rows],
        dealt=bool(columns["dealt"][rows][0]),
        form=columns["form"][rows][0],
    )


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
