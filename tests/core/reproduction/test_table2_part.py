"""Table II: which runs are made, the paired arithmetic, and the claims' verdicts."""

from __future__ import annotations

import pytest

from adcbf_cli.core.config import CLOSED_LOOP
from adcbf_cli.core.reproduction import load_part, table2
from adcbf_cli.core.reproduction.drives import PLANNERS
from adcbf_cli.core.reproduction.table2_claims import CLAIMS, HOLDS, NOT, OPEN, PAPER, in_all, verdict
from tests.core.reproduction.runs_of_scenes import a_run

SEEDS = range(6)


def runs(**better_m: float) -> list[dict[str, object]]:
    """Every planner on every seed, with the seed's own minimum distance and the planner's share on top."""
    return [
        a_run(planner, seed, min_dist_m=0.1 * seed + better_m.get(planner.replace("-", "_"), 0.0), nav_time_s=50.0)
        for seed in SEEDS
        for planner in PLANNERS
    ]


def claim(document: dict[str, object], text: str, other: str) -> dict[str, object]:
    (found,) = (one for one in document["claims"] if one["claim"].startswith(text) and one["other"] == other)
    return found


def test_every_planner_drives_every_scene_at_the_defaults():
    tasks = table2.tasks((7, 9))
    assert list(tasks) == [f"{planner}-{seed}" for seed in (7, 9) for planner in PLANNERS]
    task = tasks["mpc-cbf-9"]
    assert (task.seed, task.planner, task.config, task.knowledge) == (9, "mpc-cbf", CLOSED_LOOP, "perception")
    assert "35.869" in task.text


@pytest.mark.parametrize(
    ("sign", "interval", "expected"),
    [
        (1, (0.1, 0.3), HOLDS),
        (1, (-0.3, -0.1), NOT),
        (-1, (-0.3, -0.1), HOLDS),
        (-1, (0.1, 0.3), NOT),
        (1, (-0.1, 0.3), OPEN),
        (-1, (0.0, 0.3), OPEN),
        (1, (0.0, 0.0), OPEN),
        (1, None, OPEN),
    ],
)
def test_a_claim_is_decided_by_the_whole_interval(sign, interval, expected):
    assert verdict(sign, interval) == expected


def test_a_claim_has_to_hold_against_every_planner():
    assert in_all([HOLDS, HOLDS]) == HOLDS
    assert in_all([HOLDS, OPEN]) == OPEN
    assert in_all([HOLDS, OPEN, NOT]) == NOT
    assert in_all([]) == OPEN


def test_claims_are_judged_seed_by_seed():
    """Between seeds distances differ by half a metre, between planners always by the same: pairs tell."""
    document = table2.summarise(runs(ad_cbf_mpc=0.02, d_cbf_mpc=-0.05))
    largest = claim(document, "AD-CBF-MPC keeps", "d-cbf-mpc")
    assert largest["verdict"] == HOLDS
    assert largest["here"]["value"] == pytest.approx(0.07)
    assert largest["here"]["n_pairs"] == len(SEEDS)
    assert largest["paper"] == pytest.approx(0.94 - 0.83)
    assert claim(document, "Prediction makes room", "mpc-cbf")["verdict"] == NOT
    assert claim(document, "AD-CBF-MPC is the fastest", "mpc-cbf")["verdict"] == OPEN
    text = table2.markdown(document)
    assert "| AD-CBF-MPC keeps the largest minimum distance | **holds** | 4 | 0 | 0 |" in text
    assert "13 % more Min-dist (here +35 %)" in text  # 0.07 of the mean of 0.1 times 0 to 5, less 0.05
    assert "41 % less Vel-var (here: -)" in text


def test_differences_count_the_seeds_in_which_both_have_a_value():
    rows = [
        *(a_run("ad-cbf-mpc", seed, nav_time_s=50.0) for seed in range(6)),
        *(a_run("mpc-cbf", seed, nav_time_s=52.0) for seed in range(2)),
        *(a_run("mpc-cbf", seed, "collision") for seed in range(2, 6)),
    ]
    document = table2.summarise(rows)
    found = document["planners"]["mpc-cbf"]
    assert found["minus ad-cbf-mpc"]["nav_time_s"] | {"interval_95": None} == {
        "value": 2.0,
        "n_pairs": 2,
        "n_dropped": 4,
        "n_neither": 0,
        "interval_95": None,
    }
    assert found["here"]["success"]["value"] == pytest.approx(2 / 6)
    assert found["here"]["nav_time_s"]["n_missing"] == 4
    assert [one["seed"] for one in document["collisions"]] == [2, 3, 4, 5]
    text = table2.markdown(document)
    assert "4/6: 67 % [30, 90]" in text
    assert "2.00 (n = 2)" in text
    assert "| `mpc-cbf`, seed 2 | person, moving | 9.0 | 4.0 | 0.70 | yes |" in text


def test_what_the_paper_prints_stands_beside():
    document = table2.summarise(runs())
    text = table2.markdown(document)
    paper = next(line for line in text.splitlines() if line.startswith("| `d-cbf-mpc`, paper"))
    assert [float(cell) for cell in paper.split("|")[2:-1]] == [PAPER["d-cbf-mpc"][key] for key in table2.MEASURES]
    dashed = next(line for line in text.splitlines() if line.startswith("| `mpc-dc`, paper"))
    assert [cell.strip() for cell in dashed.split("|")[2:-1]] == ["-", "0.00", "0.938", "-", "-"]


def test_planners_without_a_finished_run_are_left_open():
    rows = [row for row in runs() if row["planner"] not in ("ad-cbf-mpc", "mpc-dc")]
    document = table2.summarise(rows)
    assert list(document["planners"]) == ["mpc-cbf", "d-cbf-mpc", "a-cbf-mpc"]
    assert claim(document, "AD-CBF-MPC has the shortest path", "mpc-cbf")["verdict"] == OPEN
    assert "`mpc-dc` collided in 0 of its 0 runs" in table2.markdown(document)


def test_mpc_dc_collides_as_the_paper_says():
    """Everybody arrives but mpc-dc, which always hits a mover: more collisions than each other planner."""
    rows = [
        a_run(planner, seed, "collision" if planner == "mpc-dc" else "success")
        for seed in range(20)
        for planner in PLANNERS
    ]
    document = table2.summarise(rows)
    found = claim(document, "MPC-DC collides", "ad-cbf-mpc")
    assert (found["paper"], found["here"]["value"], found["verdict"]) == (1.0, 1.0, HOLDS)
    text = table2.markdown(document)
    assert "`mpc-dc` collided in 20 of its 20 runs, 20 times with a mover." in text
    assert "| MPC-DC collides, the others do not | **holds** | 4 | 0 | 0 |" in text
    assert "| `ad-cbf-mpc` | collision, points | more | +100 | 100 [" in text


def test_claims_are_about_planners_and_measures_that_there_are():
    for one in CLAIMS:
        assert {one.planner, *one.others} <= set(PLANNERS)
        assert one.planner not in one.others


def test_fig6_shares_table2s_runs():
    fig6 = load_part("fig6")
    assert fig6.runs_of == "table2"
    assert fig6.settings == table2.PART.settings
    assert fig6.tasks((3, 4)) == {name: task for name, task in table2.tasks((3, 4)).items() if task.seed == 3}
