"""`adcbf plan`: what planners would have done from where the log's vehicle was, scan by scan."""

from __future__ import annotations

from adcbf_cli.commands.options import Driving, Shared, shared_options


@shared_options
def plan(shared: Shared, driving: Driving) -> None:
    """Plan at every scan, from the logged state.

    Open loop: the vehicle stays the log's own; each plan is compared with what it then did, and with where the
    obstacles really were.

    Writes `open_loop/` in the run folder: plans, their stages (barrier, gamma), times, `report.json`, `report.md`.
    Clusters, tracks and predictions first, where they are not there yet.

    Planners: mpc-dc, mpc-cbf, d-cbf-mpc, a-cbf-mpc, ad-cbf-mpc, od-ad-cbf-mpc, dwa, apf, pure-pursuit, and those of
    installed packages.

    Examples:

        adcbf plan log.mcap

        adcbf plan log.adcbf -p ad-cbf-mpc -p dwa --against dwa

        adcbf plan drive.bag --vehicle ackermann --set vehicle.max_speed_mps=3 --hard

        adcbf plan log.adcbf -p all --fail-on "plan.ad-cbf-mpc.infeasible_rate>0.05"
    """
    from adcbf_cli.commands.driving import run_open_loop

    run_open_loop(shared, driving)
