"""`adcbf run`: every stage in one pass, and the score."""

from __future__ import annotations

from adcbf_cli.commands.evaluate import FailOn, TruthOption, score_run
from adcbf_cli.commands.options import Shared, shared_options


@shared_options
def run(shared: Shared, truth: TruthOption = None, fail_on: FailOn = None) -> None:
    """Cluster, track, predict and evaluate.

    One pass over the log; every table, and the score.

    Examples:

        adcbf run log.mcap

        adcbf run log.mcap --range 20 --truth labels.csv -o out/log.adcbf

        adcbf run log.mcap --viz foxglove --viz rrd

        adcbf run log.bag --json --fail-on "later_seen.rmse_x_m>0.2" > result.json
    """
    score_run(shared, truth, fail_on or [], with_facts=True)
