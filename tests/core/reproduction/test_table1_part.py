"""Table I's case: equation 11, the floor of a straight line, and the arithmetic over runs."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.reproduction import table1
from adcbf_cli.core.reproduction.circle import BASE, Road, nearest_row, positions, straight_ahead


def test_going_straight_on_misses_the_circle_by_half_a_t_squared():
    """To second order the error is a t^2 / 2 with a = (2 pi w)^2 A, shared by x and y over a turn."""
    acceleration = (2 * np.pi * 0.015) ** 2 * 2.5
    all_steps, last = straight_ahead()
    ahead = 0.1 * np.arange(1, 31)
    np.testing.assert_allclose(last, acceleration * 9 / 2 / np.sqrt(2), rtol=0.01)
    np.testing.assert_allclose(all_steps, np.sqrt(np.mean((acceleration * ahead**2 / 2) ** 2) / 2), rtol=0.01)


def test_positions_are_equation_11():
    np.testing.assert_allclose(positions(np.array([0.0])), [[8.5, -0.5]])
    np.testing.assert_allclose(positions(np.array([0.25 / 0.015])), [[6.0, 2.0]], atol=1e-12)


def run_with_errors(value: float) -> dict[str, object]:
    road = Road(BASE.config({}))
    road.frames = 2
    road.seen_s = [0.0, 0.1]
    road.ids = {7}
    road.errors["tracking"] = [np.array([[value, 0.0]]), np.array([[-value, 2.0]])]
    return {"seed": int(value)} | road.row()


def test_rmse_and_interval():
    result = table1.mean_rmse([run_with_errors(1.0), run_with_errors(3.0)])
    assert result["tracking"]["x"]["runs_m"] == [1.0, 3.0]
    assert result["tracking"]["x"]["mean_m"] == pytest.approx(2.0)
    # t(0.975, 1) * sqrt(2) / sqrt(2)
    assert result["tracking"]["x"]["half_width_m"] == pytest.approx(12.7062, abs=1e-3)
    assert result["tracking"]["y"]["mean_m"] == pytest.approx(np.sqrt(2), abs=1e-6)
    assert result["prediction"]["x"]["mean_m"] is None
    assert result["tracked_share"] == 1.0


def test_the_text_shows_the_papers_value_beside_ours():
    text = table1.markdown(table1.summarise([run_with_errors(1.0), run_with_errors(3.0)]))
    line = next(line for line in text.splitlines() if line.startswith("| tracking, x"))
    assert [cell.strip() for cell in line.split("|")[2:4]] == ["0.015", "2.0000 ± 12.7062"]
    assert "seeds 1, 3 (n = 2)" in text
    assert "0 of the paper's four figures are above" in text
    missing = next(line for line in text.splitlines() if line.startswith("| prediction, step 30, x"))
    assert missing.split("|")[3].strip() == "-"


def test_a_track_far_away_is_not_the_obstacle():
    places = np.array([[5.0, 0.0], [0.3, 0.4]])
    assert nearest_row(places, np.zeros(2)) == 1
    assert nearest_row(places[:1], np.zeros(2)) is None
    assert nearest_row(np.empty((0, 2)), np.zeros(2)) is None


def test_every_seed_is_a_run():
    assert table1.tasks((3, 5)) == {"seed 3": 3, "seed 5": 5}
