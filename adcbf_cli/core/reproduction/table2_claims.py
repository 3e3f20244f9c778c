"""What section 4.1 and Table II claim of the five planners, as differences that runs can decide."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from adcbf_cli.core.evaluation.comparison import Difference
from adcbf_cli.core.reproduction.drives import OURS, number_cell
from adcbf_cli.core.reproduction.part import table

MEASURES = {
    "nav_time_s": ("Nav-time, s", 2),
    "min_dist_m": ("Min-dist, m", 2),
    "ref_time_s": ("Ref-time, s", 3),
    "vel_var": ("Vel-var, m2/s2", 4),
    "path_length_m": ("Path-len, m", 3),
}
"""The table's columns, and the decimals with which it writes them."""


def _printed_row(*values: float | None, collision: bool = False) -> dict[str, float | None]:
    return dict(zip(MEASURES, values, strict=True)) | {"collision": float(collision)}


PAPER = {
    "mpc-dc": _printed_row(None, 0.00, 0.938, None, None, collision=True),
    "mpc-cbf": _printed_row(49.90, 0.53, 0.370, 0.1257, 38.525),
    "d-cbf-mpc": _printed_row(48.41, 0.83, 0.357, 0.0172, 37.155),
    "a-cbf-mpc": _printed_row(49.23, 0.57, 0.433, 0.0331, 37.131),
    OURS: _printed_row(47.23, 0.94, 0.345, 0.0101, 36.728),
}
"""Table II, and from the text which run collided. None: the table has a dash."""

HOLDS, NOT, OPEN = "holds", "does not hold", "cannot be told"


@dataclass(frozen=True)
class Claim:
    """That `planner` has less (`sign` -1) or more (+1) of a measure than each of `others`."""

    text: str
    planner: str
    measure: str
    sign: int
    others: tuple[str, ...]


_ARRIVED = ("mpc-cbf", "d-cbf-mpc", "a-cbf-mpc")
"""The baselines that have all five values in Table II."""

CLAIMS = (
    Claim("MPC-DC collides, the others do not", "mpc-dc", "collision", +1, (*_ARRIVED, OURS)),
    Claim("AD-CBF-MPC keeps the largest minimum distance", OURS, "min_dist_m", +1, ("mpc-dc", *_ARRIVED)),
    Claim("AD-CBF-MPC reacts soonest", OURS, "ref_time_s", -1, ("mpc-dc", *_ARRIVED)),
    Claim("AD-CBF-MPC has the least variance of speed", OURS, "vel_var", -1, _ARRIVED),
    Claim("AD-CBF-MPC has the shortest path", OURS, "path_length_m", -1, _ARRIVED),
    Claim("AD-CBF-MPC is the fastest (Table II)", OURS, "nav_time_s", -1, _ARRIVED),
    Claim("D-CBF-MPC is the fastest (the text)", "d-cbf-mpc", "nav_time_s", -1, ("mpc-cbf", "a-cbf-mpc", OURS)),
    Claim("Prediction makes room: D-CBF over MPC-CBF", "d-cbf-mpc", "min_dist_m", +1, ("mpc-cbf",)),
    Claim("Prediction calms the speed: D-CBF over MPC-CBF", "d-cbf-mpc", "vel_var", -1, ("mpc-cbf",)),
    Claim("Adaptive gamma is faster: A-CBF over MPC-CBF", "a-cbf-mpc", "nav_time_s", -1, ("mpc-cbf",)),
    Claim("Adaptive gamma calms the speed: A-CBF over MPC-CBF", "a-cbf-mpc", "vel_var", -1, ("mpc-cbf",)),
)


def verdict(sign: int, interval: tuple[float, float] | None) -> str:
    """HOLDS where the whole interval of the difference has this sign, NOT where it has the other, else OPEN."""
    if interval is None:
        return OPEN
    low, high = (end * sign for end in interval)
    return HOLDS if min(low, high) > 0 else NOT if max(low, high) < 0 else OPEN


def judge(difference: Callable[[str, str, str], Difference | None]) -> list[dict[str, Any]]:
    """Every claim against every planner that it speaks of.

    difference: of a planner, another one and a measure: the first one's minus the second's over the seeds of both;
    None where one of them has no run.
    """
    judged = []
    for claim in CLAIMS:
        for other in claim.others:
            found = difference(claim.planner, other, claim.measure)
            judged.append(
                {
                    "claim": claim.text,
                    "planner": claim.planner,
                    "other": other,
                    "measure": claim.measure,
                    "claimed": "less" if claim.sign < 0 else "more",
                    "paper": _printed(claim, other),
                    "here": None if found is None else found.to_dict(),
                    "verdict": OPEN if found is None else verdict(claim.sign, found.interval),
                }
            )
    return judged


def _printed(claim: Claim, other: str) -> float | None:
    """The paper's difference, where it prints both values."""
    mine, others = (PAPER[planner].get(claim.measure) for planner in (claim.planner, other))
    return None if mine is None or others is None else round(mine - others, 4)


def in_all(verdicts: Sequence[str]) -> str:
    """A claim's verdict over all planners that it speaks of: it holds where it holds against each, and does not
    where it does not against one."""
    return NOT if NOT in verdicts else HOLDS if verdicts and all(one == HOLDS for one in verdicts) else OPEN


def claims_table(judged: Sequence[dict[str, Any]]) -> str:
    """One row a claim."""
    rows = []
    for claim in CLAIMS:
        verdicts = [one["verdict"] for one in judged if one["claim"] == claim.text]
        counts = (str(verdicts.count(kind)) for kind in (HOLDS, NOT, OPEN))
        rows.append((claim.text, f"**{in_all(verdicts)}**", *counts))
    return table(("claim", "verdict", "planners against which it holds", "does not", "cannot be told"), rows)


def comparisons_table(judged: Sequence[dict[str, Any]]) -> str:
    """One row a claim and other planner."""
    head = ("claim", "against", "measure", "claimed", "paper", "here", "pairs", "verdict")
    return table(head, [_row(one) for one in judged])


def _row(one: dict[str, Any]) -> tuple[str, ...]:
    here = one["here"]
    name, digits, scale = _shown(one["measure"])
    there = here is not None and here["value"] is not None
    return (
        one["claim"],
        f"`{one['other']}`",
        name,
        one["claimed"],
        "-" if one["paper"] is None else f"{scale * one['paper']:+.{digits}f}",
        number_cell(here["value"], here["interval_95"], digits, scale) if there else "-",
        "0" if here is None else str(here["n_pairs"]),
        one["verdict"],
    )


def _shown(measure: str) -> tuple[str, int, float]:
    """A measure's heading, decimals and factor: rates are shown in points of a hundred."""
    if measure in MEASURES:
        return (*MEASURES[measure], 1.0)
    return f"{measure}, points", 0, 100.0
