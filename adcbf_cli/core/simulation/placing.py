"""A scenario file's objects and movers, set into the scene: entries repeated, random values drawn,
places beside the route worked out, and what came to stand or walk in the way drawn again.

It works on the file's plain mappings and leaves checking them to the scenario's model: what is wrong
with an entry is passed on as it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple, TypeVar

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.simulation.drawing import Drawing, Place, dotted
from adcbf_cli.core.simulation.footprints import Footprint, footprint, mover_radius_m
from adcbf_cli.core.simulation.paths import beside, crossing_line, motion_along, route_points
from adcbf_cli.core.simulation.problems import first_problem
from adcbf_cli.core.simulation.scenario import (
    LEAST_FREE_M,
    Box,
    CrossingPath,
    Cylinder,
    Ego,
    Mover,
    Person,
    Point2,
    Rock,
    Route,
    StaticObject,
    Tree,
    Vehicle,
    Wall,
)
from adcbf_cli.core.types import FloatArray

Model = TypeVar("Model", bound=BaseModel)
Static = Tree | Rock | Wall | Box
Moving = Person | Vehicle | Cylinder

MAX_ATTEMPTS = 1000
MAX_COPIES = 1000
TIME_STEP_S = 0.1
MAX_TIMES = 2000

_THING: dict[str, TypeAdapter[Static | Moving]] = {"objects": TypeAdapter(StaticObject), "movers": TypeAdapter(Mover)}
_SEED: TypeAdapter[int] = TypeAdapter(Annotated[int, Field(ge=0)])
_POINT: TypeAdapter[Point2] = TypeAdapter(Point2)


class DrawnScene(NamedTuple):
    """data: the file's mapping without anything random or relative; entries: where in the file each
    entry of its lists comes from, ("movers", 3) -> ("movers", 1, "each")."""

    data: dict[str, Any]
    entries: dict[Place, Place]


def draw_scene(data: dict[str, Any]) -> DrawnScene:
    """The scene that a scenario file describes for its `seed`. Raises UsageError naming the place."""
    try:
        drawing = Drawing(_SEED.validate_python(data.get("seed", 0)))
    except ValidationError:
        return DrawnScene(data, {})
    lists = {key: data[key] for key in ("objects", "movers") if isinstance(data.get(key), list)}
    out = {key: drawing.value(node, (key,)) for key, node in data.items() if key not in lists}
    around = _surroundings(out)
    listed = {name: list(_entries(nodes, name, drawing)) for name, nodes in lists.items()}
    numbered = {(name, index): entry for name, entries in listed.items() for index, entry in enumerate(entries)}
    fixed_first = sorted(numbered, key=lambda number: numbered[number].varies)
    placed = {number: _placed(numbered[number], drawing, around) for number in fixed_first}
    for name, entries in listed.items():
        out[name] = [placed[name, index] for index in range(len(entries))]
    return DrawnScene(out, {number: entry.place for number, entry in numbered.items()})


class _Entry(NamedTuple):
    node: Any
    place: Place
    copy: int
    varies: bool


def _entries(nodes: list[Any], name: str, drawing: Drawing) -> Iterator[_Entry]:
    """The list's entries, those that repeat as often as they ask."""
    for index, node in enumerate(nodes):
        place: Place = (name, index)
        if not (isinstance(node, dict) and "repeat" in node):
            yield _Entry(node, place, 0, drawing.varies(node, place))
            continue
        if node.keys() != {"repeat", "each"}:
            raise UsageError(f"{dotted(place)}: an entry that repeats has the keys repeat and each, and no others")
        count = drawing.value(node["repeat"], (*place, "repeat"))
        if type(count) is not int or not 0 <= count <= MAX_COPIES:
            raise UsageError(f"{dotted(place)}.repeat: must be a whole number from 0 to {MAX_COPIES}")
        inner: Place = (*place, "each")
        varies = drawing.varies(node["each"], inner)
        for copy in range(count):
            yield _Entry(node["each"], inner, copy, varies)


@dataclass(slots=True)
class _Surroundings:
    """What entries are placed by: the route as a polyline, the ego's start and the route's goal, how far
    to keep from them, the times at which movers are looked at, and what has been placed already."""

    way_m: FloatArray | None
    start_m: FloatArray | None
    goal_m: FloatArray | None
    keep_free_m: float
    passage_m: float
    times_s: FloatArray
    standing: list[Footprint] = field(default_factory=list)
    moving: list[tuple[FloatArray, float]] = field(default_factory=list)

    def place(self, thing: Static | Moving, must_fit: bool) -> bool:
        """Adds a thing, unless it has to fit in and does not; says whether it was added."""
        if isinstance(thing, Static):
            shape = footprint(thing)
            placed = not must_fit or self._stands_free(shape)
            if placed:
                self.standing.append(shape)
            return placed
        motion = motion_along(thing.path, self.times_s)
        track, radius = np.column_stack([motion.x_m, motion.y_m]), mover_radius_m(thing)
        placed = not must_fit or self._walks_free(track, radius)
        if placed:
            self.moving.append((track, radius))
        return placed

    def _stands_free(self, shape: Footprint) -> bool:
        """Away from start and goal, with room to pass between it and all others, and in nobody's way."""
        ends = [end for end in (self.start_m, self.goal_m) if end is not None]
        return (
            all(shape.distance_m(end[None])[0] >= self.keep_free_m for end in ends)
            and (self.passage_m == 0 or all(shape.leaves(self.passage_m, other) for other in self.standing))
            and all(shape.distance_m(track).min() >= radius for track, radius in self.moving)
        )

    def _walks_free(self, track_m: FloatArray, radius_m: float) -> bool:
        """Away from the start at first and from the goal at last, and through nothing else on its way."""
        return (
            _apart(track_m[0], self.start_m, radius_m + self.keep_free_m)
            and _apart(track_m[-1], self.goal_m, radius_m + self.keep_free_m)
            and all(shape.distance_m(track_m).min() >= radius_m for shape in self.standing)
            and all(_distance_m(track_m, other).min() >= radius_m + reach for other, reach in self.moving)
        )


def _apart(point_m: FloatArray, other_m: FloatArray | None, distance_m: float) -> bool:
    return other_m is None or bool(_distance_m(point_m, other_m) >= distance_m)


def _distance_m(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.hypot(a[..., 0] - b[..., 0], a[..., 1] - b[..., 1]))


def _surroundings(data: dict[str, Any]) -> _Surroundings:
    duration = data.get("duration_s")
    length = float(duration) if isinstance(duration, int | float) and 0 < duration <= 3600 else 1.0
    times = np.linspace(0.0, length, min(MAX_TIMES, 2 + int(length / TIME_STEP_S)))
    if data.get("route") is None:
        return _Surroundings(None, _scripted_start(data), None, LEAST_FREE_M, 0.0, times)
    route = _checked(Route, data["route"], ("route",))
    way = route_points(route)
    return _Surroundings(way, way[0], way[-1], route.keep_free_m, route.passage_m, times)


def _scripted_start(data: dict[str, Any]) -> FloatArray | None:
    """(2,) where a scripted ego begins, if the file says so in a way that can be read."""
    try:
        path = Ego.model_validate(data.get("ego")).path
    except ValidationError:
        return None
    if path is None:
        return None
    motion = motion_along(path, np.zeros(1))
    return np.concatenate([motion.x_m, motion.y_m])


def _placed(entry: _Entry, drawing: Drawing, around: _Surroundings) -> Any:
    """An entry's mapping, drawn and resolved; anything random about it is drawn until its place is free."""
    list_name = str(entry.place[0])
    resolve = _stood if list_name == "objects" else _walked
    for attempt in range(MAX_ATTEMPTS):
        node = drawing.value(entry.node, entry.place, entry.copy, attempt)
        out = resolve(node, entry.place, around.way_m)
        try:
            thing = _THING[list_name].validate_python(out)
        except ValidationError:
            return out
        if around.place(thing, must_fit=entry.varies):
            return out
    raise UsageError(
        f"{dotted(entry.place)}: no free place in {MAX_ATTEMPTS} draws: all were too near the start, the goal or others"
    )


def _stood(node: Any, place: Place, way_m: FloatArray | None) -> Any:
    """A static object's mapping with `at_m` in the place of `beside_m`."""
    if not isinstance(node, dict) or "beside_m" not in node:
        return node
    if "at_m" in node:
        raise UsageError(f"{dotted(place)}: give either at_m or beside_m")
    way = _needed(way_m, (*place, "beside_m"))
    try:
        along, aside = _POINT.validate_python(node["beside_m"])
    except ValidationError as error:
        raise UsageError(f"{dotted(place)}.beside_m: must be [along, aside], two numbers") from error
    point, _ = beside(way, along, aside)
    rest = {key: value for key, value in node.items() if key != "beside_m"}
    return {**rest, "at_m": [round(value, 6) for value in point.tolist()]}


def _walked(node: Any, place: Place, way_m: FloatArray | None) -> Any:
    """A mover's mapping with the line that its crossing path means."""
    path = node.get("path") if isinstance(node, dict) else None
    if not isinstance(path, dict) or path.get("kind") != "crossing":
        return node
    at = (*place, "path")
    line = crossing_line(_checked(CrossingPath, path, at), _needed(way_m, at))
    return {**node, "path": line.model_dump(mode="json")}


def _needed(way_m: FloatArray | None, place: Place) -> FloatArray:
    if way_m is None:
        raise UsageError(f"{dotted(place)}: is relative to the route, and the scenario has none")
    return way_m


def _checked(model: type[Model], data: Any, place: Place) -> Model:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise UsageError(first_problem(error, data, model, place)) from error
