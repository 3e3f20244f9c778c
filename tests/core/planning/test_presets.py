"""Which planner is which, and what cannot be built."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adcbf_cli.core.config import PlanningConfig, VehicleConfig
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.planning.barrier import AdaptiveGamma, FixedGamma
from adcbf_cli.core.planning.mpc import problem_of
from adcbf_cli.core.planning.presets import PLANNERS, MpcPreset, make_planner
from adcbf_cli.core.types import Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle

VEHICLE = Vehicle.from_config(VehicleConfig())
NINE = [
    "mpc-dc",
    "mpc-cbf",
    "d-cbf-mpc",
    "a-cbf-mpc",
    "ad-cbf-mpc",
    "od-ad-cbf-mpc",
    "dwa",
    "apf",
    "pure-pursuit",
]


def preset(name: str) -> MpcPreset:
    found = PLANNERS[name]
    assert isinstance(found, MpcPreset)
    return found


def test_the_nine_planners_have_their_names() -> None:
    assert list(PLANNERS) == NINE
    for name in NINE:
        assert make_planner(name, VEHICLE, PlanningConfig(), Notes()).name == name


@pytest.mark.parametrize(
    ("name", "gamma", "predicts", "decays"),
    [
        ("mpc-dc", FixedGamma(1.0), False, False),
        ("mpc-cbf", FixedGamma(0.1), False, False),
        ("d-cbf-mpc", FixedGamma(0.1), True, False),
        ("a-cbf-mpc", AdaptiveGamma(), False, False),
        ("ad-cbf-mpc", AdaptiveGamma(), True, False),
        ("od-ad-cbf-mpc", AdaptiveGamma(), True, True),
    ],
)
def test_the_paper_s_planners_differ_in_gamma_prediction_and_decay(
    name: str, gamma: FixedGamma | AdaptiveGamma, predicts: bool, decays: bool
) -> None:
    row = preset(name)
    barrier = row.barrier(PlanningConfig())
    assert barrier.gamma == gamma
    assert row.predicts is predicts
    assert (barrier.decay_weight is not None) is decays
    assert not barrier.frozen


def test_settings_reach_the_barrier() -> None:
    planning = PlanningConfig(
        gamma_fixed=0.3, gamma_amplitude=0.4, gamma_floor=0.1, gamma_at="previous", barrier_steps=7, decay_weight=3.0
    )
    assert preset("mpc-cbf").barrier(planning).gamma == FixedGamma(0.3)
    barrier = preset("od-ad-cbf-mpc").barrier(planning)
    assert barrier.gamma == AdaptiveGamma(amplitude=0.4, floor=0.1)
    assert (barrier.frozen, barrier.steps, barrier.decay_weight) == (True, 7, 3.0)
    assert not preset("mpc-cbf").barrier(planning).frozen, "a fixed gamma needs no freezing"


def test_the_distance_constraint_has_no_printed_form() -> None:
    planning = PlanningConfig(barrier_form="printed", accept_invalid_barrier=True)
    assert preset("mpc-dc").barrier(planning).form == "product"
    assert preset("ad-cbf-mpc").barrier(planning).form == "printed"


def test_weights_and_times_reach_the_problem() -> None:
    planning = PlanningConfig(rate_hz=25.0, weight_turn=0.7, slack_weight=50.0, steps=12)
    problem = problem_of(VEHICLE, planning, preset("mpc-dc").barrier(planning))
    assert problem.first_step_s == pytest.approx(0.04)
    assert (problem.weights.turn, problem.slack_weight, problem.steps) == (0.7, 50.0, 12)
    assert problem.weights.position == planning.weight_position
    assert problem.weights.terminal == planning.weight_terminal


@pytest.mark.parametrize("wrong", ["ad-cbf", "AD-CBF-MPC", "adcbfmpc"])
def test_an_unknown_planner_names_the_nearest(wrong: str) -> None:
    with pytest.raises(UsageError, match="did you mean ad-cbf-mpc"):
        make_planner(wrong, VEHICLE, PlanningConfig(), Notes())


def test_a_planner_like_no_other_lists_them_all() -> None:
    with pytest.raises(UsageError, match=r"no planner is called 'x'; there are mpc-dc.*pure-pursuit"):
        make_planner("x", VEHICLE, PlanningConfig(), Notes())


@pytest.mark.parametrize(
    "settings", [{"gamma_form": "printed", "gamma_floor": None}, {"gamma_ceiling": None}, {"barrier_form": "printed"}]
)
def test_a_barrier_that_is_none_is_refused_unless_asked_for(settings: dict[str, object]) -> None:
    with pytest.raises(UsageError, match="class-K"):
        make_planner("ad-cbf-mpc", VEHICLE, PlanningConfig.model_validate(settings), Notes())
    accepted = PlanningConfig.model_validate({**settings, "accept_invalid_barrier": True})
    make_planner("ad-cbf-mpc", VEHICLE, accepted, Notes())


def test_a_barrier_s_settings_do_not_matter_to_planners_without_one() -> None:
    planning = PlanningConfig(barrier_form="printed")
    for name in ("dwa", "apf", "pure-pursuit", "mpc-dc"):
        assert make_planner(name, VEHICLE, planning, Notes()).name == name


def test_planners_of_one_name_share_nothing() -> None:
    one, two = (make_planner("ad-cbf-mpc", VEHICLE, PlanningConfig(), Notes()) for _ in range(2))
    assert one is not two
    assert np.isfinite(problem_of(VEHICLE, PlanningConfig(), preset("mpc-dc").barrier(PlanningConfig())).first_step_s)


PAGE = (Path(__file__).resolve().parents[3] / "docs" / "planning.md").read_text()


@pytest.mark.parametrize("setting", list(PlanningConfig.model_fields))
def test_every_setting_is_described_with_its_default(setting: str) -> None:
    """In the table of settings: the name, and the default at the same place among the row's defaults."""
    row = next(line for line in PAGE.splitlines() if line.startswith("| `") and f"`{setting}`" in line.split("|")[1])
    names, defaults = ([cell.strip(" `") for cell in column.split(",")] for column in row.split("|")[1:3])
    shown, default = defaults[names.index(setting)], PlanningConfig.model_fields[setting].default
    if isinstance(default, bool) or default is None or isinstance(default, str):
        assert shown == {True: "true", False: "false", None: "null"}.get(default, default)
    else:
        assert float(shown) == default


@pytest.mark.parametrize("name", NINE)
def test_every_planner_is_described(name: str) -> None:
    assert f"`{name}`" in PAGE
