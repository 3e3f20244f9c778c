"""Drives go into tables and come back the same."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.replay.records import Drive, PlanStages, PlanSteps, Result
from adcbf_cli.core.types import NO_ID
from adcbf_cli.io.driving_tables import DRIVING_TABLES, read_drives, write_drives


def make_drive(planner: str, seed: int, ticks: int, horizon: int = 4) -> Drive:
    rng = np.random.default_rng([seed, ticks])
    numbers = lambda *shape: rng.normal(size=shape)  # noqa: E731
    gaps = numbers(ticks)
    gaps[::2] = np.nan
    steps = PlanSteps(
        outcome=tuple("solved" if i % 2 else "braked" for i in range(ticks)),
        status=tuple("converged" if i % 2 else "" for i in range(ticks)),
        start=("",) * ticks,
        iterations=np.arange(ticks, dtype=np.int64) - 1,
        merit=gaps,
        violation_m2=np.abs(gaps),
        decay=np.ones(ticks),
        feasible=np.array([1.0, 0.0, np.nan] * ticks)[:ticks],
        obstacles=np.arange(ticks, dtype=np.int64),
        dropped=np.zeros(ticks, dtype=np.int64),
        conflict=np.arange(ticks) % 3 == 0,
        deviation_m=np.abs(numbers(ticks)),
        solve_ms=np.abs(numbers(ticks)),
    )
    stages = PlanStages(
        pose=numbers(ticks, horizon + 1, 3),
        inputs=numbers(ticks, horizon + 1, 2),
        barrier_m2=numbers(ticks, horizon + 1),
        gamma=numbers(ticks, horizon + 1),
        slack_m2=numbers(ticks, horizon + 1),
        track_id=rng.integers(NO_ID, 5, (ticks, horizon + 1)),
    )
    return Drive(
        planner=planner,
        seed=seed,
        period_s=1 / 30,
        nominal_s=20.0,
        reference_length_m=15.0,
        reference_speed_mps=0.75,
        stamp_ns=1_700_000_000_000_000_000 + np.arange(ticks) * 33_333_333,
        pose=numbers(ticks, 3),
        inputs=numbers(ticks, 2),
        clearance_m=gaps,
        nearest_id=np.where(np.isnan(gaps), NO_ID, 7),
        ttc_s=gaps,
        reference_m=np.abs(numbers(ticks)),
        along_m=np.abs(numbers(ticks)),
        log_m=gaps,
        recorded=np.arange(ticks) < ticks - 1,
        goal_reachable=np.ones(ticks, dtype=bool),
        result=Result.COLLISION,
        steps=steps,
        stages=stages,
    )


def assert_same(a: object, b: object) -> None:
    for field in fields(a):  # type: ignore[arg-type]
        left, right = getattr(a, field.name), getattr(b, field.name)
        if isinstance(left, np.ndarray):
            np.testing.assert_array_equal(left, right, err_msg=field.name)
            assert left.dtype == right.dtype, field.name
        elif hasattr(left, "__dataclass_fields__"):
            assert_same(left, right)
        else:
            assert left == right, field.name


def test_drives_come_back_as_they_were(tmp_path: Path) -> None:
    logged = replace(make_drive("logged", 0, 5), steps=None, stages=None, result=None)
    drives = [make_drive("ad-cbf-mpc", 0, 7), make_drive("ad-cbf-mpc", 1, 1), make_drive("dwa", 0, 4), logged]
    drives[2] = replace(drives[2], result=None, plan_error_m=np.full((4, 5), 0.25))
    rows = write_drives(tmp_path, drives, {"key": "k"})
    assert rows == {"drives": 4, "trajectories": 17, "plans": 12, "plan_stages": 60, "solve_times": 12}
    for before, after in zip(drives, read_drives(tmp_path), strict=True):
        assert_same(before, after)


def test_nothing_driven_gives_empty_typed_tables(tmp_path: Path) -> None:
    write_drives(tmp_path, [], {})
    assert read_drives(tmp_path) == []
    assert pq.read_table(tmp_path / "plans.parquet").num_rows == 0


def test_missing_evidence_is_null(tmp_path: Path) -> None:
    write_drives(tmp_path, [make_drive("dwa", 0, 6)], {})
    table = pq.read_table(tmp_path / "trajectories.parquet")
    assert table["clearance_m"].null_count == table["nearest_id"].null_count == 3


TAMPERED = {
    "no trajectory": ("trajectories", lambda t: t.slice(0, 0)),
    "a cut trajectory": ("trajectories", lambda t: t.slice(0, 5)),
    "another order": ("trajectories", lambda t: t.take(pa.array(range(len(t) - 1, -1, -1)))),
    "fewer plans": ("plans", lambda t: t.slice(0, 5)),
    "plans without times": ("solve_times", lambda t: t.slice(0, 0)),
    "a cut plan": ("plan_stages", lambda t: t.slice(0, 17)),
    "another result": ("drives", lambda t: t.set_column(t.column_names.index("result"), "result", pa.array(["won"]))),
    "another planner": ("drives", lambda t: t.set_column(t.column_names.index("planner"), "planner", pa.array(["x"]))),
}


@pytest.mark.parametrize("case", TAMPERED)
def test_tables_that_do_not_fit_together_are_refused(tmp_path: Path, case: str) -> None:
    write_drives(tmp_path, [make_drive("dwa", 0, 6)], {})
    name, change = TAMPERED[case]
    pq.write_table(change(pq.read_table(tmp_path / f"{name}.parquet")), tmp_path / f"{name}.parquet")
    with pytest.raises(AdcbfError, match="do not fit together"):
        read_drives(tmp_path)


def test_a_failure_on_the_way_leaves_no_table(tmp_path: Path) -> None:
    def failing():  # type: ignore[no-untyped-def]
        yield make_drive("dwa", 0, 3)
        raise AdcbfError("the log ended in the middle of a word")

    with pytest.raises(AdcbfError):
        write_drives(tmp_path, failing(), {})
    assert not [name for name in DRIVING_TABLES if (tmp_path / f"{name}.parquet").exists()]
