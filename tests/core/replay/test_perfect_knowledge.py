"""Perfect knowledge against the simulated world that it is taken from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from adcbf_cli.core.planning.problem import Obstacles
from adcbf_cli.core.replay.perfect_knowledge import PerfectKnowledge
from adcbf_cli.core.replay.simulated_world import SimulatedWorld
from adcbf_cli.core.replay.world import WorldObjects
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.world import World
from adcbf_cli.core.types import FloatArray

SECOND = 1_000_000_000
START = 100 * SECOND
STEPS, STEP_S = 30, 0.1
CYLINDER, PERSON, CAR, WAITING, BOX, WALL = range(6)
MOVERS = [
    {
        "kind": "cylinder",
        "radius_m": 0.5,
        "path": {"kind": "line", "from_m": [3, -4], "to_m": [3, 4], "speed_mps": 0.5},
    },
    {"kind": "person", "path": {"kind": "waypoints", "points_m": [[0, 3], [1, 3], [1, 9]], "speed_mps": 1.0}},
    {"kind": "vehicle", "path": {"kind": "circle", "centre_m": [0, 0], "radius_m": 5, "frequency_hz": 0.1}},
    {"kind": "cylinder", "path": {"kind": "line", "from_m": [9, 0], "to_m": [9, 5], "speed_mps": 1.0, "start_s": 5}},
]
STANDING = [
    {"kind": "box", "at_m": [-3, 0], "size_m": [0.8, 0.6, 0.5], "yaw_deg": 30},
    {"kind": "wall", "from_m": [-4, -8], "to_m": [2, -8], "thickness_m": 0.2},
]


def simulated(movers: Sequence[object] = MOVERS, objects: Sequence[object] = STANDING) -> SimulatedWorld:
    scenario = {
        "duration_s": 20, "start_time_s": 100, "lidar": {"kind": "spinning"}, "movers": movers, "objects": objects,
        "ego": {"path": {"kind": "stand", "at_m": [0, 0]}},
    }  # fmt: skip
    return SimulatedWorld(World(Scenario.model_validate(scenario), 0))


@pytest.fixture(scope="module")
def world() -> SimulatedWorld:
    return simulated()


def known(
    world: SimulatedWorld, time_s: float = 0.0, range_m: float = 100.0, at: tuple[float, float] = (0.0, 0.0)
) -> Obstacles:
    stamp = START + round(time_s * SECOND)
    return PerfectKnowledge(world).obstacles(stamp, np.array(at), range_m, STEPS, STEP_S, "none")


def corners(objects: WorldObjects, row: int) -> FloatArray:
    """(4, 2) of one rectangle."""
    along = np.array([np.cos(objects.yaw_rad[row]), np.sin(objects.yaw_rad[row])])
    across = np.array([-along[1], along[0]])
    half = 0.5 * np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * [objects.length_m[row], objects.width_m[row]]
    return np.asarray(objects.centre_m[row] + half @ np.stack([along, across]))


def test_circles_are_where_they_will_be(world: SimulatedWorld) -> None:
    got = known(world)
    row = got.track_id.tolist().index(CYLINDER)
    straight = np.column_stack([np.full(31, 3.0), -4.0 + 0.05 * np.arange(31)])
    np.testing.assert_allclose(got.position_m[row], straight, atol=1e-9)
    np.testing.assert_allclose(got.velocity_mps[row], [0.0, 0.5], atol=1e-12)
    assert got.radius_m[row] == 0.5


def test_a_turn_is_known_before_it_is_made(world: SimulatedWorld) -> None:
    """The person turns left at (1, 3) after a second: no constant velocity says so."""
    got = known(world)
    row = got.track_id.tolist().index(PERSON)
    np.testing.assert_allclose(got.position_m[row, [5, 10, 30]], [[0.5, 3.0], [1.0, 3.0], [1.0, 5.0]], atol=1e-9)
    assert got.radius_m[row] == pytest.approx(0.5 * np.hypot(0.5, 0.3)), "one circle, as perception sees it"


@pytest.mark.parametrize("time_s", [0.0, 1.3, 4.9, 17.0])
def test_discs_cover_what_is_true_at_every_stage(world: SimulatedWorld, time_s: float) -> None:
    got = known(world, time_s)
    share = np.linspace(0, 1, 21)[:, None]
    for stage in (0, 7, 30):
        objects = world.at(START + round((time_s + stage * STEP_S) * SECOND))
        for row in np.flatnonzero(objects.is_box).tolist():
            ring = corners(objects, row)
            for start, end in zip(ring, np.roll(ring, 1, axis=0), strict=True):
                edge = start + share * (end - start)
                gap = edge[:, None] - got.position_m[:, stage]
                inside = np.hypot(gap[..., 0], gap[..., 1]) <= got.radius_m + 1e-6
                assert inside.any(axis=1).all(), f"thing {row} at stage {stage}"


def test_discs_are_no_wider_than_the_thing_needs(world: SimulatedWorld) -> None:
    got = known(world)
    objects = world.at(START)
    row = got.track_id.tolist().index(BOX)
    assert got.radius_m[row] == pytest.approx(0.5)
    wall = np.abs(got.position_m[:, 0, 1] + 8.0) < 1e-9
    assert wall.sum() == 30
    assert got.radius_m[wall].max() < 0.15
    car = np.hypot(*(got.position_m[:, 0] - objects.centre_m[CAR]).T) < 2.1
    assert car.sum() == 3


def test_what_stands_until_the_horizons_end_is_static(world: SimulatedWorld) -> None:
    early, late = known(world, 1.0), known(world, 3.0)
    for got, waits in ((early, True), (late, False)):
        static = dict(zip(got.track_id.tolist(), got.is_static.tolist(), strict=True))
        assert static[WAITING] is waits, "it starts at 5 s"
        assert static[BOX]
        assert static[WALL]
        assert not static[CYLINDER]
        assert not static[PERSON]
        assert not static[CAR]


def test_what_is_far_is_not_known(world: SimulatedWorld) -> None:
    got = known(world, range_m=3.7, at=(3.0, -5.0))
    surface = np.hypot(*(got.position_m[:, 0] - [3.0, -5.0]).T) - got.radius_m
    everything = known(world)
    distance = np.hypot(*(everything.position_m[:, 0] - [3.0, -5.0]).T) - everything.radius_m
    assert (surface <= 3.7).all()
    assert len(got) == (distance <= 3.7).sum()
    assert CYLINDER in got.track_id
    assert BOX not in got.track_id
    assert any(i > WALL for i in got.track_id), "the wall's near discs"
    assert len(got) < len(everything)


def test_nothing_is_uncertain(world: SimulatedWorld) -> None:
    got = PerfectKnowledge(world).obstacles(START, np.zeros(2), 100.0, STEPS, STEP_S, "conformal")
    assert got.margin_m.shape == (len(got), STEPS + 1)
    assert not got.margin_m.any()


def test_a_disc_keeps_its_name_and_a_horizon_says_what_the_next_one_does(world: SimulatedWorld) -> None:
    """Moments that are kept from one tick to the next are those that a fresh oracle gives."""
    oracle = PerfectKnowledge(world)
    ids = None
    for tick in range(8):
        stamp = START + round(tick * SECOND / 30)
        got = oracle.obstacles(stamp, np.zeros(2), 100.0, STEPS, STEP_S, "none")
        fresh = PerfectKnowledge(world).obstacles(stamp, np.zeros(2), 100.0, STEPS, STEP_S, "none")
        for name in Obstacles.__slots__:
            np.testing.assert_array_equal(getattr(got, name), getattr(fresh, name))
        ids = got.track_id if ids is None else ids
        np.testing.assert_array_equal(got.track_id, ids)
        assert len(set(ids.tolist())) == len(ids)


def test_an_empty_world_has_no_obstacles() -> None:
    got = known(simulated([], []))
    assert len(got) == 0
    assert got.position_m.shape == (0, STEPS + 1, 2)
    assert got.velocity_mps.shape == (0, 2)
