"""How the viewers are to show what was written: a layout for Foxglove, a configuration for RViz."""

from __future__ import annotations

import json
from typing import Any

import yaml

from adcbf_cli.io.viz.items import CLOUD, CLUSTERS, DRIVEN, PREDICTIONS, TRACKS
from adcbf_cli.io.viz.records import Show
from adcbf_cli.io.viz.shapes import NO_CLUSTER, Rgb, planner_rgb


def foxglove_layout(show: Show) -> str:
    """JSON for Foxglove's "import layout": one 3D panel, seen from above, that follows the sensor."""
    panel = {
        "cameraState": {
            "perspective": True,
            "distance": 30,
            "phi": 35,
            "thetaOffset": 90,
            "targetOffset": [0, 0, 0],
            "target": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.1,
            "far": 2000,
        },
        "followMode": "follow-position",
        "followTf": show.sensor_frame,
        "scene": {"transforms": {"axisScale": 0.5, "labelSize": 0.1}, "backgroundColor": "#15151a"},
        "transforms": {f"frame:{show.world_frame}": {"visible": False}},
        "topics": _shown_topics(show),
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid",
                "instanceId": "grid",
                "label": "Grid",
                "visible": True,
                "frameId": show.world_frame,
                "size": 100,
                "divisions": 100,
                "lineWidth": 1,
                "color": "#24849340",
                "position": [0, 0, 0],
                "rotation": [0, 0, 0],
                "order": 1,
            }
        },
        "publish": {"type": "point"},
        "imageMode": {},
    }
    layout = {
        "configById": {"3D!scene": panel},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": "3D!scene",
    }
    return json.dumps(layout, indent=2) + "\n"


def _shown_topics(show: Show) -> dict[str, Any]:
    topics: dict[str, Any] = {
        CLOUD: {"visible": True, "colorMode": "rgba-fields", "pointSize": 2},
        CLUSTERS: {"visible": True},
        TRACKS: {"visible": True},
        PREDICTIONS: {"visible": True},
        DRIVEN: _path(NO_CLUSTER, 0.04),
    }
    for drive in show.drives:
        topic, rgb = drive.topic, planner_rgb(show.planner_number(drive.planner))
        topics[f"{topic}/plan"] = _path(rgb, 0.05)
        topics[f"{topic}/driven"] = _path(rgb, 0.08)
        topics[f"{topic}/vehicle"] = {"visible": True}
    return topics


def rviz_config(show: Show) -> str:
    """For `rviz2 -d`: everything in the bag, seen from above, around the sensor."""
    displays = [
        _display("Grid", "grid", None, {"Reference Frame": show.world_frame, "Cell Size": 1, "Plane Cell Count": 100}),
        _display("TF", "tf", None, {"Enabled": False, "Value": False}),
        _display(
            "PointCloud2", "cloud", CLOUD, {"Color Transformer": "RGB8", "Style": "Flat Squares", "Size (m)": 0.04}
        ),
        *(_display("MarkerArray", topic.lstrip("/"), topic) for topic in (CLUSTERS, TRACKS, PREDICTIONS)),
        _path_display(DRIVEN, NO_CLUSTER, 0.04),
    ]
    for drive in show.drives:
        topic, rgb = drive.topic, planner_rgb(show.planner_number(drive.planner))
        displays += [_path_display(f"{topic}/plan", rgb, 0.05), _path_display(f"{topic}/driven", rgb, 0.08)]
        displays.append(_display("MarkerArray", f"{topic.lstrip('/')}/vehicle", f"{topic}/vehicle"))
    view = {
        "Class": "rviz_default_plugins/Orbit",
        "Name": "Current View",
        "Distance": 30,
        "Pitch": 1.0,
        "Yaw": 3.14,
        "Target Frame": show.sensor_frame,
    }
    config = {
        "Panels": [
            {"Class": "rviz_common/Displays", "Name": "Displays"},
            {"Class": "rviz_common/Time", "Name": "Time"},
        ],
        "Visualization Manager": {
            "Class": "",
            "Displays": displays,
            "Enabled": True,
            "Global Options": {"Fixed Frame": show.world_frame, "Frame Rate": 30, "Background Color": "21; 21; 26"},
            "Name": "root",
            "Tools": [{"Class": f"rviz_default_plugins/{tool}"} for tool in ("MoveCamera", "Select", "Measure")],
            "Value": True,
            "Views": {"Current": view, "Saved": None},
        },
        "Window Geometry": {"Width": 1400, "Height": 900},
    }
    text: str = yaml.safe_dump(config, sort_keys=False)
    return text


def _display(kind: str, name: str, topic: str | None = None, settings: dict[str, Any] | None = None) -> dict[str, Any]:
    display: dict[str, Any] = {
        "Class": f"rviz_default_plugins/{kind}",
        "Name": name,
        "Enabled": True,
        "Value": True,
    }
    if topic is not None:
        display["Topic"] = {
            "Value": topic,
            "Depth": 5,
            "History Policy": "Keep Last",
            "Reliability Policy": "Reliable",
            "Durability Policy": "Volatile",
        }
    return display | (settings or {})


def _path_display(topic: str, rgb: Rgb, width_m: float) -> dict[str, Any]:
    colour = "; ".join(map(str, rgb))
    settings: dict[str, Any] = {"Line Style": "Billboards", "Line Width": width_m, "Color": colour}
    return _display("Path", topic.lstrip("/"), topic, settings)


def _path(rgb: Rgb, width_m: float) -> dict[str, Any]:
    colour = "#{:02x}{:02x}{:02x}ff".format(*rgb)
    return {"visible": True, "type": "line", "lineWidth": width_m, "gradient": [colour, colour]}
