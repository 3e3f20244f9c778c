"""Random numbers for simulation: one independent generator for each purpose and frame, so that a
change to one (a lower dropout rate, a longer log) leaves all the others as they were."""

from __future__ import annotations

import enum

import numpy as np


class Purpose(enum.IntEnum):
    TERRAIN = 0
    SHAPES = 1
    RANGING = 2
    ODOMETRY = 3
    SCENE = 4


def generator(seed: int, purpose: Purpose, index: int = 0) -> np.random.Generator:
    """The generator for the index-th use of a purpose."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(purpose), index)))
