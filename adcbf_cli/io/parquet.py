"""Parquet files: written frame by frame under a temporary name, read back in batches.

Float columns hold null for "no evidence", never NaN.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.atomic import atomic_path
from adcbf_cli.io.log_base import printable
from adcbf_cli.io.schemas import SCHEMAS

SCHEMA_VERSION = 1
METADATA_KEY = b"adcbf"
GROUP_BYTES = 4_000_000
"""So much waits in memory before it is written as a row group: rows of different tables differ in size."""
ROWS_READ = 4096
READ_BUFFER_BYTES = 1 << 16
"""Of each column, while a table is read back."""
PIECES_HELD = 200
"""So many frames' rows wait as tables of their own; then they become one. A table of one row takes a
hundred times its numbers' memory."""

Columns = dict[str, Any]


class TableWriter:
    """Writes one table, frame by frame, under a temporary name; the file appears when the `with`
    block ends well, and not at all otherwise."""

    def __init__(self, path: Path, table: str, metadata: Mapping[str, Any]) -> None:
        text = json.dumps({"schema_version": SCHEMA_VERSION, "table": table, **metadata}, sort_keys=True)
        self._schema = SCHEMAS[table].with_metadata({METADATA_KEY: text.encode()})
        self._path = path
        self._pending: list[pa.Table] = []
        self._pending_bytes = 0
        self.rows = 0

    def __enter__(self) -> TableWriter:
        self._target = atomic_path(self._path)
        dictionary = [f.name for f in self._schema if pa.types.is_string(f.type)]
        self._writer = pq.ParquetWriter(
            self._target.__enter__(),
            self._schema,
            compression="zstd",
            use_dictionary=dictionary,
        )
        return self

    def write(self, columns: Columns) -> None:
        """Adds rows, given as equally long arrays by column name."""
        table = pa.table({f.name: _array(columns[f.name], f.type) for f in self._schema}, schema=self._schema)
        self.rows += len(table)
        self._pending.append(table)
        self._pending_bytes += table.nbytes
        if self._pending_bytes >= GROUP_BYTES:
            self._flush()
        elif len(self._pending) >= PIECES_HELD:
            self._pending = [pa.concat_tables(self._pending).combine_chunks()]

    def _flush(self) -> None:
        if self._pending:
            self._writer.write_table(pa.concat_tables(self._pending).combine_chunks())
        self._pending, self._pending_bytes = [], 0

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._flush()
            self._writer.close()
        finally:
            self._target.__exit__(kind, error, trace)


def _array(values: Any, kind: pa.DataType) -> pa.Array:
    if isinstance(values, pa.Array):
        return values
    if pa.types.is_float64(kind):
        return pa.array(values, kind, from_pandas=True)  # NaN becomes null
    return pa.array(values, kind)


def table_metadata(path: Path) -> dict[str, Any] | None:
    """What the table says about itself, or None if it is missing, foreign or damaged, or has not its name's columns."""
    try:
        schema = pq.read_schema(path)
        metadata = json.loads((schema.metadata or {}).get(METADATA_KEY, b"null"))
    except (OSError, pa.ArrowException, ValueError):
        return None
    expected = SCHEMAS.get(path.stem)
    if expected is None or not schema.equals(expected):
        return None
    return metadata if isinstance(metadata, dict) else None


def read_table(path: Path, columns: list[str]) -> pa.Table:
    """These columns of a table. AdcbfError where it is damaged."""
    with told_as_damage(path):
        return pq.read_table(path, columns=columns)


def batches(path: Path, batch_size: int, columns: list[str] | None = None) -> Iterator[pa.RecordBatch]:
    """A table's rows, a batch at a time. AdcbfError where it is damaged.

    Without pre-buffering, which would hold the whole file's compressed columns.
    """
    with told_as_damage(path):
        file = pq.ParquetFile(path, pre_buffer=False, buffer_size=READ_BUFFER_BYTES)
        yield from file.iter_batches(batch_size=batch_size, columns=columns, use_threads=False)


@contextmanager
def told_as_damage(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, pa.ArrowException) as error:
        reason = printable(" ".join(str(error).split())[:120])
        raise AdcbfError(f"{path}: damaged ({reason}); --force computes it anew") from None
