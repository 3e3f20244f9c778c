"""Writes what is to be drawn in Foxglove's schemas (protobuf) into an MCAP.

An entity is replaced by the next one of its id; one that is gone is deleted by the update that lacks it, and what a
gap in the log leaves behind goes with its lifetime.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from adcbf_cli.core.frames import quaternion_from_rotation
from adcbf_cli.core.types import FloatArray
from adcbf_cli.io.atomic import atomic_path
from adcbf_cli.io.viz.items import LIFETIME_NS, Cloud, Drawing, Entity, Item, PosePath, Shape, Transform
from adcbf_cli.io.viz.records import Show
from adcbf_cli.io.viz.shapes import POINT, Rgb, packed_cloud

_NS = 1_000_000_000
_NUMERIC_TYPES = {"u1": 1, "<i4": 6, "<f4": 7}


@cache
def _schema(name: str) -> Any:
    """A message class by its name; `Timestamp` and `Duration` are protobuf's own."""
    if name in ("Timestamp", "Duration"):
        return getattr(importlib.import_module(f"google.protobuf.{name.lower()}_pb2"), name)
    return getattr(importlib.import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)


class FoxgloveWriter:
    """Get one from `open_foxglove`."""

    def __init__(self, writer: Any, show: Show) -> None:
        self._writer = writer
        self._world = show.world_frame
        self._shown: dict[str, set[int]] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}

    def write(self, item: Item) -> None:
        match item:
            case Transform():
                self._add("/tf", item.stamp_ns, "FrameTransform", **_transform(item))
            case Cloud():
                self._add(item.topic, item.stamp_ns, "PointCloud", frame_id=item.frame_id, **_cloud(item))
            case PosePath():
                poses = [_pose(pose[:3], pose[3]) for pose in item.poses]
                self._add(item.topic, item.stamp_ns, "PosesInFrame", frame_id=self._world, poses=poses)
            case Drawing():
                self._draw(item)

    def _draw(self, drawing: Drawing) -> None:
        stamp = _timestamp(drawing.stamp_ns)
        now = {entity.id for entity in drawing.entities}
        gone = sorted(self._shown.get(drawing.topic, set()) - now)
        self._shown[drawing.topic] = now
        deletion = _schema("SceneEntityDeletion")
        deletions = [deletion(timestamp=stamp, type=deletion.MATCHING_ID, id=str(one)) for one in gone]
        entities = [_entity(entity, stamp, self._world) for entity in drawing.entities]
        self._add(drawing.topic, drawing.stamp_ns, "SceneUpdate", False, deletions=deletions, entities=entities)

    def _add(self, topic: str, stamp_ns: int, schema: str, stamped: bool = True, **fields: Any) -> None:
        if stamped:
            fields["timestamp"] = _timestamp(stamp_ns)
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(
                topic=topic, message_encoding="protobuf", schema_id=self._schema_id(schema)
            )
        data = _schema(schema)(**fields).SerializeToString()
        self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns)

    def _schema_id(self, name: str) -> int:
        from mcap_protobuf.schema import register_schema

        if name not in self._schemas:
            self._schemas[name] = register_schema(self._writer, _schema(name))
        return self._schemas[name]


def _timestamp(stamp_ns: int) -> Any:
    return _schema("Timestamp")(seconds=stamp_ns // _NS, nanos=stamp_ns % _NS)


def _transform(item: Transform) -> dict[str, Any]:
    x, y, z, w = quaternion_from_rotation(item.parent_from_child[:3, :3])
    return {
        "parent_frame_id": item.parent,
        "child_frame_id": item.child,
        "translation": _xyz("Vector3", item.parent_from_child[:3, 3]),
        "rotation": _schema("Quaternion")(x=x, y=y, z=z, w=w),
    }


def _cloud(item: Cloud) -> dict[str, Any]:
    field = _schema("PackedElementField")
    fields = [
        field(name=name, offset=offset, type=_NUMERIC_TYPES[kind.str.lstrip("|")])
        for name, (kind, offset, *_) in (POINT.fields or {}).items()
    ]
    return {
        "pose": _pose(np.zeros(3), 0.0),
        "point_stride": POINT.itemsize,
        "fields": fields,
        "data": packed_cloud(item.cloud).tobytes(),
    }


def _xyz(schema: str, values: FloatArray | tuple[float, float, float]) -> Any:
    return _schema(schema)(x=values[0], y=values[1], z=values[2])


def _pose(position_m: FloatArray, yaw_rad: float) -> Any:
    turn = _schema("Quaternion")(x=0.0, y=0.0, z=np.sin(yaw_rad / 2), w=np.cos(yaw_rad / 2))
    return _schema("Pose")(position=_xyz("Vector3", position_m), orientation=turn)


def _colour(rgb: Rgb, alpha: float) -> Any:
    red, green, blue = (part / 255 for part in rgb)
    return _schema("Color")(r=red, g=green, b=blue, a=alpha)


def _entity(entity: Entity, stamp: Any, world: str) -> Any:
    made: dict[str, list[Any]] = {}
    for shape in entity.shapes:
        group, make = _PRIMITIVES[shape.kind]
        made.setdefault(group, []).append(make(shape))
    pair = _schema("KeyValuePair")
    return _schema("SceneEntity")(
        timestamp=stamp,
        frame_id=world,
        id=str(entity.id),
        lifetime=_schema("Duration")(seconds=LIFETIME_NS // _NS, nanos=LIFETIME_NS % _NS),
        frame_locked=True,
        metadata=[pair(key=key, value=value) for key, value in entity.facts.items()],
        **made,
    )


def _cylinder(shape: Shape) -> Any:
    return _schema("CylinderPrimitive")(
        pose=_pose(shape.position_m, shape.yaw_rad),
        size=_xyz("Vector3", shape.size_m),
        bottom_scale=1.0,
        top_scale=1.0,
        color=_colour(shape.rgb, shape.alpha),
    )


def _box(shape: Shape) -> Any:
    return _schema("CubePrimitive")(
        pose=_pose(shape.position_m, shape.yaw_rad),
        size=_xyz("Vector3", shape.size_m),
        color=_colour(shape.rgb, shape.alpha),
    )


def _arrow(shape: Shape) -> Any:
    length, thick, _ = shape.size_m
    head = min(2 * thick, length / 2)
    return _schema("ArrowPrimitive")(
        pose=_pose(shape.position_m, shape.yaw_rad),
        shaft_length=length - head,
        shaft_diameter=thick,
        head_length=head,
        head_diameter=2 * thick,
        color=_colour(shape.rgb, shape.alpha),
    )


def _line(shape: Shape) -> Any:
    line = _schema("LinePrimitive")
    return line(
        type=line.LINE_STRIP,
        pose=_pose(np.zeros(3), 0.0),
        thickness=shape.size_m[0],
        points=[_xyz("Point3", point) for point in ([] if shape.points_m is None else shape.points_m)],
        color=_colour(shape.rgb, shape.alpha),
    )


def _text(shape: Shape) -> Any:
    return _schema("TextPrimitive")(
        pose=_pose(shape.position_m, 0.0),
        billboard=True,
        font_size=shape.size_m[2],
        color=_colour(shape.rgb, shape.alpha),
        text=shape.text,
    )


_PRIMITIVES: dict[str, tuple[str, Callable[[Shape], Any]]] = {
    "cylinder": ("cylinders", _cylinder),
    "ellipse": ("cylinders", _cylinder),
    "box": ("cubes", _box),
    "arrow": ("arrows", _arrow),
    "line": ("lines", _line),
    "text": ("texts", _text),
}


@contextmanager
def open_foxglove(path: Path, show: Show) -> Iterator[FoxgloveWriter]:
    """A log for Foxglove, which appears at `path` when it is complete. Items must come in the order of time."""
    from mcap.writer import CompressionType, Writer

    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        writer: Any = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library="adcbf")
        yield FoxgloveWriter(writer, show)
        writer.finish()
