"""The world of a log: from truth, from tracks, from both."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.replay.world_sources import world_of
from adcbf_cli.core.types import Tracks, TrackStatus, Truth

STEP_NS = 100_000_000
CONFIG = Config()


def tracks(
    place: dict[int, tuple[float, float]],
    frames: int = 20,
    still: bool = True,
    sensor: tuple[float, float] = (0.0, 0.0),
    velocity: tuple[float, float] = (0.0, 0.0),
) -> list[Tracks]:
    """Tracks of radius 0.4 m, seen in every frame from a sensor that moves with `velocity`; unless still,
    tracks move at 1 m/s along x."""
    ids = np.array(list(place), dtype=np.int64)
    n = len(ids)
    records = []
    for k in range(frames):
        state = np.zeros((n, 6))
        state[:, :2] = list(place.values())
        if not still:
            state[:, 0] += 0.1 * k
            state[:, 3] = 1.0
        pose = np.eye(4)
        pose[:2, 3] = np.array(sensor) + 0.1 * k * np.array(velocity)
        records.append(
            Tracks(
                frame_index=k,
                stamp_ns=k * STEP_NS,
                world_from_sensor=pose,
                model="cv",
                track_id=ids,
                status=np.full(n, TrackStatus.CONFIRMED, dtype=np.int64),
                state=state,
                covariance=np.tile(np.diag([0.01] * 3 + [0.1] * 3), (n, 1, 1)),
                radius_m=np.full(n, 0.4),
                height_m=np.full(n, 1.7),
                is_static=np.full(n, still),
                cluster_id=ids,
                age_s=np.zeros(n),
                hits=np.zeros(n, dtype=np.int64),
                misses=np.zeros(n, dtype=np.int64),
                nis=np.zeros(n),
            )
        )
    return records


def truth(
    category: str, x: float, speed_mps: float = 0.0, sizes: tuple[float, float] | None = None, exhaustive: bool = True
) -> Truth:
    """One thing of id 10, sampled at 10 Hz for 2 s."""
    n = 21
    length, width = sizes or (np.nan, np.nan)
    position = np.zeros((n, 3))
    position[:, 0] = x + speed_mps * 0.1 * np.arange(n)
    return Truth(
        frame="world",
        stamp_ns=STEP_NS * np.arange(n),
        track_id=np.full(n, 10),
        category=(category,) * n,
        position_m=position,
        yaw_rad=np.zeros(n),
        length_m=np.full(n, length),
        width_m=np.full(n, width),
        height_m=np.full(n, np.nan),
        source="labels.csv",
        exhaustive=exhaustive,
    )


def test_tracks_alone() -> None:
    world, said = world_of(None, tracks({1: (3.0, 0.0)}), CONFIG)
    assert said == "the log's own tracks, smoothed"
    assert world.standing.tolist() == [1]
    assert world.clearance(np.zeros((1, 2)), 0.3, 10**15)[0, 0] == pytest.approx(3.0 - 0.4 - 0.3)


def test_moving_tracks_vanish_with_the_recording() -> None:
    world, _ = world_of(None, tracks({1: (3.0, 0.0)}, still=False), CONFIG)
    objects = world.at(10 * STEP_NS)
    np.testing.assert_allclose(objects.centre_m, [[4.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(objects.velocity_mps, [[1.0, 0.0]], atol=1e-6)
    assert len(world.at(20 * STEP_NS)) == 0


def test_where_the_vehicle_drove_nothing_stands_for_good() -> None:
    """It drives along x over the place of track 1, past the place of track 2."""
    seen = tracks({1: (1.5, 0.1), 2: (1.5, 1.0)}, velocity=(1.0, 0.0))
    world, _ = world_of(None, seen, CONFIG)
    assert world.standing.tolist() == [2]
    assert world.at(5 * STEP_NS).id.tolist() == [1, 2]
    assert world.at(100 * STEP_NS).id.tolist() == [2]


def test_circles_leave_the_logs_vehicle_its_place() -> None:
    """Circles of 0.4 m at 0.5 m and 2 m from a vehicle of 0.3 m that stands: the nearer has 0.2 m at most."""
    world, said = world_of(None, tracks({1: (0.5, 0.0), 2: (0.0, 2.0)}), CONFIG)
    assert said == "the log's own tracks, smoothed; 1 of 2 trimmed to leave the log's vehicle its place"
    np.testing.assert_allclose(world.at(0).radius_m, [0.199, 0.4], atol=1e-6)
    assert world.nearest(np.zeros(2), 0.3, 0)[0] == pytest.approx(0.001)


def test_a_moving_circle_is_trimmed_where_it_was_seen_near() -> None:
    """It moves away from 0.5 m on; that it was small then holds later."""
    world, _ = world_of(None, tracks({1: (0.5, 0.0)}, still=False), CONFIG)
    np.testing.assert_allclose(world.at(10 * STEP_NS).radius_m, [0.199], atol=1e-6)


def test_the_vehicles_own_body_is_not_there() -> None:
    """A track that always stays at the sensor's side."""
    seen = tracks({1: (0.2, 0.0), 2: (0.0, 5.0)}, still=False, velocity=(1.0, 0.0))
    world, _ = world_of(None, seen, CONFIG)
    assert world.at(5 * STEP_NS).id.tolist() == [2]


def test_truth_with_scenery_stands_alone() -> None:
    world, said = world_of(truth("wall", 5.0, sizes=(8.0, 0.2)), tracks({1: (3.0, 0.0)}), CONFIG)
    assert said == "ground truth (labels.csv), scenery included"
    assert world.at(0).id.tolist() == [10]
    assert world.standing.tolist() == [10]
    assert world.clearance(np.array([[5.0, 1.0]]), 0.3, 10**15)[0, 0] == pytest.approx(1.0 - 0.1 - 0.3)


def test_without_scenery_standing_tracks_that_are_not_labelled_are_added() -> None:
    """Track 1 is the labelled car, 2 a wall, and 3, a shadow that moves, is neither."""
    seen = [
        _both(a, b)
        for a, b in zip(tracks({1: (5.5, 0.3), 2: (5.0, 4.0)}), tracks({3: (0.0, 7.0)}, still=False), strict=True)
    ]
    world, said = world_of(truth("Car", 5.0, sizes=(4.0, 2.0)), seen, CONFIG)
    assert said == "ground truth (labels.csv) and 1 standing tracks of what it does not label"
    assert world.at(0).id.tolist() == [10, 11 + 2]
    assert world.standing.tolist() == [10, 13]


def test_labels_of_one_object_leave_the_rest_to_the_tracks() -> None:
    world, said = world_of(truth("Car", 50.0, 1.0, exhaustive=False), tracks({3: (0.0, 7.0)}, still=False), CONFIG)
    assert said == "ground truth (labels.csv) and 1 tracks of what it does not label"
    assert sorted(world.at(0).id.tolist()) == [10, 14]


def test_a_thing_that_passes_a_wall_does_not_take_it_away() -> None:
    """The labelled person is on the wall's track for a few of its sightings only."""
    world, _ = world_of(truth("Pedestrian", 3.0, 2.0), tracks({1: (5.0, 0.5)}), CONFIG)
    assert world.at(0).id.tolist() == [10, 12]


def test_labelled_things_without_a_size_are_persons_and_stand_if_they_do() -> None:
    world, _ = world_of(truth("Pedestrian", 5.0), [], CONFIG)
    assert world.at(0).radius_m.tolist() == [0.3]
    assert world.standing.tolist() == [10]
    walking, _ = world_of(truth("Pedestrian", 5.0, 1.0), [], CONFIG)
    assert walking.standing.tolist() == []
    np.testing.assert_allclose(walking.at(0).velocity_mps, [[1.0, 0.0]])


def test_truth_in_the_sensors_frame_is_refused() -> None:
    from dataclasses import replace

    with pytest.raises(AdcbfError, match="sensor frame"):
        world_of(replace(truth("Car", 5.0), frame="sensor"), [], CONFIG)


def _both(a: Tracks, b: Tracks) -> Tracks:
    from dataclasses import replace

    names = ("track_id", "status", "state", "covariance", "radius_m", "height_m", "is_static", "cluster_id")
    names += ("age_s", "hits", "misses", "nis")
    return replace(a, **{name: np.concatenate([getattr(a, name), getattr(b, name)]) for name in names})
