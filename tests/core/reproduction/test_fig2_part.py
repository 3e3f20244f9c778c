"""Fig. 2: outcomes by hand, scenes that are what they say, and the arithmetic over scenes."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from scipy.spatial import cKDTree

from adcbf_cli.core.reproduction import fig2, stacks
from adcbf_cli.core.simulation.world import World
from adcbf_cli.core.types import NO_ID


def outcomes_of(*pairs: tuple[int, int, int]) -> list[str | None]:
    """From (obstacle, cluster, points) triples; six points are enough."""
    unit = np.concatenate([np.full(count, obstacle) for obstacle, _, count in pairs])
    label = np.concatenate([np.full(count, cluster) for _, cluster, count in pairs])
    return fig2.outcomes(unit, label, int(unit.max()) + 1, fewest=6)


def test_an_obstacle_in_a_cluster_of_its_own_is_found():
    assert outcomes_of((0, 0, 10), (1, 1, 10)) == ["found", "found"]


def test_two_obstacles_in_one_cluster_are_merged():
    assert outcomes_of((0, 0, 10), (1, 0, 6), (2, 1, 6)) == ["merged", "merged", "found"]


def test_an_obstacle_in_two_clusters_is_split():
    assert outcomes_of((0, 0, 10), (0, 1, 6)) == ["split"]


def test_a_few_points_in_anothers_cluster_split_nothing():
    """Two points of obstacle 0 fall to obstacle 1's cluster, which stays obstacle 1's."""
    assert outcomes_of((0, 0, 10), (0, 1, 2), (1, 1, 10)) == ["found", "found"]


def test_an_obstacle_that_is_mostly_noise_is_missed():
    assert outcomes_of((0, NO_ID, 6), (0, 0, 5)) == ["missed"]
    assert outcomes_of((0, NO_ID, 10)) == ["missed"]


def test_what_has_too_few_points_does_not_count():
    assert outcomes_of((0, 0, 5), (1, 1, 6)) == [None, "found"]


def test_points_of_no_obstacle_count_for_none():
    """A cluster that is mostly ground is no piece of the obstacle whose few points it holds."""
    assert outcomes_of((0, 0, 10), (0, 1, 3), (NO_ID, 1, 9)) == ["found"]


def test_outcomes_do_not_depend_on_the_clusters_numbers():
    rng = np.random.default_rng(1)
    unit, label = rng.integers(-1, 6, 40_000), rng.integers(-1, 8, 40_000)
    swapped = np.where(label == NO_ID, NO_ID, rng.permutation(8)[label])
    assert fig2.outcomes(unit, label, 6, 5) == fig2.outcomes(unit, swapped, 6, 5)


@pytest.mark.parametrize("seed", range(100_000, 100_006))
def test_scenes_keep_their_groups_apart(seed: int):
    """Obstacles of different kinds are farther apart than any clusterer joins."""
    scene = stacks.draw_stacks(seed)
    world = World(scene.scenario(), seed)
    boxes = world.truth(np.array([world.start_ns]))
    unit = scene.unit_of_id()
    kind = np.array([scene.kinds[number] for number in unit])
    assert set(kind) == set(stacks.KINDS)
    corners = [_outline(box) for box in boxes]
    by_kind = {
        name: np.concatenate([c for c, own in zip(corners, kind, strict=True) if own == name]) for name in set(kind)
    }
    for one, two in itertools.combinations(by_kind, 2):
        assert cKDTree(by_kind[one]).query(by_kind[two])[0].min() > 1.0, (one, two)


def _outline(box) -> np.ndarray:
    """Points on a box's outline, 0.1 m apart or nearer."""
    share = np.linspace(-0.5, 0.5, 81)
    edge = np.full_like(share, 0.5)
    local = np.concatenate(
        [np.column_stack(pair) for pair in ((share, edge), (share, -edge), (edge, share), (-edge, share))]
    )
    x, y = local[:, 0] * box.length_m, local[:, 1] * box.width_m
    c, s = np.cos(box.yaw_rad[0]), np.sin(box.yaw_rad[0])
    return np.column_stack([box.x_m[0] + c * x - s * y, box.y_m[0] + s * x + c * y])


def test_the_same_seed_gives_the_same_scene():
    assert stacks.draw_stacks(7).scenario() == stacks.draw_stacks(7).scenario()
    assert stacks.draw_stacks(7).scenario() != stacks.draw_stacks(8).scenario()


@pytest.fixture(scope="module")
def row() -> dict:
    return fig2.run(100_000)


def test_every_method_judges_the_same_obstacles(row: dict):
    counted = {name: [outcome is None for outcome in found["outcomes"]] for name, found in row["methods"].items()}
    assert len({tuple(missing) for missing in counted.values()}) == 1
    assert all(len(found["outcomes"]) == len(row["kinds"]) for found in row["methods"].values())


def test_the_packages_own_pipeline_finds_the_same_clusters(row: dict):
    """What is measured here is what a user gets: the same points, the same number of obstacles."""
    from adcbf_cli.core.perception.pipeline import Perception
    from adcbf_cli.core.simulation.simulator import Simulator
    from adcbf_cli.core.types import Notes

    perceive = Perception(fig2.ONE_CIRCLE, Notes())
    for simulated in Simulator(stacks.draw_stacks(100_000).scenario(), 100_000):
        clusters = perceive(simulated.frame)
    assert clusters.counts.clustered == len(row["cells_m"])
    found = row["methods"]["HDBSCAN"]
    assert len(clusters) == found["clusters"]
    np.testing.assert_allclose(np.sort(clusters.radius_m), np.sort([r for *_, r in found["circles_m"]]), atol=1e-3)


def scene_row(seed: int, outcomes: list[str | None], area: float) -> dict:
    scored = {"noise_share": 0.0, "clusters": 2, "area_m2": area, "split_area_m2": area}
    methods = {name: scored | {"outcomes": ["found", "found", None]} for name in fig2.METHODS}
    methods["DBSCAN, eps 0.7 m"] = scored | {"outcomes": outcomes}
    return {"seed": seed, "kinds": ["row", "row", "posts"], "cells_m": [], "methods": methods}


def test_counts_and_paired_differences():
    rows = [
        scene_row(seed, ["merged", "merged", None] if seed % 2 else ["found", "found", None], 3.0) for seed in range(12)
    ]
    document = fig2.summarise(rows)
    found = document["methods"]["DBSCAN, eps 0.7 m"]
    assert found["counts"] == {"found": 12, "merged": 12, "split": 0, "missed": 0}
    assert found["found_share"]["value"] == 0.5
    assert document["by_kind"]["HDBSCAN"]["row"]["found"] == 24
    assert sum(document["by_kind"]["HDBSCAN"]["posts"].values()) == 0
    assert document["found_share_of_hdbscan_minus"]["DBSCAN, eps 0.7 m"]["mean"] == pytest.approx(0.5)
    text = fig2.markdown(document)
    assert re.search(r"- DBSCAN, eps 0.7 m: \+50.0 .*: more", text)
    assert text.count("no difference shown") == 3
