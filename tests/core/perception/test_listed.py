"""An object list seen as clusters: interpolation, gaps, noise, circles."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.config import ReadConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.frames import transform_points
from adcbf_cli.core.perception.listed import listed_clusters, listed_frames
from adcbf_cli.core.types import Truth

SECOND = 1_000_000_000
QUIET = ReadConfig(object_noise_m=0.0, object_rate_hz=10.0)


def listing(rows: list[tuple[float, int, float, float]], size: tuple[float, float] = (np.nan, np.nan)) -> Truth:
    rows = sorted(rows)
    n = len(rows)
    return Truth(
        frame="world",
        stamp_ns=np.array([round(t * SECOND) for t, *_ in rows], dtype=np.int64),
        track_id=np.array([i for _, i, *_ in rows], dtype=np.int64),
        category=("Pedestrian",) * n,
        position_m=np.array([(x, y, 0.0) for *_, x, y in rows]).reshape(-1, 3),
        yaw_rad=np.full(n, np.nan),
        length_m=np.full(n, size[0]),
        width_m=np.full(n, size[1]),
        height_m=np.full(n, np.nan),
        source="people.csv",
    )


def test_positions_between_samples_are_interpolated() -> None:
    truth = listing([(0.0, 7, 1.0, 0.0), (0.4, 7, 2.0, 4.0)])
    records = list(listed_clusters(truth, QUIET))
    assert len(records) == listed_frames(truth, QUIET) == 5
    assert [r.stamp_ns for r in records] == [round(k * 0.1 * SECOND) for k in range(5)]
    np.testing.assert_allclose(records[1].centre_m[0, :2], [1.25, 1.0])
    np.testing.assert_allclose([r.radius_m[0] for r in records], 0.3)


def test_nobody_is_invented_across_a_gap_or_outside_a_path() -> None:
    truth = listing([(0.0, 1, 0.0, 0.0), (3.0, 1, 3.0, 0.0), (2.8, 2, 9.0, 9.0), (3.0, 2, 9.0, 9.0)])
    seen = [len(r) for r in listed_clusters(truth, QUIET)]
    assert seen[0] == 1
    assert seen[1:28] == [0] * 27
    assert seen[28:] == [1, 1, 2]


def test_the_circle_holds_the_box() -> None:
    truth = listing([(0.0, 1, 0.0, 0.0), (0.1, 1, 0.0, 0.0)], size=(4.0, 3.0))
    assert next(listed_clusters(truth, QUIET)).radius_m == pytest.approx(2.5)


def test_noise_is_seeded_and_of_the_size_asked_for() -> None:
    truth = listing([(0.4 * k, 1, 0.0, 0.0) for k in range(500)])
    config = ReadConfig(object_noise_m=0.1, object_seed=4)
    places = np.concatenate([r.centre_m[:, :2] for r in listed_clusters(truth, config)])
    assert places.std() == pytest.approx(0.1, rel=0.05)
    again = np.concatenate([r.centre_m[:, :2] for r in listed_clusters(truth, config)])
    np.testing.assert_array_equal(places, again)
    other = next(listed_clusters(truth, ReadConfig(object_noise_m=0.1, object_seed=5)))
    assert not np.allclose(other.centre_m[0, :2], places[0])


def test_sensor_and_world_agree_and_nobody_walks_through_the_sensor() -> None:
    truth = listing([(0.0, 1, -3.0, 2.0), (0.0, 2, 8.0, -1.0), (0.1, 1, -3.0, 2.0)])
    record = next(listed_clusters(truth, QUIET))
    np.testing.assert_allclose(transform_points(record.world_from_sensor, record.centre_sensor_m), record.centre_m)
    assert (np.hypot(*record.centre_sensor_m[:, :2].T) >= 5.0).all()
    assert not record.pose_known


def test_an_empty_list_is_an_error() -> None:
    with pytest.raises(AdcbfError, match="lists no object"):
        next(listed_clusters(listing([]), QUIET))
