"""The recorded world of a log: from its ground truth, from its own smoothed tracks, or from both."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.replay.smoothing import SmoothTrack, smooth_tracks
from adcbf_cli.core.replay.world import RecordedWorld, Samples
from adcbf_cli.core.types import FloatArray, IntArray, Tracks, Truth

STANDING_SPREAD_M = 0.5
"""A labelled thing stands if it stays within this of where it first was, and is on the whole no faster
than tracking.static_speed_mps. Labels made in the sensor's frame wander with the odometry."""

MIN_RADIUS_M = 0.05
"""Of a track's circle, however near the log's vehicle came to its centre."""

CONTACT_M = 1e-3
"""What the log's vehicle came nearest to is taken to have been this far from it."""

ON_TRUTH_SHARE = 0.5
"""A track is a labelled thing if it matches one in more than this share of its sightings."""


def world_of(truth: Truth | None, tracks: Iterable[Tracks], config: Config) -> tuple[RecordedWorld, str]:
    """The best that a log knows of what was there, and in words what that is.

    truth: in the world frame. With truth that labels scenery, it alone. With truth that does not, also
    the standing tracks that are none of the labelled things (all such tracks, if truth labels a single
    object only). Without truth, the smoothed tracks. Ids of tracks that join labelled things are moved
    up past the labels' ids.

    The log's vehicle, a circle of vehicle.body_radius_m, did not collide: where a track's circle reaches
    into its place, the circle is too wide for the thing, and is trimmed.
    """
    max_gap_s = config.evaluation.max_gap_s
    if truth is not None and _has_scenery(truth, config):
        samples, standing = truth_samples(truth, config)
        return RecordedWorld(samples, max_gap_s, standing), f"ground truth ({truth.source}), scenery included"
    records = list(tracks)
    driven_m = np.array([record.world_from_sensor[:2, 3] for record in records]).reshape(-1, 2)
    smooth = [t for t in smooth_tracks(records, config.tracking) if not _is_own_body(t, config.vehicle.body_radius_m)]
    rooms = [_room(t, driven_m, config.vehicle.body_radius_m) for t in smooth]
    if truth is None:
        samples, standing = track_samples(smooth, rooms)
        said = "the log's own tracks, smoothed" + _trimmed(smooth, rooms)
        return RecordedWorld(samples, max_gap_s, standing), said
    samples, standing = truth_samples(truth, config)
    labelled = RecordedWorld(samples, max_gap_s, standing)
    exhaustive = truth.exhaustive if config.evaluation.truth_exhaustive is None else config.evaluation.truth_exhaustive
    on_label = _are_labelled(smooth, labelled, config.evaluation.match_m)
    more = [i for i, t in enumerate(smooth) if (not exhaustive or stands(t)) and not on_label[i]]
    smooth, rooms = [smooth[i] for i in more], [rooms[i] for i in more]
    added, added_standing = track_samples(smooth, rooms, first_id=int(samples.id.max(initial=-1)) + 1)
    world = RecordedWorld(
        Samples.joined([samples, added]), max_gap_s, np.concatenate([standing, added_standing]).astype(np.int64)
    )
    kind = "standing tracks" if exhaustive else "tracks"
    said = f"ground truth ({truth.source}) and {len(more)} {kind} of what it does not label"
    return world, said + _trimmed(smooth, rooms)


def truth_samples(truth: Truth, config: Config) -> tuple[Samples, IntArray]:
    """Labelled things as samples, and the ids of those that stand. Truth must be in the world frame."""
    if truth.frame != "world":
        raise AdcbfError(f"{truth.source}: ground truth in the {truth.frame} frame has to be placed in the world first")
    sized = np.isfinite(truth.length_m) & np.isfinite(truth.width_m)
    boxed = sized & np.isfinite(truth.yaw_rad)
    samples = Samples.of(
        truth.track_id,
        truth.stamp_ns,
        truth.position_m[:, :2],
        np.where(sized, 0.5 * np.hypot(truth.length_m, truth.width_m), config.read.object_radius_m),
        length_m=np.where(boxed, truth.length_m, np.nan),
        width_m=np.where(boxed, truth.width_m, np.nan),
        yaw_rad=np.where(boxed, truth.yaw_rad, np.nan),
    )
    background = {name.casefold() for name in config.evaluation.background_classes}
    category = dict(zip(truth.track_id.tolist(), truth.category, strict=True))
    standing = [
        i
        for i in category
        if category[i].casefold() in background or _labelled_standing(truth, i, config.tracking.static_speed_mps)
    ]
    return samples, np.array(standing, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Room:
    """What the log's vehicle left a track: the largest radius, and whether it can stand there for good."""

    radius_m: float
    for_good: bool


def track_samples(tracks: list[SmoothTrack], rooms: list[Room], first_id: int = 0) -> tuple[Samples, IntArray]:
    """Smoothed tracks as samples of circles, and the ids of those that stand for good.

    A track that stood when it was last seen stands for good, unless the log's own vehicle drove over
    its place: then something was there for as long as it was seen only. Circles are trimmed (`world_of`).
    """
    if not tracks:
        none = np.zeros(0, dtype=np.int64)
        return Samples.of(none, none, np.zeros((0, 2)), np.zeros(0)), none
    samples = Samples.of(
        np.concatenate([np.full(len(t.stamp_ns), first_id + t.track_id) for t in tracks]),
        np.concatenate([t.stamp_ns for t in tracks]),
        np.concatenate([t.position_m for t in tracks]),
        np.concatenate([np.minimum(t.radius_m, room.radius_m) for t, room in zip(tracks, rooms, strict=True)]),
        velocity_mps=np.concatenate([np.where(t.is_static[:, None], 0.0, t.velocity_mps) for t in tracks]),
    )
    standing = [first_id + t.track_id for t, room in zip(tracks, rooms, strict=True) if room.for_good]
    return samples, np.array(standing, dtype=np.int64)


def _room(track: SmoothTrack, driven_m: FloatArray, body_radius_m: float) -> Room:
    """driven_m: (q, 2) where the log's vehicle was at any time."""
    taken_m = body_radius_m + CONTACT_M
    while_seen = float(np.hypot(*(track.position_m - track.sensor_m).T).min()) - taken_m
    ends = driven_m[:, None] - track.position_m[[0, -1]]
    always = float(np.hypot(ends[..., 0], ends[..., 1]).min()) - taken_m
    for_good = stands(track) and always >= MIN_RADIUS_M
    return Room(max(min(while_seen, always) if for_good else while_seen, MIN_RADIUS_M), for_good)


def _trimmed(tracks: list[SmoothTrack], rooms: list[Room]) -> str:
    """What to say of trimmed circles."""
    trimmed = sum(bool((t.radius_m > room.radius_m).any()) for t, room in zip(tracks, rooms, strict=True))
    return f"; {trimmed} of {len(tracks)} trimmed to leave the log's vehicle its place" if trimmed else ""


def stands(track: SmoothTrack) -> bool:
    """Whether it stood when it was last seen, and for most of the time before."""
    return bool(track.is_static[-1]) and float(np.mean(track.is_static)) > 0.5


def _is_own_body(track: SmoothTrack, body_radius_m: float) -> bool:
    """Whether the track is a part of the vehicle that carries the sensor: its centre is mostly within."""
    offset = track.position_m - track.sensor_m
    return bool(np.median(np.hypot(offset[:, 0], offset[:, 1])) < body_radius_m)


def _has_scenery(truth: Truth, config: Config) -> bool:
    background = {name.casefold() for name in config.evaluation.background_classes}
    return any(name.casefold() in background for name in set(truth.category))


def _labelled_standing(truth: Truth, object_id: int, static_speed_mps: float) -> bool:
    rows = truth.track_id == object_id
    position, stamps = truth.position_m[rows, :2], truth.stamp_ns[rows]
    away = np.hypot(*(position - position[0]).T)
    duration_s = float(stamps[-1] - stamps[0]) / 1e9
    slow = float(np.hypot(*(position[-1] - position[0]))) <= static_speed_mps * duration_s
    return bool(len(stamps) > 1 and slow and away.max() <= STANDING_SPREAD_M)


def _are_labelled(tracks: list[SmoothTrack], labelled: RecordedWorld, match_m: float) -> list[bool]:
    """Whether most of each track's sightings lie on labelled things: centres within `match_m`, or the
    track's centre within the thing."""
    if not tracks:
        return []
    owner = np.concatenate([np.full(len(t.stamp_ns), i) for i, t in enumerate(tracks)])
    stamps = np.concatenate([t.stamp_ns for t in tracks])
    points = np.concatenate([t.position_m for t in tracks])
    matches = np.zeros(len(owner), dtype=np.bool_)
    order = np.argsort(stamps, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(stamps[order])) + 1):
        objects = labelled.at(int(stamps[rows[0]]))
        offset = points[rows][:, None] - objects.centre_m
        near = np.hypot(offset[..., 0], offset[..., 1]) <= match_m
        matches[rows] = (near | (objects.clearance(points[rows], 0.0) <= 0.0)).any(axis=1)
    share = np.bincount(owner, weights=matches) / np.bincount(owner)
    return [bool(value) for value in share > ON_TRUTH_SHARE]
