"""`adcbf info`: what a log holds, and what the other commands would take from it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from adcbf_cli.commands.options import Json
from adcbf_cli.core.errors import EXIT_DATA_LOST

if TYPE_CHECKING:
    from adcbf_cli.core.types import Notes
    from adcbf_cli.io.inspection import LogFacts
    from adcbf_cli.io.recognition import Recognised


def info(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A log: file or folder.", show_default=False)],
    json_output: Json = False,
) -> None:
    """Show what a log holds: topics, rates, gaps, frames, and what would be taken from it.

    Examples:

        adcbf info drive.mcap

        adcbf info bag_folder/ --json
    """
    from adcbf_cli.commands.terminal import print_json, show_notes
    from adcbf_cli.core.types import Notes
    from adcbf_cli.io.inspection import inspect_log, inspect_scans
    from adcbf_cli.io.logs import holds_scans, is_log
    from adcbf_cli.io.recognition import recognise

    notes = Notes()
    if not is_log(log):
        _show_recognised(log, recognise(log), json_output)
        return
    facts = inspect_scans(log, notes) if holds_scans(log) else inspect_log(log, notes)
    if json_output:
        print_json(_document(facts, notes))
    else:
        _print_facts(facts)
    show_notes(notes)
    if notes.losses:
        raise typer.Exit(EXIT_DATA_LOST)


def _show_recognised(path: Path, found: Recognised, json_output: bool) -> None:
    from adcbf_cli.commands.terminal import print_json

    if json_output:
        print_json({"path": str(path), "kind": found.kind, "use": found.use})
    else:
        print(f"{path} is {found.kind}; {found.use}")


def _print_facts(facts: LogFacts) -> None:
    from adcbf_cli.commands.terminal import print_table, say

    print(f"{facts.path}: {facts.container}, {_size(facts.bytes)}, {facts.messages} messages, {_span(facts)}")
    rows = [
        (
            topic.info.name,
            topic.info.msgtype,
            str(topic.info.count),
            _number(topic.info.rate_hz, "{:.1f}"),
            _number(_seconds(topic.info.largest_gap_ns), "{:.3f}"),
            topic.frame_id,
            topic.remark,
        )
        for topic in facts.topics
    ]
    print_table("Topics", ("topic", "type", "messages", "rate Hz", "largest gap s", "frame", ""), rows)
    if facts.edges or facts.loose_frames:
        _print_tree(facts)
    if facts.selection is None:
        say(f"warning: {facts.problem}")
        return
    print("What the other commands take:")
    for reason in facts.selection.reasons:
        print(f"  {reason}")
    print(f"  the same in full: {' '.join(facts.flags)}")


def _print_tree(facts: LogFacts) -> None:
    from adcbf_cli.io.inspection import tree_lines

    print("Frames")
    for depth, frame, how in tree_lines(facts.edges):
        print(f"  {'   ' * depth}{'└─ ' if depth else ''}{frame or chr(39) * 2}{f'  ({how})' if how else ''}")
    for frame in facts.loose_frames:
        print(f"  {frame}  (a LiDAR's frame; no transform mentions it)")
    print()


def _document(facts: LogFacts, notes: Notes) -> dict[str, Any]:
    from dataclasses import asdict

    return {
        "path": str(facts.path),
        "kind": "log",
        "container": facts.container,
        "files": [str(file) for file in facts.files],
        "bytes": facts.bytes,
        "messages": facts.messages,
        "start_ns": facts.start_ns,
        "end_ns": facts.end_ns,
        "duration_s": _seconds(_duration_ns(facts)),
        "topics": [
            {
                **{key: value for key, value in asdict(topic.info).items() if key != "largest_gap_ns"},
                "rate_hz": topic.info.rate_hz,
                "largest_gap_s": _seconds(topic.info.largest_gap_ns),
                "frame_id": topic.frame_id,
                "remark": topic.remark,
            }
            for topic in facts.topics
        ],
        "transforms": [{"parent": parent, "child": child, "how": how} for parent, child, how in facts.edges],
        "loose_frames": list(facts.loose_frames),
        "selection": None if facts.selection is None else asdict(facts.selection),
        "flags": list(facts.flags),
        "problem": facts.problem or None,
        "warnings": notes.warnings,
        "losses": [asdict(loss) for loss in notes.losses],
    }


def _duration_ns(facts: LogFacts) -> int | None:
    return None if facts.start_ns is None or facts.end_ns is None else facts.end_ns - facts.start_ns


def _span(facts: LogFacts) -> str:
    from datetime import UTC, datetime

    duration = _duration_ns(facts)
    if duration is None or facts.start_ns is None:
        return "empty"
    try:
        start = datetime.fromtimestamp(facts.start_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    except (OverflowError, ValueError, OSError):
        start = f"{facts.start_ns} ns"
    return f"{duration * 1e-9:.1f} s from {start}"


def _seconds(ns: int | None) -> float | None:
    return None if ns is None else ns * 1e-9


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _size(count: int) -> str:
    return f"{count / 1e6:.1f} MB" if count >= 1e5 else f"{count / 1e3:.1f} kB"
