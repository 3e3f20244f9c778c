"""`adcbf run`: every stage in one pass, and the score."""

from __future__ import annotations

from adcbf_cli.commands.options import Shared, shared_options


@shared_options
def run(shared: Shared) -> None:
    """Cluster, track and predict in one pass, then evaluate."""
