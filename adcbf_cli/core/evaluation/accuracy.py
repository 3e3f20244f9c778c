"""Centres against truth: errors of matched clusters and tracks, the clustering-centre bias in them, and
how honest a filter's covariance is.

A LiDAR sees one side of a thing, so the centre of what it sees lies nearer than the thing's
centre. That bias is no tracking error and does not average out; it is measured here per object,
along and across the line of sight and in the object's body axes, and errors are reported before
and after its removal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from adcbf_cli.core.evaluation.blocks import BlockSums
from adcbf_cli.core.evaluation.formulas import (
    COVERAGE_LEVELS,
    bearing,
    covered,
    ellipse_threshold,
    mahalanobis2,
    nees_bounds,
    rotate,
)
from adcbf_cli.core.evaluation.report import Metric, block_metric
from adcbf_cli.core.evaluation.scene import FrameObjects, Scene
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

SAMPLE = "matched object and frame"
SECTORS = 12
MIN_SECTOR_SAMPLES = 10
"""A sector with fewer samples has no mean of its own worth removing."""


@dataclass(frozen=True, slots=True)
class Bias:
    """Mean errors of one object's centre, metres: along the line of sight (positive is farther from
    the sensor) and across it (positive is to the left); in the object's axes, NaN where its yaw is
    unknown; and in its axes by the side it is seen from, one row for each of SECTORS equal sectors
    of the sensor's azimuth around the object, counted from its front, with their sample counts."""

    sight_m: FloatArray
    body_m: FloatArray
    aspect_m: FloatArray
    aspect_n: IntArray


class Accuracy:
    """Pairs of every frame, kept as compact arrays: `add`, then `finish`, then the results.

    prefix: of the metrics' names. what: is paired with objects, for the definitions.
    """

    def __init__(self, scene: Scene, prefix: str, what: str) -> None:
        self._scene = scene
        self._prefix = prefix
        self._what = what
        self._parts: list[tuple[Any, ...]] = []
        self.biases: dict[int, Bias] = {}

    def add(
        self,
        objects: FrameObjects,
        estimate_id: IntArray,
        estimate_m: FloatArray,
        covariance_m2: FloatArray,
        stamp_ns: int,
        world_from_sensor: FloatArray,
    ) -> None:
        """One frame's k pairs: object i was taken to be at estimate_m[i] (k, 2), with covariance (k, 2, 2)
        (NaN where there is none), by the track or cluster of this id."""
        true_m = objects.position_m[:, :2]
        sensor_m = np.broadcast_to(world_from_sensor[:2, 3], true_m.shape)
        self._parts.append(
            (
                objects.object_id,
                estimate_id,
                self._scene.blocks(objects.object_id, stamp_ns),
                estimate_m - true_m,
                covariance_m2,
                bearing(sensor_m, true_m),
                objects.yaw_rad,
            )
        )

    def finish(self) -> None:
        """Joins the frames and measures each object's bias."""
        if self._parts:
            joined = [np.concatenate(column) for column in zip(*self._parts, strict=True)]
        else:
            shapes: list[tuple[int, ...]] = [(0,), (0,), (0,), (0, 2), (0, 2, 2), (0,), (0,)]
            joined = [np.zeros(s, dtype=np.int64 if i < 3 else np.float64) for i, s in enumerate(shapes)]
        self.object_id, self._estimate_id, self._blocks, self.error_m, self._cov, self._bearing, self._yaw = joined
        self._sight = rotate(self.error_m, -self._bearing)
        self._body = rotate(self.error_m, -self._yaw)
        aspect = (self._bearing + np.pi - self._yaw) % (2 * np.pi)  # where the sensor is, from the object's front
        self._oriented = np.isfinite(self._yaw)
        self._sector = np.where(self._oriented, aspect // (2 * np.pi / SECTORS), 0).astype(np.int64) % SECTORS
        for i in np.unique(self.object_id).tolist():
            self.biases[i] = self._bias(self.object_id == i)

    def _bias(self, mine: BoolArray) -> Bias:
        oriented = mine & self._oriented
        body = self._body[oriented].mean(axis=0) if oriented.any() else np.full(2, np.nan)
        count = np.bincount(self._sector[oriented], minlength=SECTORS)
        sums = [np.bincount(self._sector[oriented], self._body[oriented, axis], SECTORS) for axis in (0, 1)]
        enough = (count >= MIN_SECTOR_SAMPLES)[:, None]
        by_aspect = np.where(enough, np.stack(sums, axis=1) / np.maximum(count, 1)[:, None], np.nan)
        return Bias(self._sight[mine].mean(axis=0), body, by_aspect, count)

    def corrected(self) -> dict[str, FloatArray]:
        """Errors (k, 2) in world axes after removal of each object's mean: in the line of sight's
        axes ("sight"), in the object's ("body"), in the object's by sector of aspect ("aspect")."""
        by_sector = np.array([self.biases[i].aspect_m for i in self.object_id.tolist()]).reshape(-1, SECTORS, 2)
        aspect = np.nan_to_num(by_sector[np.arange(len(by_sector)), self._sector])
        return {
            "sight": self.error_m - rotate(self._table("sight_m"), self._bearing),
            "body": self.error_m - rotate(self._table("body_m"), self._yaw),
            "aspect": self.error_m - rotate(aspect, self._yaw),
        }

    def _table(self, name: str) -> FloatArray:
        rows = [getattr(self.biases[i], name) for i in self.object_id.tolist()]
        return np.array(rows).reshape(-1, 2)

    def metrics(self, consistency: bool) -> dict[str, Metric]:
        """consistency: also how honest the covariances are."""
        sums = BlockSums()
        errors = {"": self.error_m, **{f"{k}_corrected_": v for k, v in self.corrected().items()}}
        for prefix, error in errors.items():
            square = error**2
            sums.add(
                self._blocks, {f"{prefix}x": square[:, 0], f"{prefix}y": square[:, 1], f"{prefix}xy": square.sum(1)}
            )
        result = self._rmse(sums) | self._bias_metrics(sums)
        if consistency:
            nees = mahalanobis2(self.error_m, self._cov)
            sums.add(self._blocks, {"nees": nees, "sight_nees": mahalanobis2(errors["sight_corrected_"], self._cov)})
            for level in COVERAGE_LEVELS:
                sums.add(self._blocks, {f"{level}": covered(nees, ellipse_threshold(level))})
            result |= self._consistency(sums)
        return result

    def _rmse(self, sums: BlockSums) -> dict[str, Metric]:
        base = (
            f"root mean square of the {self._what}'s centre minus the object's, all matched pairs of object and frame"
        )
        after = {
            "": "",
            "sight_corrected_": "; after removal of each object's mean error along and across the line of sight "
            "(2 numbers an object, from these same samples)",
            "body_corrected_": "; after removal of each object's mean error in its own axes (2 numbers an object, "
            "from these same samples); objects of known yaw",
            "aspect_corrected_": "; after removal, for each object and each 30 degree sector of the side it is seen "
            f"from, of the mean error in its own axes, where a sector has {MIN_SECTOR_SAMPLES} samples (2 numbers a "
            "sector, from these same samples); objects of known yaw",
        }
        axes = {"x": ("rmse_{}x_m", ", along world x"), "y": ("rmse_{}y_m", ", along world y"), "xy": ("rmse_{}m", "")}
        result = {}
        for prefix, suffix in after.items():
            for key, (name, axis) in axes.items():
                result[f"{self._prefix}.{name.format(prefix)}"] = block_metric(
                    sums, prefix + key, "m", SAMPLE, base + axis + suffix, "root_mean"
                )
        return result

    def _consistency(self, sums: BlockSums) -> dict[str, Metric]:
        texts = {
            "nees": "mean of e' P^-1 e over x and y; 2 for a consistent filter. Bounds hold for independent samples, "
            "which neighbouring frames are not",
            "sight_nees": "the same after removal of each object's mean error along and across the line of sight",
        }
        names = {"nees": f"{self._prefix}.nees", "sight_nees": f"{self._prefix}.nees_sight_corrected"}
        result = {
            name: block_metric(sums, key, "1", SAMPLE, texts[key], bounds=nees_bounds(sums.count(key)))
            for key, name in names.items()
        }
        for level in COVERAGE_LEVELS:
            text = f"share of true centres within the track's {level:.0%} ellipse; {level:g} for a consistent filter"
            result[f"{self._prefix}.coverage_{level * 100:g}"] = block_metric(sums, f"{level}", "1", SAMPLE, text)
        return result

    def _bias_metrics(self, sums: BlockSums) -> dict[str, Metric]:
        columns = {
            "along": (self._sight[:, 0], "along the line of sight; negative is towards the sensor"),
            "across": (self._sight[:, 1], "across the line of sight; positive is to its left"),
            "body_x": (self._body[:, 0], "along the object's own x axis; objects of known yaw"),
            "body_y": (self._body[:, 1], "along the object's own y axis; objects of known yaw"),
        }
        sums.add(self._blocks, {f"bias_{name}": values for name, (values, _) in columns.items()})
        base = f"mean of the {self._what}'s centre minus the object's"
        return {
            f"{self._prefix}.bias_{name}_m": block_metric(sums, f"bias_{name}", "m", SAMPLE, f"{base} {text}")
            for name, (_, text) in columns.items()
        }

    def object_errors(self) -> dict[int, dict[str, Any]]:
        """For the table of objects: how many ids each had, and its errors."""
        corrected = self.corrected()["sight"]
        result: dict[int, dict[str, Any]] = {}
        for i in self.biases:
            mine = self.object_id == i
            result[i] = {
                "ids": len(np.unique(self._estimate_id[mine])),
                "rmse_m": float(np.sqrt((self.error_m[mine] ** 2).sum(axis=1).mean())),
                "rmse_sight_corrected_m": float(np.sqrt((corrected[mine] ** 2).sum(axis=1).mean())),
            }
        return result

    def object_biases(self) -> dict[int, dict[str, Any]]:
        """For the table of objects: each one's bias, null where its yaw is unknown."""
        result: dict[int, dict[str, Any]] = {}
        for i, bias in self.biases.items():
            body = [float(x) if np.isfinite(x) else None for x in bias.body_m]
            result[i] = {
                "bias_along_m": float(bias.sight_m[0]),
                "bias_across_m": float(bias.sight_m[1]),
                "bias_body_x_m": body[0],
                "bias_body_y_m": body[1],
                "bias_by_aspect": [
                    {"from_deg": k * 360 // SECTORS, "n": int(n), "body_x_m": float(at[0]), "body_y_m": float(at[1])}
                    for k, (n, at) in enumerate(zip(bias.aspect_n, bias.aspect_m, strict=True))
                    if n >= MIN_SECTOR_SAMPLES
                ],
            }
        return result
