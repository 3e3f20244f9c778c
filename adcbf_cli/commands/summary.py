"""What a stage command tells at its end: the headline numbers, the folder, warnings, exit code."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import typer

from adcbf_cli.commands.terminal import print_json, print_table, say, show_notes
from adcbf_cli.core.errors import EXIT_DATA_LOST
from adcbf_cli.io.run_folder import STAGES

if TYPE_CHECKING:
    import pyarrow as pa

    from adcbf_cli.commands.stages import Outcome
    from adcbf_cli.io.run_folder import RunFolder


def finish(outcome: Outcome, stage: str, as_json: bool) -> None:
    """Prints a stage's summary and notes; ends with exit code 3 where input was lost."""
    facts = summarise(outcome, stage)
    if as_json:
        print_json(facts)
    else:
        print_facts(outcome, facts)
    show_notes(outcome.notes)
    exit_for(outcome)


def exit_for(outcome: Outcome) -> None:
    if outcome.notes.losses:
        raise typer.Exit(EXIT_DATA_LOST)


def summarise(outcome: Outcome, stage: str) -> dict[str, Any]:
    """The run's headline numbers up to `stage`, JSON-able."""
    folder = outcome.folder
    facts: dict[str, Any] = {
        "run_folder": str(folder.path),
        "selection": outcome.manifest.selection,
        "computed": list(outcome.computed),
        "reused": [s for s in STAGES[: STAGES.index(stage) + 1] if s not in outcome.computed],
        "facts": [
            {"name": name, "value": value, "unit": unit}
            for of_stage in STAGES[: STAGES.index(stage) + 1]
            for name, value, unit in _FACTS[of_stage](folder)
        ],
    }
    facts["time_ms_per_frame"] = _times(folder)
    facts["warnings"] = outcome.notes.warnings
    facts["losses"] = [{"what": loss.what, "count": loss.count} for loss in outcome.notes.losses]
    facts["counters"] = outcome.notes.counters
    return facts


def print_facts(outcome: Outcome, facts: dict[str, Any]) -> None:
    for reason in facts["selection"].get("reasons", ()):
        say(str(reason))
    rows = [
        (fact["name"], "-" if fact["value"] is None else f"{fact['value']:,}", fact["unit"]) for fact in facts["facts"]
    ]
    print_table(str(outcome.folder.path), ("", "value", "unit"), rows)
    times = facts["time_ms_per_frame"]
    spent = ", ".join(f"{stage} {ms:.1f}" for stage, ms in times.items())
    if outcome.computed and spent:
        say(f"{', '.join(outcome.computed)} computed; ms a frame: {spent}; total {sum(times.values()):.1f}")
    if facts["reused"]:
        say(f"{', '.join(facts['reused'])} reused: still valid for this input, configuration and version")


def _mean(table: Any, column: str, digits: int = 1) -> float | None:
    import pyarrow.compute as pc

    value = pc.mean(table[column]).as_py()
    return None if value is None else round(value, digits)


def _cluster_facts(folder: RunFolder) -> list[tuple[str, Any, str]]:
    from adcbf_cli.io.parquet import read_table

    frames = read_table(
        folder.table("frames"),
        columns=["timestamp_ns", "points_read", "points_in_range", "points_clustered", "clusters"],
    )
    stamps = frames["timestamp_ns"].to_numpy()
    span = float(stamps[-1] - stamps[0]) / 1e9 if len(stamps) else None
    return [
        ("scans", len(frames), ""),
        ("time span", None if span is None else round(span, 1), "s"),
        ("points a scan, mean", _mean(frames, "points_read"), ""),
        ("points in range, mean", _mean(frames, "points_in_range"), ""),
        ("points clustered, mean", _mean(frames, "points_clustered"), ""),
        ("obstacles a scan, mean", _mean(frames, "clusters"), ""),
    ]


def _track_facts(folder: RunFolder) -> list[tuple[str, Any, str]]:
    import pyarrow as pa
    import pyarrow.compute as pc

    names = ["track_id", "is_static", "age_s"]
    each: pa.Table | None = None
    for rows in _batches(folder, "tracks", ["status", *names]):
        confirmed = rows.filter(pc.equal(rows["status"], "confirmed")).select(names)
        each = confirmed if each is None else pa.concat_tables([each, confirmed])
        most = [("is_static", "max"), ("age_s", "max")]
        each = each.group_by("track_id", use_threads=False).aggregate(most).select(["track_id", *map("_".join, most)])
        each = each.rename_columns(names)
    if each is None:
        return [("confirmed tracks", 0, ""), ("of which stood still at some time", 0, ""), ("longest track", None, "s")]
    longest = pc.max(each["age_s"]).as_py()
    return [
        ("confirmed tracks", len(each), ""),
        ("of which stood still at some time", pc.sum(each["is_static"]).as_py() or 0, ""),
        ("longest track", None if longest is None else round(longest, 1), "s"),
    ]


def _prediction_facts(folder: RunFolder) -> list[tuple[str, Any, str]]:
    import pyarrow.compute as pc

    steps, count = 0, 0
    sums = {"sigma_radius_m": 0.0, "conformal_radius_m": 0.0}
    known = dict.fromkeys(sums, 0)
    for rows in _batches(folder, "predictions", ["step", *sums]):
        if pc.max(rows["step"]).as_py() > steps:  # in the first batch already, unless it is shorter than a horizon
            steps, count = pc.max(rows["step"]).as_py(), 0
            sums, known = dict.fromkeys(sums, 0.0), dict.fromkeys(sums, 0)
        last = rows.filter(pc.equal(rows["step"], steps))
        count += len(last)
        for name in sums:
            sums[name] += pc.sum(last[name]).as_py() or 0.0
            known[name] += pc.count(last[name]).as_py()
    if not steps:
        return [("predictions", 0, "")]
    mean = {name: round(sums[name] / known[name], 3) if known[name] else None for name in sums}
    return [
        ("predictions (track x frame)", count, ""),
        ("steps", steps, ""),
        ("uncertainty radius at the last step, mean", mean["sigma_radius_m"], "m"),
        ("conformal radius at the last step, mean", mean["conformal_radius_m"], "m"),
    ]


def _batches(folder: RunFolder, table: str, columns: list[str]) -> Iterator[pa.Table]:
    """A table that grows with the log, a piece at a time."""
    import pyarrow as pa

    from adcbf_cli.io.parquet import ROWS_READ, batches

    for batch in batches(folder.table(table), batch_size=ROWS_READ, columns=columns):
        yield pa.Table.from_batches([batch])


_FACTS = {"cluster": _cluster_facts, "track": _track_facts, "predict": _prediction_facts}


def _times(folder: RunFolder) -> dict[str, float]:
    from adcbf_cli.io.parquet import read_table

    table = read_table(folder.table("timings"), columns=["frame_index", "stage", "time_ms"])
    frames = len(set(table["frame_index"].to_pylist())) or 1
    sums = table.group_by("stage", use_threads=False).aggregate([("time_ms", "sum")])
    return {row["stage"]: round(row["time_ms_sum"] / frames, 2) for row in sums.to_pylist()}
