"""The perception tables: one row a thing and time, sorted by time.

`frames` has one row a LiDAR frame (also where nothing was seen in it), `clusters` one an obstacle
and frame, `tracks` one a track and frame, `predictions` one a track, frame and step, `points`
(optional) one a labelled point, `timings` one a frame and stage.

Records (adcbf_cli.core.types) go in one frame at a time and come back the same way, so neither
side's memory grows with the log. Id columns hold null for "none".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from adcbf_cli.core import frames as se3
from adcbf_cli.core.types import NO_ID, Clusters, PointCounts, Predictions, Tracks, TrackStatus
from adcbf_cli.io.parquet import ROWS_READ, Columns, batches
from adcbf_cli.io.schemas import COUNTS, POSE, SCHEMAS

FRAMES_READ = 256


def _ids(values: np.ndarray) -> pa.Array:
    """Ids, with null for NO_ID."""
    return pa.array(values, pa.int32(), mask=np.asarray(values) == NO_ID)


def _frame_keys(stamp_ns: int, frame_index: int, rows: int) -> Columns:
    return {"timestamp_ns": np.full(rows, stamp_ns), "frame_index": np.full(rows, frame_index, dtype=np.int32)}


def frame_columns(record: Clusters) -> Columns:
    """The one row of `frames` that stands for this record's frame."""
    pose = record.world_from_sensor
    values = [*pose[:3, 3], *se3.quaternion_from_rotation(pose[:3, :3])]
    return {
        **_frame_keys(record.stamp_ns, record.frame_index, 1),
        **{name: [value] for name, value in zip(POSE, values, strict=True)},
        "pose_known": [record.pose_known],
        "planar": [record.planar],
        **{f"points_{name}": [getattr(record.counts, name)] for name in COUNTS},
        "clusters": [len(record)],
    }


def with_stored_pose(record: Clusters) -> Clusters:
    """The record with its pose as `frames` keeps it, rounded through a quaternion, so that later
    stages see the same bits in the same pass as when they read the table."""
    pose = record.world_from_sensor
    stored = se3.pose_matrix(pose[:3, 3], se3.quaternion_from_rotation(pose[:3, :3]))
    return replace(record, world_from_sensor=stored)


def cluster_columns(record: Clusters) -> Columns:
    columns = {
        **_frame_keys(record.stamp_ns, record.frame_index, len(record)),
        "cluster_id": record.cluster_id,
        "points": record.points,
        "split_from": _ids(record.split_from),
    }
    for name in ("radius_m", "height_m", "length_m", "width_m", "yaw_rad", "probability"):
        columns[name] = getattr(record, name)
    for i, axis in enumerate("xyz"):
        columns[f"{axis}_m"] = record.centre_m[:, i]
        columns[f"sensor_frame_{axis}_m"] = record.centre_sensor_m[:, i]
    return columns


def point_columns(record: Clusters) -> Columns:
    labels = record.labels
    if labels is None:
        raise ValueError("this record has no point labels")
    columns = _frame_keys(record.stamp_ns, record.frame_index, len(labels.cluster_id))
    columns["cluster_id"] = _ids(labels.cluster_id)
    columns.update({f"{axis}_m": labels.points_m[:, i] for i, axis in enumerate("xyz")})
    return columns


def _rows_of(matrix: np.ndarray) -> pa.Array:
    """A (n, k) array as n lists of k."""
    rows, width = matrix.shape
    offsets = np.arange(0, (rows + 1) * width, width, dtype=np.int32) if width else np.zeros(rows + 1, np.int32)
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(np.ascontiguousarray(matrix).ravel(), pa.float64()))


def track_columns(record: Tracks) -> Columns:
    n, d = record.state.shape
    upper = np.triu_indices(d)
    columns = {
        **_frame_keys(record.stamp_ns, record.frame_index, n),
        "status": [TrackStatus(int(s)).name.lower() for s in record.status],
        "cluster_id": _ids(record.cluster_id),
        "model": [record.model] * n,
        "state": _rows_of(record.state),
        "covariance_upper": _rows_of(record.covariance[:, upper[0], upper[1]]),
        "cov_xx_m2": record.covariance[:, 0, 0],
        "cov_xy_m2": record.covariance[:, 0, 1],
        "cov_yy_m2": record.covariance[:, 1, 1],
        "manoeuvre_probability": np.full(n, np.nan) if record.manoeuvre is None else record.manoeuvre,
    }
    columns.update(
        {f"{name}": record.state[:, i] for i, name in enumerate(["x_m", "y_m", "z_m", "vx_mps", "vy_mps", "vz_mps"])}
    )
    for name in ("track_id", "radius_m", "height_m", "is_static", "age_s", "hits", "misses", "nis"):
        columns[name] = getattr(record, name)
    return columns


def prediction_columns(record: Predictions) -> Columns:
    n, steps = record.sigma_radius_m.shape
    step = np.tile(np.arange(1, steps + 1), n)
    position = record.position_m.reshape(-1, 3)
    velocity = record.velocity_mps.reshape(-1, 2)
    covariance = record.covariance_m2.reshape(-1, 2, 2)
    return {
        **_frame_keys(record.stamp_ns, record.frame_index, n * steps),
        "track_id": np.repeat(record.track_id, steps),
        "step": step,
        "target_ns": record.stamp_ns + np.round(step * record.step_s * 1e9).astype(np.int64),
        "x_m": position[:, 0],
        "y_m": position[:, 1],
        "z_m": position[:, 2],
        "vx_mps": velocity[:, 0],
        "vy_mps": velocity[:, 1],
        "cov_xx_m2": covariance[:, 0, 0],
        "cov_xy_m2": covariance[:, 0, 1],
        "cov_yy_m2": covariance[:, 1, 1],
        "radius_m": np.repeat(record.radius_m, steps),
        "sigma_radius_m": record.sigma_radius_m.ravel(),
        "conformal_radius_m": record.conformal_radius_m.ravel(),
        "is_static": np.repeat(record.is_static, steps),
    }


def timing_columns(stamp_ns: int, frame_index: int, spent_ns: Mapping[str, int]) -> Columns:
    stages = list(spent_ns)
    return {
        **_frame_keys(stamp_ns, frame_index, len(stages)),
        "stage": stages,
        "time_ms": [spent_ns[stage] / 1e6 for stage in stages],
    }


class _Rows:
    """A table's rows, read in batches, handed out frame by frame as dicts of numpy arrays."""

    def __init__(self, path: Path) -> None:
        self._batches = batches(path, batch_size=ROWS_READ)
        self._rest = SCHEMAS[path.stem].empty_table()
        self._index = np.zeros(0, dtype=np.int32)

    def of(self, frame_index: int) -> pa.Table:
        """This frame's rows. Ask for frames in ascending order."""
        while not len(self._index) or self._index[-1] <= frame_index:
            batch = next(self._batches, None)
            if batch is None:
                break
            more = pa.Table.from_batches([batch])
            start = np.searchsorted(self._index, frame_index)
            self._rest = pa.concat_tables([self._rest.slice(start), more]) if len(self._index) else more
            self._index = self._rest["frame_index"].to_numpy()
        first, last = np.searchsorted(self._index, [frame_index, frame_index + 1])
        return self._rest.slice(first, last - first)


def _column(rows: pa.Table, name: str, fill: float | None = None) -> np.ndarray:
    values = rows[name]
    if values.null_count and fill is not None:
        values = values.fill_null(fill)
    return values.to_numpy()  # type: ignore[no-any-return]


def _matrix(rows: pa.Table, name: str) -> np.ndarray:
    flat = rows[name].combine_chunks().flatten().to_numpy()
    return flat.reshape(len(rows), -1)  # type: ignore[no-any-return]


def _frame_rows(path: Path) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
    """Rows of `frames` with each frame's world_from_sensor."""
    for batch in batches(path, batch_size=FRAMES_READ):
        for row in batch.to_pylist():
            pose = [row[name] for name in POSE]
            yield row, se3.pose_matrix(np.array(pose[:3]), np.array(pose[3:]))


def read_clusters(folder: Path) -> Iterator[Clusters]:
    """The `Clusters` records of a run folder, one a frame."""
    rows = _Rows(folder / "clusters.parquet")
    for frame, world_from_sensor in _frame_rows(folder / "frames.parquet"):
        part = rows.of(frame["frame_index"])
        yield Clusters(
            frame_index=frame["frame_index"],
            stamp_ns=frame["timestamp_ns"],
            world_from_sensor=world_from_sensor,
            planar=frame["planar"],
            pose_known=frame["pose_known"],
            counts=PointCounts(**{name: frame[f"points_{name}"] for name in COUNTS}),
            cluster_id=_column(part, "cluster_id").astype(np.int64),
            centre_m=np.column_stack([_column(part, f"{axis}_m") for axis in "xyz"]),
            centre_sensor_m=np.column_stack([_column(part, f"sensor_frame_{axis}_m") for axis in "xyz"]),
            points=_column(part, "points").astype(np.int64),
            split_from=_column(part, "split_from", NO_ID).astype(np.int64),
            radius_m=_column(part, "radius_m"),
            height_m=_column(part, "height_m"),
            length_m=_column(part, "length_m"),
            width_m=_column(part, "width_m"),
            yaw_rad=_column(part, "yaw_rad"),
            probability=_column(part, "probability"),
        )


def read_tracks(folder: Path) -> Iterator[Tracks]:
    """The `Tracks` records of a run folder, one a frame."""
    rows = _Rows(folder / "tracks.parquet")
    model = _first_value(folder / "tracks.parquet", "model") or "cv"
    for frame, world_from_sensor in _frame_rows(folder / "frames.parquet"):
        part = rows.of(frame["frame_index"])
        state = _matrix(part, "state") if len(part) else np.zeros((0, 6))
        d = state.shape[1]
        covariance = np.zeros((len(part), d, d))
        upper = np.triu_indices(d)
        if len(part):
            covariance[:, upper[0], upper[1]] = _matrix(part, "covariance_upper")
            covariance[:, upper[1], upper[0]] = covariance[:, upper[0], upper[1]]
        yield Tracks(
            frame_index=frame["frame_index"],
            stamp_ns=frame["timestamp_ns"],
            world_from_sensor=world_from_sensor,
            model=model,
            track_id=_column(part, "track_id"),
            status=np.array([TrackStatus[s.upper()] for s in part["status"].to_pylist()], dtype=np.int64),
            state=state,
            covariance=covariance,
            radius_m=_column(part, "radius_m"),
            height_m=_column(part, "height_m"),
            is_static=_column(part, "is_static"),
            cluster_id=_column(part, "cluster_id", NO_ID).astype(np.int64),
            age_s=_column(part, "age_s"),
            hits=_column(part, "hits").astype(np.int64),
            misses=_column(part, "misses").astype(np.int64),
            nis=_column(part, "nis", np.nan),
            manoeuvre=None if part["manoeuvre_probability"].null_count else _column(part, "manoeuvre_probability"),
        )


def read_predictions(folder: Path) -> Iterator[Predictions]:
    """The `Predictions` records of a run folder, one a frame, also where nothing was predicted: that nothing
    was seen is known too. None at all where the whole table is empty."""
    path = folder / "predictions.parquet"
    first = [_first_value(path, name) for name in ("timestamp_ns", "target_ns")]
    if first[0] is None:
        return
    rows = _Rows(path)
    for frame, _ in _frame_rows(folder / "frames.parquet"):
        part = rows.of(frame["frame_index"])
        if not len(part):
            yield _nothing_predicted(frame["frame_index"], frame["timestamp_ns"], (first[1] - first[0]) / 1e9)
            continue
        step = _column(part, "step")
        steps = int(step.max())
        shape = (len(part) // steps, steps)
        xx, xy, yy = (_column(part, f"cov_{name}_m2").reshape(shape) for name in ("xx", "xy", "yy"))
        yield Predictions(
            frame_index=frame["frame_index"],
            stamp_ns=frame["timestamp_ns"],
            step_s=float(part["target_ns"][steps - 1].as_py() - frame["timestamp_ns"]) / steps / 1e9,
            track_id=_column(part, "track_id")[::steps],
            is_static=_column(part, "is_static")[::steps],
            position_m=np.stack([_column(part, f"{axis}_m").reshape(shape) for axis in "xyz"], axis=-1),
            velocity_mps=np.stack([_column(part, f"v{axis}_mps").reshape(shape) for axis in "xy"], axis=-1),
            covariance_m2=np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], axis=-2),
            radius_m=_column(part, "radius_m")[::steps],
            sigma_radius_m=_column(part, "sigma_radius_m").reshape(shape),
            conformal_radius_m=_column(part, "conformal_radius_m", np.nan).reshape(shape),
        )


def _nothing_predicted(frame_index: int, stamp_ns: int, step_s: float) -> Predictions:
    return Predictions(
        frame_index=frame_index,
        stamp_ns=stamp_ns,
        step_s=step_s,
        track_id=np.zeros(0, dtype=np.int64),
        is_static=np.zeros(0, dtype=np.bool_),
        position_m=np.zeros((0, 1, 3)),
        velocity_mps=np.zeros((0, 1, 2)),
        covariance_m2=np.zeros((0, 1, 2, 2)),
        radius_m=np.zeros(0),
        sigma_radius_m=np.zeros((0, 1)),
        conformal_radius_m=np.zeros((0, 1)),
    )


def _first_value(path: Path, column: str) -> Any:
    for batch in batches(path, batch_size=1, columns=[column]):
        if len(batch):
            return batch.column(0)[0].as_py()
    return None
