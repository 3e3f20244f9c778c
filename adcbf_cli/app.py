"""The `adcbf` command: its subcommands, and how errors become one line and an exit code.

Command modules import nothing heavy at their top, so that `adcbf --help` answers at once.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Annotated

import typer

import adcbf_cli
from adcbf_cli.commands import (
    batch,
    cluster,
    compare,
    completion,
    config,
    doctor,
    evaluate,
    info,
    plan,
    predict,
    replay,
    report,
    reproduce,
    run,
    simulate,
    track,
)
from adcbf_cli.core.errors import EXIT_FAILED, AdcbfError

EXIT_INTERRUPTED = 128 + signal.SIGINT

app = typer.Typer(
    name="adcbf",
    no_args_is_help=True,
    add_completion=False,  # `adcbf completion` has scripts of its own
    rich_markup_mode=None,  # rich would double the time that --help takes
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="""Recorded robot logs in, answers out: what the LiDAR saw, where it was going, and whether a planner would
have kept clear of it.

A log is an MCAP file, a ROS 1 bag, a rosbag2 folder, a folder of PCD scans, or a CSV of objects. Results go to a run
folder of Parquet tables; numbers go to stdout, everything else to stderr.

Exit codes: 0 done, 1 failed, 2 wrong usage, 3 done but part of the input was lost, 4 done but a
threshold was missed.""",
)

for module in (info, run, cluster, track, predict, evaluate, compare, plan, replay, report, simulate, reproduce):
    app.command(module.__name__.rpartition(".")[2])(getattr(module, module.__name__.rpartition(".")[2]))
app.command("batch", cls=batch.CommandAfterDashes)(batch.batch)
app.add_typer(config.app, name="config")
app.command("doctor")(doctor.doctor)
app.command("completion")(completion.completion)


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"adcbf {adcbf_cli.__version__}")
        raise typer.Exit


@app.callback()
def _global_options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


def _terminate(signal_number: int, _frame: object) -> None:
    """Leaves by way of every `with` and `finally`, so that no temporary file stays."""
    sys.exit(128 + signal_number)


def main() -> None:
    """The console entry point."""
    signal.signal(signal.SIGTERM, _terminate)
    if "_ADCBF_COMPLETE" in os.environ:  # a completion script asks
        from typer.completion import get_completion_inspect_parameters

        from adcbf_cli.commands.completing import LINE, behind_dashes

        get_completion_inspect_parameters()  # is what registers the shells' ways to ask
        os.environ[LINE] = behind_dashes(os.environ.get(LINE, ""))
    try:
        app(prog_name="adcbf")
    except AdcbfError as error:
        print(f"adcbf: error: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except SystemError as error:
        # A signal that arrives inside compiled code comes out wrapped.
        stop = error.__cause__ or error.__context__
        if isinstance(stop, SystemExit | KeyboardInterrupt):
            sys.exit(stop.code if isinstance(stop, SystemExit) else EXIT_INTERRUPTED)
        raise
    except BrokenPipeError:
        # The reader of our output (head, less) has gone: nothing is wrong, and nobody listens.
        sys.stderr.close()
        sys.exit(EXIT_FAILED)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        print(f"adcbf: error: {where}{error.strerror or error}", file=sys.stderr)
        sys.exit(EXIT_FAILED)


if __name__ == "__main__":
    main()
