"""The scenes of Fig. 2: obstacles of different density and shape around a standing LiDAR, drawn by a seed.

The paper says what its figure shows - complex stacking, small intervals, obstacles of very different length and
width - but gives no sizes. Each scene has one group of each kind below, each in a sector of its own:

    row     three boxes side by side, near, 0.2 to 0.8 m apart
    stack   boxes that touch one another, one obstacle, and two loose ones 0.3 to 0.8 m beside it
    person  a person 0.4 to 0.8 m in front of a wall of 3 m
    rocks   four rocks of different size, 0.3 to 0.9 m apart
    posts   four thin trunks, far, 0.5 to 1.2 m apart
    wall    a wall that runs away from the sensor, so that its points grow sparse along it

Gaps are drawn from about the shortest at which the package's HDBSCAN tells clusters apart (0.3 m) to near the widest
that it joins (1 m).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.types import FloatArray

KINDS = ("row", "stack", "person", "rocks", "posts", "wall")
SCANS = 5
"""The last one is clustered: ground removal has then seen the ground."""

LIDAR: dict[str, Any] = {
    "kind": "spinning",
    "channels": 16,
    "azimuth_step_deg": 0.4,
    "instantaneous": True,
    "range_sigma_m": 0.02,
    "max_range_m": 20.0,
}
TERRAIN: dict[str, Any] = {"kind": "bumps", "size_m": 50, "amplitude_m": 0.05, "wavelength_m": 3.0}


@dataclass
class Stacks:
    """A scene under way: what stands, what moves (the person, who stands too), and each one's obstacle.

    unit_of: by the object's place in its list, the number of the obstacle that it belongs to.
    kinds: each obstacle's kind.
    """

    objects: list[dict[str, Any]] = field(default_factory=list)
    object_unit: list[int] = field(default_factory=list)
    movers: list[dict[str, Any]] = field(default_factory=list)
    mover_unit: list[int] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)

    def stand(self, kind: str, thing: dict[str, Any], same: bool = False) -> None:
        """Adds something that stands, as a new obstacle or as a part of the last one."""
        if not same:
            self.kinds.append(kind)
        self.objects.append(thing)
        self.object_unit.append(len(self.kinds) - 1)

    def unit_of_id(self) -> list[int]:
        """By truth id (movers first), the obstacle's number."""
        return [*self.mover_unit, *self.object_unit]

    def scenario(self) -> Scenario:
        return Scenario.model_validate(
            {
                "duration_s": SCANS / 10,
                "terrain": TERRAIN,
                "objects": self.objects,
                "movers": self.movers,
                "ego": {"path": {"kind": "stand", "at_m": [0, 0]}},
                "lidar": LIDAR,
            }
        )


def draw_stacks(seed: int) -> Stacks:
    """The scene of this seed."""
    rng = np.random.default_rng(seed)
    scene = Stacks()
    turn = rng.uniform(0, 360)
    for sector, kind in enumerate(rng.permutation(KINDS)):
        _GROUPS[str(kind)](scene, rng, turn + 360 / len(KINDS) * sector)
    return scene


def _place(azimuth_deg: float, away_m: float, across_m: float) -> list[float]:
    """The point at a distance in a direction, and to the left of it."""
    angle = np.deg2rad(azimuth_deg)
    forward, left = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    spot: FloatArray = away_m * forward + across_m * left
    return [round(float(value), 4) for value in spot]


def _box(
    rng: np.random.Generator, azimuth_deg: float, at_m: list[float], width_m: float, depth_m: float
) -> dict[str, Any]:
    size = [round(depth_m, 4), round(width_m, 4), round(float(rng.uniform(0.6, 1.4)), 4)]
    return {"kind": "box", "at_m": at_m, "size_m": size, "yaw_deg": round(azimuth_deg, 4)}


def _row(scene: Stacks, rng: np.random.Generator, azimuth_deg: float) -> None:
    away, widths, gaps = rng.uniform(3.5, 5.0), rng.uniform(0.4, 0.7, 3), rng.uniform(0.2, 0.8, 2)
    left = -(widths.sum() + gaps.sum()) / 2
    for width, gap in zip(widths, [*gaps, 0.0], strict=True):
        spot = _place(azimuth_deg, away + rng.uniform(0.0, 0.3), left + width / 2)
        scene.stand("row", _box(rng, azimuth_deg, spot, float(width), float(rng.uniform(0.4, 0.8))))
        left += width + gap


def _stack(scene: Stacks, rng: np.random.Generator, azimuth_deg: float) -> None:
    away, widths = rng.uniform(4.5, 6.0), rng.uniform(0.4, 0.7, 3)
    edge = -widths.sum() / 2
    ends = ((-1, edge), (1, -edge))
    for part, width in enumerate(widths):
        depth = rng.uniform(0.4, 1.2)
        spot = _place(azimuth_deg, away + depth / 2 + rng.uniform(0.0, 0.3), edge + width / 2)
        scene.stand("stack", _box(rng, azimuth_deg, spot, float(width), float(depth)), same=part > 0)
        edge += width
    for side, start in ends:
        width = rng.uniform(0.3, 0.5)
        spot = _place(azimuth_deg, away + rng.uniform(0.2, 0.6), start + side * (rng.uniform(0.3, 0.8) + width / 2))
        scene.stand("stack", _box(rng, azimuth_deg, spot, float(width), float(width)))


def _person(scene: Stacks, rng: np.random.Generator, azimuth_deg: float) -> None:
    away = rng.uniform(4.0, 6.0)
    ends = [_place(azimuth_deg, away, side * 1.5) for side in (-1, 1)]
    scene.stand("person", {"kind": "wall", "from_m": ends[0], "to_m": ends[1], "height_m": 1.8})
    before = 0.1 + 0.15 + rng.uniform(0.4, 0.8)  # half the wall's thickness, half the person's depth
    spot = _place(azimuth_deg, away - before, rng.uniform(-1.0, 1.0))
    scene.kinds.append("person")
    scene.movers.append({"kind": "person", "path": {"kind": "stand", "at_m": spot, "yaw_deg": round(azimuth_deg, 4)}})
    scene.mover_unit.append(len(scene.kinds) - 1)


def _rocks(scene: Stacks, rng: np.random.Generator, azimuth_deg: float) -> None:
    away, sizes, gaps = rng.uniform(6.0, 8.0), rng.uniform(0.4, 0.8, 4), rng.uniform(0.3, 0.9, 3)
    left = -(sizes.sum() + gaps.sum()) / 2
    for size, gap in zip(sizes, [*gaps, 0.0], strict=True):
        spot = _place(azimuth_deg, away + rng.uniform(-0.3, 0.3), left + size / 2)
        shape = [round(float(size), 4), round(float(size), 4), round(float(rng.uniform(0.5, 1.0)), 4)]
        scene.stand("rocks", {"kind": "rock", "at_m": spot, "size_m": shape, "yaw_deg": round(azimuth_deg, 4)})
        left += size + gap


def _posts(scene: Stacks, rng: np.random.Generator, azimuth_deg: float) -> None:
    away, radii, gaps = rng.uniform(6.5, 8.0), rng.uniform(0.06, 0.15, 4), rng.uniform(0.5, 1.2, 3)
    left = -(2 * radii.sum() + gaps.sum()) / 2
    for radius, gap in zip(radii, [*gaps, 0.0], strict=True):
        spot = _place(azimuth_deg, away + rng.uniform(-0.3, 0.3), left + radius)
        trunk = {"kind": "tree", "at_m": spot, "trunk_radius_m": round(float(radius), 4), "crown_radius_m": 0.5}
        scene.stand("posts", trunk)
        left += 2 * radius + gap


def _wall(scene: Stacks, rng: np.random.Generator, azimuth_deg: float) -> None:
    beside, tilt = rng.choice((-1.0, 1.0)) * rng.uniform(0.6, 1.2), rng.uniform(-0.3, 0.3)
    near, far = rng.uniform(4.0, 5.0), rng.uniform(8.5, 10.0)
    ends = [_place(azimuth_deg, near, beside), _place(azimuth_deg, far, beside + tilt)]
    scene.stand("wall", {"kind": "wall", "from_m": ends[0], "to_m": ends[1], "height_m": 1.8})


_GROUPS = {"row": _row, "stack": _stack, "person": _person, "rocks": _rocks, "posts": _posts, "wall": _wall}
