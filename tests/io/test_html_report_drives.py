"""What a page keeps of drives, and what is lost in thinning."""

from __future__ import annotations

import numpy as np

from adcbf_cli.io.html_report.drives import SHARES, Detail, _chosen_seeds, _Driven, _encoded


def test_the_distribution_of_solve_times_is_of_all_ticks() -> None:
    """Of 6,000 ticks about 1,500 are drawn, the slowest of each span among them: their median is no median."""
    rng = np.random.default_rng(4)
    count = 6000
    solve_ms = rng.lognormal(1.5, 0.4, count)
    ticks = {name: np.zeros(count) for name in ("x_m", "y_m", "yaw_rad")}
    ticks |= {"timestamp_ns": np.arange(count) * 33_000_000, "clearance_m": rng.random(count)}
    driven = _Driven(ticks, {"solve_ms": solve_ms}, [], None)
    encoded = _encoded(driven, 0, np.zeros(2), Detail())
    shares = encoded["solve_shares"]
    assert len(encoded["solve_us"]) < 2000
    assert len(shares["us"]) == len(shares["share_e4"]) <= SHARES
    for quantile in (0.1, 0.5, 0.9, 0.99):
        shown = np.interp(quantile, np.array(shares["share_e4"]) / 1e4, np.array(shares["us"]) / 1e3)
        assert abs(np.mean(solve_ms <= shown) - quantile) < 0.006
    assert shares["us"][-1] == round(solve_ms.max() * 1000)
    assert shares["share_e4"][-1] == 10_000


def test_the_seed_whose_plans_are_stored_is_shown_first() -> None:
    entries = [{"planner": name, "seed": seed, "result": "success"} for name in ("a", "b") for seed in (7, 3, 5)]
    assert _chosen_seeds(entries, most=24) == [7, 3, 5]
    assert _chosen_seeds(entries, most=2) == [7]
    entries[2]["result"] = "collision"
    assert _chosen_seeds(entries, most=4) == [7, 5]
