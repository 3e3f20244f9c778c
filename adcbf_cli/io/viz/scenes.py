"""From a run folder and its log to what viewers are shown: one stream of records, in the order of time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.types import NO_ID, Clusters, Frame, IntArray, Notes, Tracks
from adcbf_cli.io import tables
from adcbf_cli.io.frame_reader import FrameReader
from adcbf_cli.io.run_folder import DRIVING, Manifest, RunFolder
from adcbf_cli.io.viz.drives import body_radius_m, drive_names, drive_ticks
from adcbf_cli.io.viz.records import LabelledCloud, Record, SceneFrame, Show
from adcbf_cli.io.viz.shapes import Floor, Trail, label_points


def show_of(folder: RunFolder, manifest: Manifest) -> tuple[Show, int]:
    """What holds for the whole log, and how many drives the folder has besides those shown."""
    modes = [mode for kind, mode in DRIVING.items() if _is_current(folder, manifest, kind)]
    found = [drive_names(folder.path / mode, mode) for mode in modes]
    world = str(manifest.selection.get("world_frame") or "world")
    sensor = str(manifest.selection.get("sensor_frame") or "sensor")
    show = Show(
        source_sha256=manifest.source.sha256,
        world_frame=world,
        sensor_frame=sensor if sensor != world else f"{sensor}_sensor",
        body_radius_m={mode: body_radius_m(folder.path / mode) for mode in modes},
        probability=manifest.config.prediction.probability,
        drives=tuple(name for shown, _ in found for name in shown),
    )
    return show, sum(hidden for _, hidden in found)


def _is_current(folder: RunFolder, manifest: Manifest, kind: str) -> bool:
    """Whether the folder's drives of this kind are whole, and of the predictions that it holds now."""
    predicted = manifest.stages.get("predict")
    return predicted is not None and folder.driving_key(kind) == predicted.key


def scenes(folder: RunFolder, manifest: Manifest, show: Show, log: Path | None) -> Iterator[Record]:
    """The folder's valid tables frame by frame, with the log's points where `log` is given, and its drives' ticks.

    The log must be the one that the folder was made from. AdcbfError where a table or the log cannot be read.
    """
    streams: list[Iterator[Record]] = [_frames(folder.path, manifest, _clouds(log, manifest.config.read))]
    streams += [drive_ticks(folder.path, name) for name in show.drives]
    floor_m = 0.0
    for record in heapq.merge(*streams, key=_stamp_ns):
        if isinstance(record, SceneFrame):
            floor_m = record.floor_m
            yield record
        else:
            yield replace(record, floor_m=floor_m)


def _stamp_ns(record: Record) -> int:
    return record.stamp_ns


def _clouds(log: Path | None, config: ReadConfig) -> Iterator[Frame]:
    if log is not None:
        # What was lost of the log was told when the clusters were made.
        with FrameReader(log, config, Notes()) as reader:
            yield from reader


def _frames(folder: Path, manifest: Manifest, clouds: Iterator[Frame]) -> Iterator[SceneFrame]:
    """One record a scan."""
    tracks = tables.read_tracks(folder) if "track" in manifest.stages else None
    predicted = "predict" in manifest.stages and manifest.stages["predict"].rows.get("predictions")
    predictions = tables.read_predictions(folder) if predicted else None
    floor, trail = Floor(), Trail()
    waiting = next(clouds, None)
    records = tables.read_clusters(folder)
    upcoming = next(records, None)
    while upcoming is not None:
        clusters, upcoming = upcoming, next(records, None)
        trail.add(clusters.world_from_sensor[:3, 3])
        followed = None if tracks is None else next(tracks)
        cluster_track = _track_of_clusters(clusters, followed)
        cloud = None
        if waiting is not None:
            _check_together(waiting, clusters, folder)
            cloud = _labelled(waiting, clusters, cluster_track)
            waiting = next(clouds, None)
        yield SceneFrame(
            stamp_ns=clusters.stamp_ns,
            clusters=clusters,
            cluster_track=cluster_track,
            tracks=followed,
            predictions=None if predictions is None else next(predictions),
            cloud=cloud,
            floor_m=floor.at(clusters),
            driven=trail.shown(clusters.stamp_ns, upcoming is None) if clusters.pose_known else None,
        )


def _check_together(frame: Frame, clusters: Clusters, folder: Path) -> None:
    if (frame.index, frame.stamp_ns) != (clusters.frame_index, clusters.stamp_ns):
        raise AdcbfError(f"{folder}: its frames are not the log's; run on the log again with --force")


def _track_of_clusters(clusters: Clusters, tracks: Tracks | None) -> IntArray:
    """(n,) the track that each cluster updated, or NO_ID."""
    track = np.full(len(clusters), NO_ID, dtype=np.int64)
    if tracks is not None:
        updated = tracks.cluster_id != NO_ID
        track[tracks.cluster_id[updated]] = tracks.track_id[updated]
    return track


def _labelled(frame: Frame, clusters: Clusters, cluster_track: IntArray) -> LabelledCloud:
    cluster_id = label_points(frame.points_m, frame.world_from_sensor, clusters)
    track_id = np.append(cluster_track, NO_ID)[cluster_id]  # NO_ID is the last place
    return LabelledCloud(frame.points_m, cluster_id, track_id)
