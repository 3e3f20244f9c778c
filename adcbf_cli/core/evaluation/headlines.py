"""The metrics most looked at: what fits a screen. Reports hold all of them."""

from __future__ import annotations

import re

from adcbf_cli.core.evaluation.comparison_text import HEADLINE

_WITH_TRUTH = re.compile(
    r"clustering\.(rmse_m|bias_along_m|bias_across_m)"
    r"|tracking\.(rmse_x_m|rmse_y_m|rmse_sight_corrected_m|rmse_body_corrected_m|nees|coverage_95)"
    r"|prediction\.(rmse_x_m|rmse_y_m|rmse_still_x_m|rmse_still_y_m|[af]de_m\..*)"
    r"|prediction\.(coverage_95|coverage_conformal_radius)"
    r"|detection\.(recall.*|track_recall|moving_precision)"
    r"|clear\.(mota|motp_m|misses|false_positives|switches)|hota\.hota"
    r"|clusters\.per_frame|tracks\.(confirmed|life_s\.median|static_share)"
)
_WITHOUT_TRUTH = re.compile(
    r"later_seen\.(moving\.)?(rmse_x_m|rmse_y_m|fde_m\..*|coverage_95|coverage_conformal_radius)"
    r"|clusters\.per_frame|tracks\.(created|confirmed|life_s.*|static_share|coasting_share|speed_mps.*)"
)


def is_headline(name: str, with_truth: bool) -> bool:
    """Whether an evaluation's metric is shown on a screen, with ground truth or without."""
    return (_WITH_TRUTH if with_truth else _WITHOUT_TRUTH).fullmatch(name) is not None


def is_driving_headline(name: str) -> bool:
    """The same for a planner's metric, `replay.<planner>.<metric>` or `plan.<planner>.<metric>`."""
    kind, _, rest = name.partition(".")
    return kind in HEADLINE and rest.rpartition(".")[2] in HEADLINE[kind]
