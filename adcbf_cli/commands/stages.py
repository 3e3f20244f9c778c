"""Runs pipeline stages on a log or a run folder, and keeps what they give in the run folder.

One pass over the frames does everything that is asked for and not there yet:

    log -> frames -> clusters -> tracks -> predictions
                        |           |          |
                      table       table      table

A stage whose valid output is already in the folder is read back instead of computed.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from adcbf_cli.commands.options import Shared
from adcbf_cli.commands.plugin_hints import tell_overshadowed
from adcbf_cli.commands.recomputing import what_goes
from adcbf_cli.commands.terminal import progress, say
from adcbf_cli.commands.viz import check_viz
from adcbf_cli.core.config import CLUSTERERS, MOTION_MODELS, Config
from adcbf_cli.core.errors import AdcbfError, UsageError, given_by_option
from adcbf_cli.core.plugins import Kind
from adcbf_cli.core.timing import RecordingTimer
from adcbf_cli.core.types import Clusters, Frame, Notes, Predictions, Tracks, Truth
from adcbf_cli.io import tables
from adcbf_cli.io.log_base import printable
from adcbf_cli.io.parquet import TableWriter
from adcbf_cli.io.plugin_versions import stage_plugins
from adcbf_cli.io.report import FIGURE_FILES, PAGE
from adcbf_cli.io.run_folder import (
    DRIVING,
    OPTIONAL_TABLES,
    STAGES,
    TABLES,
    Manifest,
    RunFolder,
    Source,
    StageRecord,
    code_version,
    identify_source,
    stage_keys,
)
from adcbf_cli.io.settings import read_text, resolve_config

if TYPE_CHECKING:
    from adcbf_cli.core.prediction.calibration import Calibration

Record = TypeVar("Record", Clusters, Tracks, Predictions)


REPORTS = ("report.json", "report.md", "score_blocks.parquet", PAGE, *FIGURE_FILES)


@dataclass(frozen=True)
class Job:
    """What to run: the log, the run folder, the settings, and the calibration file's text (known to be one)."""

    log: Path
    folder: RunFolder
    source: Source
    config: Config
    calibration: str | None
    hashed_now: bool


@dataclass(frozen=True)
class Outcome:
    """What came of a job: the folder, its manifest, the stages that were computed in this call
    (the others were reused), and the notes of every stage up to the one asked for."""

    folder: RunFolder
    manifest: Manifest
    computed: tuple[str, ...]
    notes: Notes


def plan_job(shared: Shared, overrides: dict[str, Any] | None = None, calibration_file: Path | None = None) -> Job:
    """Reads the shared options: a log starts from the defaults, a run folder from its own settings."""
    check_viz(shared.viz)
    overrides = {**shared.overrides(), **(overrides or {})}
    calibration = None if calibration_file is None else read_text(calibration_file)
    if calibration is not None:
        with given_by_option(f"--calibration {calibration_file}: "):
            _parse_calibration(calibration)
    if RunFolder.is_one(shared.source):
        if shared.output is not None and shared.output.resolve() != shared.source.resolve():
            raise UsageError("-o goes with a log; a run folder is worked on where it is")
        folder = RunFolder(shared.source)
        manifest = folder.manifest()
        config = resolve_config(manifest.config, shared.config, shared.settings or (), overrides)
        if calibration is None and config.prediction.calibration == "file":
            calibration = manifest.calibration
        return Job(folder.path / manifest.source.path, folder, manifest.source, config, calibration, hashed_now=False)

    from adcbf_cli.io.logs import log_files

    config = resolve_config(Config(), shared.config, shared.settings or (), overrides)
    files = log_files(shared.source)
    folder = RunFolder(shared.output or Path(f"{log_stem(shared.source)}.adcbf"))
    _check_free(folder.path)
    source = identify_source(os.path.relpath(shared.source, folder.path), files)
    return Job(shared.source, folder, source, config, calibration, hashed_now=True)


def _check_free(folder: Path) -> None:
    """UsageError where no table can be written, or another command's results are, which a run's report would
    overwrite."""
    try:
        str(folder).encode()
    except UnicodeEncodeError:
        raise UsageError(f"-o {printable(str(folder))}: not UTF-8, as the names of tables have to be") from None
    batch = (folder / "batch.jsonl").exists() or any(folder.glob("runs/log=*"))
    if batch or (folder / "runs.jsonl").exists():
        what = "a batch" if batch else "the runs of a closed loop"
        raise UsageError(f"{folder}: holds {what}; choose another folder with -o")


def log_stem(log: Path) -> str:
    """The name that a log's run folder is made from: the file's without its suffix, as text that any tool can read."""
    resolved = log.resolve()
    return printable(resolved.name if resolved.is_dir() else resolved.stem)


def run_stages(job: Job, upto: str, force: bool = False) -> Outcome:
    """Makes sure that the run folder holds valid output of every stage up to `upto`; what is
    there and valid is reused, unless `force`."""
    tell_overshadowed(Kind.CLUSTERER, {job.config.perception.clusterer} & {*CLUSTERERS})
    tell_overshadowed(Kind.MOTION_MODEL, {job.config.tracking.model} & {*MOTION_MODELS})
    keys = stage_keys(job.source.sha256, job.config, job.calibration)
    wanted = STAGES[: STAGES.index(upto) + 1]
    with job.folder.locked():
        valid = [stage for stage in STAGES if job.folder.has_valid(stage, keys[stage])]
        reusable = [] if force else [s for s, v in zip(wanted, valid, strict=False) if s == v]
        todo = wanted[len(reusable) :]
        old = job.folder.usable_manifest()
        manifest = _manifest_so_far(job, old, valid)
        if todo:
            with ExitStack() as stack:
                opened = _open_input(job, manifest, todo, stack)  # before anything goes: there may be no such topic
                told = what_goes(job.folder, old, manifest, valid, todo, log=job.hashed_now)
                if told is not None:
                    say(told)
                manifest = _compute_anew(job, manifest, keys, valid, todo, opened)
        notes = _together([manifest.stages[stage] for stage in wanted])
        return Outcome(job.folder, manifest, todo, notes)


def _manifest_so_far(job: Job, old: Manifest | None, valid: list[str]) -> Manifest:
    """The folder's manifest `old` with the stages that are still valid, or a new one."""
    if old is None:
        return Manifest(job.source, {}, job.config, {}, job.calibration, stage_plugins(job.config))
    stages = {name: old.stages[name] for name in valid}
    return replace(
        old,
        source=job.source,
        config=job.config,
        stages=stages,
        calibration=job.calibration,
        plugins=stage_plugins(job.config),
    )


def _remove_outdated(folder: RunFolder, valid: list[str]) -> None:
    """Removes tables that the settings in force no longer give, and reports on them: a script
    that opens a file by its name must not meet an older run's."""
    outdated = [name for stage in STAGES if stage not in valid for name in (*TABLES[stage], *OPTIONAL_TABLES[stage])]
    for path in [*map(folder.table, [*outdated, "timings"]), *(folder.path / name for name in REPORTS)]:
        path.unlink(missing_ok=True)
    for kind in DRIVING:
        folder.remove_driving(kind)


def _compute_anew(
    job: Job, manifest: Manifest, keys: dict[str, str], valid: list[str], todo: tuple[str, ...], opened: _Input
) -> Manifest:
    """Removes what no longer holds, then runs the stages `todo`."""
    _remove_outdated(job.folder, valid)
    try:
        return _compute(job, manifest, keys, todo, opened)
    except BaseException:
        # Of several tables some may have been finished before the failure: no manifest lists them.
        _remove_outdated(job.folder, valid)
        raise


@dataclass(frozen=True)
class _Input:
    """Where the first stage that runs takes its records from, and what is noted on the way."""

    selection: dict[str, Any]
    frames: int | None
    records: Any
    notes: dict[str, Notes]
    timer: RecordingTimer


def _open_input(job: Job, manifest: Manifest, todo: tuple[str, ...], stack: ExitStack) -> _Input:
    """The log, or the table of the stage before. Raises AdcbfError where there is no such log, or nothing in it that is
    asked for."""
    notes = {stage: Notes() for stage in todo}
    timer = RecordingTimer()
    if todo[0] == "cluster":
        return _Input(*_clusters(job, notes["cluster"], timer, stack), notes, timer)
    read: Callable[[Path], Any] = tables.read_clusters if todo[0] == "track" else tables.read_tracks
    frames = manifest.stages["cluster"].rows.get("frames")
    return _Input(manifest.selection, frames, read(job.folder.path), notes, timer)


def _compute(job: Job, manifest: Manifest, keys: dict[str, str], todo: tuple[str, ...], opened: _Input) -> Manifest:
    """Runs the stages `todo` in one pass and writes their tables, then the manifest."""
    notes, timer, records = opened.notes, opened.timer, opened.records
    config, selection = job.config, opened.selection
    with ExitStack() as stack:
        writers = _open_writers(job, keys, todo, replace(manifest, selection=selection), stack)
        if "cluster" in todo:
            records = _keep_clusters(records, writers)
        if "track" in todo:
            from adcbf_cli.core.tracking.tracker import track_clusters

            tracks = track_clusters(records, config.tracking, notes["track"], timer)
            records = _keep(tracks, tables.track_columns, writers["tracks"])
        if "predict" in todo:
            predictions = _predict(job, records, notes["predict"], timer)
            records = _keep(predictions, tables.prediction_columns, writers["predictions"])
        for record in progress(records, opened.frames, " + ".join(todo)):
            writers["timings"].write(tables.timing_columns(record.stamp_ns, record.frame_index, timer.take()))

    stages = dict(manifest.stages)
    for stage in todo:
        written = {name: writers[name].rows for name in (*TABLES[stage], *OPTIONAL_TABLES[stage]) if name in writers}
        noted = notes[stage]
        stages[stage] = StageRecord(keys[stage], written, noted.warnings, noted.losses, noted.counters)
    finished = replace(manifest, selection=selection, stages=stages)
    job.folder.write_manifest(finished)
    return finished


def _clusters(
    job: Job, notes: Notes, timer: RecordingTimer, stack: ExitStack
) -> tuple[dict[str, Any], int | None, Iterable[Clusters]]:
    """What is taken from the log, how many frames it promises, and the obstacles in each."""
    from adcbf_cli.io.logs import is_object_list

    _check_log(job)
    if is_object_list(job.log):
        from adcbf_cli.core.perception.listed import listed_clusters, listed_frames

        truth = read_object_list(job.log, notes)
        selection = {"world_frame": "objects", "reasons": ("an object list: its objects are seen as they are",)}
        return selection, listed_frames(truth, job.config.read), listed_clusters(truth, job.config.read)
    from adcbf_cli.core.perception.pipeline import cluster_frames
    from adcbf_cli.io.frame_reader import FrameReader

    reader = stack.enter_context(FrameReader(job.log, job.config.read, notes))
    records = cluster_frames(_timed(reader, timer), job.config.perception, notes, timer)
    return asdict(reader.selection), reader.expected_frames, records


def read_object_list(path: Path, notes: Notes) -> Truth:
    """The objects of a CSV that stands for a log."""
    from adcbf_cli.io.truth import TruthContext, read_truth

    nothing = np.zeros(0, dtype=np.int64)
    return read_truth(str(path), path)(TruthContext(nothing, nothing, path), notes)


def _check_log(job: Job) -> None:
    """AdcbfError unless the log is still the one that the run folder was made from."""
    from adcbf_cli.io.logs import log_files

    if not job.log.exists():
        raise AdcbfError(f"{job.log}: this log is gone, and the run folder lacks what would be computed from it")
    if not job.hashed_now and identify_source(job.source.path, log_files(job.log)).sha256 != job.source.sha256:
        raise AdcbfError(f"{job.log}: has changed since {job.folder.path} was made; run on the log itself")


def _open_writers(
    job: Job, keys: dict[str, str], todo: tuple[str, ...], manifest: Manifest, stack: ExitStack
) -> dict[str, TableWriter]:
    provenance = {
        "source": {"name": job.source.name, "sha256": job.source.sha256},
        "selection": manifest.selection,
        "config": job.config.model_dump(mode="json"),
        "plugins": manifest.plugins,
        "adcbf": code_version(),
    }
    names = {name: stage for stage in todo for name in TABLES[stage]}
    if job.config.perception.point_labels and "cluster" in todo:
        names["points"] = "cluster"
    names["timings"] = todo[-1]
    return {
        name: stack.enter_context(TableWriter(job.folder.table(name), name, {**provenance, "key": keys[stage]}))
        for name, stage in names.items()
    }


def _predict(job: Job, tracks: Iterable[Tracks], notes: Notes, timer: RecordingTimer) -> Iterator[Predictions]:
    from adcbf_cli.core.prediction.predictor import predict_tracks

    calibration = None if job.calibration is None else _parse_calibration(job.calibration)
    yield from predict_tracks(tracks, job.config.prediction, job.config.tracking, notes, timer, calibration)


def _parse_calibration(text: str) -> Calibration:
    from adcbf_cli.core.prediction.calibration import Calibration

    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        raise AdcbfError(
            "not a calibration file, it is no JSON; `adcbf predict --save-calibration` writes one"
        ) from None
    return Calibration.from_dict(document)


def _timed(frames: Iterable[Frame], timer: RecordingTimer) -> Iterator[Frame]:
    """Books the time that the log takes to deliver each frame under `read`."""
    source = iter(frames)
    while True:
        with timer("read"):
            frame = next(source, None)
        if frame is None:
            return
        yield frame


def _keep_clusters(records: Iterable[Clusters], writers: dict[str, TableWriter]) -> Iterator[Clusters]:
    for record in records:
        writers["frames"].write(tables.frame_columns(record))
        writers["clusters"].write(tables.cluster_columns(record))
        if "points" in writers:
            writers["points"].write(tables.point_columns(record))
        yield tables.with_stored_pose(record)


def _keep(records: Iterable[Record], columns: Callable[[Record], Any], writer: TableWriter) -> Iterator[Record]:
    for record in records:
        writer.write(columns(record))
        yield record


def _together(records: list[StageRecord]) -> Notes:
    """The notes of several stages as one."""
    together = Notes()
    for record in records:
        for warning in record.warnings:
            together.warn(warning)
        together.losses.extend(record.losses)
        for name, number in record.counters.items():
            together.count(name, number)
    return together
