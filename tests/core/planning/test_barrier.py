"""Gamma of eq. 14 in its readings, and which barriers are refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.planning.barrier import AdaptiveGamma, Barrier, FixedGamma, barrier_flaw, check_barrier, gamma_at
from adcbf_cli.core.types import FloatArray

FAR = np.array(50.0)
UNCLIPPED = AdaptiveGamma(floor=None, ceiling=None)
PRINTED = AdaptiveGamma(form="printed", floor=None, ceiling=None)


def at(gamma: AdaptiveGamma | FixedGamma, distance_m: float, radius_m: float) -> float:
    return float(gamma_at(gamma, np.array(distance_m), np.array(radius_m)))


def test_a_hand_computed_value() -> None:
    """At d = 2.6 m and r = 0.2 m both arguments are one sigma: A (1 + erf(1/sqrt 2)) (1 + erf(1/sqrt 2))."""
    one_sigma = 0.6826894921370859
    assert at(UNCLIPPED, 2.6, 0.2) == pytest.approx(0.5 * (1 + one_sigma) ** 2, rel=1e-12)
    assert at(UNCLIPPED, 2.0, 0.4) == pytest.approx(0.5, rel=1e-12)


def test_the_cdf_form_leaves_zero_to_one_without_a_clip() -> None:
    assert at(UNCLIPPED, 50.0, 0.0) == pytest.approx(1.954, abs=1e-3)
    assert at(UNCLIPPED, 50.0, 1.0) == pytest.approx(0.0027, abs=1e-4)
    assert at(AdaptiveGamma(), 50.0, 0.0) == 1.0
    assert at(AdaptiveGamma(), 50.0, 1.0) == 0.05


def test_the_printed_form_is_negative_for_big_obstacles() -> None:
    radius = np.linspace(0.0, 2.0, 20001)
    value = gamma_at(PRINTED, FAR, radius)
    assert radius[value < 0].min() == pytest.approx(0.656, abs=1e-3)
    assert (value[radius > 0.657] < 0).all()
    assert value.min() == pytest.approx(-2.67, abs=0.01)


def test_the_printed_form_is_the_printed_formula() -> None:
    """A (1 + erf(d - d_E) / (sqrt 2 sigma_d)) (1 - erf(r - r_E) / (sqrt 2 sigma_r)), number by number."""
    expected = (
        0.5 * (1 + math.erf(1.4 - 2.0) / (math.sqrt(2) * 0.6)) * (1 - math.erf(0.55 - 0.4) / (math.sqrt(2) * 0.2))
    )
    assert at(PRINTED, 1.4, 0.55) == pytest.approx(expected, rel=1e-12)


def test_far_below_the_edge_nothing_is_rounded_away() -> None:
    assert 0 < at(UNCLIPPED, 5.0, 2.5) < 1e-20


@given(st.floats(0.5, 10), st.floats(0.5, 10), st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_gamma_grows_with_distance_and_falls_with_radius(near: float, far: float, small: float, large: float) -> None:
    near, far, small, large = min(near, far), max(near, far), min(small, large), max(small, large)
    for gamma in (UNCLIPPED, AdaptiveGamma()):
        assert at(gamma, near, small) <= at(gamma, far, small)
        assert at(gamma, near, large) <= at(gamma, near, small)


def test_distances_and_radii_broadcast() -> None:
    distance: FloatArray = np.linspace(0.5, 5, 12).reshape(4, 3)
    radius = np.array([0.2, 0.5, 0.9])
    table = gamma_at(AdaptiveGamma(), distance, radius)
    assert table.shape == (4, 3)
    assert table[2, 1] == at(AdaptiveGamma(), distance[2, 1], 0.5)
    np.testing.assert_array_equal(gamma_at(FixedGamma(0.1), distance, radius), np.full((4, 3), 0.1))


ACCEPTED = {
    "distance": Barrier(FixedGamma(1.0)),
    "fixed": Barrier(FixedGamma(0.1)),
    "adaptive": Barrier(AdaptiveGamma()),
    "adaptive, optimal decay": Barrier(AdaptiveGamma(), decay_weight=10.0),
    "no floor": Barrier(AdaptiveGamma(floor=None)),
    "no ceiling, but small enough": Barrier(AdaptiveGamma(amplitude=0.25, ceiling=None)),
    "printed gamma, clipped": Barrier(AdaptiveGamma(form="printed")),
}


@pytest.mark.parametrize("barrier", ACCEPTED.values(), ids=ACCEPTED)
@pytest.mark.parametrize(("body_m", "safety_m"), [(0.3, 0.2), (0.05, 0.0), (2.0, 1.0)])
def test_class_k_functions_are_accepted(barrier: Barrier, body_m: float, safety_m: float) -> None:
    check_barrier(barrier, body_m, safety_m)


REJECTED = {
    "printed gamma": (Barrier(PRINTED), ["gamma is -2.7", "r = 2.00 m", "planning.gamma_form=cdf"]),
    "no ceiling": (Barrier(UNCLIPPED), ["alpha(h) > h", "1.92", "r = 0.05 m", "planning.gamma_ceiling=1"]),
    "high ceiling": (Barrier(AdaptiveGamma(ceiling=1.5)), ["alpha(h) > h", "1.50", "planning.gamma_ceiling=1"]),
    "printed form": (
        Barrier(AdaptiveGamma(), form="printed"),
        ["alpha(0) = ", "not 0", "planning.barrier_form=product"],
    ),
    "printed form, fixed": (Barrier(FixedGamma(0.5), form="printed"), ["alpha(0) = 0.5, not 0"]),
    "fixed above one": (Barrier(FixedGamma(1.2)), ["alpha(h) > h", "planning.gamma_fixed"]),
    "fixed at zero": (Barrier(FixedGamma(0.0)), ["gamma is 0", "planning.gamma_fixed"]),
    "printed gamma on a floor of zero": (
        Barrier(AdaptiveGamma(form="printed", floor=0.0)),
        ["gamma is 0", "planning.gamma_form=cdf"],
    ),
    "rounded to zero": (
        Barrier(AdaptiveGamma(radius_sigma_m=0.02, floor=None)),
        ["gamma is 0", "planning.gamma_floor=0.05"],
    ),
}


@pytest.mark.parametrize(("barrier", "parts"), REJECTED.values(), ids=REJECTED)
def test_others_are_refused_with_the_place_and_the_cure(barrier: Barrier, parts: list[str]) -> None:
    with pytest.raises(UsageError) as refusal:
        check_barrier(barrier, 0.3, 0.2)
    for part in [*parts, "planning.accept_invalid_barrier=true"]:
        assert part in str(refusal.value)


def test_alpha_that_falls_with_h_is_found() -> None:
    """Unclipped from above and negative twice, the printed gamma is positive, yet falls with distance."""
    falling = AdaptiveGamma(form="printed", floor=1e-6, ceiling=None, amplitude=0.1, distance_m=9.0, radius_m=-1.0)
    flaw = barrier_flaw(Barrier(falling), 0.3, 0.2)
    assert flaw is not None
    assert "alpha falls with growing h" in flaw


def test_only_what_can_be_met_is_judged() -> None:
    """Within 1 m of a big obstacle the printed gamma falls with distance: a small vehicle gets there, a
    vehicle of 0.8 m with 0.2 m to keep does not."""
    barrier = Barrier(AdaptiveGamma(form="printed", floor=1e-3))
    assert "alpha falls" in str(barrier_flaw(barrier, 0.02, 0.0))
    assert barrier_flaw(barrier, 0.8, 0.2) is None


def test_what_is_accepted_keeps_h_from_changing_its_sign() -> None:
    """At the constraint's edge h[k + 1] = h - alpha(h): never below zero from h >= 0, never above h."""
    for barrier in ACCEPTED.values():
        radius, height = np.meshgrid(np.linspace(0.05, 2.0, 30), np.linspace(0.0, 50.0, 200))
        distance = np.sqrt(height + (radius + 0.5) ** 2)
        following = (1 - gamma_at(barrier.gamma, distance, radius)) * height
        assert (following >= 0).all()
        assert (following <= height).all()
