"""The points of the shown scans: from the run's `points` table, else from the log itself, clustered once more."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.types import NO_ID, Clusters, FloatArray, IntArray, Notes
from adcbf_cli.io.html_report.thinning import MILLI, evenly, integers
from adcbf_cli.io.parquet import ROWS_READ, batches

Labelled = Iterator[tuple[int, FloatArray, IntArray]]
"""Frame by frame: its index, points (n, 2) in the world in m, and each one's cluster or NO_ID."""


def stored_points(table: Path, wanted: set[int]) -> Labelled:
    """The wanted frames' points, from the table; its rows are sorted by frame."""
    columns = ["frame_index", "x_m", "y_m", "cluster_id"]
    index, held = None, []
    for batch in batches(table, batch_size=ROWS_READ * 4, columns=columns):
        frames = batch.column("frame_index").to_numpy()
        places = np.column_stack([batch.column(name).to_numpy() for name in ("x_m", "y_m")])
        labels = batch.column("cluster_id").fill_null(NO_ID).to_numpy().astype(np.int64)
        cuts = np.flatnonzero(np.diff(frames)) + 1
        for part in np.split(np.arange(len(frames)), cuts):
            if not len(part):
                continue
            if index is not None and frames[part[0]] != index:
                yield from _joined(index, held)
                held = []
            index = int(frames[part[0]])
            if index in wanted:
                held.append((places[part], labels[part]))
    if index is not None:
        yield from _joined(index, held)


def _joined(index: int, held: list[tuple[FloatArray, IntArray]]) -> Labelled:
    if held:
        yield index, np.concatenate([places for places, _ in held]), np.concatenate([labels for _, labels in held])


class LogPoints:
    """The points of a log, frame by frame, labelled by the run's own perception."""

    def __init__(self, log: Path, config: Config, stack: ExitStack) -> None:
        from adcbf_cli.core.perception.pipeline import cluster_frames
        from adcbf_cli.io.frame_reader import FrameReader

        notes = Notes()  # the run folder has them already
        labelling = config.perception.model_copy(update={"point_labels": True})
        reader = stack.enter_context(FrameReader(log, config.read, notes))
        self.records: Iterable[Clusters] = cluster_frames(reader, labelling, notes)

    @staticmethod
    def of(record: Clusters) -> tuple[int, FloatArray, IntArray]:
        """A record's index, points and labels."""
        if record.labels is None:
            raise ValueError("this record has no point labels")
        return record.frame_index, record.labels.points_m[:, :2], record.labels.cluster_id


def encode_points(points_m: FloatArray, label: IntArray, origin_m: FloatArray, most: int, cell_m: float) -> list[int]:
    """x, y (mm from the origin) and cluster (-1: none) of at most `most` points, one a `cell_m` square and cluster.

    The first point in a square stands for it: several lie above one another in a top view.
    """
    cells = np.column_stack([np.floor(points_m / cell_m).astype(np.int64), label])
    _, first = np.unique(cells, axis=0, return_index=True)
    first = first[evenly(len(first), most)]
    rows = np.column_stack([np.rint((points_m[first] - origin_m) * MILLI), label[first]])
    return [value for value in integers(rows) if value is not None]
