"""Fig. 2: DBSCAN and HDBSCAN on the same cloud, and over many scenes how often each tells obstacles apart.

One scan of each scene (`stacks`) goes through the package's crop, ground removal, grid and outlier removal; all
clusterers get the same grid cells, and the same code measures the obstacles. Which obstacle a point lies on is known
from the ray that made it. Of an obstacle with enough returns to be a cluster, with `best` the cluster that holds
most of its points:

    missed  less than half of its points are in any cluster
    merged  `best` is also the best of another obstacle
    split   not merged, and another cluster consists of its points for at least half
    found   none of these

The inflated area is what the obstacles' circles take beyond the cells that hold points: with one circle a cluster,
as in the paper, and with this package's splitting of what is long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from adcbf_cli.core.config import PerceptionConfig
from adcbf_cli.core.evaluation.intervals import bootstrap_mean, wilson
from adcbf_cli.core.evaluation.segmentation import inflated_area
from adcbf_cli.core.perception.clustering import Grouping, dbscan, hdbscan
from adcbf_cli.core.perception.grid import Cells, occupied_cells
from adcbf_cli.core.perception.obstacles import split_over_long
from adcbf_cli.core.perception.pipeline import Perception
from adcbf_cli.core.reproduction.part import Document, Part, Row, seed_text, table
from adcbf_cli.core.reproduction.stacks import KINDS, LIDAR, TERRAIN, draw_stacks
from adcbf_cli.core.simulation.simulator import Simulator
from adcbf_cli.core.types import NO_ID, FloatArray, IntArray, Notes

RANGE_M = 11.0
CONFIG = PerceptionConfig(range_m=RANGE_M, point_labels=True)
ONE_CIRCLE = CONFIG.model_copy(update={"max_radius_m": 1e3})
ENOUGH = 0.5
"""Share of an obstacle's points that must be in clusters, and of a cluster's that make it a piece of the obstacle."""

OUTCOMES = ("found", "merged", "split", "missed")
DRAWN = ("DBSCAN, eps 0.5 m", "HDBSCAN")
"""The two panels: both at this package's defaults."""


def _dbscan(eps_m: float) -> Callable[[Cells], Grouping]:
    def cluster(cells: Cells) -> Grouping:
        smallest = CONFIG.min_cluster_size
        return dbscan(
            cells.mean_m,
            eps_m=eps_m,
            min_samples=CONFIG.min_samples,
            min_cluster_size=smallest,
            returns=cells.returns(),
        )

    return cluster


def _hdbscan(cells: Cells) -> Grouping:
    return hdbscan(
        cells.mean_m,
        min_cluster_size=CONFIG.min_cluster_size,
        min_samples=CONFIG.min_samples,
        min_gap_m=CONFIG.min_gap_m,
        max_gap_m=CONFIG.max_gap_m,
        min_probability=CONFIG.min_probability,
        returns=cells.returns(),
    )


def _textbook(cells: Cells) -> Grouping:
    """scikit-learn's HDBSCAN over the whole cloud, given the smallest cluster's size and nothing else."""
    from sklearn.cluster import HDBSCAN

    found = HDBSCAN(min_cluster_size=CONFIG.min_cluster_size, copy=True).fit(cells.mean_m)
    return Grouping(found.labels_.astype(np.int64), found.probabilities_)


METHODS: dict[str, Callable[[Cells], Grouping]] = {
    "DBSCAN, eps 0.3 m": _dbscan(0.3),
    "DBSCAN, eps 0.5 m": _dbscan(0.5),
    "DBSCAN, eps 0.7 m": _dbscan(0.7),
    "HDBSCAN": _hdbscan,
    "HDBSCAN, textbook": _textbook,
}


@dataclass(frozen=True)
class Cloud:
    """One scan's points above ground around the sensor, (n, 3) in the world, each one's obstacle (n,) or NO_ID,
    and their grid cells; kinds: each obstacle's."""

    points_m: FloatArray
    unit: IntArray
    cells: Cells
    kinds: list[str]


def observe(seed: int) -> Cloud:
    """What the clusterers get of a seed's scene."""
    from scipy.spatial import cKDTree

    scene = draw_stacks(seed)
    perceive = Perception(CONFIG, Notes())
    for simulated in Simulator(scene.scenario(), seed):
        clusters = perceive(simulated.frame)
    assert clusters.labels is not None
    frame, points = simulated.frame, clusters.labels.points_m
    cast = frame.points_m @ frame.world_from_sensor[:3, :3].T + frame.world_from_sensor[:3, 3]
    _, source = cKDTree(cast).query(points)
    unit_of_id = np.array([*scene.unit_of_id(), NO_ID])  # the last for the ground, whose id is -1
    sensor_m = frame.world_from_sensor[:2, 3]
    cells = occupied_cells(points[:, :2] - sensor_m, CONFIG.cell_m, sensor_m)
    return Cloud(points - frame.world_from_sensor[:3, 3], unit_of_id[simulated.object_id[source]], cells, scene.kinds)


def outcomes(unit: IntArray, label: IntArray, units: int, fewest: int) -> list[str | None]:
    """Each obstacle's outcome (see the module's text), None for one with fewer than `fewest` points.

    unit, label: (n,) each point's obstacle and cluster, or NO_ID.
    """
    counts, best = _shared_points(unit, label, units, fewest)
    pieces = (counts[:-1] >= ENOUGH * counts.sum(axis=0))[:, :-1].sum(axis=1)
    shared = np.bincount(best[best != NO_ID], minlength=1)
    found: list[str | None] = []
    for number, points in enumerate(counts[:-1].sum(axis=1)):
        if points < fewest:
            found.append(None)
        elif best[number] == NO_ID:
            found.append("missed")
        elif shared[best[number]] > 1:
            found.append("merged")
        else:
            found.append("split" if pieces[number] > 1 else "found")
    return found


def _shared_points(unit: IntArray, label: IntArray, units: int, fewest: int) -> tuple[IntArray, IntArray]:
    """(units + 1, clusters + 1) points by obstacle and cluster, the last row and column being those of none; and each
    obstacle's best cluster, NO_ID where it is missed or has fewer than `fewest` points."""
    counts = np.zeros((units + 1, int(label.max(initial=0)) + 2), dtype=np.int64)
    np.add.at(counts, (unit, label), 1)  # NO_ID counts in the last one
    own = counts[:-1]
    total, clustered = own.sum(axis=1), own[:, :-1].sum(axis=1)
    held = (total >= fewest) & (clustered >= ENOUGH * total)
    return counts, np.where(held, own[:, :-1].argmax(axis=1), NO_ID)


def merged_clusters(unit: IntArray, label: IntArray, units: int, fewest: int) -> list[int]:
    """The clusters that are the best of more than one obstacle."""
    best = _shared_points(unit, label, units, fewest)[1]
    found, count = np.unique(best[best != NO_ID], return_counts=True)
    merged: list[int] = found[count > 1].tolist()
    return merged


def tasks(seeds: Sequence[int]) -> dict[str, int]:
    return {f"seed {seed}": seed for seed in seeds}


def run(seed: int) -> Row:
    """All methods on one scene."""
    cloud = observe(seed)
    methods = {name: _score(cloud, cluster(cloud.cells), name in DRAWN) for name, cluster in METHODS.items()}
    return {"seed": seed, "kinds": cloud.kinds, "cells_m": cloud.cells.mean_m.round(3).tolist(), "methods": methods}


def _score(cloud: Cloud, grouping: Grouping, drawn: bool) -> Row:
    """One method on one scene; with its clusters and circles where they are drawn."""
    label, units, fewest = grouping.label[cloud.cells.point_cell], len(cloud.kinds), CONFIG.min_cluster_size
    cells = cloud.cells
    whole, pieces = (
        split_over_long(cloud.points_m, cells.point_cell, cells.mean_m, grouping.label, config)[0]
        for config in (ONE_CIRCLE, CONFIG)
    )
    area, split_area = (
        inflated_area(found.centre_m, found.radius_m, cloud.points_m[:, :2], CONFIG.cell_m, RANGE_M)
        for found in (whole, pieces)
    )
    on_obstacles = cloud.unit != NO_ID
    row: Row = {
        "outcomes": outcomes(cloud.unit, label, units, fewest),
        "noise_share": round(float(np.mean(label[on_obstacles] == NO_ID)), 6),
        "clusters": len(whole.radius_m),
        "area_m2": round(area, 4),
        "split_area_m2": round(split_area, 4),
    }
    if drawn:
        row["label"] = grouping.label.tolist()
        row["circles_m"] = np.column_stack([whole.centre_m[:, :2], whole.radius_m]).round(3).tolist()
        row["merged"] = merged_clusters(cloud.unit, label, units, fewest)
    return row


def summarise(rows: Sequence[Row]) -> Document:
    methods = {name: _of_method([row["methods"][name] for row in rows], name) for name in METHODS}
    kinds = {name: {kind: _counts(_outcomes_of(rows, name, kind)) for kind in KINDS} for name in METHODS}
    hdbscan_found = _found_shares(rows, "HDBSCAN")
    differences = {}
    for name in METHODS:
        if name != "HDBSCAN":
            by_seed = hdbscan_found - _found_shares(rows, name)
            interval = bootstrap_mean(by_seed.tolist(), "found share")
            differences[name] = {"mean": float(by_seed.mean()), "interval": interval}
    first = rows[0]
    return {
        "seeds": [row["seed"] for row in rows],
        "paper": "a picture; no number is given",
        "methods": methods,
        "by_kind": kinds,
        "found_share_of_hdbscan_minus": differences,
        "drawn": {
            "seed": first["seed"],
            "range_m": RANGE_M,
            "cells_m": first["cells_m"],
            "panels": [{"name": name} | first["methods"][name] for name in DRAWN],
        },
    }


def _outcomes_of(rows: Sequence[Row], method: str, kind: str | None = None) -> list[str]:
    """All outcomes of a method, of one kind or all; obstacles with too few points left out."""
    return [
        outcome
        for row in rows
        for outcome, own in zip(row["methods"][method]["outcomes"], row["kinds"], strict=True)
        if outcome is not None and kind in (None, own)
    ]


def _counts(found: Sequence[str]) -> dict[str, int]:
    return {outcome: found.count(outcome) for outcome in OUTCOMES}


def _found_shares(rows: Sequence[Row], method: str) -> FloatArray:
    """(seeds,) each scene's share of obstacles found."""
    return np.array([np.mean([outcome == "found" for outcome in _outcomes_of([row], method)]) for row in rows])


def _of_method(scenes: Sequence[Row], name: str) -> dict[str, Any]:
    found = [outcome for scene in scenes for outcome in scene["outcomes"] if outcome is not None]
    result: dict[str, Any] = {"obstacles": len(found), "counts": _counts(found)}
    result["found_share"] = {
        "value": result["counts"]["found"] / len(found),
        "interval": wilson(result["counts"]["found"], len(found)),
    }
    for key in ("area_m2", "split_area_m2", "noise_share", "clusters"):
        values = [float(scene[key]) for scene in scenes]
        result[key] = {"mean": float(np.mean(values)), "interval": bootstrap_mean(values, key)}
    return result


def markdown(document: Document) -> str:
    rows = []
    for name, found in document["methods"].items():
        share = found["found_share"]
        cells = [str(found["counts"][outcome]) for outcome in OUTCOMES]
        cells.append(f"{100 * share['value']:.1f} {_between(share['interval'], 100, 1)}")
        cells.append(f"{100 * found['noise_share']['mean']:.1f}")
        cells += [
            f"{found[key]['mean']:.1f} {_between(found[key]['interval'], 1, 1)}" for key in ("area_m2", "split_area_m2")
        ]
        rows.append((name, *cells))
    head = (
        "clusterer",
        *OUTCOMES,
        "found, %",
        "points left as noise, %",
        "inflated area, m^2",
        "..., long ones split, m^2",
    )
    kinds = [
        (name, *(f"{counts['found']} / {sum(counts.values())}" for counts in found.values()))
        for name, found in document["by_kind"].items()
    ]
    obstacles = next(iter(document["methods"].values()))["obstacles"]
    return "\n\n".join(
        (
            f"(a) DBSCAN and (b) HDBSCAN on the same grid cells of one scan (seed {document['drawn']['seed']}), one "
            "circle a cluster; in the table the same over all scenes. The paper shows one scene and gives no number.",
            table(head, rows),
            f"{obstacles} obstacles in the scenes of {seed_text(document['seeds'])}, one scan each. Merged: in one "
            "cluster with another obstacle; split: in two or more clusters; missed: most of it in none. Brackets: 95 % "
            "intervals (Wilson; bootstrap over scenes). Inflated area: what the circles take beyond the cells with "
            "points, a scene. HDBSCAN is the package's, with its default gaps; textbook is scikit-learn's over the "
            "whole cloud, given the smallest cluster's size alone; DBSCAN's default here is eps 0.5 m.",
            "Found, by kind of obstacle:",
            table(("clusterer", *KINDS), kinds),
            _findings(document),
        )
    )


def _findings(document: Document) -> str:
    """How HDBSCAN compares with each other clusterer, from the paired differences."""
    lines = ["HDBSCAN's share of obstacles found, against the others on the same scenes, in percentage points:", ""]
    for name, difference in document["found_share_of_hdbscan_minus"].items():
        interval = difference["interval"]
        verdict = "too few scenes to say"
        if interval is not None:
            verdict = "more" if interval[0] > 0 else "fewer" if interval[1] < 0 else "no difference shown"
        lines.append(
            f"- {name}: {round(100 * difference['mean'], 1) + 0.0:+.1f} {_between(interval, 100, 1)}: {verdict}"
        )
    return "\n".join(lines)


def _between(interval: Sequence[float] | None, factor: float, digits: int) -> str:
    if interval is None:
        return "[-]"
    return f"[{factor * interval[0]:.{digits}f}, {factor * interval[1]:.{digits}f}]"


PART = Part(
    name="fig2",
    title="Fig. 2: DBSCAN and HDBSCAN on the same cloud",
    tasks=tasks,
    run=run,
    summarise=summarise,
    markdown=markdown,
    figure=True,
    settings={"perception": CONFIG.model_dump(mode="json"), "lidar": LIDAR, "terrain": TERRAIN},
)
