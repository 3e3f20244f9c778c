"""Sums by block: means, and what of them another run on the same log can be paired with."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.evaluation import blocks
from adcbf_cli.core.evaluation.blocks import Blocks, BlockSums, block_keys

SECOND = 1_000_000_000


def filled(own_ids: bool, ids: list[int], stamps_s: list[int], values: list[float]) -> BlockSums:
    sums = BlockSums(own_ids)
    for i, stamp_s, value in zip(ids, stamps_s, values, strict=True):
        keys = block_keys(np.array([i]), np.array([stamp_s * SECOND]), 5 * SECOND)
        sums.add(keys, {"error": np.array([value])})
    return sums


def as_rows(found: Blocks | None) -> list[tuple[int, float, float]]:
    assert found is not None
    return list(zip(found.keys.tolist(), found.sums.tolist(), found.counts.tolist(), strict=True))


def test_a_block_is_an_object_and_a_stretch_of_time() -> None:
    found = filled(False, [1, 1, 1, 2], [0, 4, 5, 0], [1.0, 2.0, 4.0, 8.0]).blocks("error", "root_mean")
    assert as_rows(found) == [(1 << 32, 3.0, 2.0), ((1 << 32) + 1, 4.0, 1.0), (2 << 32, 8.0, 1.0)]
    assert found is not None
    assert (found.form, found.dealt) == ("root_mean", False)


def test_blocks_of_ids_that_no_other_run_has_are_stretches_of_time() -> None:
    """Whatever the tracker called its tracks, the blocks are the same."""
    stamps, values = [0, 4, 5, 0], [1.0, 2.0, 4.0, 8.0]
    one = filled(True, [1, 1, 1, 2], stamps, values).blocks("error")
    other = filled(True, [7, 9, 9, 3], stamps, values).blocks("error")
    assert as_rows(one) == as_rows(other) == [(0, 11.0, 3.0), (1, 4.0, 1.0)]


@pytest.mark.parametrize("own_ids", [False, True])
def test_dealt_blocks_keep_the_mean_and_hands_depend_on_the_block_alone(
    own_ids: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(blocks, "MAX_KEPT", 20)
    monkeypatch.setattr(blocks, "MAX_BLOCKS", 10)
    rng = np.random.default_rng(1)
    stamps, values = rng.integers(0, 1000, 300).tolist(), rng.random(300).tolist()
    ids = rng.integers(0, 5, 300).tolist()
    renamed = [10 - i for i in ids] if own_ids else ids
    one, other = filled(own_ids, ids, stamps, values), filled(own_ids, renamed[::-1], stamps[::-1], values[::-1])
    found, again = one.blocks("error"), other.blocks("error")
    assert found is not None
    assert again is not None
    assert found.dealt
    assert found.keys.tolist() == again.keys.tolist()
    assert found.counts.tolist() == again.counts.tolist()
    assert found.sums == pytest.approx(again.sums)
    assert found.sums.sum() / found.counts.sum() == pytest.approx(np.mean(values))
    assert one.value("error") == pytest.approx(np.mean(values))


def test_nothing_has_no_blocks() -> None:
    assert BlockSums().blocks("error") is None
    sums = BlockSums(own_ids=True)
    sums.add(block_keys(np.array([1]), np.array([0]), SECOND), {"error": np.array([np.nan])})
    assert sums.blocks("error") is None
    assert sums.value("error") is None


def test_a_sum_without_a_count_is_kept() -> None:
    """Two false tracks where nothing is labelled are errors all the same."""
    sums = BlockSums()
    sums.add_sums(3, {"mota": (4.0, 5), "nothing": (0.0, 0)})
    sums.add_sums(4, {"mota": (-2.0, 0), "nothing": (0.0, 0)})
    assert as_rows(sums.blocks("mota")) == [(3, 4.0, 5.0), (4, -2.0, 0.0)]
    assert sums.value("mota") == pytest.approx(2 / 5)
    assert sums.blocks("nothing") is None


def test_a_total_counts_blocks_in_which_nothing_was() -> None:
    sums = BlockSums()
    for block in range(3):
        sums.add_sums(block, {"switches": (float(block == 1), 10)})
    assert as_rows(sums.blocks("switches", "total")) == [(0, 0.0, 10.0), (1, 1.0, 10.0), (2, 0.0, 10.0)]
    assert sums.value("switches", "total") == 1.0


def test_sums_that_are_dealt_still_add_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(blocks, "MAX_KEPT", 20)
    monkeypatch.setattr(blocks, "MAX_BLOCKS", 10)
    rng = np.random.default_rng(7)
    errors, objects = rng.integers(-3, 4, 500), rng.integers(0, 3, 500)
    sums = BlockSums()
    for block, (error, count) in enumerate(zip(errors.tolist(), objects.tolist(), strict=True)):
        sums.add_sums(block // 3, {"mota": (error, count)})
    found = sums.blocks("mota")
    assert found is not None
    assert found.dealt
    assert len(found.keys) == 10
    assert (found.sums.sum(), found.counts.sum()) == (errors.sum(), objects.sum())
    assert sums.value("mota") == pytest.approx(errors.sum() / objects.sum())
    assert sums.value("mota", "total") == errors.sum()
