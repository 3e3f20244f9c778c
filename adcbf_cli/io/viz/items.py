"""What a viewer draws: transforms, clouds, paths, and drawings of entities made of a few kinds of shape.

The same for every viewer; a writer turns these into its format and knows nothing of tracks or planners.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from adcbf_cli.core.frames import pose_matrix
from adcbf_cli.core.types import NO_ID, Clusters, FloatArray, IntArray, Predictions, Tracks, TrackStatus
from adcbf_cli.io.viz.records import DriveTick, LabelledCloud, Record, SceneFrame, Show
from adcbf_cli.io.viz.shapes import NO_CLUSTER, Rgb, ellipse, planner_rgb, track_rgb

CLOUD, CLUSTERS, TRACKS, PREDICTIONS, DRIVEN = "/cloud", "/clusters", "/tracks", "/predictions", "/driven"

LEAST_HEIGHT_M = 0.05
"""A planar laser's obstacles have no height, and would be seen from above only."""

SHOWN_STEPS = 3
"""So many steps of a prediction become cylinders: evenly spread, the last one among them."""

LEAST_SPEED_MPS = 0.05
"""Slower tracks get no arrow."""

ARROW_S = 1.0
"""A velocity's arrow ends where the obstacle would be after so long."""

LIFETIME_NS = 1_000_000_000
"""What was drawn goes after so long without news: a gap in the log is seen as one."""

_LINE_M = 0.03
_FLAT_M = 0.02
_TEXT_M = 0.3


@dataclass(frozen=True, slots=True)
class Shape:
    """position_m: (3,) the centre, or where an arrow starts or a text stands. size_m: along its own axes, x turned
    by yaw; an arrow's length and thickness. points_m: (k, 3), of a line only. text: of other kinds, what to show
    when it is pointed at."""

    kind: Literal["cylinder", "ellipse", "box", "arrow", "line", "text"]
    rgb: Rgb
    alpha: float
    position_m: FloatArray
    yaw_rad: float = 0.0
    size_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    points_m: FloatArray | None = None
    text: str = ""


@dataclass(frozen=True, slots=True)
class Entity:
    """Shapes that come and go together; facts: what to show of it when it is clicked."""

    id: int
    shapes: tuple[Shape, ...]
    facts: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Drawing:
    """Everything that is on this topic from now on, in the world's frame: what it does not hold is gone."""

    topic: str
    stamp_ns: int
    entities: tuple[Entity, ...]


@dataclass(frozen=True, slots=True)
class Transform:
    """parent_from_child: 4 x 4."""

    stamp_ns: int
    parent: str
    child: str
    parent_from_child: FloatArray


@dataclass(frozen=True, slots=True)
class Cloud:
    topic: str
    stamp_ns: int
    frame_id: str
    cloud: LabelledCloud


@dataclass(frozen=True, slots=True)
class PosePath:
    """poses: (k, 4) x, y, z, yaw in the world."""

    topic: str
    stamp_ns: int
    poses: FloatArray
    rgb: Rgb


Item = Transform | Cloud | PosePath | Drawing


def items(record: Record, show: Show) -> Iterator[Item]:
    """What to draw of one record."""
    if isinstance(record, SceneFrame):
        yield from _of_frame(record, show)
    else:
        yield from _of_tick(record, show)


def _of_frame(frame: SceneFrame, show: Show) -> Iterator[Item]:
    stamp_ns = frame.stamp_ns
    yield Transform(stamp_ns, show.world_frame, show.sensor_frame, frame.clusters.world_from_sensor)
    if frame.cloud is not None:
        yield Cloud(CLOUD, stamp_ns, show.sensor_frame, frame.cloud)
    yield Drawing(CLUSTERS, stamp_ns, tuple(_cluster_entities(frame.clusters, frame)))
    if frame.tracks is not None:
        yield Drawing(TRACKS, stamp_ns, tuple(_track_entities(frame.tracks, show.probability)))
    if frame.predictions is not None:
        yield Drawing(PREDICTIONS, stamp_ns, tuple(_predicted_entities(frame.predictions)))
    if frame.driven is not None:
        yield PosePath(DRIVEN, stamp_ns, np.column_stack([frame.driven, _headings(frame.driven)]), NO_CLUSTER)


def _headings(way_m: FloatArray) -> FloatArray:
    """(k,) the direction from each point to the next."""
    step = np.diff(way_m[:, :2], axis=0)
    yaw = np.arctan2(step[:, 1], step[:, 0])
    return np.append(yaw, yaw[-1:] if len(yaw) else 0.0)


def _cluster_entities(clusters: Clusters, frame: SceneFrame) -> Iterator[Entity]:
    for i in range(len(clusters)):
        size = (float(clusters.length_m[i]), float(clusters.width_m[i]), _height(clusters.height_m[i]))
        size = (max(size[0], _FLAT_M), max(size[1], _FLAT_M), size[2])
        track_id = int(frame.cluster_track[i])
        facts = {
            "radius_m": f"{clusters.radius_m[i]:.3f}",
            "points": str(clusters.points[i]),
            "probability": f"{clusters.probability[i]:.2f}",
            "track_id": "" if track_id == NO_ID else str(track_id),
        }
        box = Shape("box", track_rgb(track_id), 0.2, clusters.centre_m[i], float(clusters.yaw_rad[i]), size)
        yield Entity(int(clusters.cluster_id[i]), (box,), facts)


def _height(height_m: float) -> float:
    return max(float(height_m), LEAST_HEIGHT_M)


def _track_entities(tracks: Tracks, probability: float) -> Iterator[Entity]:
    """Those that are there: not those that end in this frame."""
    for i in np.flatnonzero(tracks.status != TrackStatus.ENDED):
        yield _track_entity(tracks, int(i), probability)


def _track_entity(tracks: Tracks, i: int, probability: float) -> Entity:
    """A cylinder, and the ellipse that holds its centre; if it moves, its number and where it will be in a second.
    Numbers on all that stands would hide the scene."""
    track_id, place = int(tracks.track_id[i]), tracks.state[i, :3]
    vx, vy = tracks.state[i, 3:5]
    speed, still = float(np.hypot(vx, vy)), bool(tracks.is_static[i])
    moves = speed >= LEAST_SPEED_MPS and not still
    status = TrackStatus(int(tracks.status[i])).name.lower()
    rgb, height = track_rgb(track_id), _height(tracks.height_m[i])
    across = 2 * float(tracks.radius_m[i])
    around = ellipse(tracks.covariance[i, :2, :2], probability)
    up = np.array([0.0, 0.0, height / 2])
    name = f"{track_id}  {speed:.1f} m/s" if moves else f"{track_id}"
    shapes = [
        Shape("cylinder", rgb, 0.4 if status == "confirmed" else 0.15, place, 0.0, (across, across, height), text=name),
        Shape("ellipse", rgb, 0.4, place - up, around.yaw_rad, (2 * around.half_m[0], 2 * around.half_m[1], _FLAT_M)),
    ]
    if moves:
        above = place + up + np.array([0.0, 0.0, _TEXT_M])
        shapes.append(Shape("arrow", rgb, 1.0, place, float(np.arctan2(vy, vx)), (speed * ARROW_S, 0.1, 0.1)))
        shapes.append(Shape("text", rgb, 1.0, above, size_m=(_TEXT_M, _TEXT_M, _TEXT_M), text=name))
    facts = {
        "status": status,
        "speed_mps": f"{speed:.3f}",
        "radius_m": f"{tracks.radius_m[i]:.3f}",
        "age_s": f"{tracks.age_s[i]:.1f}",
        "static": str(still).lower(),
    }
    return Entity(track_id, tuple(shapes), facts)


def _predicted_entities(predictions: Predictions) -> Iterator[Entity]:
    """The way, and cylinders at some of its steps (at the last only, of what stands still), each with the obstacle's
    radius and its margin: the calibrated one where there is one."""
    steps = predictions.position_m.shape[1]
    moving = shown_steps(steps)
    calibrated = predictions.conformal_radius_m
    margin = np.where(np.isfinite(calibrated), calibrated, predictions.sigma_radius_m)
    for i, track_id in enumerate(predictions.track_id):
        rgb = track_rgb(int(track_id))
        way = predictions.position_m[i]
        shapes = [Shape("line", rgb, 0.9, way[0], size_m=(_LINE_M, _LINE_M, _LINE_M), points_m=way)]
        for step in moving[-1:] if predictions.is_static[i] else moving:
            across = 2 * float(predictions.radius_m[i] + margin[i, step - 1])
            shapes.append(Shape("cylinder", rgb, 0.12, way[step - 1], 0.0, (across, across, LEAST_HEIGHT_M)))
        facts = {"radius_m": f"{predictions.radius_m[i]:.3f}", "margin_at_end_m": f"{margin[i, -1]:.3f}"}
        yield Entity(int(track_id), tuple(shapes), facts)


def shown_steps(steps: int) -> IntArray:
    """Of steps 1 to `steps`, those that become cylinders."""
    return np.unique(np.linspace(steps / SHOWN_STEPS, steps, SHOWN_STEPS).round().astype(np.int64).clip(1))


def _of_tick(tick: DriveTick, show: Show) -> Iterator[Item]:
    topic, floor_m = tick.drive.topic, tick.floor_m
    number = show.planner_number(tick.drive.planner)
    rgb = planner_rgb(number)
    place = np.array([tick.pose[0], tick.pose[1], floor_m])
    yaw = float(tick.pose[2])
    turn = np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)])
    if tick.plan is not None:
        yield PosePath(f"{topic}/plan", tick.stamp_ns, _on_floor(tick.plan, floor_m), rgb)
    if tick.drive.has_own_path:
        yield Transform(tick.stamp_ns, show.world_frame, topic.lstrip("/"), pose_matrix(place, turn))
        radius_m = show.body_radius_m[tick.drive.mode]
        yield Drawing(f"{topic}/vehicle", tick.stamp_ns, (_vehicle(tick, place, rgb, number, radius_m),))
    if tick.driven is not None:
        yield PosePath(f"{topic}/driven", tick.stamp_ns, _on_floor(tick.driven, floor_m), rgb)


def _on_floor(poses: FloatArray, floor_m: float) -> FloatArray:
    return np.column_stack([poses[:, :2], np.full(len(poses), floor_m), poses[:, 2]])


def _vehicle(tick: DriveTick, place: FloatArray, rgb: Rgb, number: int, radius_m: float) -> Entity:
    """The circle that holds the vehicle, where it is heading, and what its planner did; names stand one above the
    other where vehicles are together."""
    height = 2 * radius_m / 3
    middle = place + np.array([0.0, 0.0, height / 2])
    text = tick.drive.planner if tick.outcome in ("", "solved") else f"{tick.drive.planner}: {tick.outcome}"
    clearance = "" if np.isnan(tick.clearance_m) else f"{tick.clearance_m:.3f}"
    shapes = (
        Shape("cylinder", rgb, 0.8, middle, 0.0, (2 * radius_m, 2 * radius_m, height)),
        Shape("arrow", rgb, 1.0, middle, float(tick.pose[2]), (2 * radius_m, 0.1, 0.1)),
        Shape(
            "text",
            rgb,
            1.0,
            middle + np.array([0.0, 0.0, (2 + number) * _TEXT_M]),
            size_m=(_TEXT_M, _TEXT_M, _TEXT_M),
            text=text,
        ),
    )
    facts = {
        "seed": str(tick.drive.seed),
        "speed_mps": f"{tick.speed_mps:.3f}",
        "clearance_m": clearance,
        "outcome": tick.outcome,
    }
    return Entity(0, shapes, facts)
