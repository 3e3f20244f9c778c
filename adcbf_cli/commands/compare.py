"""`adcbf compare`: runs side by side, and whether one is worse than the first."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from adcbf_cli.commands.options import Json
from adcbf_cli.commands.terminal import print_json, print_table, say
from adcbf_cli.core.errors import EXIT_THRESHOLD, AdcbfError, UsageError

if TYPE_CHECKING:
    from adcbf_cli.core.evaluation.change_limits import ChangeLimit
    from adcbf_cli.core.evaluation.run_comparison import RunComparison
    from adcbf_cli.core.evaluation.scored_run import ScoredRun

STDOUT = "-"


def compare(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN", help="Run folders; the first is the base.", show_default=False),
    ],
    fail_on: Annotated[
        list[str] | None,
        typer.Option("--fail-on", metavar="METRIC>+N[%]", help="Exit with 4 if it changes so (< > <= >=); repeatable."),
    ] = None,
    markdown: Annotated[
        str | None, typer.Option("--markdown", metavar="FILE|-", help="Write it for a pull request; - is stdout.")
    ] = None,
    json_output: Json = False,
) -> None:
    """Show runs side by side, with differences to the first.

    All metrics of the reports that `evaluate`, `run`, `plan` and `replay` left in the run folders. Where two runs are
    of one log, differences have 95 % intervals: means, counts and most scores paired by blocks, drives by seed.

    --fail-on takes a change against the first run, with its sign: `prediction.rmse_x_m>+5%` fails if it rises by more
    than 5 %, `clear.mota<-0.01` if it falls by more than 0.01.

    Examples:

        adcbf compare main.adcbf branch.adcbf

        adcbf compare ukf.adcbf ekf.adcbf kf.adcbf --json > filters.json

        adcbf compare main.adcbf branch.adcbf --markdown comment.md --fail-on "detection.recall<-0.02"
    """
    from adcbf_cli.core.evaluation import run_comparison_text as text
    from adcbf_cli.core.evaluation.change_limits import exceeded, parse_change_limit
    from adcbf_cli.core.evaluation.run_comparison import compare_runs
    from adcbf_cli.io.report import check_page
    from adcbf_cli.io.score_blocks import read_score_blocks

    limits = [parse_change_limit(word) for word in fail_on or []]
    if json_output and markdown == STDOUT:
        raise UsageError("--json and --markdown - both want stdout; write one of them to a file")
    if markdown not in (None, STDOUT):
        check_page(Path(str(markdown)), ".md")
    base, *others = _read(runs)
    _check_metrics(limits, [base, *others])
    blocks = [read_score_blocks(path) for path in runs]
    found = [compare_runs(base, run, blocks[0], own) for run, own in zip(others, blocks[1:], strict=True)]
    missed = {one.run: exceeded(limits, one.changes) for one in found}
    if markdown is not None:
        _write(markdown, text.markdown(base, found, missed))
    if json_output:
        print_json(text.document(base, others, found, list(map(str, limits)), missed))
    elif markdown != STDOUT:
        names = text.headline_names(base, found)
        print_table(f"compared with {base.name}", *text.side_by_side(base.name, found, names))
    for one in found:
        _tell(one, missed[one.run])
    if any(missed.values()):
        raise typer.Exit(EXIT_THRESHOLD)


def _write(target: str, page: str) -> None:
    from adcbf_cli.io.atomic import write_text_atomically

    if target == STDOUT:
        sys.stdout.write(page)
    else:
        write_text_atomically(Path(target), page)


def _tell(found: RunComparison, missed: Sequence[str]) -> None:
    from adcbf_cli.core.evaluation.run_comparison_text import tally

    for remark in found.remarks:
        say(f"warning: {found.run}: {remark}")
    say(f"{found.run}: of {len(found.changes)} metrics {tally(found)}")
    for line in missed:
        say(f"threshold missed: {found.run}: {line}")


def _read(paths: Sequence[Path]) -> list[ScoredRun]:
    from adcbf_cli.io.run_scores import read_scored_run

    if len(paths) < 2:
        raise UsageError("one run alone cannot be compared: give a base and at least one more run folder")
    names = [str(path) for path in paths]
    if len(set(names)) < len(names):
        raise UsageError("a run folder is given twice")
    runs = [read_scored_run(path, name) for path, name in zip(paths, names, strict=True)]
    for run in runs:
        if not run.scored:
            raise AdcbfError(f"{run.name}: holds no scores; `adcbf evaluate {run.name}` makes them")
    return runs


def _check_metrics(limits: Sequence[ChangeLimit], runs: Sequence[ScoredRun]) -> None:
    """UsageError where a limit is on a metric that cannot come out."""
    from adcbf_cli.commands.evaluate import possible_metrics
    from adcbf_cli.core.config import EvaluationConfig
    from adcbf_cli.core.evaluation.thresholds import check_names

    if limits:
        known = {name: None for run in runs for name in run.metrics}
        known |= dict.fromkeys(possible_metrics(EvaluationConfig()))
        check_names([limit.threshold for limit in limits], known)
