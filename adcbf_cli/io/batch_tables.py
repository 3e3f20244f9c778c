"""What a batch keeps of each log: `summary/log=<name>/part.parquet`, one row, and `metrics/log=<name>/part.parquet`,
one row a metric. Each of the two folders is one hive-partitioned dataset, whose column `log` is the name.

The summary is written last. It carries the key of all that the log's results depend on, so that a log whose
summary has that key, and whose run folder is still the one it tells of, is finished.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.io.atomic import remove_leftovers
from adcbf_cli.io.parquet import METADATA_KEY, SCHEMA_VERSION, TableWriter, table_metadata
from adcbf_cli.io.run_folder import DRIVING, MANIFEST
from adcbf_cli.io.run_scores import REPORTS
from adcbf_cli.io.schemas import SCHEMAS
from adcbf_cli.io.viz import VIEW_FILES

PART = "part.parquet"
DATASETS = ("summary", "metrics")
RUNS = "runs"
_PREFIX = "log="

Row = dict[str, Any]


class BatchTables:
    """The datasets in a batch's folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run_folder(self, name: str) -> Path:
        return self.folder / RUNS / f"{_PREFIX}{name}"

    def names(self) -> dict[Path, str]:
        """The paths of the logs that are in the summary, and the names that they go by."""
        names = [folder.name.removeprefix(_PREFIX) for folder in sorted((self.folder / "summary").glob(f"{_PREFIX}*/"))]
        places = {name: self._read("summary", name)[0].get("place") for name in names}
        return {self.folder / place: name for name, place in places.items() if isinstance(place, str)}

    def finished(self, name: str, key: str) -> Row | None:
        """The log's row as `write` was given it, if the log is finished under this key; else None."""
        metadata, rows = self._read("summary", name)
        if metadata.get("key") != key or metadata.get("made") != self._fingerprint(name) or len(rows) != 1:
            return None
        about_metrics, metrics = self._read("metrics", name)
        if about_metrics.get("key") != key:
            return None
        headlines = {metric["metric"]: metric["value"] for metric in metrics if metric["headline"]}
        return {"log": name, **rows[0], "metrics": headlines}

    def write(
        self, name: str, place: str, key: str | None, row: Row, metrics: Mapping[str, Metric], headlines: set[str]
    ) -> Row:
        """Keeps a log's results; returns its row with the headline metrics.

        place: the log's path from the batch's folder. key: None where it is not to count as finished. row: the columns
        of `summary`.
        """
        for dataset in DATASETS:
            self._part(dataset, name).parent.mkdir(parents=True, exist_ok=True)
            remove_leftovers(self._part(dataset, name).parent)
        metadata = {"key": key, "made": self._fingerprint(name), "place": place}
        with TableWriter(self._part("metrics", name), "metrics", metadata) as writer:
            writer.write(_metric_columns(metrics, headlines))
        with TableWriter(self._part("summary", name), "summary", metadata) as writer:
            writer.write({column: [row[column]] for column in SCHEMAS["summary"].names})
        shown = {n: metric.value for n, metric in metrics.items() if n in headlines}
        return {"log": name, **{column: row[column] for column in SCHEMAS["summary"].names}, "metrics": shown}

    def remove_others(self, names: Iterable[str]) -> list[str]:
        """Takes logs that are none of these out of the datasets; their run folders stay. Returns their names."""
        kept = {f"{_PREFIX}{name}" for name in names}
        gone = set()
        for dataset in DATASETS:
            for folder in sorted((self.folder / dataset).glob(f"{_PREFIX}*/")):
                if folder.name not in kept:
                    gone.add(folder.name.removeprefix(_PREFIX))
                    shutil.rmtree(folder)
        return sorted(gone)

    def _part(self, dataset: str, name: str) -> Path:
        return self.folder / dataset / f"{_PREFIX}{name}" / PART

    def _read(self, dataset: str, name: str) -> tuple[dict[str, Any], list[Row]]:
        """A part's metadata and rows; nothing where it is missing, damaged or another version's."""
        path = self._part(dataset, name)
        try:
            table = pq.ParquetFile(path).read()
            metadata = json.loads((table.schema.metadata or {}).get(METADATA_KEY, b"null"))
        except (OSError, pa.ArrowException, ValueError):
            return {}, []
        whole = isinstance(metadata, dict) and table.schema.equals(SCHEMAS[dataset])
        if not whole or metadata.get("schema_version") != SCHEMA_VERSION:
            return {}, []
        return metadata, table.to_pylist()

    def _fingerprint(self, name: str) -> str:
        """Of the run folder's manifest and reports, and of which of its other files are there and whole: another
        command on the folder changes one of them, or a hand that removes or cuts off what it holds."""
        run = self.run_folder(name)
        digest = hashlib.sha256()
        for file in (MANIFEST, *REPORTS):
            path = run / file
            content = path.read_bytes() if path.is_file() else b""
            digest.update(f"{file} {len(content)}\n".encode() + content)
        tables = (path for place in (".", *DRIVING.values()) for path in sorted((run / place).glob("*.parquet")))
        views = (run / file for files in VIEW_FILES.values() for file in files)
        for path in (*tables, *(view for view in views if view.is_file())):
            whole = path.suffix != ".parquet" or table_metadata(path) is not None
            digest.update(f"{path.relative_to(run).as_posix()} {whole}\n".encode())
        return digest.hexdigest()


def _metric_columns(metrics: Mapping[str, Metric], headlines: set[str]) -> dict[str, Sequence[Any]]:
    found = list(metrics.values())
    intervals = [metric.interval or (None, None) for metric in found]
    return {
        "metric": list(metrics),
        "value": [metric.value for metric in found],
        "unit": [metric.unit for metric in found],
        "n": [metric.n for metric in found],
        "sample": [metric.sample for metric in found],
        "low": [low for low, _ in intervals],
        "high": [high for _, high in intervals],
        "headline": [name in headlines for name in metrics],
    }
