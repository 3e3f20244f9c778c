"""Every planner in every hard case: what must always hold, and what is guaranteed by construction."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.config import PlanningConfig, VehicleConfig
from adcbf_cli.core.planning.planner import Outcome
from adcbf_cli.core.planning.presets import PLANNERS, make_planner
from adcbf_cli.core.types import Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle
from tests.core.planning.hard_cases import CASES, Case, Course, drive

QUICK = PlanningConfig(rate_hz=10.0)
"""A third of the ticks of the default rate; the cases are as hard."""

VEHICLES = {
    "unicycle": Vehicle.from_config(VehicleConfig()),
    "ackermann": Vehicle.from_config(VehicleConfig(kind="ackermann")),
}
BY_NAME = {case.name: case for case in CASES}
STATIC = [case.name for case in CASES if case.is_static]
MPC = [name for name in PLANNERS if name.endswith(("mpc", "dc", "cbf"))]

_driven: dict[tuple[str, str, str], Course] = {}


def course(name: str, case: str, kind: str = "unicycle") -> Course:
    """The drive; each one driven once. `drive` asserts that every plan is finite and within limits."""
    key = (name, case, kind)
    if key not in _driven:
        vehicle = VEHICLES[kind]
        _driven[key] = drive(BY_NAME[case], make_planner(name, vehicle, QUICK, Notes()), vehicle, QUICK)
    return _driven[key]


@pytest.mark.parametrize("case", list(BY_NAME))
@pytest.mark.parametrize("name", list(PLANNERS))
def test_every_plan_is_within_the_limits(name: str, case: str) -> None:
    assert len(course(name, case).outcomes) > 10 or course(name, case).collided


@pytest.mark.parametrize("case", ["dead ahead", "oncoming", "no way out", "corner"])
@pytest.mark.parametrize("name", list(PLANNERS))
def test_a_steered_vehicle_is_driven_within_its_limits(name: str, case: str) -> None:
    assert len(course(name, case, "ackermann").outcomes) > 10


@pytest.mark.parametrize("case", STATIC)
@pytest.mark.parametrize("name", list(PLANNERS))
def test_what_stands_still_is_not_hit(name: str, case: str) -> None:
    """Known, and standing: braking always remains, and no planner here drives closer than it promises."""
    assert not course(name, case).collided


@pytest.mark.parametrize("case", [name for name in STATIC if "margin" not in name])
@pytest.mark.parametrize("name", [*MPC, "dwa", "pure-pursuit"])
def test_the_safety_distance_is_kept_from_what_stands_still(name: str, case: str) -> None:
    assert course(name, case).clearance_m.min() > QUICK.safety_distance_m - 0.01


@pytest.mark.parametrize("name", list(PLANNERS))
def test_a_free_way_is_driven_in_the_time_it_takes(name: str) -> None:
    free = course(name, "free")
    assert free.arrived
    assert len(free.pose) * free.period_s < 1.2 * 9.0 / 0.75
    assert set(free.outcomes) == {Outcome.SOLVED}


@pytest.mark.parametrize("case", ["big ahead", "big, 5 cm aside"])
@pytest.mark.parametrize("name", ["a-cbf-mpc", "ad-cbf-mpc", "od-ad-cbf-mpc"])
def test_adaptive_gamma_passes_a_big_obstacle(name: str, case: str) -> None:
    """r = 1.0 m, where gamma sits on its floor; without one the vehicle freezes there."""
    assert course(name, case).arrived


def test_planners_that_predict_avoid_what_comes_and_crosses() -> None:
    for name in ("d-cbf-mpc", "ad-cbf-mpc", "od-ad-cbf-mpc", "dwa"):
        for case in ("oncoming", "crossing", "overtaking"):
            assert course(name, case).arrived, (name, case)


@pytest.mark.parametrize("name", MPC)
def test_the_margin_is_left_again(name: str) -> None:
    for case in ("within the margin", "nose in the margin"):
        assert course(name, case).arrived, case


@pytest.mark.parametrize("name", list(PLANNERS))
def test_no_way_out_ends_inside_without_a_collision(name: str) -> None:
    ring = course(name, "no way out")
    assert not ring.arrived
    assert np.hypot(ring.pose[:, 0], ring.pose[:, 1]).max() < 2.0 - 0.5 - 0.3


@pytest.mark.parametrize("name", list(PLANNERS))
def test_a_goal_within_an_obstacle_is_never_reached(name: str) -> None:
    assert not course(name, "goal inside").arrived


@pytest.mark.parametrize("case", ["within the margin", "nose in the margin"])
def test_hard_constraints_stand_where_soft_ones_relax(case: str) -> None:
    """Within the margin h < 0, and from a standstill it cannot grow as fast as its barrier asks."""
    hard = QUICK.model_copy(update={"hard": True})
    vehicle = VEHICLES["unicycle"]
    driven = drive(BY_NAME[case], make_planner("d-cbf-mpc", vehicle, hard, Notes()), vehicle, hard)
    assert set(driven.outcomes) == {Outcome.STOPPED}
    assert Outcome.RELAXED in course("d-cbf-mpc", case).outcomes


def test_two_runs_are_the_same() -> None:
    case, vehicle = BY_NAME["slalom"], VEHICLES["unicycle"]
    one, two = (drive(case, make_planner("ad-cbf-mpc", vehicle, QUICK, Notes()), vehicle, QUICK) for _ in range(2))
    np.testing.assert_array_equal(one.pose, two.pose)


def test_an_empty_case_has_no_obstacles() -> None:
    assert Case("nothing", []).is_static
    assert np.isinf(course("dwa", "free").clearance_m).all()
