"""`adcbf replay`: planners drive through the recorded world."""

from __future__ import annotations

from typing import Annotated

import typer

from adcbf_cli.commands.options import Driving, Shared, shared_options

Start = Annotated[
    str | None, typer.Option("--start", metavar="X,Y[,YAW]", help="Start here (m, rad, world), instead of the log's.")
]
Seeds = Annotated[
    str, typer.Option("--seeds", metavar="A:B|N,...", help="Seed 0 is the log's own start; others are displaced.")
]


@shared_options
def replay(shared: Shared, driving: Driving, start: Start = None, seeds: Seeds = "0") -> None:
    """Drive planners through the recorded world.

    Closed loop: the vehicle model drives itself, at 30 Hz, and knows only what the tracker had seen by then, within
    range. The recorded obstacles move as they did and do not react: results are counterfactual, and say from when on
    the vehicle was so far from the log's that its sensor would have seen something else.

    Writes `replay/` in the run folder: trajectories, plans, their stages, times, `report.json`, `report.md`.

    Examples:

        adcbf replay log.mcap --range 12 --truth truth.csv

        adcbf replay log.adcbf -p all --seeds 0:20

        adcbf replay people.csv --start 0,0 --goal 12,5 --speed 1 -p ad-cbf-mpc -p dwa

        adcbf replay log.adcbf --viz ros2

        adcbf replay log.adcbf --fail-on "replay.ad-cbf-mpc.collision>0"
    """
    from adcbf_cli.commands.driving import run_replay

    run_replay(shared, driving, start, seeds)
