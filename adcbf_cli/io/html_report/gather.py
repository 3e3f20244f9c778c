"""Everything that a page shows of one run folder. What is missing is said, with the command that would make it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.html_report import evidence
from adcbf_cli.io.html_report.documents import Driving, Evaluation, read_document
from adcbf_cli.io.html_report.drives import Detail, gather_drives, gather_gamma, left_out
from adcbf_cli.io.html_report.points import LogPoints, encode_points, stored_points
from adcbf_cli.io.html_report.scene import MOST_LIVES, PREDICTED_STEPS, gather_scene, halve
from adcbf_cli.io.html_report.thinning import evenly, integers
from adcbf_cli.io.logs import is_object_list
from adcbf_cli.io.parquet import read_table, table_metadata
from adcbf_cli.io.run_folder import DRIVING, STAGES, TABLES, Manifest, RunFolder, is_source
from adcbf_cli.io.run_settings import changed_settings, settings_made_with

T = TypeVar("T")
Watch = Callable[[Iterable[T], int | None, str], Iterator[T]]
"""Passes items on and may show how far it is: (items, how many, what)."""

PAGE_BYTES = 16_000_000
"""Data of all runs of a page together; with code, tables and figures it stays below 20 MB."""
MOST_FRAMES = 600
MOST_POINTS = 1000
FEWEST_FRAMES = 40
MOST_COUNTS = 3000
POINT_CELL_M = 0.1
SCANS_READ_AGAIN = 2000
"""A log of more scans is clustered again for its points only on request: it would take minutes."""


@dataclass(frozen=True)
class Wishes:
    """points: True, False, or None: where they are stored, or the log is at hand and not long.
    runs: how many share the page: each has its share of bytes, drives and, beyond two, of ticks."""

    points: bool | None = None
    runs: int = 1

    @property
    def data_bytes(self) -> int:
        return PAGE_BYTES // self.runs

    @property
    def detail(self) -> Detail:
        full = Detail()
        return Detail(max(1, full.drives // self.runs), full.ticks * 2 // max(2, self.runs))


@dataclass
class RunPage:
    """One run, ready for a page. data: what the page's scripts draw. missing: by section, why it is empty and the
    command that would fill it."""

    name: str
    folder: str
    manifest: Manifest
    data: dict[str, Any]
    about: list[tuple[str, str]]
    settings: list[tuple[str, str]]
    warnings: list[tuple[str, str]]
    report: dict[str, Any] | None
    driving: dict[str, dict[str, Any]]
    stage_times: list[dict[str, Any]]
    missing: dict[str, tuple[str, str]] = field(default_factory=dict)
    thinned: list[str] = field(default_factory=list)


def gather_run(path: Path, name: str, wishes: Wishes, watch: Watch[Any]) -> RunPage:
    """Reads a run folder, called `name` on its page. AdcbfError where it is none, has nothing whole, or is damaged."""
    folder = RunFolder(path)
    manifest = folder.manifest()
    stages = _whole_stages(folder, manifest)
    missing: dict[str, tuple[str, str]] = {}
    thinned: list[str] = []
    frames = manifest.stages["cluster"].rows.get("frames", 0)
    scene = gather_scene(path, stages, frames, MOST_FRAMES)
    _gather_points(folder, manifest, scene, wishes, watch, missing)
    report, driving, drives, gamma = _gather_reports(folder, manifest, scene, wishes, missing, thinned)
    made_with = settings_made_with(manifest.config, report, driving)
    for stage, what in (("track", "tracks"), ("predict", "predictions")):
        if stage not in stages:
            missing[what] = (f"no {what} were made", _command(stage, path))
    data = {
        "name": name,
        "scene": scene,
        "drives": drives,
        "gamma": gamma,
        "calibration": [] if report is None else evidence.calibration_points(report),
        "probability": manifest.config.prediction.probability,
    }
    data["scene"] = _fitted(data, wishes.data_bytes, thinned)
    return RunPage(
        name=name,
        folder=str(path),
        manifest=manifest,
        data=data,
        about=[*_about(manifest, scene, report, driving, stages), ("adcbf", _version(folder))],
        settings=[(key, json.dumps(value)) for key, value in changed_settings(made_with)],
        warnings=evidence.warnings_of(manifest, report, driving),
        report=report,
        driving={kind: {**document, **evidence.planner_tables(document)} for kind, document in driving.items()},
        stage_times=_stage_times(folder),
        missing=missing,
        thinned=thinned,
    )


def _whole_stages(folder: RunFolder, manifest: Manifest) -> tuple[str, ...]:
    """The stages whose tables are whole and of the manifest's keys, up to the first that is not."""
    whole: list[str] = []
    for stage in STAGES:
        record = manifest.stages.get(stage)
        if record is None or not folder.has_valid(stage, record.key):
            break
        whole.append(stage)
    if not whole:
        log = folder.path / manifest.source.path
        again = _command("run", log, "-o", str(folder.path))
        raise AdcbfError(f"{folder.path}: holds no finished stage; run `{again}` first")
    return tuple(whole)


def _gather_reports(
    folder: RunFolder,
    manifest: Manifest,
    scene: dict[str, Any],
    wishes: Wishes,
    missing: dict[str, tuple[str, str]],
    thinned: list[str],
) -> tuple[dict[str, Any] | None, dict[str, dict[str, Any]], list[dict[str, Any]], list[dict[str, Any]]]:
    """The evaluation, the driving reports, the drives and the maps of gamma, as far as the folder holds them."""
    path = folder.path
    report = read_document(path / "report.json", Evaluation, _command("evaluate", path))
    if report is None:
        missing["scores"] = ("this run was not scored", _command("evaluate", path, "--truth", "FILE"))
    posed = any(frame["sensor"] is not None for frame in scene["shown"])
    driving, drives, gamma = {}, [], []
    for kind, name in reversed(DRIVING.items()):  # closed loop first
        found = _driving_document(folder, manifest, kind)
        if isinstance(found, str):
            missing[kind] = (found, _driving_command(kind, path, posed))
            continue
        driving[kind] = found
        gathered = gather_drives(path / name, kind, scene["start_ns"], np.array(scene["origin_m"]), wishes.detail)
        gathered["route"] = _route(found, scene)
        gathered["deadline_ms"] = round(1000 / found["config"]["planning"]["rate_hz"], 3)
        gathered["safety_m"] = found["config"]["planning"]["safety_distance_m"]
        gathered["body_radius_m"] = found["config"]["vehicle"]["body_radius_m"]
        drives.append(gathered)
        keep_out_mm = round(1000 * (gathered["body_radius_m"] + gathered["safety_m"]))
        maps = [{**entry, "keep_out_mm": keep_out_mm} for entry in gather_gamma(path / name)]
        gamma += [entry for entry in maps if entry not in gamma]
        thinned += left_out(gathered, wishes.detail, name)
    return report, driving, drives, gamma


def _command(name: str, path: Path, *options: str) -> str:
    """As it can be pasted into a shell."""
    return shlex.join(["adcbf", name, str(path), *options])


def _driving_command(kind: str, path: Path, posed: bool) -> str:
    """What drives in this run folder. posed: whether the log says where its vehicle was; else there is no open loop,
    and a closed one needs to be told from where to where."""
    if kind == "replay":
        way = () if posed else ("--start", "X,Y", "--goal", "X,Y")
        return _command(kind, path, *way, "-p", "all", "--seeds", "0:20")
    return _command(kind, path, "-p", "all") if posed else ""


def _driving_document(folder: RunFolder, manifest: Manifest, kind: str) -> dict[str, Any] | str:
    """A kind of driving's report, or why there is none that belongs to this run."""
    name = DRIVING[kind]
    document = read_document(folder.path / name / "report.json", Driving, _command(kind, folder.path))
    key = folder.driving_key(kind)
    if document is None or key is None:
        there = any((folder.path / name).glob("*.parquet"))
        return (
            f"{name}/ is not whole"
            if there
            else "no planner was tried " + ("in closed loop" if kind == "replay" else "in open loop")
        )
    predicted = manifest.stages.get("predict")
    if predicted is None or predicted.key != key:
        return f"{name}/ was made of other predictions than this folder's"
    return document


def _route(document: dict[str, Any], scene: dict[str, Any]) -> dict[str, Any]:
    route = document["route"]
    origin = np.array(scene["origin_m"])
    points = np.array(document["reference_m"], dtype=float).reshape(-1, 2)
    return {
        "xy_mm": integers(points - origin, 1000),
        "goal_mm": integers(np.array(route["goal_m"]) - origin, 1000),
    }


def _gather_points(
    folder: RunFolder,
    manifest: Manifest,
    scene: dict[str, Any],
    wishes: Wishes,
    watch: Watch[Any],
    missing: dict[str, tuple[str, str]],
) -> None:
    """Adds the shown scans' points to the scene, where they can be had."""
    if wishes.points is False:
        missing["points"] = ("points were not asked for", _command("report", folder.path, "--points"))
        return
    shown = {frame["frame"]: frame for frame in scene["shown"]}
    origin = np.array(scene["origin_m"])
    with ExitStack() as stack:
        source: Iterable[tuple[int, Any, Any]]
        metadata = table_metadata(folder.table("points"))
        if metadata is not None and metadata.get("key") == manifest.stages["cluster"].key:
            source = stored_points(folder.table("points"), set(shown))
        else:
            reason = _why_not_from_log(folder, manifest, scene, wishes)
            if reason is not None:
                missing["points"] = reason
                return
            log = folder.path / manifest.source.path
            reader = LogPoints(log, manifest.config, stack)
            records = watch(reader.records, scene["frames"], "points of the log")
            source = (LogPoints.of(record) for record in records if record.frame_index in shown)
        for index, places, label in source:
            shown[index]["points"] = encode_points(places, label, origin, MOST_POINTS, POINT_CELL_M)
    scene["points"] = True


def _why_not_from_log(
    folder: RunFolder, manifest: Manifest, scene: dict[str, Any], wishes: Wishes
) -> tuple[str, str] | None:
    """Why points cannot be read from the log, with what would help, or None where they can."""
    log = folder.path / manifest.source.path
    again = _command("cluster", folder.path, "--labels")
    if not log.exists():
        return "the run stored no points, and its log is no longer where it was", "adcbf cluster LOG --labels"
    if is_object_list(log):
        return "a list of objects has no points", ""
    if wishes.points is None and scene["frames"] > SCANS_READ_AGAIN:
        return f"the run stored no points, and its log has {scene['frames']:,} scans to read again", (
            _command("report", folder.path, "--points")
        )
    if not is_source(log, manifest.source):
        return "the run stored no points, and its log has changed since", again
    return None


def _fitted(data: dict[str, Any], most_bytes: int, thinned: list[str]) -> dict[str, Any]:
    """The scene, with scans left out until the run's data is small enough; says what was left out."""
    scene: dict[str, Any] = data["scene"]
    rest = _size({**data, "scene": None})
    while rest + _size(scene) > most_bytes and len(scene["shown"]) > FEWEST_FRAMES:
        scene = halve(scene)
    if scene["stride"] > 1:
        thinned.append(f"top view: one in {scene['stride']} of {scene['frames']:,} scans")
    if scene.get("points"):
        thinned.append(
            f"points: one a {POINT_CELL_M:g} m square and cluster, at most {MOST_POINTS:,} a scan, seen from above"
        )
    if scene["steps"]:
        thinned.append(f"predictions: {min(PREDICTED_STEPS, len(scene['steps']))} steps, the last alone of what stands")
    if scene["confirmed"] > MOST_LIVES:
        thinned.append(f"bars: the {MOST_LIVES} longest-lived of {scene['confirmed']:,} confirmed tracks")
    counts = scene["counts"]
    if len(counts["t_ms"]) > MOST_COUNTS:
        kept = evenly(len(counts["t_ms"]), MOST_COUNTS).tolist()
        scene = {**scene, "counts": {name: [values[k] for k in kept] for name, values in counts.items()}}
        thinned.append(f"counts over time: {MOST_COUNTS:,} scans")
    return scene


def _size(part: Any) -> int:
    return len(json.dumps(part, separators=(",", ":")))


def _about(
    manifest: Manifest,
    scene: dict[str, Any],
    report: dict[str, Any] | None,
    driving: dict[str, dict[str, Any]],
    stages: tuple[str, ...],
) -> list[tuple[str, str]]:
    """What was run, and on what."""
    source = manifest.source
    size = sum(file.size_bytes for file in source.files)
    span_s = (scene["counts"]["t_ms"] or [0])[-1] / 1000
    rows = [
        (
            "Log",
            f"{source.name}, {_bytes(size)}" + ("" if len(source.files) == 1 else f" in {len(source.files)} files"),
        ),
        ("SHA-256", source.sha256),
        ("Scans", f"{scene['frames']:,} over {span_s:.1f} s"),
        *(("Taken", str(reason)) for reason in manifest.selection.get("reasons", ())),
        ("Stages", ", ".join(f"{stage} ({_rows(manifest, stage)})" for stage in stages)),
    ]
    truth = None if report is None else report["basis"]["truth"]
    if report is not None:
        rows.append(("Scored against", "later sightings: no ground truth" if truth is None else _truth(truth)))
    for kind, document in driving.items():
        route = document["route"]
        rows.append(
            (
                "Closed loop" if kind == "replay" else "Open loop",
                f"world: {document['world']}; route {route['length_m']:.1f} m at {route['speed_mps']:.3g} m/s",
            )
        )
    return rows


def _version(folder: RunFolder) -> str:
    """Of the adcbf that made the run, not of the one that shows it."""
    return str((table_metadata(folder.table("frames")) or {}).get("adcbf", "unknown"))


def _bytes(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count / 1e3:.1f} kB"


def _rows(manifest: Manifest, stage: str) -> str:
    counted = manifest.stages[stage].rows
    return ", ".join(f"{counted[name]:,} {name}" for name in TABLES[stage] if name in counted)


def _truth(truth: dict[str, Any]) -> str:
    return f"{truth['source']}: {truth['labels']:,} labels of {truth['objects']:,} objects"


def _stage_times(folder: RunFolder) -> list[dict[str, Any]]:
    """Where the time of the last pass went: ms a scan by stage, median, 95 % and largest."""
    if table_metadata(folder.table("timings")) is None:
        return []
    rows = read_table(folder.table("timings"), ["stage", "time_ms"])
    names, spent = np.array(rows["stage"].to_pylist(), dtype=object), rows["time_ms"].to_numpy()
    found = []
    for name in dict.fromkeys(names.tolist()):
        mine = spent[names == name]
        found.append(
            {
                "stage": name,
                "n": len(mine),
                "p50_ms": float(np.median(mine)),
                "p95_ms": float(np.quantile(mine, 0.95)),
                "max_ms": float(mine.max()),
            }
        )
    return found
