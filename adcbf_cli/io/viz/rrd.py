"""Writes what is to be drawn as a recording for Rerun's viewer.

A row of an entity holds all that is drawn there, so that the next row replaces it; an empty row ends what a gap in
the log, or its end, would leave behind.

Rerun gives rows and chunks random ids; here they are counted, so that the same input gives the same bytes.
"""

from __future__ import annotations

import importlib
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from adcbf_cli.core.frames import quaternion_from_rotation
from adcbf_cli.core.types import FloatArray
from adcbf_cli.io.atomic import atomic_path
from adcbf_cli.io.viz.items import LIFETIME_NS, Cloud, Drawing, Item, PosePath, Shape, Transform
from adcbf_cli.io.viz.records import Show
from adcbf_cli.io.viz.shapes import cloud_rgb

TIMELINE = "time"
CHUNK_BYTES = 1 << 20
CHUNK_ROWS = 256
"""So much of an entity is written as one chunk: many small ones would slow the viewer down."""

_MAGIC, _HEADER_BYTES = b"RRF2", 12
_MESSAGE = struct.Struct("<QQ")
_STORE_INFO = 1
_ROW_ID_START, _ROW_ID_MIDDLE, _ROW_ID_BYTES = b"\x0a\x12\x09", b"\x11", 17
"""Of a recording's file: its header, a message's kind and size, and a protobuf of two 64-bit numbers, the row id."""

_LINE_M = 0.02
_PATH_M = 0.04
_POINT_PIXELS = 1.5
_ALPHA_POWER = 1.5
"""Rerun's viewer blends so that the same alpha hides more than in the others."""


@dataclass
class _Rows:
    """Rows of one entity that wait to be written: per row its time, and by component what it holds."""

    stamp_ns: list[int] = field(default_factory=list)
    batches: dict[Any, list[Any]] = field(default_factory=dict)
    bytes: int = 0


@dataclass(frozen=True)
class _Joined:
    """Values of many rows, as Rerun wants to be given them."""

    values: pa.Array

    def as_arrow_array(self) -> pa.Array:
        return self.values


@cache
def _rerun(module: str = "rerun") -> Any:
    """Rerun's SDK, which is an extra. Its library would warn at every file about the index that is left out."""
    os.environ.setdefault("RUST_LOG", "error")
    return importlib.import_module(module)


class RrdWriter:
    """Get one from `open_rrd`."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self._rows: dict[str, _Rows] = {}
        self._drawn_ns: dict[str, int] = {}
        self._ids = 0

    def write(self, item: Item) -> None:
        match item:
            case Transform():
                self._add(_frame_path(item.child), item.stamp_ns, _transform(item))
            case Cloud():
                self._add(f"{_frame_path(item.frame_id)}{item.topic}", item.stamp_ns, *_cloud(item))
            case PosePath():
                self._add(f"world{item.topic}", item.stamp_ns, _path(item))
            case Drawing():
                self._draw(item)

    def finish(self) -> None:
        """Ends what is drawn, and writes what waits."""
        for topic, stamp_ns in self._drawn_ns.items():
            self._clear(topic, stamp_ns + LIFETIME_NS)
        for path in list(self._rows):
            self._flush(path)

    def _draw(self, drawing: Drawing) -> None:
        last_ns = self._drawn_ns.get(drawing.topic)
        if last_ns is not None and drawing.stamp_ns - last_ns > LIFETIME_NS:
            self._clear(drawing.topic, last_ns + LIFETIME_NS)
        self._drawn_ns[drawing.topic] = drawing.stamp_ns
        shapes = [shape for entity in drawing.entities for shape in entity.shapes]
        for kind, archetype in _ARCHETYPES.items():
            self._add(
                f"world{drawing.topic}/{kind}", drawing.stamp_ns, archetype([s for s in shapes if s.kind == kind])
            )

    def _clear(self, topic: str, stamp_ns: int) -> None:
        for kind, archetype in _ARCHETYPES.items():
            self._add(f"world{topic}/{kind}", stamp_ns, archetype([]))

    def _add(self, path: str, stamp_ns: int, *archetypes: Any) -> None:
        rows = self._rows.setdefault(path, _Rows())
        rows.stamp_ns.append(stamp_ns)
        for batch in chain.from_iterable(archetype.as_component_batches() for archetype in archetypes):
            values = batch.as_arrow_array()
            rows.batches.setdefault(str(batch.component_descriptor()), []).append(
                (batch.component_descriptor(), values)
            )
            rows.bytes += values.nbytes
        if rows.bytes >= CHUNK_BYTES or len(rows.stamp_ns) >= CHUNK_ROWS:
            self._flush(path)

    def _flush(self, path: str) -> None:
        rr, chunks = _rerun(), _rerun("rerun.chunk")
        rows = self._rows.pop(path)
        times = rr.TimeColumn(TIMELINE, timestamp=np.array(rows.stamp_ns, dtype="datetime64[ns]"))
        columns = []
        for named in rows.batches.values():
            arrays = [values for _, values in named]
            together = _Joined(pa.concat_arrays(arrays))
            columns.append(rr.ComponentColumn(named[0][0], together, lengths=[len(values) for values in arrays]))
        chunk = chunks.Chunk.from_columns(f"/{path}", indexes=[times], columns=columns)
        self._stream.send_chunks(chunks.Chunk.from_record_batch(self._counted(chunk.to_record_batch())))

    def _counted(self, batch: pa.RecordBatch) -> pa.RecordBatch:
        """The chunk with ids that are counted."""
        metadata = dict(batch.schema.metadata)
        metadata[b"rerun:id"] = f"chunk_{self._take_id():032X}".encode()
        ids = [self._take_id().to_bytes(16, "big") for _ in range(len(batch))]
        place = batch.schema.get_field_index("rerun.controls.RowId")
        row_id = batch.schema.field(place)
        batch = batch.set_column(place, row_id, pa.array(ids, row_id.type))
        return batch.replace_schema_metadata(metadata)

    def _take_id(self) -> int:
        self._ids += 1
        return self._ids


def _frame_path(frame_id: str) -> str:
    """Frames have a branch of their own: a transform moves all that is below it, and drawings are in the world."""
    return f"world/frames/{_rerun().escape_entity_path_part(frame_id)}"


def _transform(item: Transform) -> Any:
    matrix = item.parent_from_child
    return _rerun().Transform3D(translation=matrix[:3, 3], quaternion=quaternion_from_rotation(matrix[:3, :3]))


def _cloud(item: Cloud) -> tuple[Any, Any]:
    """The points, and the ids of what each belongs to."""
    rr, cloud = _rerun(), item.cloud
    points = rr.Points3D(cloud.points_m, colors=cloud_rgb(cloud), radii=rr.Radius.ui_points(_POINT_PIXELS))
    return points, rr.AnyValues(cluster_id=cloud.cluster_id, track_id=cloud.track_id)


def _path(item: PosePath) -> Any:
    return _rerun().LineStrips3D([item.poses[:, :3]], colors=[item.rgb], radii=[_PATH_M])


def _colours(shapes: list[Shape]) -> np.ndarray:
    rows = [(*shape.rgb, round(255 * shape.alpha**_ALPHA_POWER)) for shape in shapes]
    return np.array(rows, dtype=np.uint8).reshape(-1, 4)


def _centres(shapes: list[Shape]) -> FloatArray:
    return np.array([shape.position_m for shape in shapes]).reshape(-1, 3)


def _halves(shapes: list[Shape]) -> FloatArray:
    return np.array([shape.size_m for shape in shapes]).reshape(-1, 3) / 2


def _turns(shapes: list[Shape]) -> FloatArray:
    half = np.array([shape.yaw_rad for shape in shapes]) / 2
    return np.column_stack([np.zeros((len(half), 2)), np.sin(half), np.cos(half)])


def _cylinders(shapes: list[Shape]) -> Any:
    halves = _halves(shapes)
    return _rerun().Cylinders3D(
        lengths=2 * halves[:, 2],
        radii=halves[:, 0],
        centers=_centres(shapes),
        colors=_colours(shapes),
        fill_mode="solid",
        labels=[shape.text for shape in shapes],
        show_labels=False,
    )


def _ellipses(shapes: list[Shape]) -> Any:
    return _rerun().Ellipsoids3D(
        half_sizes=_halves(shapes), centers=_centres(shapes), quaternions=_turns(shapes), colors=_colours(shapes)
    )


def _boxes(shapes: list[Shape]) -> Any:
    return _rerun().Boxes3D(
        half_sizes=_halves(shapes), centers=_centres(shapes), quaternions=_turns(shapes), colors=_colours(shapes)
    )


def _arrows(shapes: list[Shape]) -> Any:
    yaw = np.array([shape.yaw_rad for shape in shapes])
    length = 2 * _halves(shapes)[:, :1]
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))])
    return _rerun().Arrows3D(vectors=length * ahead, origins=_centres(shapes), colors=_colours(shapes))


def _lines(shapes: list[Shape]) -> Any:
    strips = [shape.points_m for shape in shapes]
    return _rerun().LineStrips3D(strips, colors=_colours(shapes), radii=[_LINE_M] * len(strips))


def _texts(shapes: list[Shape]) -> Any:
    return _rerun().Points3D(
        _centres(shapes),
        labels=[shape.text for shape in shapes],
        colors=_colours(shapes),
        radii=np.full(len(shapes), 1e-3),
        show_labels=True,
    )


_ARCHETYPES: dict[str, Callable[[list[Shape]], Any]] = {
    "cylinder": _cylinders,
    "ellipse": _ellipses,
    "box": _boxes,
    "arrow": _arrows,
    "line": _lines,
    "text": _texts,
}


@contextmanager
def open_rrd(path: Path, show: Show) -> Iterator[RrdWriter]:
    """A recording, which appears at `path` when it is complete.

    It has no footer, Rerun's index of chunks: the SDK writes that in another order each time.
    """
    with atomic_path(path) as temporary:
        stream = _rerun().RecordingStream("adcbf", recording_id=show.source_sha256[:32], send_properties=False)
        stream.save(temporary, write_footer=False)
        writer = RrdWriter(stream)
        try:
            yield writer
            writer.finish()
            stream.flush()
        finally:
            stream.disconnect()
        _settle_store_ids(temporary)


def _settle_store_ids(path: Path) -> None:
    """The messages that open a recording, which name it, carry random row ids too; they become zero. A file that does
    not begin as expected is left as it is."""
    with path.open("r+b") as file:
        if file.read(4) != _MAGIC:
            return
        place = _HEADER_BYTES
        while True:
            file.seek(place)
            head = file.read(_MESSAGE.size + len(_ROW_ID_START) + _ROW_ID_BYTES)
            kind, size = _MESSAGE.unpack_from(head) if len(head) >= _MESSAGE.size else (0, 0)
            time, rest = head[_MESSAGE.size :][:3], head[_MESSAGE.size + 11 :][:1]
            if kind != _STORE_INFO or time != _ROW_ID_START or rest != _ROW_ID_MIDDLE:
                return
            file.seek(place + _MESSAGE.size + 3)
            file.write(bytes(8) + _ROW_ID_MIDDLE + bytes(8))
            place += _MESSAGE.size + size
