"""Lives of tracks, chosen seeds and plans, as a page shows them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adcbf_cli.core.types import Tracks, TrackStatus
from adcbf_cli.io.driving_tables import write_drives
from adcbf_cli.io.html_report import scene
from adcbf_cli.io.html_report.drives import Detail, gather_drives, left_out
from adcbf_cli.io.html_report.points import encode_points, stored_points
from adcbf_cli.io.html_report.scene import Lives
from adcbf_cli.io.parquet import TableWriter
from adcbf_cli.io.tables import point_columns
from tests.io.test_driving_tables import make_drive
from tests.records import make_clusters, make_tracks

TENTATIVE, CONFIRMED, COASTING, ENDED = TrackStatus


def seen(states: dict[int, tuple[TrackStatus, bool]]) -> Tracks:
    """One scan's tracks: by id, status and whether it stands."""
    record = make_tracks(0, len(states), 6, np.random.default_rng(0))
    return replace(
        record,
        track_id=np.array(list(states), dtype=np.int64),
        status=np.array([status for status, _ in states.values()], dtype=np.int64),
        is_static=np.array([standing for _, standing in states.values()], dtype=bool),
    )


def test_a_life_is_told_state_by_state() -> None:
    lives = Lives()
    story = [TENTATIVE, CONFIRMED, CONFIRMED, COASTING, CONFIRMED, ENDED]
    for k, status in enumerate(story):
        lives.see(seen({7: (status, k == 4)}), 100 * k)
    assert lives.longest() == [
        {"id": 7, "spans": [[0, 100, 0], [100, 300, 1], [300, 400, 3], [400, 500, 2]]},
    ]
    assert lives.confirmed == 1


def test_tracks_that_nobody_confirmed_have_no_bar() -> None:
    lives = Lives()
    lives.see(seen({1: (TENTATIVE, False), 2: (CONFIRMED, False)}), 0)
    lives.see(seen({1: (ENDED, False), 2: (CONFIRMED, False)}), 100)
    assert [life["id"] for life in lives.longest()] == [2]


def test_the_longest_lives_stay_whatever_the_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "MOST_LIVES", 3)
    lengths = {number: 1 + (number * 7) % 11 for number in range(11)}
    lives = Lives()
    for k in range(13):
        state = {n: (CONFIRMED if k < length else ENDED, False) for n, length in lengths.items() if k <= length}
        if state:
            lives.see(seen(state), 100 * k)
    found = lives.longest()
    assert lives.confirmed == 11
    assert {life["id"] for life in found} == set(sorted(lengths, key=lambda number: -lengths[number])[:3])
    assert [life["id"] for life in found] == sorted(life["id"] for life in found)


def test_seeds_that_failed_are_shown_before_others(tmp_path: Path) -> None:
    """Seed 0 first, then those in which a drive failed; what is left out is said, the planners are all named."""
    from adcbf_cli.core.replay.records import Result

    def result(planner: str, seed: int) -> Result:
        return Result.COLLISION if (planner, seed) in {("dwa", 3), ("ad", 5)} else Result.SUCCESS

    drives = [replace(make_drive(p, s, ticks=40), result=result(p, s)) for p in ("ad", "dwa") for s in range(6)]
    write_drives(tmp_path, drives, {})
    detail = Detail(drives=6, ticks=25)
    found = gather_drives(tmp_path, "replay", drives[0].stamp_ns[0], np.zeros(2), detail)
    assert found["shown_seeds"] == [0, 3, 5]
    assert found["seeds"] == list(range(6))
    assert {(drive["planner"], drive["seed"]) for drive in found["drives"]} == {
        (planner, seed) for planner in ("ad", "dwa") for seed in (0, 3, 5)
    }
    told = list(left_out(found, detail, "replay"))
    assert told[0].startswith("replay: of 6 seeds, 0, 3, 5 are shown")
    assert told[1:] == [
        "replay: about 25 ticks a drive, the extremes among them",
        "replay: 5 plans a drive, evenly spread",
    ]


def test_a_drive_keeps_its_extremes_and_its_plans(tmp_path: Path) -> None:
    drive = make_drive("ad", 0, ticks=300)
    write_drives(tmp_path, [drive], {})
    found = gather_drives(tmp_path, "replay", drive.stamp_ns[0], np.array([10.0, -20.0]), Detail(ticks=60))
    shown = found["drives"][0]
    assert drive.steps is not None
    assert drive.stages is not None
    assert len(shown["t_ms"]) <= 60
    assert min(value for value in shown["clearance_mm"] if value is not None) == round(
        np.nanmin(drive.clearance_m) * 1000
    )
    assert max(shown["solve_us"]) == round(drive.steps.solve_ms.max() * 1000)
    assert min(shown["barrier_min_cm2"]) == round(drive.stages.barrier_m2.min() * 1e4)
    assert shown["t_ms"][-1] == round((drive.stamp_ns[-1] - drive.stamp_ns[0]) / 1e6)
    planned = np.reshape(shown["plans"]["xy_mm"], (12, -1, 2)) / 1000 + [10, -20]
    np.testing.assert_allclose(planned[0], drive.stages.pose[0, :, :2], atol=0.00051)
    np.testing.assert_allclose(planned[-1], drive.stages.pose[-1, :, :2], atol=0.00051)
    braked = sum(round((to - start) / (1000 / 30)) + 1 for start, to, what in shown["fallbacks"] if what == "braked")
    assert braked == drive.steps.outcome.count("braked")


def test_stored_points_come_back_by_frame_however_the_batches_fall(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(3)
    records = [make_clusters(index, 3, rng, with_labels=True) for index in range(6)]
    with TableWriter(tmp_path / "points.parquet", "points", {}) as writer:
        for record in records:
            writer.write(point_columns(record))
    monkeypatch.setattr("adcbf_cli.io.html_report.points.ROWS_READ", 1)
    found = {index: (places, label) for index, places, label in stored_points(tmp_path / "points.parquet", {1, 2, 5})}
    assert set(found) == {1, 2, 5}
    for index, (places, label) in found.items():
        labels = records[index].labels
        assert labels is not None
        np.testing.assert_array_equal(places, labels.points_m[:, :2])
        np.testing.assert_array_equal(label, labels.cluster_id)


def test_points_in_one_square_become_one_but_not_across_clusters() -> None:
    points = np.array([[5.01, 1.01], [5.02, 1.02], [5.03, 1.03], [5.31, 1.01]])
    flat = encode_points(points, np.array([0, 0, 1, 0]), np.array([5.0, 1.0]), most=10, cell_m=0.1)
    assert np.reshape(flat, (-1, 3)).tolist() == [[10, 10, 0], [30, 30, 1], [310, 10, 0]]
    assert len(encode_points(points, np.array([0, 0, 1, 0]), np.zeros(2), most=2, cell_m=0.1)) == 6
