"""The drives of a run folder as a stream of ticks, read a piece at a time."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import chain, count, pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
from pydantic import ValidationError

from adcbf_cli.core.config import VehicleConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.parquet import read_table, table_metadata, told_as_damage
from adcbf_cli.io.viz.records import DriveName, DriveTick
from adcbf_cli.io.viz.shapes import Trail

_BATCH_ROWS = 4096
_POSE = ("x_m", "y_m", "yaw_rad")

_Columns = dict[str, np.ndarray]


def drive_names(folder: Path, mode: str) -> tuple[list[DriveName], int]:
    """The drive of each planner's first seed, and how many other drives there are."""
    rows = read_table(folder / "drives.parquet", ["planner", "seed", "ticks"]).to_pylist()
    first: dict[str, int] = {}
    for row in rows:
        if row["ticks"]:
            first.setdefault(row["planner"], row["seed"])
    topics = drive_topics(mode, first)
    names = [
        DriveName(mode, planner, seed, topic) for (planner, seed), topic in zip(first.items(), topics, strict=True)
    ]
    return names, len(rows) - len(first)


def drive_topics(mode: str, planners: Iterable[str]) -> list[str]:
    """/replay/ad_cbf_mpc: letters, digits and _ only, as ROS asks for. Names that would be the same get numbers."""
    topics: list[str] = []
    for planner in planners:
        plain = f"/{mode}/" + re.sub(r"[^A-Za-z0-9_]", "_", planner)
        numbered = (f"{plain}_{number}" for number in count(2))
        topics.append(next(topic for topic in chain([plain], numbered) if topic not in topics))
    return topics


def body_radius_m(folder: Path) -> float:
    """Of the vehicle that was driven. AdcbfError where the tables do not say."""
    metadata = table_metadata(folder / "drives.parquet") or {}
    try:
        return VehicleConfig.model_validate(metadata["config"]["vehicle"]).body_radius_m
    except (ValidationError, LookupError, TypeError):
        raise AdcbfError(f"{folder}: its settings are not this adcbf's; drive again") from None


def drive_ticks(run_folder: Path, drive: DriveName) -> Iterator[DriveTick]:
    """One record a row of `trajectories`, with its plan where there is one; heights are for the caller to fill in.

    AdcbfError where a table is damaged.
    """
    folder = run_folder / drive.mode
    outcomes = _AtTick(_by_tick(folder / "plans.parquet", drive, ("outcome",)))
    plans = _AtTick(_by_tick(folder / "plan_stages.parquet", drive, _POSE))
    trail = Trail()
    rows = _by_tick(folder / "trajectories.parquet", drive, ("timestamp_ns", *_POSE, "speed_mps", "clearance_m"))
    upcoming = next(rows, None)
    while upcoming is not None:
        (tick, row), upcoming = upcoming, next(rows, None)
        stamp_ns, pose = int(row["timestamp_ns"][0]), _poses(row)[0]
        trail.add(pose)
        outcome, plan = outcomes.of(tick), plans.of(tick)
        yield DriveTick(
            drive=drive,
            stamp_ns=stamp_ns,
            pose=pose,
            speed_mps=float(row["speed_mps"][0]),
            clearance_m=float(row["clearance_m"][0]),
            outcome="" if outcome is None else outcome["outcome"][0] or "",
            plan=None if plan is None else _poses(plan),
            driven=trail.shown(stamp_ns, upcoming is None) if drive.has_own_path else None,
        )


def _poses(columns: _Columns) -> np.ndarray:
    return np.column_stack([columns[name] for name in _POSE])


class _AtTick:
    """Looks groups of rows up by ascending tick."""

    def __init__(self, groups: Iterator[tuple[int, _Columns]]) -> None:
        self._groups = groups
        self._next = next(groups, None)

    def of(self, tick: int) -> _Columns | None:
        while self._next is not None and self._next[0] < tick:
            self._next = next(self._groups, None)
        return self._next[1] if self._next is not None and self._next[0] == tick else None


def _by_tick(path: Path, drive: DriveName, columns: tuple[str, ...]) -> Iterator[tuple[int, _Columns]]:
    """This drive's rows, tick by tick; a drive's rows are together and in order."""
    rest: pa.Table | None = None
    for batch in _batches(path, drive, columns):
        table = batch if rest is None else pa.concat_tables([rest, batch])
        groups = list(_split(table))
        yield from groups[:-1]
        rest = table.slice(len(table) - len(groups[-1][1]["tick"]))
    if rest is not None:
        yield from _split(rest)


def _batches(path: Path, drive: DriveName, columns: tuple[str, ...]) -> Iterator[pa.Table]:
    """Row groups of other drives are passed over unread."""
    mine = (ds.field("planner") == drive.planner) & (ds.field("seed") == drive.seed)
    with told_as_damage(path):
        scanned = ds.dataset(path).to_batches(
            columns=["tick", *columns],
            filter=mine,
            batch_size=_BATCH_ROWS,
            batch_readahead=0,
            fragment_readahead=0,
            use_threads=False,
        )
        yield from (pa.Table.from_batches([batch]) for batch in scanned if len(batch))


def _split(table: pa.Table) -> Iterator[tuple[int, _Columns]]:
    columns = {name: table[name].to_numpy() for name in table.column_names}
    tick = columns["tick"]
    edges = [0, *(np.flatnonzero(np.diff(tick)) + 1), len(tick)]
    for first, end in pairwise(edges):
        yield int(tick[first]), {name: values[first:end] for name, values in columns.items()}
