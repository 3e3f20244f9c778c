"""What a stage command tells at its end: the headline numbers, the folder, warnings, exit code."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from adcbf_cli.commands.terminal import print_json, print_table, say, show_notes
from adcbf_cli.core.errors import EXIT_DATA_LOST
from adcbf_cli.io.run_folder import STAGES

if TYPE_CHECKING:
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
    import pyarrow.compute as pc

    from adcbf_cli.io.parquet import read_table

    tracks = read_table(folder.table("tracks"), columns=["track_id", "status", "is_static", "age_s"])
    confirmed = tracks.filter(pc.equal(tracks["status"], "confirmed"))
    each = confirmed.group_by("track_id", use_threads=False).aggregate([("is_static", "max"), ("age_s", "max")])
    longest = pc.max(each["age_s_max"]).as_py()
    return [
        ("confirmed tracks", len(each), ""),
        ("of which stood still at some time", pc.sum(each["is_static_max"]).as_py() or 0, ""),
        ("longest track", None if longest is None else round(longest, 1), "s"),
    ]


def _prediction_facts(folder: RunFolder) -> list[tuple[str, Any, str]]:
    import pyarrow.compute as pc

    from adcbf_cli.io.parquet import read_table

    rows = read_table(folder.table("predictions"), columns=["track_id", "step", "sigma_radius_m", "conformal_radius_m"])
    if not len(rows):
        return [("predictions", 0, "")]
    last = rows.filter(pc.equal(rows["step"], pc.max(rows["step"])))
    return [
        ("predictions (track x frame)", len(last), ""),
        ("steps", pc.max(rows["step"]).as_py(), ""),
        ("uncertainty radius at the last step, mean", _mean(last, "sigma_radius_m", 3), "m"),
        ("conformal radius at the last step, mean", _mean(last, "conformal_radius_m", 3), "m"),
    ]


_FACTS = {"cluster": _cluster_facts, "track": _track_facts, "predict": _prediction_facts}


def _times(folder: RunFolder) -> dict[str, float]:
    from adcbf_cli.io.parquet import read_table

    table = read_table(folder.table("timings"), columns=["frame_index", "stage", "time_ms"])
    frames = len(set(table["frame_index"].to_pylist())) or 1
    sums = table.group_by("stage", use_threads=False).aggregate([("time_ms", "sum")])
    return {row["stage"]: round(row["time_ms_sum"] / frames, 2) for row in sums.to_pylist()}
