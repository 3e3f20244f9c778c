"""CLEAR MOT and HOTA: hand-computed scenes, and the published implementations as oracles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from adcbf_cli.core.evaluation.clear import ClearMot
from adcbf_cli.core.evaluation.hota import Hota, similarity
from adcbf_cli.core.evaluation.matching import assign, centre_distances, inside_boxes

MATCH_M = 1.0
ZERO_M = 2.0
STRETCH = 5


@dataclass
class Scene:
    """Per frame: object ids, object xy, track ids, track xy."""

    frames: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]

    def clear(self) -> ClearMot:
        counts = ClearMot()
        for objects, at, tracks, seen in self.frames:
            distance = centre_distances(at, seen)
            counts.add(objects, tracks, distance, distance <= MATCH_M)
        return counts

    def hota(self) -> Hota:
        scores = Hota()
        for k, (objects, at, tracks, seen) in enumerate(self.frames):
            scores.add(objects, tracks, similarity(centre_distances(at, seen), ZERO_M), k // STRETCH)
        return scores

    def moved(self, change) -> Scene:
        return Scene([(o, change(p), t, change(q)) for o, p, t, q in self.frames])

    def renamed(self, objects, tracks) -> Scene:
        return Scene(
            [(np.array([objects[i] for i in o]), p, np.array([tracks[i] for i in t]), q) for o, p, t, q in self.frames]
        )


def random_scene(seed: int, frames: int = 25, apart: bool = False) -> Scene:
    """Four objects that walk about, tracks that miss, swap, drift away, and false ones. `apart`: so far
    from each other that no track is near two of them."""
    rng = np.random.default_rng(seed)
    at = np.array([[0.0, 20.0 * i] for i in range(4)]) if apart else rng.uniform(-4, 4, (4, 2))
    track_of = np.arange(4) + 10
    result = []
    for _ in range(frames):
        at = at + rng.normal(0, 0.15, at.shape)
        if rng.random() < 0.15:
            swap = rng.permutation(4)[:2]
            track_of[swap] = track_of[swap[::-1]]
        if rng.random() < 0.1:
            track_of[rng.integers(4)] = track_of.max() + 1
        seen = rng.random(4) < 0.85
        seen[0] = True  # the references treat frames without any track in ways of their own
        places = at + rng.normal(0, 0.35, at.shape)
        false = rng.uniform(-4, 4, (rng.integers(3), 2))
        tracks = np.concatenate([track_of[seen], 100 + np.arange(len(false))])
        result.append((np.arange(4), at.copy(), tracks, np.concatenate([places[seen], false])))
    return Scene(result)


def trackeval_scores(scene: Scene) -> tuple[dict, dict]:
    from trackeval.metrics import CLEAR, HOTA

    track_ids = np.unique(np.concatenate([t for _, _, t, _ in scene.frames]))
    object_ids = np.unique(np.concatenate([o for o, _, _, _ in scene.frames]))
    data = {
        "num_timesteps": len(scene.frames),
        "num_gt_ids": len(object_ids),
        "num_tracker_ids": len(track_ids),
        "num_gt_dets": sum(len(o) for o, _, _, _ in scene.frames),
        "num_tracker_dets": sum(len(t) for _, _, t, _ in scene.frames),
        "gt_ids": [np.searchsorted(object_ids, o) for o, _, _, _ in scene.frames],
        "tracker_ids": [np.searchsorted(track_ids, t) for _, _, t, _ in scene.frames],
        "similarity_scores": [similarity(centre_distances(p, q), ZERO_M) for _, p, _, q in scene.frames],
    }
    quiet = {"PRINT_CONFIG": False, "THRESHOLD": 1 - MATCH_M / ZERO_M}
    return CLEAR(quiet).eval_sequence(data), HOTA().eval_sequence(data)


@pytest.mark.parametrize("seed", range(12))
def test_clear_agrees_with_trackeval(seed: int) -> None:
    scene = random_scene(seed)
    mine, (theirs, _) = scene.clear(), trackeval_scores(scene)
    assert mine.matches == theirs["CLR_TP"]
    assert mine.misses == theirs["CLR_FN"]
    assert mine.false_positives == theirs["CLR_FP"]
    assert mine.switches == theirs["IDSW"]
    assert mine.fragmentations == theirs["Frag"]
    assert mine.mota == pytest.approx(theirs["MOTA"])
    assert mine.motp_m == pytest.approx((1 - theirs["MOTP"]) * ZERO_M)


@pytest.mark.parametrize("seed", range(12))
def test_clear_agrees_with_motmetrics(seed: int) -> None:
    import motmetrics

    # motmetrics lets an object keep its track through frames without a match, the paper and trackeval
    # do not; where no track is near two objects, that makes no difference.
    scene = random_scene(seed, apart=True)
    accumulator = motmetrics.MOTAccumulator(auto_id=True)
    for objects, at, tracks, seen in scene.frames:
        distance = centre_distances(at, seen)
        accumulator.update(objects, tracks, np.where(distance <= MATCH_M, distance, np.nan))
    names = ["num_misses", "num_false_positives", "mota", "motp", "num_matches", "num_switches"]
    theirs = motmetrics.metrics.create().compute(accumulator, metrics=names).iloc[0]
    mine = scene.clear()
    assert mine.misses == theirs["num_misses"]
    assert mine.false_positives == theirs["num_false_positives"]
    assert mine.switches == theirs["num_switches"] > 0
    assert mine.matches == theirs["num_matches"] + theirs["num_switches"]
    assert mine.mota == pytest.approx(theirs["mota"])
    assert mine.motp_m == pytest.approx(theirs["motp"])


@pytest.mark.parametrize("seed", range(12))
def test_hota_agrees_with_trackeval(seed: int) -> None:
    scene = random_scene(seed)
    mine, (_, theirs) = scene.hota().scores(), trackeval_scores(scene)
    assert mine.hota == pytest.approx(theirs["HOTA"].mean())
    assert mine.det_a == pytest.approx(theirs["DetA"].mean())
    assert mine.det_re == pytest.approx(theirs["DetRe"].mean())
    assert mine.det_pr == pytest.approx(theirs["DetPr"].mean())
    assert mine.ass_a == pytest.approx(theirs["AssA"].mean())
    assert mine.loc_a == pytest.approx(theirs["LocA"].mean())


@pytest.mark.parametrize("seed", range(4))
def test_scores_do_not_depend_on_place_heading_or_names(seed: int) -> None:
    scene = random_scene(seed)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    same = [
        scene.moved(lambda p: p @ turn.T + [1000.0, -20.0]),
        scene.renamed({0: 7, 1: 3, 2: 900, 3: 1}, {i: 5000 - 7 * i for i in range(200)}),
    ]
    clear, hota = scene.clear(), scene.hota().scores()
    for other in same:
        assert other.clear().mota == pytest.approx(clear.mota)
        assert other.clear().switches == clear.switches
        assert other.clear().motp_m == pytest.approx(clear.motp_m)
        assert other.hota().scores().hota == pytest.approx(hota.hota)


def frame(objects: dict[int, float], tracks: dict[int, float]) -> tuple:
    """Things on a line, id: x."""

    def split(things: dict[int, float]) -> tuple[np.ndarray, np.ndarray]:
        xs = [[x, 0.0] for x in things.values()]
        return np.array(list(things), dtype=np.int64), np.array(xs).reshape(-1, 2)

    return (*split(objects), *split(tracks))


def test_clear_counts_by_hand() -> None:
    """One object: tracked, missed, taken by a second track; a false track in the first frame."""
    scene = Scene(
        [
            frame({1: 0.0}, {10: 0.3, 11: 5.0}),
            frame({1: 0.0}, {}),
            frame({1: 0.0}, {20: 0.5}),
            frame({1: 0.0}, {20: 0.1, 10: 0.0}),  # the nearer one is not the one it has: it keeps 20
        ]
    )
    counts = scene.clear()
    assert (counts.objects, counts.matches, counts.misses, counts.false_positives) == (4, 3, 1, 2)
    assert (counts.switches, counts.fragmentations, counts.duplicates) == (1, 1, 1)
    assert counts.mota == pytest.approx(1 - (1 + 2 + 1) / 4)
    assert counts.motp_m == pytest.approx((0.3 + 0.5 + 0.1) / 3)


def test_excused_tracks_and_unscored_objects_vanish() -> None:
    counts = ClearMot()
    distance = np.array([[0.2, 9.0, 9.0], [9.0, 0.1, 9.0]])
    match = counts.add(
        np.array([1, 2]),
        np.array([10, 11, 12]),
        distance,
        distance <= 1,
        scored=np.array([True, False]),
        ignorable=np.array([False, False, True]),
    )
    assert (counts.objects, counts.matches, counts.misses, counts.false_positives) == (1, 1, 0, 0)
    assert match.rows.tolist() == [0]
    assert match.columns.tolist() == [0]


def test_nothing_to_score_is_null_not_zero() -> None:
    assert ClearMot().mota is None
    assert ClearMot().motp_m is None
    assert Hota().scores().hota is None
    only_objects = Scene([frame({1: 0.0}, {})])
    assert only_objects.clear().mota == 0.0
    assert only_objects.hota().scores().hota == 0.0
    assert only_objects.hota().scores().loc_a is None


def test_hota_by_hand() -> None:
    """Two frames, one object, a new track in the second, both exact: DetA 1, AssA 1/2."""
    scores = Scene([frame({1: 0.0}, {10: 0.0}), frame({1: 0.0}, {20: 0.0})]).hota().scores()
    assert scores.det_a == pytest.approx(1.0)
    assert scores.ass_a == pytest.approx(0.5)
    assert scores.hota == pytest.approx(np.sqrt(0.5))
    assert scores.loc_a == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_stretchs_influence_is_what_seeing_it_more_often_does(seed: int) -> None:
    """The derivative of each such score along a stretch's weight, by finite differences over whole evaluations."""
    often = 40
    scene = random_scene(seed, apart=True)  # so that more of one stretch changes no match
    stretches = [scene.frames[k : k + STRETCH] for k in range(0, len(scene.frames), STRETCH)]
    scores, base = scene.hota().scores(), Scene(scene.frames * often).hota().scores()
    assert scores.stretch.tolist() == [0, 1, 2, 3, 4]
    assert scores.influence.keys() == {"det_a", "det_re", "det_pr", "loc_a"}
    for b, stretch in enumerate(stretches):
        more = Scene(scene.frames * often + stretch).hota().scores()
        for name, influence in scores.influence.items():
            risen = often * (getattr(more, name) - getattr(base, name))
            assert influence[b] == pytest.approx(risen, abs=2e-3, rel=0.05), name
    for name, influence in scores.influence.items():
        assert influence.sum() == pytest.approx(0.0, abs=1e-12), name
        assert np.abs(influence).max() > 1e-3, name


def test_drawn_influences_vary_as_scores_of_drawn_stretches_do() -> None:
    """The spread that influences give is that of scoring stretches drawn anew, each draw a whole evaluation."""
    scene = random_scene(3, frames=200, apart=True)
    stretches = [scene.frames[k : k + STRETCH] for k in range(0, len(scene.frames), STRETCH)]
    scores = scene.hota().scores()
    rng = np.random.default_rng(1)
    draws = rng.integers(len(stretches), size=(200, len(stretches)))
    drawn = [Scene([f for b in draw for f in stretches[b]]).hota().scores() for draw in draws]
    for name, influence in scores.influence.items():
        spread = np.std([getattr(one, name) for one in drawn])
        assert np.sqrt((influence**2).sum()) == pytest.approx(spread, rel=0.2), name


def test_a_run_without_tracks_scores_nothing_whichever_stretch_is_seen() -> None:
    scores = Scene([frame({1: 0.0}, {})] * 3 * STRETCH).hota().scores()
    assert scores.stretch.tolist() == [0, 1, 2]
    assert {name: influence.tolist() for name, influence in scores.influence.items()} == {
        name: [0.0, 0.0, 0.0] for name in ("det_a", "det_re")
    }


def test_assignment_prefers_more_pairs_over_nearer_ones() -> None:
    distance = np.array([[0.1, 0.9], [0.8, 5.0]])
    rows, columns = assign(distance, distance <= 1)
    assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == [(0, 1), (1, 0)]


def test_points_in_turned_boxes() -> None:
    """A 4 x 2 m box turned by 90 degrees reaches 2 m along y and 1 m along x."""
    point = np.array([[0.0, 1.9], [0.9, 0.0], [1.1, 0.0], [0.0, 2.1], [1.9, 0.0]])
    box = (np.zeros((1, 2)), np.array([np.pi / 2]), np.array([4.0]), np.array([2.0]))
    assert inside_boxes(*box, point, 0.0)[0].tolist() == [True, True, False, False, False]
    assert inside_boxes(*box, point, 0.2)[0].tolist() == [True, True, True, True, False]
    unknown = (np.zeros((1, 2)), np.array([np.nan]), np.array([4.0]), np.array([2.0]))
    assert not inside_boxes(*unknown, point, 1.0).any()
