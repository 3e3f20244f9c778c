"""A campaign as a command of its own: `python campaign_script.py FOLDER COUNT LASTS_S JOBS`, printing its rows.

Its signals are handled as the `adcbf` command handles them.
"""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

import typer

from adcbf_cli import app
from adcbf_cli.commands.campaign import run_campaign
from adcbf_cli.io.run_rows import RunRows
from tests.commands.campaign_work import jobs, run


def campaign(folder: Path, count: int, lasts_s: float, at_once: int) -> None:
    with RunRows(folder, "runs", "k") as rows:
        tasks = jobs(count, folder / "log", lasts_s=lasts_s)
        print(json.dumps(run_campaign(tasks, run, rows, at_once, "squares")))


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs begin without it
    app.app = typer.Typer()
    app.app.command()(campaign)
    sys.exit(app.main())
