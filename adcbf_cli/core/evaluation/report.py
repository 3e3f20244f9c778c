"""What an evaluation found: metrics by flat name, each with its unit, its number of samples and
its definition."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from adcbf_cli.core.evaluation.blocks import Blocks, BlockSums, Form

SCHEMA_VERSION = 1


@dataclass(frozen=True, slots=True)
class Metric:
    """One number. value: None where there is no evidence. n: samples behind it, named by `sample`.

    interval: 95 % bootstrap interval, where one was drawn. bounds: where a consistent filter's
    value lies with 95 % probability, for metrics that have such bounds. blocks: what the value is made of,
    where it can be cut into stretches of the log.
    """

    value: float | None
    unit: str
    n: int
    sample: str
    definition: str
    interval: tuple[float, float] | None = None
    bounds: tuple[float, float] | None = None
    blocks: Blocks | None = field(default=None, repr=False, compare=False)

    def to_dict(self) -> dict[str, Any]:
        document: dict[str, Any] = {
            "value": _finite(self.value),
            "unit": self.unit,
            "n": self.n,
            "sample": self.sample,
            "definition": self.definition,
        }
        if self.interval is not None:
            document["interval_95"] = [_finite(x) for x in self.interval]
        if self.bounds is not None:
            document["bounds_95"] = [_finite(x) for x in self.bounds]
        return document


def block_metric(
    sums: BlockSums,
    name: str,
    unit: str,
    sample: str,
    definition: str,
    form: Form = "mean",
    bounds: tuple[float, float] | None = None,
) -> Metric:
    """What `sums` holds under this name as a metric, with its interval and its blocks."""
    return Metric(
        sums.value(name, form),
        unit,
        sums.count(name),
        sample,
        definition,
        interval=sums.interval(name, form),
        bounds=bounds,
        blocks=sums.blocks(name, form),
    )


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


@dataclass(slots=True)
class Report:
    """Metrics in the order they are shown, one row an object, and what the numbers rest on."""

    metrics: dict[str, Metric] = field(default_factory=dict)
    objects: list[dict[str, Any]] = field(default_factory=list)
    basis: dict[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able, the content of report.json."""
        return {
            "schema_version": SCHEMA_VERSION,
            "basis": self.basis,
            "metrics": {name: metric.to_dict() for name, metric in self.metrics.items()},
            "objects": self.objects,
        }
