"""`adcbf track`: from a log, or a run folder with clusters, to obstacles followed through time."""

from __future__ import annotations

from typing import Annotated

import typer

from adcbf_cli.commands import completing
from adcbf_cli.commands.options import Shared, shared_options

Filter = Annotated[
    str | None,
    typer.Option(
        "--filter",
        metavar="NAME",
        help="ukf (default), ekf or kf.",
        autocompletion=completing.one_of("ukf", "ekf", "kf"),
    ),
]
Model = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help="Motion model: cv (default), ca, ct, or one of an installed package.",
        autocompletion=completing.motion_models,
    ),
]


@shared_options
def track(shared: Shared, filter_name: Filter = None, model: Model = None) -> None:
    """Follow obstacles from scan to scan.

    Each with its position, velocity, covariance, and whether it stands still.

    Writes `tracks.parquet`; clusters first, where they are not there yet.

    Examples:

        adcbf track log.mcap

        adcbf track log.adcbf --filter ekf

        adcbf track log.mcap --set tracking.max_coast_s=2
    """
    from adcbf_cli.commands.stages import plan_job, run_stages
    from adcbf_cli.commands.summary import finish
    from adcbf_cli.commands.viz import write_viz

    overrides = {"tracking.filter": filter_name, "tracking.model": model}
    outcome = run_stages(plan_job(shared, overrides), "track", shared.force)
    write_viz(outcome, shared.viz)
    finish(outcome, "track", shared.json_output)
