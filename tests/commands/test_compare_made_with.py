"""`adcbf compare` on folders that were scored or driven again: what the reports were made with counts, not run.json."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from tests.commands.conftest import run_here

WAY = ("--goal", "6,0", "--speed", "1", "--range", "8", "-p", "pure-pursuit")


def compared(base: Path, other: Path) -> dict[str, Any]:
    done = run_here("compare", base, other, "--json")
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)["runs"][0]
    return found


def test_settings_of_a_reused_folder_are_those_of_its_reports(driven_run: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.adcbf"
    shutil.copytree(driven_run, again)
    scored = run_here("evaluate", again, "--set", "evaluation.bootstrap_block_s=3", "--set", "evaluation.match_m=0.3")
    assert scored.returncode == 0, scored.stderr
    driven = run_here("replay", again, *WAY, "--start", "0,0", "--set", "vehicle.body_radius_m=0.2")
    assert driven.returncode == 0, driven.stderr
    assert (again / "run.json").read_bytes() == (driven_run / "run.json").read_bytes()
    found = compared(driven_run, again)
    assert found["settings"] == {
        "evaluation.match_m": [1.0, 0.3],
        "evaluation.bootstrap_block_s": [5.0, 3.0],
        "vehicle.body_radius_m (replay)": [0.3, 0.2],
    }
    assert found["metrics"]["later_seen.rmse_x_m"]["no_interval"] == "another evaluation.bootstrap_block_s"


def test_drives_from_elsewhere_or_in_another_world_are_no_pairs(tmp_path: Path) -> None:
    """The other truth has the first one's name, and every seed its number."""
    log = tmp_path / "people.csv"
    rows = [f"{200_000_000 * k},1,Pedestrian,3.0,{0.16 * k - 4:.4f}" for k in range(40)]
    log.write_text("\n".join(["timestamp_ns,track_id,class,x_m,y_m", *rows]) + "\n")
    reasons = {}
    for name, side_m, start in (
        ("base", 1.2, "0,0"),
        ("same", 1.2, "0,0"),
        ("start", 1.2, "0,0.1"),
        ("truth", 1.3, "0,0"),
    ):
        truth, run = tmp_path / name / "truth.csv", tmp_path / name / "run"
        truth.parent.mkdir()
        standing = [f"{200_000_000 * k},2,Pedestrian,4.5,{side_m}" for k in range(40)]
        truth.write_text(log.read_text() + "\n".join(standing) + "\n")
        done = run_here("replay", log, "-o", run, *WAY, "--seeds", "0:5", "--start", start, "--truth", truth)
        assert done.returncode == 0, done.stderr
        if name != "base":
            found = compared(tmp_path / "base" / "run", run)
            reasons[name] = found["metrics"]["replay.pure-pursuit.min_dist_m"]["no_interval"]
    another = "another world, route or start: drives of a seed are no pairs"
    assert reasons == {"same": None, "start": another, "truth": another}
