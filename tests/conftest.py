"""Shared fixtures. Real logs are never part of the project: tests that want them skip where they are absent."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent


@pytest.fixture
def real_data() -> Callable[[str], Path]:
    """`real_data("kitti0000/kitti0000_a.mcap")` gives that file's path, or skips the test, visibly."""
    root = Path(os.environ.get("ADCBF_REAL_DATA", PROJECT.parent / "shared" / "data"))

    def find(name: str) -> Path:
        path = root / name
        if not path.exists():
            pytest.skip(f"real log {name} is not here (set ADCBF_REAL_DATA)")
        return path

    return find


@pytest.fixture
def sample_data() -> Path:
    """The folder with the project's own simulated log."""
    return PROJECT / "sample_data"
