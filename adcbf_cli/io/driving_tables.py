"""The driving tables of one folder (`open_loop/` or `replay/` in a run folder): drives, their ticks,
what was planned at each, and how long that took.

Everything but `solve_times` is the same for the same input, whatever the machine and its load.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.replay.records import Drive, PlanStages, PlanSteps, Result
from adcbf_cli.core.types import NO_ID, FloatArray, IntArray
from adcbf_cli.io.parquet import Columns, TableWriter, read_table
from adcbf_cli.io.schemas import SCHEMAS

DRIVING_TABLES = ("drives", "trajectories", "plans", "plan_stages", "solve_times")

_TRAJECTORY_FLOATS = ("clearance_m", "ttc_s", "reference_m", "along_m", "log_m")
_PLAN_TEXTS = ("outcome", "status", "start")
_PLAN_NUMBERS = ("merit", "violation_m2", "decay", "deviation_m", "conflict", "obstacles", "dropped")
_STAGE_FLOATS = ("barrier_m2", "gamma", "slack_m2")


def write_drives(folder: Path, drives: Iterable[Drive], metadata: Mapping[str, Any]) -> dict[str, int]:
    """Writes the tables of these drives into the folder and returns their row counts."""
    with ExitStack() as stack:
        writers = {
            name: stack.enter_context(TableWriter(folder / f"{name}.parquet", name, metadata))
            for name in DRIVING_TABLES
        }
        for drive in drives:
            writers["drives"].write(_drive_columns(drive))
            writers["trajectories"].write(_trajectory_columns(drive))
            if drive.steps is not None:
                writers["plans"].write(_plan_columns(drive, drive.steps))
                writers["solve_times"].write({**_ticks(drive), "solve_ms": drive.steps.solve_ms})
            if drive.stages is not None:
                writers["plan_stages"].write(_stage_columns(drive, drive.stages))
    return {name: writer.rows for name, writer in writers.items()}


def write_gamma_map(folder: Path, maps: Mapping[str, tuple[FloatArray, FloatArray, FloatArray]], metadata: Any) -> None:
    """maps: by planner, distances (d,), radii (r,) and gamma (d, r)."""
    with TableWriter(folder / "gamma.parquet", "gamma", metadata) as writer:
        for planner, (distance_m, radius_m, gamma) in maps.items():
            columns = {
                "planner": [planner] * gamma.size,
                "distance_m": np.repeat(distance_m, len(radius_m)),
                "radius_m": np.tile(radius_m, len(distance_m)),
                "gamma": gamma.ravel(),
            }
            writer.write(columns)


def _of_drive(drive: Drive, rows: int) -> Columns:
    return {"planner": [drive.planner] * rows, "seed": np.full(rows, drive.seed, dtype=np.int32)}


def _ticks(drive: Drive, repeat: int = 1) -> Columns:
    ticks = len(drive.stamp_ns)
    return {
        **_of_drive(drive, ticks * repeat),
        "timestamp_ns": np.repeat(drive.stamp_ns, repeat),
        "tick": np.repeat(np.arange(ticks, dtype=np.int32), repeat),
    }


def _drive_columns(drive: Drive) -> Columns:
    numbers = ("period_s", "nominal_s", "reference_length_m", "reference_speed_mps")
    return {
        **_of_drive(drive, 1),
        **{name: [getattr(drive, name)] for name in numbers},
        "result": [None if drive.result is None else str(drive.result)],
        "ticks": [len(drive.stamp_ns)],
    }


def _trajectory_columns(drive: Drive) -> Columns:
    return {
        **_ticks(drive),
        **_motion(drive.pose, drive.inputs),
        **{name: getattr(drive, name) for name in _TRAJECTORY_FLOATS},
        "nearest_id": _ids(drive.nearest_id),
        "recorded": drive.recorded,
        "goal_reachable": drive.goal_reachable,
    }


def _motion(pose: FloatArray, inputs: FloatArray) -> Columns:
    return {
        "x_m": pose[..., 0].ravel(),
        "y_m": pose[..., 1].ravel(),
        "yaw_rad": pose[..., 2].ravel(),
        "speed_mps": inputs[..., 0].ravel(),
        "turn_input": inputs[..., 1].ravel(),
    }


def _ids(values: IntArray) -> pa.Array:
    return pa.array(values.ravel(), pa.int64(), mask=values.ravel() == NO_ID)


def _plan_columns(drive: Drive, steps: PlanSteps) -> Columns:
    known = np.isfinite(steps.feasible)
    return {
        **_ticks(drive),
        **{name: [text or None for text in getattr(steps, name)] for name in _PLAN_TEXTS},
        **{name: getattr(steps, name) for name in _PLAN_NUMBERS},
        "iterations": pa.array(steps.iterations, pa.int32(), mask=steps.iterations < 0),
        "feasible": pa.array(np.nan_to_num(steps.feasible) > 0, pa.bool_(), mask=~known),
    }


def _stage_columns(drive: Drive, stages: PlanStages) -> Columns:
    ticks, per_tick = stages.barrier_m2.shape
    error = np.full((ticks, per_tick), np.nan) if drive.plan_error_m is None else drive.plan_error_m
    return {
        **_ticks(drive, per_tick),
        "stage": np.tile(np.arange(per_tick, dtype=np.int32), ticks),
        **_motion(stages.pose, stages.inputs),
        **{name: getattr(stages, name).ravel() for name in _STAGE_FLOATS},
        "track_id": _ids(stages.track_id),
        "plan_error_m": error.ravel(),
    }


def read_drives(folder: Path) -> list[Drive]:
    """The drives that `write_drives` wrote. AdcbfError where a table is damaged, or they do not fit together."""
    tables = {name: read_table(folder / f"{name}.parquet", SCHEMAS[name].names) for name in DRIVING_TABLES}
    rows = {name: _Parts(table) for name, table in tables.items()}
    entries = tables["drives"].to_pylist()
    for entry in entries:
        if not _is_whole(entry, rows):
            raise AdcbfError(
                f"{folder}: its tables do not fit together ({entry['planner']}, seed {entry['seed']}); drive again"
            )
    return [_drive(entry, rows) for entry in entries]


def _is_whole(entry: dict[str, Any], rows: dict[str, _Parts]) -> bool:
    """Whether every table has each tick of this drive, in order, or, apart from the trajectory, none of it."""
    key, ticks = (entry["planner"], entry["seed"]), np.arange(entry["ticks"])
    if entry["result"] not in (None, *Result):
        return False
    driven, plans, times = (rows[name].of(key) for name in ("trajectories", "plans", "solve_times"))
    if (driven is None) != (len(ticks) == 0) or (plans is None) != (times is None):
        return False
    if any(part is not None and not np.array_equal(part["tick"], ticks) for part in (driven, plans, times)):
        return False
    staged = rows["plan_stages"].of(key)
    if staged is None:
        return True
    stages = np.arange(int(staged["stage"].max()) + 1)
    in_order = np.array_equal(staged["stage"], np.tile(stages, len(ticks)))
    return in_order and np.array_equal(staged["tick"], np.repeat(ticks, len(stages)))


class _Parts:
    """A table's rows by planner and seed; `write_drives` keeps each drive's rows together, in order."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table
        self._span: dict[tuple[str, int], list[int]] = {}
        keys = zip(table["planner"].to_pylist(), table["seed"].to_pylist(), strict=True)
        for row, key in enumerate(keys):
            self._span.setdefault(key, [row, row])[1] = row

    def of(self, key: tuple[str, int]) -> dict[str, np.ndarray] | None:
        """The drive's columns as arrays: floats with NaN for null, ids with NO_ID, or None without rows."""
        if key not in self._span:
            return None
        first, last = self._span[key]
        part = self._table.slice(first, last - first + 1)
        return {name: _values(part[name]) for name in part.column_names}


def _values(column: pa.ChunkedArray) -> np.ndarray:
    kind = column.type
    if pa.types.is_float64(kind):
        return np.array(column.to_numpy(), dtype=float)
    if pa.types.is_integer(kind):
        return np.array(column.fill_null(NO_ID).to_numpy(), dtype=np.int64)
    if pa.types.is_boolean(kind):
        values = np.array([np.nan if v is None else float(v) for v in column.to_pylist()])
        return values if np.isnan(values).any() else values.astype(bool)
    return np.array([value or "" for value in column.to_pylist()], dtype=object)


def _drive(entry: dict[str, Any], rows: dict[str, _Parts]) -> Drive:
    key = (entry["planner"], entry["seed"])
    ticks = rows["trajectories"].of(key)
    if ticks is None:
        ticks = {name: _values(SCHEMAS["trajectories"].empty_table()[name]) for name in SCHEMAS["trajectories"].names}
    staged = rows["plan_stages"].of(key)
    per_tick = 0 if staged is None else int(staged["stage"].max()) + 1
    errors = None if staged is None else staged["plan_error_m"].reshape(-1, per_tick)
    result = entry["result"]
    return Drive(
        planner=entry["planner"],
        seed=entry["seed"],
        period_s=entry["period_s"],
        nominal_s=entry["nominal_s"],
        reference_length_m=entry["reference_length_m"],
        reference_speed_mps=entry["reference_speed_mps"],
        stamp_ns=ticks["timestamp_ns"],
        pose=np.column_stack([ticks["x_m"], ticks["y_m"], ticks["yaw_rad"]]),
        inputs=np.column_stack([ticks["speed_mps"], ticks["turn_input"]]),
        **{name: ticks[name] for name in _TRAJECTORY_FLOATS},
        nearest_id=ticks["nearest_id"],
        recorded=ticks["recorded"].astype(bool),
        goal_reachable=ticks["goal_reachable"].astype(bool),
        result=None if result is None else Result(result),
        steps=_steps(rows["plans"].of(key), rows["solve_times"].of(key)),
        stages=None if staged is None else _stages(staged, per_tick),
        plan_error_m=errors if result is None and errors is not None else None,
    )


def _steps(plans: dict[str, np.ndarray] | None, times: dict[str, np.ndarray] | None) -> PlanSteps | None:
    if plans is None or times is None:
        return None
    return PlanSteps(
        outcome=tuple(plans["outcome"]),
        status=tuple(plans["status"]),
        start=tuple(plans["start"]),
        merit=plans["merit"],
        violation_m2=plans["violation_m2"],
        decay=plans["decay"],
        deviation_m=plans["deviation_m"],
        conflict=plans["conflict"].astype(bool),
        obstacles=plans["obstacles"],
        dropped=plans["dropped"],
        iterations=plans["iterations"],
        feasible=plans["feasible"].astype(float),
        solve_ms=times["solve_ms"],
    )


def _stages(staged: dict[str, np.ndarray], per_tick: int) -> PlanStages:
    def grid(name: str) -> np.ndarray:
        return staged[name].reshape(-1, per_tick)

    return PlanStages(
        pose=np.stack([grid("x_m"), grid("y_m"), grid("yaw_rad")], axis=-1),
        inputs=np.stack([grid("speed_mps"), grid("turn_input")], axis=-1),
        **{name: grid(name) for name in _STAGE_FLOATS},
        track_id=grid("track_id"),
    )
