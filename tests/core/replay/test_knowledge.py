"""What is known when, where, and with which margin: hand-computed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.core.replay.knowledge import Knowledge
from adcbf_cli.core.types import Notes, Predictions

MS = 1_000_000
Make = Callable[..., Predictions]


def knowledge(*records: Predictions, notes: Notes | None = None, body_radius_m: float = 0.0) -> Knowledge:
    known = Knowledge(notes or Notes(), body_radius_m)
    for record in records:
        known.update(record)
    return known


def test_nothing_before_the_first_record() -> None:
    known = Knowledge(Notes()).obstacles(0, np.zeros(2), 10.0, 3, 0.1, "none")
    assert len(known) == 0
    assert known.position_m.shape == (0, 4, 2)
    assert known.margin_m.shape == (0, 4)


def test_positions_now_and_ahead(predicted: Make) -> None:
    known = knowledge(predicted(0, [[1.0, 2.0]], [[2.0, -1.0]])).obstacles(0, np.zeros(2), 10.0, 3, 0.1, "none")
    np.testing.assert_allclose(known.position_m[0], [[1.0, 2.0], [1.2, 1.9], [1.4, 1.8], [1.6, 1.7]])
    np.testing.assert_allclose(known.velocity_mps, [[2.0, -1.0]])
    np.testing.assert_allclose(known.margin_m, np.zeros((1, 4)))


def test_the_age_of_the_record_counts_and_steps_may_differ(predicted: Make) -> None:
    """75 ms after the record, steps of 0.2 s: the record ends at 0.5 s, and goes on at its last velocity."""
    record = predicted(0, [[0.0, 0.0]], [[1.0, 0.0]])
    bent = predicted(
        0,
        [[0.0, 0.0]],
        [[1.0, 0.0]],
        position_m=np.array([[[0.1, 0, 0], [0.2, 0, 0], [0.2, 0.1, 0], [0.2, 0.2, 0], [0.2, 0.3, 0]]]),
        velocity_mps=np.array([[[1.0, 0], [1.0, 0], [0, 1.0], [0, 1.0], [0, 1.0]]]),
    )
    straight = knowledge(record).obstacles(75 * MS, np.zeros(2), 10.0, 4, 0.2, "none")
    np.testing.assert_allclose(straight.position_m[0, :, 0], [0.075, 0.275, 0.475, 0.675, 0.875])
    around = knowledge(bent).obstacles(75 * MS, np.zeros(2), 10.0, 4, 0.2, "none")
    np.testing.assert_allclose(around.position_m[0, :, 0], [0.075, 0.2, 0.2, 0.2, 0.2])
    np.testing.assert_allclose(around.position_m[0, :, 1], [0.0, 0.075, 0.275, 0.475, 0.675])


def test_only_what_is_near_now(predicted: Make) -> None:
    """Range counts to the surface (radius 0.3), from where the ego is, to where things are now."""
    known = knowledge(predicted(0, [[5.2, 0.0], [5.4, 0.0], [-3.0, 0.0]], [[0, 0], [0, 0], [50.0, 0.0]]))
    near = known.obstacles(0, np.zeros(2), 5.0, 3, 0.1, "none")
    assert near.track_id.tolist() == [0, 2]
    assert known.obstacles(0, np.array([1.0, 0.0]), 5.0, 3, 0.1, "none").track_id.tolist() == [0, 1, 2]
    assert known.obstacles(200 * MS, np.zeros(2), 5.0, 3, 0.1, "none").track_id.tolist() == [0]


def test_margins(predicted: Make) -> None:
    """sigma grows 0.1 m a step from 0.1 at step 1; the moment itself has step 1's."""
    known = knowledge(predicted(0, [[1.0, 0.0]], [[1.0, 0.0]]))
    sigma = known.obstacles(0, np.zeros(2), 10.0, 7, 0.1, "sigma").margin_m[0]
    np.testing.assert_allclose(sigma, [0.1, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
    later = known.obstacles(150 * MS, np.zeros(2), 10.0, 1, 0.1, "conformal").margin_m[0]
    np.testing.assert_allclose(later, [0.3, 0.5])


def test_a_missing_conformal_radius_is_sigmas_and_counted(predicted: Make) -> None:
    notes = Notes()
    record = predicted(0, [[1.0, 0.0], [2.0, 0.0]], [[1, 0], [1, 0]])
    record.conformal_radius_m[0] = np.nan
    margin = knowledge(record, notes=notes).obstacles(0, np.zeros(2), 10.0, 2, 0.1, "conformal").margin_m
    np.testing.assert_allclose(margin, [[0.1, 0.1, 0.2], [0.2, 0.2, 0.4]])
    assert notes.counters == {"obstacles_without_conformal_radius": 1}


def test_what_stands_keeps_the_first_steps_margin(predicted: Make) -> None:
    record = predicted(0, [[1.0, 0.0], [2.0, 0.0]], [[0, 0], [1, 0]])
    margin = knowledge(record).obstacles(0, np.zeros(2), 10.0, 2, 0.1, "sigma").margin_m
    np.testing.assert_allclose(margin, [[0.1, 0.1, 0.1], [0.1, 0.1, 0.2]])


def test_old_predictions_are_carried_on_and_counted(predicted: Make) -> None:
    notes = Notes()
    known = knowledge(predicted(0, [[0.0, 0.0]], [[1.0, 0.0]]), notes=notes)
    known.obstacles(500 * MS, np.zeros(2), 10.0, 1, 0.1, "none")
    assert notes.counters == {}
    old = known.obstacles(900 * MS, np.zeros(2), 10.0, 1, 0.1, "none")
    np.testing.assert_allclose(old.position_m[0, :, 0], [0.9, 1.0])
    assert notes.counters == {"steps_on_stale_predictions": 1}


def test_the_newest_record_counts(predicted: Make) -> None:
    known = knowledge(predicted(0, [[1.0, 0.0]], [[1.0, 0.0]]), predicted(100 * MS, [[4.0, 0.0]], [[1.0, 0.0]]))
    assert known.obstacles(100 * MS, np.zeros(2), 10.0, 1, 0.1, "none").position_m[0, 0, 0] == pytest.approx(4.0)


def test_what_stood_is_remembered_until_something_else_is_seen_there(predicted: Make) -> None:
    seen = predicted(0, [[1.0, 0.0], [3.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]])
    gone = predicted(100 * MS, [[8.0, 0.0]], [[0.0, 0.0]], track_id=np.array([5]))
    known = knowledge(seen, gone)
    now = known.obstacles(200 * MS, np.zeros(2), 10.0, 2, 0.1, "none")
    assert now.track_id.tolist() == [5, 0]
    np.testing.assert_allclose(now.position_m[1], [[1.0, 0.0]] * 3)
    known.update(predicted(200 * MS, [[1.2, 0.0]], [[0.0, 0.0]], track_id=np.array([9])))
    assert known.obstacles(200 * MS, np.zeros(2), 10.0, 2, 0.1, "none").track_id.tolist() == [9, 5]


def test_a_remembered_track_that_is_seen_again_is_itself(predicted: Make) -> None:
    first = predicted(0, [[1.0, 0.0]], [[0.0, 0.0]])
    none = predicted(100 * MS, np.zeros((0, 2)), np.zeros((0, 2)))
    again = predicted(200 * MS, [[2.0, 0.0]], [[1.0, 0.0]])
    known = knowledge(first, none, again).obstacles(200 * MS, np.zeros(2), 10.0, 2, 0.1, "none")
    assert known.track_id.tolist() == [0]
    assert known.position_m[0, 0, 0] == pytest.approx(2.0)


def test_where_the_logs_vehicle_drives_nothing_stands(predicted: Make) -> None:
    known = Knowledge(Notes(), body_radius_m=0.3)
    known.update(predicted(0, [[1.0, 0.0]], [[0.0, 0.0]]), np.zeros(2))
    known.update(predicted(100 * MS, np.zeros((0, 2)), np.zeros((0, 2))), np.array([0.5, 0.0]))
    assert len(known.obstacles(100 * MS, np.zeros(2), 10.0, 2, 0.1, "none")) == 1
    known.update(predicted(200 * MS, np.zeros((0, 2)), np.zeros((0, 2))), np.array([0.9, 0.0]))
    assert len(known.obstacles(200 * MS, np.zeros(2), 10.0, 2, 0.1, "none")) == 0


def test_what_is_remembered_to_stand_can_be_forgotten(predicted: Make) -> None:
    known = Knowledge(Notes())
    known.update(predicted(0, [[1.0, 0.0], [0.0, 2.0]], np.zeros((2, 2)), radius_m=np.array([0.3, 0.4])))
    assert len(known.standing()[0]) == 0, "what is seen is not remembered"
    known.update(predicted(100 * MS, np.empty((0, 2)), np.empty((0, 2))))
    ids, centre, radius = known.standing()
    assert ids.tolist() == [0, 1]
    np.testing.assert_allclose(centre, [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    np.testing.assert_allclose(radius, [0.3, 0.4])
    assert len(known.obstacles(100 * MS, np.zeros(2), 10.0, 2, 0.1, "none")) == 2
    known.forget(np.array([0]))
    assert known.obstacles(100 * MS, np.zeros(2), 10.0, 2, 0.1, "none").track_id.tolist() == [1]


def test_where_the_ego_is_nothing_else_is(predicted: Make) -> None:
    known = Knowledge(Notes(), body_radius_m=0.3)
    known.update(predicted(0, [[1.0, 0.0], [0.0, 2.0], [-0.2, 0.1]], np.zeros((3, 2)), radius_m=np.full(3, 0.8)))
    told = known.obstacles(0, np.zeros(2), 10.0, 2, 0.1, "none")
    assert told.track_id.tolist() == [0, 1]
    np.testing.assert_allclose(told.radius_m, [0.7, 0.8])
    elsewhere = known.obstacles(0, np.array([0.0, -3.0]), 10.0, 2, 0.1, "none")
    np.testing.assert_allclose(elsewhere.radius_m, 0.8)


def test_the_vehicles_own_body_is_no_obstacle(predicted: Make) -> None:
    notes = Notes()
    known = Knowledge(notes, body_radius_m=0.3)
    known.update(predicted(0, [[0.2, 0.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]]), np.zeros(2))
    assert known.obstacles(0, np.zeros(2), 10.0, 2, 0.1, "none").track_id.tolist() == [1]
    assert notes.counters == {"tracks_within_own_body": 1}


def test_after_the_end_only_what_stands(predicted: Make) -> None:
    notes = Notes()
    known = knowledge(predicted(0, [[1.0, 0.0], [2.0, 0.0]], [[1.0, 0.0], [0.0, 0.0]]), notes=notes)
    known.end()
    left = known.obstacles(60_000 * MS, np.zeros(2), 10.0, 2, 0.1, "none")
    assert left.track_id.tolist() == [1]
    np.testing.assert_allclose(left.position_m[0], [[2.0, 0.0]] * 3)
    assert notes.counters == {}


@pytest.mark.parametrize("name", ["position_m", "velocity_mps", "radius_m", "sigma_radius_m"])
def test_a_number_that_is_none_is_named(predicted: Make, name: str) -> None:
    record = predicted(0, [[1.0, 0.0], [2.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]])
    getattr(record, name)[1] = np.nan
    with pytest.raises(AdcbfError, match=rf"predictions, frame 0 .*{name} of track 1"):
        knowledge(record)


def test_a_record_that_goes_back_is_an_error(predicted: Make) -> None:
    with pytest.raises(AdcbfError, match="older than the record before"):
        knowledge(predicted(100, [[1.0, 0.0]], [[0, 0]]), predicted(0, [[1.0, 0.0]], [[0, 0]]))
