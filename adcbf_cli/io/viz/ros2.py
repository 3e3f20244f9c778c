"""Writes what is to be drawn as a ROS 2 bag for RViz: PointCloud2, MarkerArray, Path and tf in an MCAP.

A marker is replaced by the next one of its namespace and id; one that is gone is deleted by the array that lacks it,
and what a gap in the log leaves behind goes with its lifetime.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from adcbf_cli.io.mcap_writer import NS_PER_S, LogWriter, open_log
from adcbf_cli.io.viz.items import LIFETIME_NS, Cloud, Drawing, Item, PosePath, Shape, Transform
from adcbf_cli.io.viz.records import Show
from adcbf_cli.io.viz.shapes import packed_cloud

MARKERS = "visualization_msgs/msg/MarkerArray"
PATH = "nav_msgs/msg/Path"

_FIELDS = {name: (4 * place, "<f4") for place, name in enumerate("xyz")} | {
    "cluster_id": (12, "<i4"),
    "track_id": (16, "<i4"),
    "rgb": (20, "<u4"),
}
"""Of POINT, with its four colour bytes as one number, which is how ROS packs them."""

_Key = tuple[str, int]
"""A marker's namespace and id."""


class Ros2Writer:
    """Get one from `open_ros2`."""

    def __init__(self, log: LogWriter, show: Show) -> None:
        self._log = log
        self._types = log.types
        self._world = show.world_frame
        self._shown: dict[str, set[_Key]] = {}

    def write(self, item: Item) -> None:
        match item:
            case Transform():
                self._log.write_transform(item.parent, item.child, item.stamp_ns, item.parent_from_child)
            case Cloud():
                self._cloud(item)
            case PosePath():
                header = self._log.header(item.stamp_ns, self._world)
                stamped = self._types["geometry_msgs/msg/PoseStamped"]
                poses = [stamped(header=header, pose=self._pose(pose[:3], pose[3])) for pose in item.poses]
                self._log.write(item.topic, PATH, self._types[PATH](header=header, poses=poses), item.stamp_ns)
            case Drawing():
                self._draw(item)

    def _cloud(self, item: Cloud) -> None:
        header = self._log.header(item.stamp_ns, item.frame_id)
        self._log.write_points(item.topic, header, packed_cloud(item.cloud), _FIELDS, item.stamp_ns)

    def _draw(self, drawing: Drawing) -> None:
        marker = self._types["visualization_msgs/msg/Marker"]
        drawn: dict[_Key, Any] = {}
        for entity in drawing.entities:
            for shape in entity.shapes:
                namespace, number = str(shape.kind), 1
                while (namespace, entity.id) in drawn:
                    number += 1
                    namespace = f"{shape.kind} {number}"
                drawn[namespace, entity.id] = shape
        gone = sorted(self._shown.get(drawing.topic, set()) - set(drawn))
        self._shown[drawing.topic] = set(drawn)
        nothing = Shape("box", (0, 0, 0), 0.0, np.zeros(3))
        markers = [self._marker(drawing, key, nothing, marker.DELETE) for key in gone]
        markers += [self._marker(drawing, key, shape, marker.ADD) for key, shape in drawn.items()]
        self._log.write(drawing.topic, MARKERS, self._types[MARKERS](markers=markers), drawing.stamp_ns)

    def _marker(self, drawing: Drawing, key: _Key, shape: Shape, action: int) -> Any:
        types = self._types
        marker = types["visualization_msgs/msg/Marker"]
        kinds = {
            "cylinder": marker.CYLINDER,
            "ellipse": marker.CYLINDER,
            "box": marker.CUBE,
            "arrow": marker.ARROW,
            "line": marker.LINE_STRIP,
            "text": marker.TEXT_VIEW_FACING,
        }
        along, across, up = shape.size_m
        point = types["geometry_msgs/msg/Point"]
        red, green, blue = (part / 255 for part in shape.rgb)
        is_line = shape.points_m is not None
        return marker(
            header=self._log.header(drawing.stamp_ns, self._world),
            ns=key[0],
            id=key[1],
            type=kinds[shape.kind],
            action=action,
            pose=self._pose(np.zeros(3) if is_line else shape.position_m, shape.yaw_rad),
            scale=types["geometry_msgs/msg/Vector3"](x=along, y=across, z=up),
            color=types["std_msgs/msg/ColorRGBA"](r=red, g=green, b=blue, a=shape.alpha),
            lifetime=types["builtin_interfaces/msg/Duration"](sec=LIFETIME_NS // NS_PER_S, nanosec=0),
            frame_locked=True,
            points=[point(*map(float, place)) for place in ([] if shape.points_m is None else shape.points_m)],
            colors=[],
            texture_resource="",
            texture=self._no_image(drawing.stamp_ns),
            uv_coordinates=[],
            text=shape.text,
            mesh_resource="",
            mesh_file=types["visualization_msgs/msg/MeshFile"](filename="", data=np.zeros(0, dtype=np.uint8)),
            mesh_use_embedded_materials=False,
        )

    def _no_image(self, stamp_ns: int) -> Any:
        return self._types["sensor_msgs/msg/CompressedImage"](
            header=self._log.header(stamp_ns, ""), format="", data=np.zeros(0, dtype=np.uint8)
        )

    def _pose(self, position_m: np.ndarray, yaw_rad: float) -> Any:
        types = self._types
        x, y, z = map(float, position_m)
        turn = types["geometry_msgs/msg/Quaternion"](
            x=0.0, y=0.0, z=float(np.sin(yaw_rad / 2)), w=float(np.cos(yaw_rad / 2))
        )
        return types["geometry_msgs/msg/Pose"](
            position=types["geometry_msgs/msg/Point"](x=x, y=y, z=z), orientation=turn
        )


@contextmanager
def open_ros2(path: Path, show: Show) -> Iterator[Ros2Writer]:
    """A ROS 2 bag, which appears at `path` when it is complete. Items must come in the order of time."""
    with open_log(path) as log:
        yield Ros2Writer(log, show)
