"""Predictions against where things went: displacement errors by horizon, consistency, coverage.

Two references use the same measures: ground truth, and, without any, where the same track was
later seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from adcbf_cli.core.evaluation.blocks import BlockSums
from adcbf_cli.core.evaluation.formulas import (
    COVERAGE_LEVELS,
    covered,
    ellipse_threshold,
    mahalanobis2,
    nees_bounds,
)
from adcbf_cli.core.evaluation.report import Metric, block_metric
from adcbf_cli.core.types import FloatArray, IntArray, Predictions

STEP_SAMPLE = "prediction and step"
SAMPLE = "prediction"


def target_stamps(predictions: Predictions) -> IntArray:
    """(N,) the stamps that a record's steps are for, int64 ns."""
    steps = predictions.position_m.shape[1]
    ahead_ns = np.round(np.arange(1, steps + 1) * predictions.step_s * 1e9).astype(np.int64)
    targets: IntArray = predictions.stamp_ns + ahead_ns
    return targets


@dataclass(frozen=True, slots=True)
class Reference:
    """What predictions are held against. name: the metrics' prefix. what: for definitions.
    corrections: further error sets, by the name that goes into the metric, with their definition."""

    name: str
    what: str
    corrections: Mapping[str, str]


class ForecastScore:
    """Running sums over predictions; nothing but sums is kept."""

    def __init__(self, reference: Reference, horizons_s: tuple[float, ...], own_ids: bool = False) -> None:
        """own_ids: as in `BlockSums`."""
        self._reference = reference
        self._horizons_s = horizons_s
        self._sums = BlockSums(own_ids)
        self._steps_s: set[float] = set()
        self._longest_s = 0.0

    def add(
        self,
        predictions: Predictions,
        rows: IntArray,
        blocks: IntArray,
        error_m: FloatArray,
        corrected_m: Mapping[str, FloatArray],
    ) -> None:
        """One frame: predictions `rows` (p,), their errors (p, N, 2), NaN where the thing's position is
        unknown, and the same after each correction."""
        distance = np.hypot(error_m[..., 0], error_m[..., 1])
        nees = mahalanobis2(error_m, predictions.covariance_m2[rows])
        quantities = {"x": error_m[..., 0] ** 2, "y": error_m[..., 1] ** 2}
        for name, corrected in corrected_m.items():
            quantities |= {f"{name}x": corrected[..., 0] ** 2, f"{name}y": corrected[..., 1] ** 2}
        coverage = self._coverage(predictions, rows, distance, nees)
        quantities |= coverage
        self._longest_s = max(self._longest_s, distance.shape[1] * predictions.step_s)
        for horizon_s in self._horizons_s:
            step = round(horizon_s / predictions.step_s) - 1
            if not 0 <= step < distance.shape[1]:
                continue
            tag = f".{horizon_s:.1f}s"
            quantities |= {f"{name}{tag}": values[:, step] for name, values in coverage.items()}
            quantities |= {f"{axis}{tag}": quantities[axis][:, step] for axis in "xy"}
            quantities[f"fde{tag}"] = distance[:, step]
            quantities[f"ade{tag}"] = distance[:, : step + 1].mean(axis=1)  # NaN unless every step is known
            quantities[f"nees{tag}"] = nees[:, step]
        self._sums.add(blocks, quantities)

    @staticmethod
    def _coverage(
        predictions: Predictions, rows: IntArray, distance: FloatArray, nees: FloatArray
    ) -> dict[str, FloatArray]:
        result = {f"coverage_{p * 100:g}": covered(nees, ellipse_threshold(p)) for p in COVERAGE_LEVELS}
        radii = {
            "coverage_sigma_radius": predictions.sigma_radius_m[rows],
            "coverage_conformal_radius": predictions.conformal_radius_m[rows],
        }
        for name, radius in radii.items():
            excess = np.where(np.isnan(radius), np.nan, distance - radius)
            result[name] = covered(excess, 0.0)
        return result

    def metrics(self) -> dict[str, Metric]:
        what, prefix = self._reference.what, self._reference.name
        span = f"all steps up to {self._longest_s:g} s pooled"
        result: dict[str, Metric] = {}
        sets = {"": "", **self._reference.corrections}
        for correction, text in sets.items():
            for axis in "xy":
                definition = f"root mean square of predicted minus {what} position along world {axis}, {span}{text}"
                result[f"{prefix}.rmse_{correction}{axis}_m"] = self._root(
                    f"{correction}{axis}", STEP_SAMPLE, definition
                )
        for horizon_s in self._horizons_s:
            result |= self._at_horizon(f".{horizon_s:.1f}s", f"{horizon_s:g} s ahead")
        for name, text in _coverage_texts(what).items():
            result[f"{prefix}.{name}"] = self._plain(name, "1", STEP_SAMPLE, f"{text}, {span}")
        return result

    def _at_horizon(self, tag: str, when: str) -> dict[str, Metric]:
        what, prefix = self._reference.what, self._reference.name
        result = {
            f"{prefix}.ade_m{tag}": self._plain(
                f"ade{tag}", "m", SAMPLE, f"mean distance of predicted from {what} position over all steps to {when}"
            ),
            f"{prefix}.fde_m{tag}": self._plain(
                f"fde{tag}", "m", SAMPLE, f"mean distance of predicted from {what} position {when}"
            ),
        }
        for axis in "xy":
            text = f"root mean square of predicted minus {what} position along world {axis}, {when}"
            result[f"{prefix}.rmse_{axis}_m{tag}"] = self._root(f"{axis}{tag}", SAMPLE, text)
        text = (
            f"mean of e' P^-1 e over x and y {when}; 2 if the covariance is right. Bounds hold for independent samples"
        )
        bounds = nees_bounds(self._sums.count(f"nees{tag}"))
        result[f"{prefix}.nees{tag}"] = block_metric(self._sums, f"nees{tag}", "1", SAMPLE, text, bounds=bounds)
        for name, text in _coverage_texts(what).items():
            result[f"{prefix}.{name}{tag}"] = self._plain(f"{name}{tag}", "1", SAMPLE, f"{text}, {when}")
        return result

    def _plain(self, key: str, unit: str, sample: str, definition: str) -> Metric:
        return block_metric(self._sums, key, unit, sample, definition)

    def _root(self, key: str, sample: str, definition: str) -> Metric:
        return block_metric(self._sums, key, "m", sample, definition, "root_mean")


def _coverage_texts(what: str) -> dict[str, str]:
    texts = {
        f"coverage_{p * 100:g}": f"share of {what} positions within the predicted {p:.0%} ellipse"
        for p in COVERAGE_LEVELS
    }
    texts["coverage_sigma_radius"] = f"share of {what} positions within sigma_radius_m of the predicted one"
    texts["coverage_conformal_radius"] = f"share of {what} positions within conformal_radius_m of the predicted one"
    return texts
