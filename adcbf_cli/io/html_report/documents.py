"""The reports that other commands left in a run folder, checked as far as a page relies on them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError

from adcbf_cli.core.config import PlanningConfig, ReplayConfig, VehicleConfig
from adcbf_cli.core.errors import AdcbfError
from adcbf_cli.io.settings import first_problem


def _known(interval: tuple[float | None, float | None] | None) -> tuple[float | None, float | None] | None:
    return None if interval is None or None in interval else interval


Interval = Annotated[tuple[float | None, float | None] | None, AfterValidator(_known)]
"""None too where an end is not known."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)


class _Score(_Part):
    value: float | None
    unit: str
    n: int
    sample: str
    definition: str
    interval_95: Interval = None


class _Truth(_Part):
    source: str
    labels: int
    objects: int


class _Basis(_Part):
    truth: _Truth | None = None
    config: dict[str, Any]


class _Document(_Part):
    schema_version: Literal[1]
    warnings: list[str] = []
    thresholds_missed: list[str] = []


class Evaluation(_Document):
    """report.json of `adcbf evaluate`."""

    metrics: dict[str, _Score]
    basis: _Basis


class _Declared(_Part):
    unit: str
    better: str
    window: str
    definition: str


class _Total(_Part):
    value: float | None
    n: int
    n_missing: int
    interval_95: Interval


class _Paired(_Part):
    value: float | None
    n_pairs: int
    interval_95: Interval


class _Planner(_Part):
    drives: int
    metrics: dict[str, _Total]
    differences: dict[str, _Paired]


class _Comparison(_Part):
    kind: Literal["replay", "plan"]
    against: str | None
    metrics: dict[str, _Declared]
    planners: dict[str, _Planner]


class _Route(_Part):
    length_m: float
    speed_mps: float
    goal_m: tuple[float, float]


class _Settings(_Part):
    vehicle: VehicleConfig
    planning: PlanningConfig
    replay: ReplayConfig


class Driving(_Document):
    """report.json of `adcbf plan` and `adcbf replay`. reference_m: the path to follow, not in older reports."""

    counterfactual: str | None
    world: str
    route: _Route
    reference_m: list[tuple[float, float]] = []
    config: _Settings
    counters: dict[str, int] = {}
    comparison: _Comparison


def read_document(path: Path, kind: type[Evaluation] | type[Driving], remake: str) -> dict[str, Any] | None:
    """What a page takes of a report, as plain data, or None where there is no report. AdcbfError where it is none that
    this adcbf reads; `remake` is the command that writes it."""
    try:
        return kind.model_validate_json(path.read_bytes()).model_dump(mode="json")
    except FileNotFoundError:
        return None
    except ValidationError as error:
        reason = first_problem(error)
        raise AdcbfError(f"{path}: not a report that this adcbf reads ({reason}); make it again: {remake}") from None
