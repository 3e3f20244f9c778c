"""Fig. 3: one turn of equation 11's circle in x and y over time - actual, tracked and predicted.

The predicted curve is the last step of each prediction (3 s ahead), drawn at the time that it is for.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from adcbf_cli.core.reproduction.circle import (
    BASE,
    CIRCLE,
    LIDAR,
    PERIOD_S,
    SETTINGS,
    Road,
    finite,
    positions,
    run_cases,
)
from adcbf_cli.core.reproduction.part import Document, Part, Row, table
from adcbf_cli.core.types import FloatArray


def tasks(seeds: Sequence[int]) -> dict[str, int]:
    """The first seed alone: the picture is of one run."""
    return {f"seed {seeds[0]}": seeds[0]}


def run(seed: int) -> Row:
    road = next(run_cases([BASE], {}, seed, PERIOD_S))
    return {"seed": seed} | series(road) | {"rmse_m": road.row()}


def series(road: Road) -> Row:
    """The run's curves: times in s, places (n, 2) in m."""
    now = np.array(road.seen_s)
    ahead = np.stack(road.ahead_m) if road.ahead_m else np.empty((0, 1, 2))
    later = now + road.step_s * ahead.shape[1]
    return {
        "tracked_s": _rounded(now),
        "tracked_m": _rounded(np.array(road.tracked_m).reshape(-1, 2)),
        "predicted_s": _rounded(later),
        "predicted_m": _rounded(ahead[:, -1]),
        "horizon_s": finite(road.step_s * ahead.shape[1]),
    }


def summarise(rows: Sequence[Row]) -> Document:
    row = rows[0]
    curves: dict[str, Any] = {}
    largest: dict[str, Any] = {}
    for name in ("tracked", "predicted"):
        time_s, place = np.array(row[f"{name}_s"]), np.array(row[f"{name}_m"]).reshape(-1, 2)
        error = place - positions(time_s)
        curves[name] = {"time_s": time_s.tolist(), "place_m": place.tolist(), "error_m": _rounded(error)}
        largest[name] = [finite(value) for value in np.abs(error).max(axis=0, initial=0.0)]
    actual_s = np.linspace(0.0, PERIOD_S + row["horizon_s"], 400)
    curves["actual"] = {"time_s": _rounded(actual_s), "place_m": _rounded(positions(actual_s))}
    return {
        "seed": row["seed"],
        "unit": "m",
        "horizon_s": row["horizon_s"],
        "rmse": {"tracked": row["rmse_m"]["tracking"], "predicted": row["rmse_m"]["step_30"]},
        "largest_error": largest,
        "drawn": curves,
    }


def markdown(document: Document) -> str:
    rows = [
        (f"{name}, {axis}", f"{document['rmse'][name][k]:.4f}", f"{document['largest_error'][name][k]:.4f}")
        for name in ("tracked", "predicted")
        for k, axis in enumerate("xy")
    ]
    return "\n\n".join(
        (
            f"Seed {document['seed']} of the runs of Table I. Predicted is the last of the 30 steps, "
            f"{document['horizon_s']:g} s ahead, at the time that it is for. The paper's figure shows the curves of "
            "one run without their errors; below each curve here are the differences from equation 11.",
            table(("m", "RMSE", "largest error"), rows),
        )
    )


def _rounded(values: FloatArray) -> list[Any]:
    """To a tenth of a millimetre, as JSON."""
    rounded: list[Any] = np.round(values, 4).tolist()
    return rounded


PART = Part(
    name="fig3",
    title="Fig. 3: actual, tracked and predicted motion",
    tasks=tasks,
    run=run,
    summarise=summarise,
    markdown=markdown,
    figure=True,
    settings={"circle": CIRCLE, "lidar": LIDAR, "settings": SETTINGS},
)
