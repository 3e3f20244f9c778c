"""Where Patchwork++ has no package, the plane does its work, and a warning says so."""

from __future__ import annotations

import numpy as np
import pytest

from adcbf_cli.core.config import PerceptionConfig
from adcbf_cli.core.perception import ground
from adcbf_cli.core.types import Notes


def test_the_plane_stands_in_with_a_warning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ground, "find_spec", lambda name: None)
    notes = Notes()
    removal = ground.GroundRemoval(PerceptionConfig(), notes)
    grid = np.stack(np.meshgrid(np.arange(-5, 5, 0.2), np.arange(-5, 5, 0.2)), axis=-1).reshape(-1, 2)
    floor = np.column_stack([grid, np.full(len(grid), -1.0)])
    post = np.column_stack([np.full((20, 2), 2.0), np.linspace(-0.8, 0.2, 20)])
    heights = removal.heights(np.vstack([floor, post]))
    assert np.isneginf(heights[: len(floor)]).all()
    np.testing.assert_allclose(heights[len(floor) :], post[:, 2] + 1.0, atol=0.05)
    assert "plane" in notes.warnings[0]
