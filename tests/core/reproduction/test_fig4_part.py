"""Fig. 4: the two cases, what a gamma permits, and the text's statements from the numbers."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from adcbf_cli.core.config import PlanningConfig, VehicleConfig
from adcbf_cli.core.reproduction import fig4
from adcbf_cli.core.reproduction.part import Document, Row


@pytest.fixture(scope="module")
def rows() -> list[Row]:
    return [fig4.run(case) for case in fig4.CASES]


@pytest.fixture(scope="module")
def document(rows: list[Row]) -> Document:
    return fig4.summarise(rows)


def test_the_papers_two_cases():
    """Section 3.3: 0.4 m from 4.0 m away and coming, 0.6 m from 1.0 m away and going; 50 steps each."""
    coming, going = (case.distance_m() for case in fig4.CASES)
    assert len(coming) == len(going) == 50
    assert (coming[0], going[0]) == (4.0, 1.0)
    assert (np.diff(coming) < 0).all()
    assert (np.diff(going) > 0).all()


def test_gamma_by_hand(document: Document):
    """d = 4 m, r = r_E: 0.5 (1 + erf(2 / (0.6 sqrt 2))) and, as printed, 0.5 (1 + erf(2) / (0.6 sqrt 2))."""
    gamma = document["cases"][0]["gamma"]
    assert gamma["adaptive"]["first"] == pytest.approx(0.999571, abs=1e-6)
    assert gamma["printed"]["first"] == pytest.approx(0.5 * (1 + 0.9953223 / (0.6 * np.sqrt(2))), abs=1e-6)
    assert gamma["fixed"] == {"first": 0.1, "last": 0.1}


def test_permitted_speed_by_hand():
    """h = 2^2 - 1 = 3; gamma 1 lets it come to contact, 1 m in 0.1 s; gamma 0 lets it come no nearer. Inside, at
    h = 0.25 - 1, gamma 1 asks for contact: 0.5 m away in one step."""
    distance = np.array([2.0, 2.0, 0.5])
    permitted = fig4.permitted_mps(distance, np.array([1.0, 0.0, 1.0]), 1.0, 0.1)
    np.testing.assert_allclose(permitted, [10.0, 0.0, -5.0], atol=1e-12)


def test_what_is_permitted_keeps_the_barrier():
    rng = np.random.default_rng(0)
    distance, gamma = rng.uniform(0.2, 5.0, 200), rng.uniform(0.0, 1.0, 200)
    later = distance - 0.1 * fig4.permitted_mps(distance, gamma, 0.9, 0.1)
    np.testing.assert_allclose(later**2 - 0.81, (1 - gamma) * (distance**2 - 0.81), atol=1e-9)


def test_obstacle_2_begins_outside_the_safe_set(document: Document):
    second = document["cases"][1]
    assert second["first_barrier_m2"] == pytest.approx(1.0 - 1.1**2)
    assert second["steps_inside_keep_out"] == 2  # 1.00 and 1.06 m, then 1.12 m


def test_every_step_has_a_plan(document: Document):
    for case in document["cases"]:
        for plans in case["plans"].values():
            assert sum(plans["outcomes"].values()) == fig4.STEPS


def test_a_plan_without_obstacle_in_reach_goes_on():
    far = fig4.Case("far", 0.4, 50.0, 0.0)
    plans = fig4.plan_standing("ad-cbf-mpc", far, PlanningConfig(), VehicleConfig())
    assert plans["outcomes"]["solved"] == fig4.STEPS
    assert min(plans["reach_m"]) > 1.5  # 3 s at up to 0.75 m/s, from standing


def test_the_text_says_what_the_numbers_say(document: Document):
    assert "comes nearer: reproduced" in fig4.markdown(document)
    other = copy.deepcopy(document)
    other["map"]["rises_with_distance"] = False
    other["cases"][1]["first_barrier_m2"] = 0.5
    text = fig4.markdown(other)
    assert "comes nearer: NOT reproduced" in text
    assert "Obstacle 2 begins inside" in text


def test_the_map_bounds_are_the_clip(document: Document):
    assert document["map"]["as_configured"] == [0.05, 1.0]
    assert document["map"]["printed"][0] < 0 < 1 < document["map"]["printed"][1]
