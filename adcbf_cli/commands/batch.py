"""`adcbf batch`: one command on many logs, in parallel, resumable, with one dataset of results."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer
from typer.core import TyperCommand

from adcbf_cli.commands import completing
from adcbf_cli.commands.terminal import print_json, say
from adcbf_cli.core.errors import EXIT_DATA_LOST, EXIT_FAILED, EXIT_THRESHOLD, UsageError

if TYPE_CHECKING:
    from adcbf_cli.commands.batch_engines import Finished
    from adcbf_cli.commands.batch_work import LogTask

JSON_LINES = "batch.jsonl"
_COMMAND = "adcbf.batch.command"

Row = dict[str, Any]


class CommandAfterDashes(TyperCommand):
    """Takes what stands after `--` for the command that runs on each log."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if "--" in args:
            dashes = args.index("--")
            ctx.meta[_COMMAND] = args[dashes + 1 :]
            args = args[:dashes]
        own = {option for parameter in self.params for option in (*parameter.opts, *parameter.secondary_opts)}
        for word in args:
            if word.startswith("--") and word.partition("=")[0] not in own | {"--help"}:
                raise UsageError(
                    f"{word}: no option of batch; those of the command that runs on each log go behind --, "
                    f"as in `adcbf batch LOGS -- run {word}`"
                )
        return super().parse_args(ctx, args)

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        return [*super().collect_usage_pieces(ctx), "[-- COMMAND [OPTIONS]]"]


def batch(
    ctx: typer.Context,
    logs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="LOGS",
            help="Logs, or quoted patterns.",
            show_default=False,
            autocompletion=completing.batch_commands,
        ),
    ] = None,
    list_file: Annotated[
        str | None, typer.Option("--from", metavar="FILE|-", help="Also the logs that this file lists, one a line.")
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the batch.")] = Path("adcbf.batch"),
    jobs: Annotated[
        int | None, typer.Option("--jobs", "-j", min=1, help="Logs at once; default: as many as cores.")
    ] = None,
    engine: Annotated[
        str,
        typer.Option(
            "--engine",
            metavar="processes|ray",
            help="Processes here, or a Ray cluster (adcbf[ray]).",
            autocompletion=completing.one_of("processes", "ray"),
        ),
    ] = "processes",
    address: Annotated[
        str | None,
        typer.Option("--address", metavar="HOST:PORT", help="Ray cluster; default: RAY_ADDRESS, else one of its own."),
    ] = None,
    json_output: Annotated[bool, typer.Option("--json", help="Print one JSON document, not a line a log.")] = False,
) -> None:
    """Run a command on many logs, and gather what came of it.

    What stands behind `--` is run on each log: `run`, if nothing else is named, or cluster, track, predict, evaluate,
    plan, replay, with its options. In these, {log}, {dir}, {stem} and {name} stand for the log's path, its folder, its
    file name without suffix, and its name in the batch.

    A log that fails does not stop the others. The same command goes on where it was stopped: finished logs are not
    repeated, failed ones are tried again.

    One JSON line a log goes to stdout and to `batch.jsonl`. `summary/` and `metrics/` are datasets in Parquet with a
    partition a log, run folders are in `runs/log=NAME/`.

    Exit codes: 1 if a log failed, else 4 if one missed a threshold, else 3 if of one a part was lost.

    Examples:

        adcbf batch logs/*.mcap

        adcbf batch 'logs/**/*.bag' --jobs 4 -o week12.batch -- --range 20 --truth '{dir}/{stem}.csv'

        find /data -name '*.mcap' | adcbf batch --from - -- replay -p all --seeds 0:10

        adcbf batch --from logs.txt --engine ray --address head:6379 -o /shared/logs.batch
    """
    from adcbf_cli.io.batch_tables import BatchTables
    from adcbf_cli.io.run_folder import RunFolder

    start = _engine(engine, address, jobs)
    tasks = _plan(logs or [], list_file, output, ctx.meta.get(_COMMAND, []))
    with RunFolder(output).locked():
        (output / JSON_LINES).unlink(missing_ok=True)
        _finish(BatchTables(output), _work(start, tasks, streamed=not json_output), json_output)


def _work(start: Callable[..., Finished], tasks: dict[str, LogTask], streamed: bool) -> _Results:
    """Every log's row; streamed: printed as they come."""
    from adcbf_cli.commands.batch_work import run_log
    from adcbf_cli.commands.run_progress import RunProgress

    finished = start(tasks, run_log)
    with closing(finished), RunProgress(len(tasks), "batch", "logs") as progress:
        # Now, with the bar begun, and before an engine keeps what it has to say away from stdout.
        results = _Results(tasks, sys.stdout if streamed else None)
        for name, answer in finished:
            progress.advance(failed=results.take(name, answer))
    return results


def _engine(name: str, address: str | None, jobs: int | None) -> Callable[..., Finished]:
    """What takes tasks and the work to do on each. UsageError where there is no such engine, or it is not installed."""
    from adcbf_cli.commands.batch_engines import load_ray, on_processes, on_ray

    if name == "ray":
        load_ray()
        return partial(on_ray, jobs=jobs, address=address)
    if name != "processes":
        raise UsageError(f"--engine {name!r}: must be one of processes, ray")
    if address is not None:
        raise UsageError("--address is of a Ray cluster, and needs --engine ray")
    return partial(on_processes, jobs=jobs)


def _plan(logs: Sequence[str], list_file: str | None, output: Path, words: Sequence[str]) -> dict[str, LogTask]:
    """Everything that can be wrong in what was asked is found before any work is done."""
    from adcbf_cli.commands.batch_work import LogTask, settings_in_environment, software
    from adcbf_cli.io.batch_logs import find_logs, resolved, unique_names
    from adcbf_cli.io.batch_tables import BatchTables
    from adcbf_cli.io.run_folder import MANIFEST, RunFolder

    if RunFolder.is_one(output):
        raise UsageError(f"{output}: is the run folder of a log; choose another with -o")
    found = find_logs(logs, list_file)
    for path in found:
        if os.path.isfile(path / MANIFEST):  # False too where the path is none at all
            raise UsageError(f"{path}: is a run folder; a batch is of logs")
    command = _command(words)
    before = {resolved(path): name for path, name in BatchTables(output).names().items()}
    environment, version, here = settings_in_environment(), software(), Path.cwd()
    tasks = {
        name: LogTask(name, str(log), str(output.resolve()), str(here), command, environment, version)
        for name, log in zip(unique_names(found, before), found, strict=True)
    }
    _check_options(next(iter(tasks.values())))
    return tasks


def _command(words: Sequence[str]) -> tuple[str, ...]:
    """The command for each log, and its options."""
    from adcbf_cli.commands.batch_work import COMMANDS
    from adcbf_cli.io.settings import nearest

    named = bool(words) and not words[0].startswith("-")
    name, options = (words[0], words[1:]) if named else ("run", words)
    if name not in COMMANDS:
        raise UsageError(f"{name}: no command that runs on each log ({', '.join(COMMANDS)}){nearest(name, COMMANDS)}")
    return name, *options


def _check_options(task: LogTask) -> None:
    """UsageError for options that no log can be worked on with, as far as they can be told from those of one."""
    from adcbf_cli.commands.batch_work import command_of
    from adcbf_cli.core.config import Config
    from adcbf_cli.io.settings import resolve_config

    name, *options = task.arguments()
    given = command_of(name).make_context(f"adcbf {name}", [*options, "--", task.log]).params
    if given["output"] is not None:
        raise UsageError("-o behind --: the batch chooses each log's run folder; give -o before --")
    own = set(task.arguments()) - set(task.command)
    if not any(word.endswith(str(given["config"])) for word in own):  # a file that is another for each log fails there
        resolve_config(Config(), given["config"], given["settings"] or ())


class _Results:
    """The logs' rows in the order of the tasks, written to `out` as soon as those before are there."""

    def __init__(self, tasks: dict[str, LogTask], out: TextIO | None) -> None:
        self._tasks = tasks
        self._out = out
        self._found: dict[str, Row] = {}
        self._printed = 0
        self.reused = 0

    def take(self, name: str, answer: Row) -> bool:
        """Keeps a worker's answer; whether the log failed."""
        from adcbf_cli.commands.batch_rows import FAILED
        from adcbf_cli.commands.batch_work import REUSED, keep_failure
        from adcbf_cli.commands.campaign import ERROR

        if REUSED in answer:
            self.reused += answer.pop(REUSED)
        else:
            answer = keep_failure(self._tasks[name], answer[ERROR])
        self._found[name] = answer
        if self._out is not None:
            self._print(self._out)
        return bool(answer["status"] == FAILED)

    def _print(self, out: TextIO) -> None:
        names = list(self._tasks)
        while self._printed < len(names) and names[self._printed] in self._found:
            print(_line(self._found[names[self._printed]]), file=out, flush=True)
            self._printed += 1

    def rows(self) -> list[Row]:
        return [self._found[name] for name in self._tasks]


def _line(row: Row) -> str:
    return json.dumps(row, allow_nan=False)


def _finish(tables: Any, results: _Results, as_json: bool) -> None:
    """batch.jsonl, what is out of date, the last line, the exit code."""
    from adcbf_cli.io.atomic import write_text_atomically

    rows = results.rows()
    gone = tables.remove_others(row["log"] for row in rows)
    if gone:
        what = "1 log" if len(gone) == 1 else f"{len(gone)} logs"
        more = " ..." if len(gone) > 1 else ""
        say(f"no longer in the tables, since not among these: {what} of an earlier batch: {gone[0]}{more}")
    write_text_atomically(tables.folder / JSON_LINES, "".join(_line(row) + "\n" for row in rows))
    counts = Counter(row["status"] for row in rows)
    if as_json:
        print_json({"folder": str(tables.folder), "counts": dict(sorted(counts.items())), "logs": rows})
    _say_failures(rows)
    say(_summary(tables.folder, rows, counts, results.reused))
    damaged = any(row["losses"] for row in rows)
    for bad, code in ((counts["failed"], EXIT_FAILED), (counts["missed"], EXIT_THRESHOLD), (damaged, EXIT_DATA_LOST)):
        if bad:
            raise typer.Exit(code)


def _say_failures(rows: list[Row]) -> None:
    for row in rows:
        if row["status"] == "failed":
            say(f"failed: {row['path']}: {row['error'].removeprefix(row['path']).lstrip(': ')}")


def _summary(folder: Path, rows: list[Row], counts: Counter[str], reused: int) -> str:
    told = ", ".join(
        f"{counts[status]} {status}" for status in ("done", "damaged", "missed", "failed") if counts[status]
    )
    before = f"; {reused} of them finished before" if reused else ""
    return f"{len(rows)} log{'' if len(rows) == 1 else 's'}: {told}{before}; {folder}"
