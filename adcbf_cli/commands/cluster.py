"""`adcbf cluster`: from a log to the obstacles in each scan."""

from __future__ import annotations

from typing import Annotated

import typer

from adcbf_cli.commands import completing
from adcbf_cli.commands.options import Shared, shared_options


@shared_options
def cluster(
    shared: Shared,
    clusterer: Annotated[
        str | None,
        typer.Option(
            "--clusterer",
            metavar="NAME",
            help="hdbscan (default), dbscan, or one of an installed package.",
            autocompletion=completing.clusterers,
        ),
    ] = None,
    labels: Annotated[
        bool | None, typer.Option("--labels/--no-labels", help="Also write each point's cluster (table `points`).")
    ] = None,
) -> None:
    """Find the obstacles in each scan.

    Each with its centre, radius, height, extent, point count and membership probability.

    Writes `frames.parquet` and `clusters.parquet` to the run folder.

    Examples:

        adcbf cluster log.mcap

        adcbf cluster drive.bag --lidar /points --range 20 -o out/drive.adcbf

        adcbf cluster bag_folder/ --clusterer dbscan --labels
    """
    from adcbf_cli.commands.stages import plan_job, run_stages
    from adcbf_cli.commands.summary import finish
    from adcbf_cli.commands.viz import write_viz

    overrides = {"perception.clusterer": clusterer, "perception.point_labels": labels}
    outcome = run_stages(plan_job(shared, overrides), "cluster", shared.force)
    write_viz(outcome, shared.viz)
    finish(outcome, "cluster", shared.json_output)
