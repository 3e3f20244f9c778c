"""Writes a simulated world's ground truth as CSV: one row an object and scan, sorted by time, then id."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from adcbf_cli.core.simulation.objects import TruthBox
from adcbf_cli.core.types import IntArray

COLUMNS = (
    "timestamp_ns", "track_id", "class", "x_m", "y_m", "z_m", "yaw_rad", "length_m", "width_m", "height_m",
    "vx_mps", "vy_mps",
)  # fmt: skip


def write_truth(path: Path, stamp_ns: IntArray, boxes: Sequence[TruthBox]) -> None:
    """boxes[i] is object i at all the (n,) stamps. Positions are box centres in the world frame, to a
    tenth of a millimetre. `path` is for the caller to make atomic."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream, lineterminator="\n")
        table.writerow(COLUMNS)
        for row, stamp in enumerate(stamp_ns):
            for track_id, box in enumerate(boxes):
                place = (box.x_m[row], box.y_m[row], box.z_m[row], box.yaw_rad[row])
                size = (box.length_m, box.width_m, box.height_m)
                speed = (box.vx_mps[row], box.vy_mps[row])
                numbers = [_decimal(float(value)) for value in (*place, *size, *speed)]
                table.writerow([int(stamp), track_id, box.category, *numbers])


def _decimal(value: float) -> str:
    """Four decimals, and no minus before a zero."""
    text = f"{value:.4f}"
    return "0.0000" if text == "-0.0000" else text
