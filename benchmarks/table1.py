"""The paper's Table I, and which choices move it.

The case and its measures are those of `adcbf reproduce table1` (adcbf_cli/core/reproduction/circle.py
describes them). An RMSE is taken over a run (one seed); shown are the mean over runs and the half width
of its 95 % t interval. With --vary, each further row changes one choice, and the others stay.

    python benchmarks/table1.py                    # the case itself, 20 seeds
    python benchmarks/table1.py --vary --seeds 5   # which choices move it
    python benchmarks/table1.py --only "model ct" --only base
    python benchmarks/table1.py --set tracking.model=ct --seeds 5 --first-seed 100
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

from adcbf_cli.core.reproduction.circle import (  # noqa: E402 - after the thread counts
    BASE,
    MEASURES,
    PERIOD_S,
    Case,
    run_cases,
    straight_ahead,
)
from adcbf_cli.core.reproduction.part import Row  # noqa: E402
from adcbf_cli.core.reproduction.table1 import PAPER, interval_cell, mean_rmse  # noqa: E402

ROUGH: dict[str, Any] = {"kind": "bumps", "size_m": 50, "amplitude_m": 0.15, "wavelength_m": 3.0, "slope_deg": 4.0}

VARIANTS = (
    BASE,
    Case("filter ekf", settings={"tracking.filter": "ekf"}),
    Case("filter kf", settings={"tracking.filter": "kf"}),
    Case("model ca", settings={"tracking.model": "ca"}),
    Case("model ct", settings={"tracking.model": "ct"}),
    Case("one noise level, 1 m/s^2", settings={"tracking.cruise_ratio": 1.0}),
    Case("noise as configured, not adapted", settings={"tracking.adaptive_noise": False}),
    Case("centre: rectangle", settings={"perception.centre": "box"}),
    Case("centre: mean of points", settings={"perception.centre": "mean"}),
    Case("centre: always a circle", settings={"perception.centre": "circle"}),
    Case("clusterer dbscan", settings={"perception.clusterer": "dbscan"}),
    Case("no outlier removal", settings={"perception.smoothing": False}),
    Case("range noise 0.005 m", lidar={"range_sigma_m": 0.005}),
    Case("range noise 0.05 m", lidar={"range_sigma_m": 0.05}),
    Case("32 channels", lidar={"channels": 32}),
    Case("azimuth step 0.4 deg", lidar={"azimuth_step_deg": 0.4}),
    Case("rough ground, 4 deg slope", terrain=ROUGH),
    Case("spinning, stamp at its start", lidar={"instantaneous": False}),
)


def markdown(results: dict[str, dict[str, Any]], seeds: range) -> str:
    """The results as a table, metres, x / y."""
    head = ("variant", "centre", "tracking", "prediction", "prediction, step 30", "tracked", "ids")
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    tracking, prediction = (" / ".join(f"{value:.3f}" for value in PAPER[key]) for key in ("tracking", "prediction"))
    lines.append(f"| paper's Table I | | {tracking} | {prediction} | | | |")
    all_steps, last = straight_ahead()
    lines.append(
        f"| exact state, straight ahead | | | {all_steps[0]:.4f} / {all_steps[1]:.4f} | "
        f"{last[0]:.4f} / {last[1]:.4f} | | |"
    )
    for name, result in results.items():
        cells = [" / ".join(interval_cell(result[measure][axis]) for axis in "xy") for measure in MEASURES]
        share = f"{100 * result['tracked_share']:.1f} %"
        lines.append(f"| {name} | {' | '.join(cells)} | {share} | {result['identities']:.2f} |")
    lines.append("")
    lines.append(f"RMSE in m, x / y: mean over seeds {seeds[0]} to {seeds[-1]}, and half of its 95 % interval.")
    return "\n".join(lines)


def parse_arguments(arguments: Sequence[str] | None) -> argparse.Namespace:
    summary, _, rest = (__doc__ or "").partition("\n\n")
    parser = argparse.ArgumentParser(
        description=summary, epilog=rest, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20, metavar="N", help="runs of each variant (default 20)")
    parser.add_argument("--first-seed", type=int, default=0, metavar="N", help="seeds count from here (default 0)")
    parser.add_argument("--duration", type=float, default=PERIOD_S, metavar="S", help="default: one turn, 66.7 s")
    parser.add_argument("--vary", action="store_true", help="all variants, not the base case alone")
    parser.add_argument("--only", action="append", metavar="NAME", help="this variant; repeatable")
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.KEY=VALUE", help="a setting for all")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all runs' values here")
    parsed = parser.parse_args(arguments)
    if parsed.seeds < 1:
        parser.error("--seeds must be at least 1")
    names = {variant.name for variant in VARIANTS}
    unknown = sorted(set(parsed.only or ()) - names)
    if unknown:
        parser.error(f"no variant {unknown[0]!r}; there are: {', '.join(sorted(names))}")
    if any("=" not in item or "." not in item.split("=")[0] for item in parsed.set):
        parser.error("--set takes STAGE.KEY=VALUE")
    return parsed


def main(arguments: Sequence[str] | None = None) -> None:
    import yaml

    chosen = parse_arguments(arguments)
    wanted = chosen.only or (None if chosen.vary else ["base"])
    variants = [variant for variant in VARIANTS if wanted is None or variant.name in wanted]
    extra = {key: yaml.safe_load(value) for key, value in (item.split("=", 1) for item in chosen.set)}
    runs: dict[str, list[Row]] = {variant.name: [] for variant in variants}
    seeds = range(chosen.first_seed, chosen.first_seed + chosen.seeds)
    for seed in seeds:
        for variant, road in zip(variants, run_cases(variants, extra, seed, chosen.duration), strict=True):
            runs[variant.name].append(road.row())
        print(f"seed {seed} done", file=sys.stderr)
    results = {name: mean_rmse(found) for name, found in runs.items()}
    print(markdown(results, seeds))
    if chosen.json is not None:
        document = {"seeds": list(seeds), "duration_s": chosen.duration, "settings": extra, "results": results}
        chosen.json.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
