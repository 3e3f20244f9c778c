"""How the viewers are to show what was written: a layout for Foxglove, a configuration for RViz."""

from __future__ import annotations

import json
from typing import Any

from adcbf_cli.io.viz.items import CLOUD, CLUSTERS, DRIVEN, PREDICTIONS, TRACKS, drive_topic
from adcbf_cli.io.viz.records import Show
from adcbf_cli.io.viz.shapes import NO_CLUSTER, Rgb, planner_rgb


def foxglove_layout(show: Show) -> str:
    """JSON for Foxglove's "import layout": one 3D panel, seen from above, that follows the sensor."""
    topics: dict[str, Any] = {
        CLOUD: {"visible": True, "colorMode": "rgba-fields", "pointSize": 2},
        CLUSTERS: {"visible": True},
        TRACKS: {"visible": True},
        PREDICTIONS: {"visible": True},
        DRIVEN: _path(NO_CLUSTER, 0.04),
    }
    for place, drive in enumerate(show.drives):
        topic, rgb = drive_topic(drive), planner_rgb(place)
        topics[f"{topic}/plan"] = _path(rgb, 0.05)
        topics[f"{topic}/driven"] = _path(rgb, 0.08)
        topics[f"{topic}/vehicle"] = {"visible": True}
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
        "topics": topics,
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


def _path(rgb: Rgb, width_m: float) -> dict[str, Any]:
    colour = "#{:02x}{:02x}{:02x}ff".format(*rgb)
    return {"visible": True, "type": "line", "lineWidth": width_m, "gradient": [colour, colour]}
