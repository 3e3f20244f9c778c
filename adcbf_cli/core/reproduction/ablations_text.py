"""The ablations as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from adcbf_cli.core.reproduction.drives import mean_cell, number_cell, rate_cell
from adcbf_cli.core.reproduction.part import Document, seed_text, table

ENDS = ("collision", "collision_despite_way", "timeout", "freeze")
MEANS = {"min_dist_m": ("Min-dist, m", 2), "nav_time_s": ("Nav-time, s", 1)}


def markdown(document: Document) -> str:
    blocks = [_what(document)]
    for group in document["groups"]:
        blocks += [f"## {group['title']}", group["note"], _ends(group["variants"]), _differences(group["variants"])]
    blocks += ["## The movers' speed", _speed_note(document["speeds"]), _speeds(document["speeds"])]
    return "\n\n".join(blocks)


def _what(document: Document) -> str:
    n = len(document["seeds"])
    zero = 100 * 3.84 / (n + 3.84)
    return (
        f"{document['runs']} runs in closed loop over the scene `{document['scene']}` of this package: nine to ten "
        "metres to go, up to six things that stand and one to five movers that keep their course. Each variant drives "
        f"{seed_text(document['seeds'])}; one thing is changed at a time, everything else is the package's default. "
        "Unless it says perception, a planner knows everything within range as it is, with its true future. Rates: "
        "events of runs, per cent and 95 % score interval; means with 95 % bootstrap intervals; differences are to the "
        "first line's variant (where there are planners, to the same planner's line above), scene by scene, rates in "
        f"points of a hundred. These are few runs: of {n}, none may still mean up to {zero:.0f} per cent, and a "
        "difference whose interval contains 0 says nothing about its sign. Of so many differences one in twenty is "
        "expected to miss 0 by chance."
    )


def _ends(variants: Sequence[Mapping[str, Any]]) -> str:
    """How each variant's runs ended."""
    rows = []
    for one in variants:
        here = one["here"]
        cells = ["-"] * (len(ENDS) + len(MEANS))
        if here is not None:
            cells = [rate_cell(here[end]) for end in ENDS]
            cells += [mean_cell(here[name], digits) for name, (_, digits) in MEANS.items()]
        rows.append((one["label"], str(one["n"]), *cells))
    head = ("", "n", "collision", "collision though a way exists", "timeout", "freeze")
    return table((*head, *(title for title, _ in MEANS.values())), rows)


def _differences(variants: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for one in variants:
        found = one["differences"]
        if found is not None:
            cells = [_cell(found[end], 0, 100.0) for end in ("success", "collision")]
            cells += [_cell(found[name], digits) for name, (_, digits) in MEANS.items()]
            rows.append((one["label"], *cells))
    head = ("difference", "success, points", "collision, points", *(title for title, _ in MEANS.values()))
    return table(head, rows)


def _cell(found: Mapping[str, Any], digits: int, scale: float = 1.0) -> str:
    if found["value"] is None:
        return "-"
    return f"{number_cell(found['value'], found['interval_95'], digits, scale)} (n = {found['n_pairs']})"


def _speeds(speeds: Mapping[str, Any]) -> str:
    """Collisions of each planner at each speed."""
    points = next(iter(speeds.values()))["points"]
    head = ("collision, movers at", *(f"{point['speed_mps']:g} m/s" for point in points), "first", "breaks")
    rows = []
    for planner, found in speeds.items():
        cells = ["-" if p["here"] is None else rate_cell(p["here"]["collision"]) for p in found["points"]]
        rows.append((f"`{planner}`", *cells, _at(found["first_collision_mps"]), _at(found["breaks_mps"])))
    return table(head, rows)


def _at(speed_mps: float | None) -> str:
    return "never" if speed_mps is None else f"{speed_mps:g}"


def _speed_note(speeds: Mapping[str, Any]) -> str:
    points = next(iter(speeds.values()))["points"]
    return (
        "All movers of a scene at one speed; what else is drawn stays the same, but for the places that the speed "
        "itself decides. Perfect knowledge. The vehicle's top speed is 1 m/s, and movers come from all sides: it "
        "cannot get away from a faster one behind it. `first` is the lowest of these speeds (m/s) with a collision at "
        "all, `breaks` the lowest with more collisions than half of the runs; never: not up to "
        f"{points[-1]['speed_mps']:g} m/s. {_with_a_way(speeds)}"
    )


def _with_a_way(speeds: Mapping[str, Any]) -> str:
    """How many of the collisions came although the scene can be driven through."""
    here = [point["here"] for found in speeds.values() for point in found["points"] if point["here"] is not None]
    total, despite = (sum(_events(one[name]) for one in here) for name in ("collision", "collision_despite_way"))
    return f"In {despite} of the {total} collisions a way through the scene is known to exist."


def _events(found: Mapping[str, Any]) -> int:
    return round(float(found["value"] or 0.0) * int(found["n"]))
