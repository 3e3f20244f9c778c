"""`score_blocks.parquet`: what was written is read again, and what is not understood is left alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.evaluation.blocks import Blocks, Form
from adcbf_cli.core.evaluation.report import Metric
from adcbf_cli.io.report import JSON_NAME
from adcbf_cli.io.score_blocks import read_score_blocks, write_score_blocks

BLOCKS = Blocks(np.array([2, 5]), np.array([1.0, -3.0]), np.array([4.0, 0.0]), True, "mean")


def write(folder: Path, *forms: Any) -> None:
    (folder / JSON_NAME).write_text("{}")
    metrics = {f"m{i}": Metric(1.0, "1", 4, "frame", "", blocks=replace(BLOCKS, form=f)) for i, f in enumerate(forms)}
    write_score_blocks(folder, metrics | {"none": Metric(1.0, "1", 4, "frame", "")})


def test_blocks_are_read_as_they_were_written(tmp_path: Path) -> None:
    forms: tuple[Form, ...] = ("mean", "root_mean", "total")
    write(tmp_path, *forms)
    found = read_score_blocks(tmp_path)
    assert list(found) == ["m0", "m1", "m2"]
    for blocks, form in zip(found.values(), forms, strict=True):
        assert (blocks.form, blocks.dealt) == (form, True)
        assert [blocks.keys.tolist(), blocks.sums.tolist(), blocks.counts.tolist()] == [[2, 5], [1.0, -3.0], [4.0, 0.0]]


@pytest.mark.parametrize("form", ["median", "", None])
def test_a_form_of_another_version_is_not_guessed_at(tmp_path: Path, form: str | None) -> None:
    write(tmp_path, "mean", form)
    assert read_score_blocks(tmp_path) == {}
