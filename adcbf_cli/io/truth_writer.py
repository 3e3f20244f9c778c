"""Writes a simulated world's ground truth as CSV: one row an object and scan, sorted by time, then id."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from adcbf_cli.core.frames import wrap_angle
from adcbf_cli.core.simulation.objects import TruthBox
from adcbf_cli.core.types import IntArray

COLUMNS = (
    "timestamp_ns", "track_id", "class", "x_m", "y_m", "z_m", "yaw_rad", "length_m", "width_m", "height_m",
    "vx_mps", "vy_mps",
)  # fmt: skip


def write_truth(path: Path, blocks: Iterable[tuple[IntArray, Sequence[TruthBox]]]) -> None:
    """Each block of time: its (n,) stamps, and boxes of which the i-th is object i at all of them.

    Positions are box centres in the world frame, to a tenth of a millimetre. `path` is for the caller
    to make atomic.
    """
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(COLUMNS)
        for stamp_ns, boxes in blocks:
            for row, stamp in enumerate(stamp_ns):
                table.writerows(_row(int(stamp), number, box, row) for number, box in enumerate(boxes))


def _row(stamp_ns: int, track_id: int, box: TruthBox, row: int) -> list[str | int]:
    """Object `track_id`'s line at the row-th of its box's times."""
    yaw = -wrap_angle(-box.yaw_rad[row])  # in (-pi, pi]
    place = (box.x_m[row], box.y_m[row], box.z_m[row], yaw)
    size = (box.length_m, box.width_m, box.height_m)
    speed = (box.vx_mps[row], box.vy_mps[row])
    return [stamp_ns, track_id, box.category, *(_decimal(float(value)) for value in (*place, *size, *speed))]


def _decimal(value: float) -> str:
    """Four decimals, and no minus before a zero."""
    text = f"{value:.4f}"
    return "0.0000" if text == "-0.0000" else text
