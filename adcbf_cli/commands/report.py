"""`adcbf report`: run folders as one HTML page that needs no network, and as figures for a paper."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from adcbf_cli.commands.options import Json
from adcbf_cli.core.errors import EXIT_DATA_LOST, UsageError

if TYPE_CHECKING:
    from adcbf_cli.core.types import Loss
    from adcbf_cli.io.html_report.gather import RunPage

MOST_RUNS = 8


def report(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Run folders of earlier commands.", show_default=False)
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE.html", help="Page to write; default: report.html in the run."),
    ] = None,
    points: Annotated[
        bool | None,
        typer.Option("--points/--no-points", help="Show points; default: if stored, or the log is there and short."),
    ] = None,
    figures: Annotated[
        bool, typer.Option("--figures/--no-figures", help="Also draw SVG and PNG, into a folder beside the page.")
    ] = True,
    json_output: Json = False,
) -> None:
    """Write one HTML page that can be sent and opened without a network.

    What was run and on what, scores, a top view that can be scrubbed through time, tracks and predictions, clearance,
    barrier and gamma, planners with intervals, solve times, calibration, and every warning. Several runs stand side by
    side. Only what the run folders hold is shown; the page names the command that would make what is missing.
    Figures that a paper can use are drawn into `figures/` in the run folder; with -o page.html, into `page.figures/`
    beside it. Of several runs, each has a folder of its own in there.

    Examples:

        adcbf report drive.adcbf

        adcbf report before.adcbf after.adcbf -o before_after.html

        adcbf report drive.adcbf --no-points --no-figures --json
    """
    from adcbf_cli.commands.terminal import print_json
    from adcbf_cli.io.report import PAGE, check_page, figure_folder

    _check_runs(runs)
    target = output or runs[0] / PAGE
    check_page(target, ".html")
    pages, drawn = _write(runs, target, points, figure_folder(target, runs[0]) if figures else None)
    if json_output:
        print_json(_document(target, pages, drawn))
    else:
        _tell(target, pages, drawn)
    if any(map(_losses, pages)):
        raise typer.Exit(EXIT_DATA_LOST)


def _write(
    runs: list[Path], target: Path, points: bool | None, figures: Path | None
) -> tuple[list[RunPage], list[Path]]:
    """Writes the page, and into the folder `figures`, if any, its figures. Returns the runs as they are on it, and the
    figures' files."""
    from contextlib import ExitStack

    from adcbf_cli.commands.terminal import progress
    from adcbf_cli.io.atomic import write_text_atomically
    from adcbf_cli.io.html_report.figures import write_figures
    from adcbf_cli.io.html_report.gather import Wishes, gather_run
    from adcbf_cli.io.html_report.page import render
    from adcbf_cli.io.run_folder import RunFolder

    wishes = Wishes(points, len(runs))
    drawn: list[Path] = []
    with ExitStack() as stack:
        for run in runs:
            if os.access(run, os.W_OK):  # where nobody may write, nobody does meanwhile
                stack.enter_context(RunFolder(run).locked())
        pages = [gather_run(run, name, wishes, progress) for run, name in zip(runs, _names(runs), strict=True)]
        write_text_atomically(target, render(pages))
        if figures is not None:
            for page in pages:
                own = "" if len(pages) == 1 else page.name.replace(os.sep, "_")
                drawn += write_figures(page, figures / own)
    return pages, drawn


def _names(runs: list[Path]) -> list[str]:
    """What the runs are called: their folders' names, or the paths as given where two would be called the same."""
    short = [run.resolve().name for run in runs]
    return short if len(set(short)) == len(runs) else [str(run).rstrip(os.sep) for run in runs]


def _losses(page: RunPage) -> list[Loss]:
    """What of a run's log could not be read."""
    return [loss for record in page.manifest.stages.values() for loss in record.losses]


def _tell(target: Path, pages: list[RunPage], drawn: list[Path]) -> None:
    from adcbf_cli.commands.terminal import say, told_loss

    print(target)
    for page in pages:
        for loss in _losses(page):
            say(f"{page.name}: {told_loss(loss)}")
        for section, (reason, command) in page.missing.items():
            say(f"{page.name}: no {section}: {reason}" + (f"; to add them: {command}" if command else ""))
    if drawn:
        say(f"{len(drawn)} figures in {os.path.commonpath([path.parent for path in drawn])}")
    say(f"{target.stat().st_size / 1e6:.1f} MB; open it in any browser, it needs no network")


def _check_runs(runs: list[Path]) -> None:
    """UsageError for what is no run folder, the same one twice, or more than stand side by side."""
    from adcbf_cli.io.run_folder import MANIFEST, RunFolder

    for run in runs:
        if not RunFolder.is_one(run):
            hint = f"; make one: adcbf run {run}" if run.is_file() else ""
            raise UsageError(f"{run}: not a run folder (no {MANIFEST}){hint}")
    if len({run.resolve() for run in runs}) < len(runs):
        raise UsageError("the same run folder is given twice")
    if len(runs) > MOST_RUNS:
        raise UsageError(f"{len(runs)} runs do not fit side by side; give {MOST_RUNS} at most")


def _document(target: Path, pages: list[RunPage], drawn: list[Path]) -> dict[str, Any]:
    return {
        "page": str(target),
        "bytes": target.stat().st_size,
        "figures": [str(path) for path in drawn],
        "runs": [
            {
                "run_folder": page.folder,
                "warnings": [{"from": where, "text": text} for where, text in page.warnings],
                "missing": [
                    {"section": section, "why": why, "command": command or None}
                    for section, (why, command) in page.missing.items()
                ],
                "thinned": page.thinned,
            }
            for page in pages
        ],
    }
