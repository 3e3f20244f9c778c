"""One log of a batch: runs an `adcbf` command on it, and keeps what came of it. Worker processes import this."""

from __future__ import annotations

import hashlib
import importlib
import io
import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import typer

from adcbf_cli.commands.batch_rows import FAILED, STATUS, Row, plain_row, read_results, storable
from adcbf_cli.core.errors import EXIT_FAILED, EXIT_OK, EXIT_USAGE, AdcbfError

COMMANDS = ("run", "cluster", "track", "predict", "evaluate", "plan", "replay")
"""What takes a log and writes a run folder."""

REUSED = "reused"
"""In a worker's answer: whether the log was finished already."""

_WRITTEN = ("output", "save_calibration")
"""Options that name what a command writes. All other files that options name are read."""


@dataclass(frozen=True)
class LogTask:
    """What a worker needs to know. batch, directory: absolute; the second is what relative paths start from.

    command: its name and options, with {log}, {dir}, {stem} and {name} where the log's own are to stand.
    environment: the settings in the environment. software: what the process that gives the task runs.
    """

    name: str
    log: str
    batch: str
    directory: str
    command: tuple[str, ...]
    environment: tuple[tuple[str, str], ...]
    software: str

    def arguments(self) -> list[str]:
        """The command's name and its options for this log."""
        log = Path(self.log)
        stem = log.name if log.is_dir() else log.stem
        values = {"{log}": self.log, "{dir}": str(log.parent), "{stem}": stem, "{name}": self.name}
        return [_filled(word, values) for word in self.command]


def _filled(word: str, values: dict[str, str]) -> str:
    for mark, value in values.items():
        word = word.replace(mark, value)
    return word


def command_of(name: str) -> Any:
    """The command that parses and runs `adcbf NAME`."""
    module = importlib.import_module(f"adcbf_cli.commands.{name}")
    single = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)
    single.command(name)(getattr(module, name))
    return typer.main.get_command(single)


def settings_in_environment() -> tuple[tuple[str, str], ...]:
    """The variables that settings are read from."""
    return tuple(sorted((n, v) for n, v in os.environ.items() if n.startswith("ADCBF_") and "__" in n))


@cache
def software() -> str:
    """The versions of adcbf and of all plugins that are installed, down to their sources."""
    from adcbf_cli.core.plugins import Kind, plugins
    from adcbf_cli.io.plugin_versions import plugin_version
    from adcbf_cli.io.run_folder import code_version

    others = {plugin_version(plugin) for kind in Kind for plugin in plugins(kind)}
    return ", ".join([f"adcbf {code_version()}", *sorted(others)])


def run_log(task: LogTask) -> Row:
    """The log's row, and under `REUSED` whether it was there already. Whatever is wrong with the log is in the row."""
    from adcbf_cli.io.batch_tables import BatchTables

    if task.software != software():
        raise AdcbfError(f"this batch was started with {task.software}, but on its turn there was {software()}")
    _take_over(task)
    tables = BatchTables(Path(task.batch))
    try:
        source_sha256, key = _key(task)
    except AdcbfError as error:
        return {REUSED: False, **keep_failure(task, str(error), error.exit_code)}
    except OSError as error:
        return {REUSED: False, **keep_failure(task, _in_words(error))}
    found = tables.finished(task.name, key)
    if found is not None:
        return {REUSED: True, **found}
    code, error_line = _run_command([*task.arguments(), "-o", str(tables.run_folder(task.name)), "--", task.log])
    if code not in STATUS:
        return {REUSED: False, **keep_failure(task, error_line, code, source_sha256)}
    return {REUSED: False, **_keep_results(task, code, key)}


def keep_failure(task: LogTask, error: str, code: int = EXIT_FAILED, source_sha256: str | None = None) -> Row:
    """Writes down that the log failed, and why; the next batch tries it again."""
    from adcbf_cli.io.batch_tables import BatchTables

    row = _row(task, FAILED, code) | {"error": storable(error), "source_sha256": source_sha256}
    return BatchTables(Path(task.batch)).write(task.name, _place(task), None, row, {}, set())


def _keep_results(task: LogTask, code: int, key: str) -> Row:
    from adcbf_cli.io.batch_tables import BatchTables

    tables = BatchTables(Path(task.batch))
    folder = tables.run_folder(task.name)
    _say_where_the_log_is(task, folder)
    results = read_results(folder, task.command[0])
    own = {"run_folder": folder.relative_to(task.batch).as_posix()}
    row = _row(task, STATUS[code], code) | own | results.columns
    return tables.write(task.name, _place(task), key, row, results.metrics, results.headlines)


def _row(task: LogTask, status: str, code: int) -> Row:
    return plain_row(task.log, " ".join(task.command), status, code)


def _place(task: LogTask) -> str:
    """The log's path from the batch's folder: both may be moved together."""
    return os.path.relpath(os.path.join(task.directory, task.log), task.batch)


def _say_where_the_log_is(task: LogTask, folder: Path) -> None:
    """In the manifest, which is not written anew where every stage could be reused: the log may have been moved."""
    from adcbf_cli.io.run_folder import RunFolder

    manifest = RunFolder(folder).manifest()
    now = replace(manifest, source=replace(manifest.source, path=os.path.relpath(task.log, folder)))
    if now != manifest:
        RunFolder(folder).write_manifest(now)


def _take_over(task: LogTask) -> None:
    """Makes this process' surroundings those that the batch was started in: a worker may run on another machine."""
    for name, _ in settings_in_environment():
        del os.environ[name]
    os.environ.update(task.environment)
    os.chdir(task.directory)


def _key(task: LogTask) -> tuple[str, str]:
    """The log's hash, and one over all that its results depend on: the log and where it is, the command, the files
    that it names, the settings in the environment, the code. AdcbfError where there is no log."""
    from adcbf_cli.io.logs import log_files
    from adcbf_cli.io.run_folder import identify_source

    source = identify_source(task.log, log_files(Path(task.log)))
    files = [_digest(file) for file in _files_read(task)]
    parts = [source.sha256, task.log, _place(task), task.command, files, task.environment, task.software]
    return source.sha256, hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _files_read(task: LogTask) -> Iterator[Path]:
    """The files that the command's options name, however they are spelled, and the calibration of KITTI labels."""
    name, *options = task.arguments()
    # What cannot be parsed is left out, and fails when the command is run.
    given = command_of(name).make_context(name, [*options, "--", task.log], resilient_parsing=True).params
    for option, value in sorted(given.items()):
        values = value if isinstance(value, list | tuple) else (value,)
        named = () if option in ("source", *_WRITTEN) else (v for v in values if isinstance(v, str | Path))
        for file in (Path(text) for text in named if os.path.isfile(text)):
            yield file
            beside = file.resolve().parent.parent / "calib" / file.name
            if beside.is_file():
                yield beside


def _digest(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _run_command(arguments: Sequence[str]) -> tuple[int, str]:
    """The command's exit code, as a shell would have it, and its error in one line. What it prints is dropped."""
    command = command_of(arguments[0])
    errors = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(errors):
        code, error = _exit_of(lambda: command.main(list(arguments[1:]), prog_name=f"adcbf {arguments[0]}"))
    said = [line for line in errors.getvalue().splitlines() if line.strip()]
    return code, error or (said[-1] if code and said else "")


def _exit_of(run: Callable[[], Any]) -> tuple[int, str]:
    from adcbf_cli.commands.campaign import in_one_line

    try:
        run()
    except AdcbfError as error:
        return error.exit_code, str(error)
    except SystemExit as stop:
        return _code(stop), ""
    except OSError as error:
        return EXIT_FAILED, _in_words(error)
    except Exception as error:
        stopped = error.__cause__ or error.__context__
        if isinstance(stopped, SystemExit):  # a signal that arrived inside compiled code comes out wrapped
            raise stopped from None
        return EXIT_FAILED, in_one_line(error)
    return EXIT_OK, ""


def _in_words(error: OSError) -> str:
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"


def _code(stop: SystemExit) -> int:
    """The exit code; SystemExit again where a signal told this process to leave."""
    code = stop.code if isinstance(stop.code, int) else EXIT_FAILED * (stop.code is not None)
    if code > 128:
        raise stop
    return code if code in (*STATUS, EXIT_USAGE) else EXIT_FAILED
