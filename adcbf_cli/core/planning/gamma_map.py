"""Gamma over distance and radius (the paper's Fig. 4a), for planners that adapt it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from adcbf_cli.core.config import PlanningConfig
from adcbf_cli.core.planning.barrier import AdaptiveGamma, gamma_at
from adcbf_cli.core.planning.presets import PLANNERS, MpcPreset
from adcbf_cli.core.types import FloatArray

DISTANCE_M = np.linspace(0.0, 5.0, 101)
RADIUS_M = np.linspace(0.1, 1.2, 23)


def gamma_maps(names: Iterable[str], planning: PlanningConfig) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """By planner: centre distances (d,), obstacle radii (r,), both in m, and gamma (d, r)."""
    maps = {}
    for name in names:
        preset = PLANNERS.get(name)
        gamma = preset.barrier(planning).gamma if isinstance(preset, MpcPreset) else None
        if isinstance(gamma, AdaptiveGamma):
            values = gamma_at(gamma, DISTANCE_M[:, None], RADIUS_M[None, :])
            maps[name] = DISTANCE_M, RADIUS_M, values
    return maps
