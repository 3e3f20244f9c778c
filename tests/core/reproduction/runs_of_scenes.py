"""Rows as runs through scenes give them, with made-up numbers."""

from __future__ import annotations

from typing import Any


def a_run(planner: str, seed: int, result: str = "success", **metrics: float | None) -> dict[str, Any]:
    """A finished run; a collision is an avoidable one with a person."""
    known: dict[str, float | None] = dict.fromkeys(
        ("nav_time_s", "path_length_m", "min_dist_m", "ref_time_s", "vel_var")
    )
    known |= {"freezing_s": 0.0, "relaxed_rate": 0.0, "braked_rate": 0.0, "stopped_rate": 0.0}
    collision = None
    if result == "collision":
        collision = {"object_id": 0, "kind": "person", "moving": True, "at_s": 9.0, "speed_mps": 0.7}
        collision |= {"known_since_s": 4.0, "avoidable": True, "avoidable_until_s": 8.0}
    return {
        "seed": seed,
        "planner": planner,
        "knowledge": "perception",
        "result": result,
        "duration_s": 10.0,
        "metrics": known | metrics,
        "scene": {"movers": 6, "fastest_mps": 0.7, "standing": 19, "bumps_m": 0.1, "slope_deg": 1.0},
        "collision": collision,
        "escape_exists": None if result == "success" else True,
        "path": [[0.0, 0.0], [1.0, 0.5]],
        "log": None,
        "counters": {},
    }
