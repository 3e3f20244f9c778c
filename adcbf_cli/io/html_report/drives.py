"""The drives of a run folder's `open_loop/` or `replay/`, as far as a page shows them tick by tick."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from adcbf_cli.core.replay.records import LOGGED
from adcbf_cli.core.types import FloatArray
from adcbf_cli.io.html_report.thinning import MILLI, evenly, integers, with_extremes
from adcbf_cli.io.parquet import ROWS_READ, batches, read_table

PLANNED_STAGES = 11
TEN_THOUSANDTH = 10_000
"""Barriers and gammas are integers of this: a barrier below it, 1 cm^2, is as good as touched."""

Key = tuple[str, int]


@dataclass(frozen=True)
class Detail:
    """How much is shown tick by tick: about so many drives of a kind, and so many ticks and plans of each."""

    drives: int = 24
    ticks: int = 1500

    @property
    def plans(self) -> int:
        return self.ticks // 5


_TICKS = ("timestamp_ns", "x_m", "y_m", "yaw_rad", "clearance_m")
SHARES = 200
"""So many points of the distribution of a drive's solve times are kept, the longest among them."""
_STAGES = ("tick", "stage", "x_m", "y_m", "barrier_m2", "gamma")


def gather_drives(folder: Path, kind: str, start_ns: int, origin_m: FloatArray, detail: Detail) -> dict[str, Any]:
    """The drives of one kind: how many there are, and some of them in `detail`.

    Seeds are shown whole, all planners of one: first the one that was driven first, whose plans alone are stored,
    then those in which a drive failed, then the rest; at least one seed is.
    """
    entries = read_table(folder / "drives.parquet", ["planner", "seed", "result"]).to_pylist()
    driven = [entry for entry in entries if entry["planner"] != LOGGED]
    seeds = _chosen_seeds(driven, detail.drives)
    shown = [entry for entry in entries if entry["seed"] in seeds or entry["planner"] == LOGGED]
    chosen = {(entry["planner"], entry["seed"]): entry for entry in shown}
    ticks = _columns(folder / "trajectories.parquet", chosen, _TICKS)
    solve = _columns(folder / "solve_times.parquet", chosen, ("solve_ms",))
    outcomes = _texts(folder / "plans.parquet", chosen, "outcome")
    stages = _columns(folder / "plan_stages.parquet", chosen, _STAGES)
    drives = []
    for key, entry in chosen.items():
        if key not in ticks:
            continue
        drive = {"kind": kind, "planner": key[0], "seed": key[1], "result": entry["result"]}
        planned = _plans(stages.get(key), len(ticks[key]["timestamp_ns"]))
        of_drive = _Driven(ticks[key], solve.get(key), outcomes.get(key) or [], planned)
        drives.append(drive | _encoded(of_drive, start_ns, origin_m, detail))
    return {
        "kind": kind,
        "drives": drives,
        "total": len(entries),
        "seeds": sorted({entry["seed"] for entry in driven}),
        "shown_seeds": seeds,
        "planners": list(dict.fromkeys(entry["planner"] for entry in entries)),
    }


def _chosen_seeds(entries: list[dict[str, Any]], most: int) -> list[int]:
    """The one with plans first, the others ascending."""
    first = entries[0]["seed"] if entries else None
    every = sorted({entry["seed"] for entry in entries}, key=lambda seed: (seed != first, seed))
    failed = {entry["seed"] for entry in entries if entry["result"] not in (None, "success")}
    order = [*every[:1], *(s for s in every[1:] if s in failed), *(s for s in every[1:] if s not in failed)]
    chosen: set[int] = set()
    shown = 0
    for seed in order:
        shown += sum(entry["seed"] == seed for entry in entries)
        if chosen and shown > most:
            break
        chosen.add(seed)
    return [seed for seed in every if seed in chosen]


def _rows(path: Path, chosen: dict[Key, Any], names: tuple[str, ...]) -> Iterator[tuple[Key, pa.Table]]:
    """Pieces of a driving table, of one chosen drive each. Read in batches: only what is chosen is held."""
    for batch in batches(path, batch_size=ROWS_READ * 4, columns=["planner", "seed", *names]):
        table = pa.Table.from_batches([batch])
        keys = table.select(["planner", "seed"]).group_by(["planner", "seed"], use_threads=False).aggregate([])
        for row in keys.to_pylist():
            key = (row["planner"], row["seed"])
            if key in chosen:
                mine = pc.and_(pc.equal(table["planner"], key[0]), pc.equal(table["seed"], key[1]))
                yield key, table.filter(mine)


def _columns(path: Path, chosen: dict[Key, Any], names: tuple[str, ...]) -> dict[Key, dict[str, np.ndarray]]:
    """Numbers by drive and column; NaN for null."""
    parts: dict[Key, list[pa.Table]] = {}
    for key, table in _rows(path, chosen, names):
        parts.setdefault(key, []).append(table)
    return {key: {name: pa.concat_tables(tables)[name].to_numpy() for name in names} for key, tables in parts.items()}


def _texts(path: Path, chosen: dict[Key, Any], name: str) -> dict[Key, list[str | None]]:
    found: dict[Key, list[str | None]] = {}
    for key, table in _rows(path, chosen, (name,)):
        found.setdefault(key, []).extend(table[name].to_pylist())
    return found


def _plans(stages: dict[str, np.ndarray] | None, ticks: int) -> dict[str, FloatArray] | None:
    """A drive's plans as (T, N + 1) arrays, or None for a planner without."""
    if stages is None or not ticks or len(stages["stage"]) % ticks:
        return None
    return {name: stages[name].reshape(ticks, -1).astype(float) for name in ("x_m", "y_m", "barrier_m2", "gamma")}


@dataclass(frozen=True)
class _Driven:
    """One drive's rows of each table; None where a table has none of it."""

    ticks: dict[str, np.ndarray]
    solve: dict[str, np.ndarray] | None
    outcome: list[str | None]
    plans: dict[str, FloatArray] | None


def _encoded(driven: _Driven, start_ns: int, origin_m: FloatArray, detail: Detail) -> dict[str, Any]:
    ticks, solve, plans = driven.ticks, driven.solve, driven.plans
    count = len(ticks["timestamp_ns"])
    nothing = np.full(count, np.nan)
    solve_ms = nothing if solve is None else solve["solve_ms"].astype(float)
    now = nothing if plans is None else plans["barrier_m2"][:, 0]
    worst = nothing if plans is None else _smallest(plans["barrier_m2"])
    gamma = nothing if plans is None else plans["gamma"][:, 0]
    kept = with_extremes(count, detail.ticks, (ticks["clearance_m"], worst), (solve_ms,))
    after_ms = np.rint((ticks["timestamp_ns"] - start_ns) / 1e6)
    encoded = {
        "ticks": count,
        "t_ms": integers(after_ms[kept]),
        "x_mm": integers(ticks["x_m"][kept] - origin_m[0], MILLI),
        "y_mm": integers(ticks["y_m"][kept] - origin_m[1], MILLI),
        "yaw_mrad": integers(ticks["yaw_rad"][kept], MILLI),
        "clearance_mm": integers(ticks["clearance_m"][kept], MILLI),
        "barrier_cm2": integers(now[kept], TEN_THOUSANDTH),
        "barrier_min_cm2": integers(worst[kept], TEN_THOUSANDTH),
        "gamma_e4": integers(gamma[kept], TEN_THOUSANDTH),
        "solve_us": integers(solve_ms[kept], MILLI),
        "solve_shares": _shares(solve_ms),
        "fallbacks": _spans(driven.outcome, after_ms),
        "plans": None,
    }
    if plans is not None:
        shown, stages = evenly(count, detail.plans), evenly(plans["x_m"].shape[1], PLANNED_STAGES)
        place = np.stack([plans[f"{axis}_m"][np.ix_(shown, stages)] - origin_m[i] for i, axis in enumerate("xy")], -1)
        encoded["plans"] = {"t_ms": integers(after_ms[shown]), "xy_mm": [integers(row, MILLI) for row in place]}
    return encoded


def _shares(solve_ms: FloatArray) -> dict[str, list[int | None]]:
    """The distribution of all ticks' solve times, before any is left out: times, ascending, and which share of the
    steps took no longer."""
    known = np.sort(solve_ms[np.isfinite(solve_ms)])
    kept = evenly(len(known), SHARES)
    share = (kept + 1) / max(1, len(known))
    return {"us": integers(known[kept], MILLI), "share_e4": integers(share, TEN_THOUSANDTH)}


def _spans(outcome: list[str | None], after_ms: FloatArray) -> list[list[Any]]:
    """[from, to, outcome] in ms wherever a planning step was not simply solved."""
    spans: list[list[Any]] = []
    for tick, what in enumerate(outcome):
        if what in (None, "solved"):
            continue
        t_ms, before_ms = int(after_ms[tick]), int(after_ms[max(tick - 1, 0)])
        if spans and spans[-1][2] == what and spans[-1][1] == before_ms:
            spans[-1][1] = t_ms
        else:
            spans.append([t_ms, t_ms, what])
    return spans


def _smallest(values: FloatArray) -> FloatArray:
    """The smallest of each row, NaN where a row has none."""
    known = np.isfinite(values)
    lowest = np.where(known, values, np.inf).min(axis=1)
    return np.where(known.any(axis=1), lowest, np.nan)


def left_out(gathered: dict[str, Any], detail: Detail, name: str) -> Iterator[str]:
    """What of the drives of folder `name` is not on the page."""
    if len(gathered["shown_seeds"]) < len(gathered["seeds"]):
        seeds = ", ".join(map(str, gathered["shown_seeds"]))
        yield (
            f"{name}: of {len(gathered['seeds'])} seeds, {seeds} are shown tick by tick (first the one driven "
            "first, then those in which a drive failed); the tables count all"
        )
    if any(drive["ticks"] > detail.ticks for drive in gathered["drives"]):
        yield f"{name}: about {detail.ticks:,} ticks a drive, the extremes among them"
    if any(drive["plans"] is not None and drive["ticks"] > detail.plans for drive in gathered["drives"]):
        yield f"{name}: {detail.plans} plans a drive, evenly spread"


def gather_gamma(folder: Path) -> list[dict[str, Any]]:
    """The maps of gamma over distance and radius; planners with the same one share it."""
    maps: dict[str, dict[str, Any]] = {}
    rows = read_table(folder / "gamma.parquet", ["planner", "distance_m", "radius_m", "gamma"])
    for planner in dict.fromkeys(rows["planner"].to_pylist()):
        mine = rows.filter(pc.equal(rows["planner"], planner))
        distance, radius = (np.unique(mine[name].to_numpy()) for name in ("distance_m", "radius_m"))
        values = mine["gamma"].to_numpy()
        if len(values) != len(distance) * len(radius):
            continue
        digest = values.tobytes().hex()
        entry = maps.setdefault(
            digest,
            {
                "planners": [],
                "distance_mm": integers(distance, MILLI),
                "radius_mm": integers(radius, MILLI),
                "gamma_e4": integers(values, TEN_THOUSANDTH),
            },
        )
        entry["planners"].append(planner)
    return list(maps.values())
