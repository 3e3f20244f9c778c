"""What the top view shows, scan by scan: the sensor, clusters, tracks, predictions, and the tracks' lives over time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from adcbf_cli.core.types import Clusters, FloatArray, IntArray, Predictions, Tracks, TrackStatus
from adcbf_cli.io.html_report.thinning import MILLI, integers, stride_for
from adcbf_cli.io.tables import read_clusters, read_predictions, read_tracks

PREDICTED_STEPS = 6
MOST_LIVES = 120
"""So many tracks get a bar of their own over time: the longest-lived confirmed ones."""
SQUARE_MILLI = MILLI * MILLI


Span = list[int]
"""From, to (ms) and state."""


class Lives:
    """When each track lived and in which state; fed with every scan, also those that the top view leaves out. Of the
    confirmed tracks that have ended, only the longest-lived are kept."""

    def __init__(self) -> None:
        self.confirmed = 0
        self._alive: dict[int, list[Span]] = {}
        self._seen_often: set[int] = set()
        self._ended: list[tuple[int, int, list[Span]]] = []

    def see(self, tracks: Tracks, t_ms: int) -> None:
        rows = zip(tracks.track_id.tolist(), tracks.status.tolist(), tracks.is_static.tolist(), strict=True)
        for number, status, standing in rows:
            if status == TrackStatus.CONFIRMED and number not in self._seen_often:
                self._seen_often.add(number)
                self.confirmed += 1
            spans = self._alive.setdefault(number, [])
            if spans:
                spans[-1][1] = t_ms
            if status == TrackStatus.ENDED:
                self._end(number)
            elif not spans or spans[-1][2] != _state(status, standing):
                spans.append([t_ms, t_ms, _state(status, standing)])

    def _end(self, number: int) -> None:
        spans = self._alive.pop(number)
        if number in self._seen_often and spans:
            self._seen_often.discard(number)
            heapq.heappush(self._ended, (_length_ms(spans), -number, spans))
            if len(self._ended) > MOST_LIVES:
                heapq.heappop(self._ended)

    def longest(self) -> list[dict[str, Any]]:
        """The longest-lived confirmed tracks, in the order of their first sighting."""
        alive = [(_length_ms(self._alive[number]), -number, self._alive[number]) for number in self._seen_often]
        chosen = sorted([*self._ended, *alive], reverse=True)[:MOST_LIVES]
        lives = [{"id": -negative, "spans": spans} for _, negative, spans in chosen]
        return sorted(lives, key=lambda life: (life["spans"][0][0], life["id"]))


def _length_ms(spans: list[Span]) -> int:
    return spans[-1][1] - spans[0][0]


def _state(status: int, standing: bool) -> int:
    """0 tentative, 1 moving, 2 standing, 3 coasting."""
    if status == TrackStatus.CONFIRMED:
        return 2 if standing else 1
    return 0 if status == TrackStatus.TENTATIVE else 3


def gather_scene(folder: Path, stages: tuple[str, ...], frames: int, most_frames: int) -> dict[str, Any]:
    """The scene of a run folder with these stages valid. Lengths in mm from `origin_m` (whole metres), times in ms
    after `start_ns`.

    frames: how many there are. Every `stride`-th of them is kept, as far as `most_frames` allow; counts and lives
    over time are of all.
    """
    stride = stride_for(frames, most_frames)
    scene: dict[str, Any] = {"frames": frames, "stride": stride, "shown": [], "steps": [], "step_ms": None}
    lives = Lives()
    counts: dict[str, list[int]] = {"t_ms": [], "clusters": [], "moving": [], "standing": [], "coasting": []}
    start_ns, origin = 0, np.zeros(2)
    for number, (clusters, tracks, predictions) in enumerate(_records(folder, stages)):
        if number == 0:
            start_ns = clusters.stamp_ns
            origin = np.rint(clusters.world_from_sensor[:2, 3])
        t_ms = round((clusters.stamp_ns - start_ns) / 1e6)
        _count(counts, t_ms, clusters, tracks)
        if tracks is not None:
            lives.see(tracks, t_ms)
        if number % stride:
            continue
        shown: dict[str, Any] = {"t_ms": t_ms, "frame": clusters.frame_index, "sensor": _sensor(clusters, origin)}
        shown["clusters"] = _clusters(clusters, origin)
        if tracks is not None:
            shown["tracks"] = _tracks(tracks, origin)
        if predictions is not None:
            steps = _kept_steps(predictions.position_m.shape[1])
            if len(predictions):
                scene["steps"], scene["step_ms"] = (steps + 1).tolist(), round(predictions.step_s * 1000)
            shown["predictions"] = _predictions(predictions, steps, origin)
        scene["shown"].append(shown)
    return {
        **scene,
        "start_ns": start_ns,
        "origin_m": integers(origin),
        "counts": counts if "track" in stages else {name: counts[name] for name in ("t_ms", "clusters")},
        "lives": lives.longest(),
        "confirmed": lives.confirmed,
    }


def _kept_steps(steps: int) -> IntArray:
    """Indices of at most PREDICTED_STEPS of the steps, equally far apart as far as they divide; the last is kept."""
    kept = min(PREDICTED_STEPS, steps)
    indices: IntArray = np.rint(np.arange(1, kept + 1) * (steps / kept)).astype(np.int64) - 1
    return indices


def _records(folder: Path, stages: tuple[str, ...]) -> Iterator[tuple[Clusters, Tracks | None, Predictions | None]]:
    """Every frame's records side by side; None for a stage that is not there."""
    tracks = read_tracks(folder) if "track" in stages else None
    predictions = read_predictions(folder) if "predict" in stages else None
    for clusters in read_clusters(folder):
        yield (
            clusters,
            None if tracks is None else next(tracks),
            None if predictions is None else next(predictions, None),
        )


def _count(counts: dict[str, list[int]], t_ms: int, clusters: Clusters, tracks: Tracks | None) -> None:
    counts["t_ms"].append(t_ms)
    counts["clusters"].append(len(clusters))
    if tracks is None:
        return
    confirmed = tracks.status == TrackStatus.CONFIRMED
    counts["moving"].append(int((confirmed & ~tracks.is_static).sum()))
    counts["standing"].append(int((confirmed & tracks.is_static).sum()))
    counts["coasting"].append(int((tracks.status == TrackStatus.COASTING).sum()))


def _sensor(clusters: Clusters, origin: FloatArray) -> list[int | None] | None:
    """x, y, yaw; None where the log does not say where the sensor was."""
    if not clusters.pose_known:
        return None
    pose = clusters.world_from_sensor
    yaw = np.arctan2(pose[1, 0], pose[0, 0])
    return integers(np.array([*(pose[:2, 3] - origin), yaw]), MILLI)


def _clusters(clusters: Clusters, origin: FloatArray) -> list[int | None]:
    """x, y, radius, length, width, yaw of each."""
    columns = (clusters.radius_m, clusters.length_m, clusters.width_m, clusters.yaw_rad)
    return integers(np.column_stack([clusters.centre_m[:, :2] - origin, *columns]), MILLI)


def _tracks(tracks: Tracks, origin: FloatArray) -> list[list[int | None]]:
    """id, state, x, y, vx, vy (mm/s), cov xx, xy, yy (mm^2), radius of each track that lives, seen or not."""
    alive = np.flatnonzero(tracks.status != TrackStatus.ENDED)
    lengths = np.column_stack([tracks.state[alive, :2] - origin, tracks.state[alive, 3:5], tracks.radius_m[alive]])
    spread = tracks.covariance[alive][:, [0, 0, 1], [0, 1, 1]]
    rows = []
    for k, row in enumerate(alive.tolist()):
        x, y, vx, vy, radius = integers(lengths[k], MILLI)
        state = _state(int(tracks.status[row]), bool(tracks.is_static[row]))
        rows.append([int(tracks.track_id[row]), state, x, y, vx, vy, *integers(spread[k], SQUARE_MILLI), radius])
    return rows


def _predictions(predictions: Predictions, steps: IntArray, origin: FloatArray) -> list[list[int | None]]:
    """id, then x, y, cov xx, xy, yy (mm^2) at each of the kept steps; at the last one only for what stands."""
    rows = []
    for row in range(len(predictions)):
        kept = steps[-1:] if predictions.is_static[row] else steps
        place = predictions.position_m[row, kept, :2] - origin
        spread = predictions.covariance_m2[row, kept][:, [0, 0, 1], [0, 1, 1]] * MILLI
        rows.append([int(predictions.track_id[row]), *integers(np.column_stack([place, spread]), MILLI)])
    return rows


def halve(scene: dict[str, Any]) -> dict[str, Any]:
    """The scene with every second of the shown scans."""
    return {**scene, "stride": scene["stride"] * 2, "shown": scene["shown"][::2]}
