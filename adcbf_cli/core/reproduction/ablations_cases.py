"""What is varied in the ablations: each variant against the one that differs from it in nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from adcbf_cli.core.evaluation.scene_runs import SceneTask
from adcbf_cli.core.replay.sensor_loop import KnowledgeSource
from adcbf_cli.core.reproduction.drives import OURS, PLANNERS, config_with
from adcbf_cli.scenarios import scenario_text

SCENE = "crossings"
SPEED_RANGE = "speed_mps: {uniform: [0.2, 1.5]}"
"""The movers' speed as the scene's file has it."""

SPEEDS_MPS = (0.2, 0.5, 0.8, 1.1, 1.5)


@dataclass(frozen=True)
class Variant:
    """A planner, what is set besides the defaults, what it knows, and the speed of all movers (None: as the scene
    draws them)."""

    planner: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    knowledge: KnowledgeSource = "perfect"
    speed_mps: float | None = None

    @property
    def name(self) -> str:
        """Equal for equal variants: those that several groups share are run once."""
        settings = [f"{key}={value}" for key, value in sorted(self.settings.items())]
        speed = [] if self.speed_mps is None else [f"speed={self.speed_mps:g}"]
        return " ".join([self.planner, self.knowledge, *settings, *speed])

    def task(self, seed: int) -> SceneTask:
        text = scenario_text(SCENE)
        if self.speed_mps is not None:
            text = at_one_speed(text, self.speed_mps)
        return SceneTask(text, SCENE, seed, self.planner, config_with(self.settings), self.knowledge)


def at_one_speed(text: str, speed_mps: float) -> str:
    """The scene's text with one speed for all movers. Everything else is drawn as before: each random value
    has a generator of its own. ValueError where the text does not say the speed once, as expected."""
    if text.count(SPEED_RANGE) != 1:
        raise ValueError(f"the scene {SCENE} does not hold {SPEED_RANGE!r} once")
    return text.replace(SPEED_RANGE, f"speed_mps: {speed_mps:g}")


@dataclass(frozen=True)
class Group:
    """Variants that belong together, by label, each with what it is compared with (itself: the base)."""

    title: str
    note: str
    variants: Mapping[str, tuple[Variant, Variant]]


def _of_ours(settings: Mapping[str, Mapping[str, Any]], base: str) -> dict[str, tuple[Variant, Variant]]:
    """Variants of the paper's planner, with the default first."""
    default = Variant(OURS)
    return {base: (default, default)} | {label: (Variant(OURS, value), default) for label, value in settings.items()}


def _seen(settings: Mapping[str, Mapping[str, Any]]) -> dict[str, tuple[Variant, Variant]]:
    """Variants of the paper's planner with perception, the default first."""
    default = Variant(OURS, knowledge="perception")
    return {"default": (default, default)} | {
        label: (Variant(OURS, value, "perception"), default) for label, value in settings.items()
    }


def _pairs(first: str, second: str, changed: Mapping[str, Any]) -> dict[str, tuple[Variant, Variant]]:
    """Each planner as it is by default, then changed."""
    variants = {}
    for planner in PLANNERS:
        base = Variant(planner)
        variants[f"`{planner}`, {first}"] = (base, base)
        variants[f"`{planner}`, {second}"] = (Variant(planner, **changed), base)
    return variants


_ANY_BARRIER: dict[str, Any] = {"planning.accept_invalid_barrier": True}
_NO_CLIP: dict[str, Any] = {"planning.gamma_floor": None, "planning.gamma_ceiling": None}
_PRINTED_GAMMA = {"planning.gamma_form": "printed", **_NO_CLIP}
_PRINTED_BARRIER = {"planning.barrier_form": "printed"}
_HELD_TOO = {"planning.obstacle_set": "paper"}
_PREVIOUS = {"planning.gamma_at": "previous"}

GROUPS = (
    Group(
        "What perception costs",
        "Everything within 7 m is known with its true future, or seen by the planner's own LiDAR, clustered, tracked "
        "and predicted. The difference is perception minus perfect knowledge.",
        _pairs("perfect knowledge", "perception", {"knowledge": "perception"}),
    ),
    Group(
        "What the fallback ladder is worth",
        "With the ladder, a plan that breaks a barrier is driven only where, by what the planner believes, the body "
        "keeps the safety distance or comes no closer than it would by braking; else the vehicle brakes. Without it, "
        "every solution is driven.",
        _pairs("ladder", "none", {"settings": {"planning.fallback": "none"}}),
    ),
    Group(
        "The floor of gamma",
        "Equation 14 as a Gaussian distribution function is positive, so that no floor is the same as a floor of 0. "
        "The default is 0.05.",
        _of_ours(
            {
                "no floor": {"planning.gamma_floor": None, **_ANY_BARRIER},
                **{f"{floor:g}": {"planning.gamma_floor": floor, **_ANY_BARRIER} for floor in (0.02, 0.1, 0.2)},
            },
            "0.05 (default)",
        ),
    ),
    Group(
        "The formulas as printed",
        "Each instead of the form that is used by default (see the deviations from the paper): gamma of equation 14 "
        "with the divisor outside of erf and without a clip; the barrier dh >= -gamma instead of dh >= -gamma h; each "
        "moving obstacle twice, where it is and where it will be; gamma taken from the plan before instead of being a "
        "function inside the problem.",
        _of_ours(
            {
                "gamma as printed": {**_PRINTED_GAMMA, **_ANY_BARRIER},
                "barrier as printed": {**_PRINTED_BARRIER, **_ANY_BARRIER},
                "obstacles twice": _HELD_TOO,
                "gamma from the plan before": _PREVIOUS,
                "all four": {**_PRINTED_GAMMA, **_PRINTED_BARRIER, **_HELD_TOO, **_PREVIOUS, **_ANY_BARRIER},
            },
            "default",
        ),
    ),
    Group(
        "The horizon",
        "Plans and predictions over the same number of steps, of 0.1 s each.",
        _of_ours(
            {f"{steps} steps": {"planning.steps": steps, "prediction.steps": steps} for steps in (10, 20, 45)},
            "30 steps (default)",
        ),
    ),
    Group(
        "What is not in the paper",
        "With perception. By default obstacles are widened by the 95 % radius of their predicted position (sigma), and "
        "where a plan breaks a barrier or stands, sampled ways are tried too (three starts); the LiDAR's cloud is "
        "cropped to 16 x 16 m, and planners are told what is within 7 m.",
        _seen(
            {
                "no margin": {"planning.uncertainty": "none"},
                "conformal margin": {"planning.uncertainty": "conformal"},
                "two starts": {"planning.starts": 2},
                "the paper's 8 x 8 m": {"perception.range_m": 4.0, "replay.range_m": 4.0},
                "no margin, two starts": {"planning.uncertainty": "none", "planning.starts": 2},
            }
        ),
    ),
)


def at_speeds() -> dict[tuple[str, float], Variant]:
    """Each planner among movers that all have one speed."""
    return {(planner, speed): Variant(planner, speed_mps=speed) for planner in PLANNERS for speed in SPEEDS_MPS}


def all_variants() -> list[Variant]:
    """Each once, bases before what is compared with them."""
    grouped = [one for group in GROUPS for pair in group.variants.values() for one in reversed(pair)]
    return list({variant.name: variant for variant in (*grouped, *at_speeds().values())}.values())


def tasks_of(variants: Sequence[Variant], seeds: Sequence[int]) -> dict[str, tuple[str, SceneTask]]:
    """By run id, the variant's name and what is to be driven; seed by seed, so that what is left takes as long a
    run as what is done."""
    of_any_seed = {one.name: one.task(0) for one in variants}
    return {
        f"{name} seed {seed}": (name, replace(task, seed=seed)) for seed in seeds for name, task in of_any_seed.items()
    }
