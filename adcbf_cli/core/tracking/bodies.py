"""What a track remembers of its obstacle's body, and where the body's centre is when part is seen.

A LiDAR sees the sides that face it. From behind, a car is its rear face; from beside, it is whole.
The centre of what is seen thus wanders over the body while both move past each other. Here each
track remembers two perpendicular axes of its body and the extent along each. Where a cluster is
shorter along an axis than remembered, the end that faces the sensor is real and the far end is
hidden: the centre is completed away from the sensor by half of what is missing. (Choosing the visible
reference point and deriving the centre from it is common practice in vehicle tracking: MacLachlan
and Mertz, Tracking of Moving Objects from a Moving Vehicle Using a Scanning Laser Rangefinder,
ITSC 2006.)

The axes turn with the rectangles that are seen and with the course over ground, each as far as its
own uncertainty lets it. Both tell the axes modulo a quarter turn, which is all that is needed. Where
they contradict themselves (bushes) the axes stay unknown and nothing is completed.

A walker's legs open and close; no end of them is hidden. So each track also keeps how steadily its
seen and its completed centre moved, and completes only as far as that made the motion steadier.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from adcbf_cli.core.config import TrackingConfig
from adcbf_cli.core.types import BoolArray, FloatArray, IntArray

PERSISTENCE = 5
"""An extent is believed once it was seen this many times in a row: passing near something else
merges the two for a moment."""
GROWING_GAIN = 0.3
SHRINKING_GAIN = 0.05
"""Shrinking, for a side that is seen square; a side seen edge-on tells nothing of its length."""

SURE_YAW_RAD = 0.25
UNSURE_YAW_RAD = 0.45
"""Axes are fully trusted up to the first standard deviation, and not at all from the second on, that
of any angle modulo a quarter turn."""
YAW_FLOOR_RAD = 0.05
MAX_YAW_VARIANCE = UNSURE_YAW_RAD**2
TURNING_RAD_PER_SQRT_S = 1.0
"""How fast a moving body's axes may turn: a random walk; a standing one's a tenth."""
COURSE_VARIANCE_FACTOR = 10.0
"""The filtered course of successive frames is nearly the same evidence: it counts a tenth."""
FEIGNED_SPEED_PER_S = 0.25
"""A centre that wanders over the body as its visible side changes feigns this share of the body's
extent a second as a velocity."""
JOLT_MEMORY_HITS = 20.0
COMPLETION_ERROR = 0.15
"""Standard deviation of a completed centre, as a share of the missing length."""


@dataclass(slots=True)
class Bodies:
    """n bodies: yaw_rad (n,) of the first axis in the world, yaw_variance (n,) rad^2, extent_m (n, 2)
    along the first and the second axis, recent_m (n, PERSISTENCE, 2) the extents seen last; seen_at_m
    and completed_at_m (n, 2) the last centres, world; jolt_m2 (n, 2) the mean square by which the seen
    and the completed centre's steps departed from the velocity."""

    yaw_rad: FloatArray
    yaw_variance: FloatArray
    extent_m: FloatArray
    recent_m: FloatArray
    seen_at_m: FloatArray
    completed_at_m: FloatArray
    jolt_m2: FloatArray

    @classmethod
    def seen_first(
        cls,
        centre_m: FloatArray,
        length_m: FloatArray,
        width_m: FloatArray,
        yaw_rad: FloatArray,
        config: TrackingConfig,
    ) -> Bodies:
        """Bodies as large as these rectangles (n,) at centres (n, 2)."""
        extent = np.column_stack([length_m, width_m])
        recent = np.repeat(extent[:, None, :], PERSISTENCE, axis=1)
        variance = rectangle_yaw_variance(length_m, config)
        jolt = np.full((len(length_m), 2), config.sigma_range_m**2)
        return cls(yaw_rad.copy(), variance, extent, recent, centre_m.copy(), centre_m.copy(), jolt)

    @classmethod
    def empty(cls) -> Bodies:
        pairs = np.zeros((0, 2))
        return cls(np.zeros(0), np.zeros(0), pairs, np.zeros((0, PERSISTENCE, 2)), pairs, pairs, pairs)

    def __len__(self) -> int:
        return len(self.yaw_rad)

    def select(self, rows: BoolArray | IntArray) -> Bodies:
        return Bodies(*(getattr(self, field.name)[rows] for field in fields(self)))

    def put(self, rows: IntArray, other: Bodies) -> None:
        """Overwrites these rows."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(other, field.name)

    def joined(self, other: Bodies) -> Bodies:
        return Bodies(
            *(np.concatenate([getattr(self, field.name), getattr(other, field.name)]) for field in fields(self))
        )

    def steadiness(self, config: TrackingConfig) -> FloatArray:
        """(n,) how far completing pays, 0 to 1: 1 where the completed centre moved more steadily than the
        seen one, and about as steadily as a centre of that size is measured."""
        seen, completed = self.jolt_m2[:, 0], self.jolt_m2[:, 1]
        nominal = config.sigma_range_m**2 + (config.sigma_extent_ratio**2 / 4) * (self.extent_m**2).sum(axis=1)
        steadier = np.minimum(2.0 * seen / (seen + completed), 1.0)
        steady = np.minimum(2.0 * nominal / completed, 1.0)
        share: FloatArray = steadier * steady
        return share


def axes_at(yaw_rad: FloatArray) -> FloatArray:
    """(..., 2, 2): both axes of bodies with yaw (...) as rows, world."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    axes: FloatArray = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=-2)
    return axes


def known(yaw_variance: FloatArray) -> FloatArray:
    """How far axes of this variance (...) are known, 0 to 1."""
    sigma = np.sqrt(yaw_variance)
    share: FloatArray = np.clip((UNSURE_YAW_RAD - sigma) / (UNSURE_YAW_RAD - SURE_YAW_RAD), 0.0, 1.0)
    return share


def rectangle_yaw_variance(length_m: FloatArray, config: TrackingConfig) -> FloatArray:
    """Variance (rad^2) of the direction of a rectangle whose ends are seen to the range noise."""
    by_noise = np.minimum(config.sigma_range_m / np.maximum(length_m, 1e-6), 1.0)
    variance: FloatArray = np.minimum(YAW_FLOOR_RAD**2 + by_noise**2, MAX_YAW_VARIANCE)
    return variance


def extents_along(
    length_m: FloatArray, width_m: FloatArray, rectangle_yaw_rad: FloatArray, body_yaw_rad: FloatArray
) -> FloatArray:
    """Extents (..., 2) of rectangles along a body's axes; the arguments (...) broadcast.

    Those of the ellipse with the same sides: exact where the axes agree and for what is as long as
    wide, and without the growth of a turned rectangle's corners.
    """
    angle = rectangle_yaw_rad - body_yaw_rad
    c, s = np.cos(angle), np.sin(angle)
    first = np.hypot(length_m * c, width_m * s)
    second = np.hypot(length_m * s, width_m * c)
    return np.stack([first, second], axis=-1)


def facing(axes: FloatArray, extent_m: FloatArray, to_sensor_m: FloatArray) -> FloatArray:
    """(..., 2) which end of each axis the sensor sees: +1 the positive one, -1 the negative one, and in
    between where it stands beside the body. axes (..., 2, 2); extent_m (..., 2); to_sensor_m (..., 2) from
    the body's centre."""
    seen_from = np.einsum("...ij,...j->...i", axes, to_sensor_m)
    ends: FloatArray = np.clip(seen_from / np.maximum(extent_m / 2, 1e-6), -1.0, 1.0)
    return ends


def completion(
    extent_m: FloatArray, seen_m: FloatArray, ends: FloatArray, trust: FloatArray, noise_m: float
) -> FloatArray:
    """What to add to a seen centre, along the body's axes (..., 2), to come to the body's centre.

    extent_m, seen_m: (..., 2) remembered and seen; ends: (..., 2) from `facing`; trust: (...). The end
    that faces the sensor is taken as seen. Differences of the noise's size say nothing and fade out.
    """
    missing = extent_m - seen_m
    missing = missing * missing**2 / (missing**2 + noise_m**2)
    result: FloatArray = -0.5 * trust[..., None] * ends * missing
    return result


def cut_surplus(extent_m: FloatArray, seen_m: FloatArray, to_others: FloatArray, trust: FloatArray) -> FloatArray:
    """The same for a cluster that holds others too: what it has beyond the body is on their side.

    to_others: (..., 2) from `facing`, which end of each axis the others are at.
    """
    result: FloatArray = -0.5 * trust[..., None] * to_others * np.maximum(seen_m - extent_m, 0.0)
    return result


def completion_sigma(extent_m: FloatArray, seen_m: FloatArray, ends: FloatArray, trust: FloatArray) -> FloatArray:
    """Standard deviation (..., 2) of a completed centre along the body's axes; arguments as above.

    Seen from beside, a part may be missing at either end. What is larger than the body holds something
    else too, and its centre may be off by half of that.
    """
    missing = np.maximum(extent_m - seen_m, 0.0)
    surplus = np.maximum(seen_m - extent_m, 0.0)
    share = COMPLETION_ERROR * np.abs(ends) + (1.0 - np.abs(ends)) / np.sqrt(12.0)
    result: FloatArray = trust[..., None] * (share * missing + 0.5 * surplus)
    return result


def followed_course(bodies: Bodies, velocity_mps: FloatArray, velocity_covariance: FloatArray) -> Bodies:
    """The bodies with their axes corrected by their course: velocity (n, 2), its covariance (n, 2, 2)."""
    speed = np.maximum(np.linalg.norm(velocity_mps, axis=1), 1e-6)
    course = velocity_mps / speed[:, None]
    sideways = np.column_stack([-course[:, 1], course[:, 0]])
    drift = np.einsum("ni,nij,nj->n", sideways, velocity_covariance, sideways) / speed**2
    along = np.einsum("ni,nij,nj->n", course, velocity_covariance, course) / speed**2
    feigned = (FEIGNED_SPEED_PER_S * bodies.extent_m.max(axis=1) / speed) ** 2
    course_variance = COURSE_VARIANCE_FACTOR * (YAW_FLOOR_RAD**2 + np.maximum(drift, along) + feigned)
    course_yaw = np.arctan2(course[:, 1], course[:, 0])
    yaw, variance = followed_yaw(bodies.yaw_rad, bodies.yaw_variance, course_yaw, course_variance)
    return replace(bodies, yaw_rad=yaw, yaw_variance=variance)


def aged_variance(variance: FloatArray, is_static: BoolArray, dt_s: float) -> FloatArray:
    """The axes' variance (n,) after dt_s in which the bodies may have turned."""
    rate = np.where(is_static, 0.1, 1.0) * TURNING_RAD_PER_SQRT_S
    return np.minimum(variance + rate**2 * dt_s, MAX_YAW_VARIANCE)


def grown_bodies(bodies: Bodies, seen_m: FloatArray, centre_m: FloatArray, sensor_m: FloatArray) -> Bodies:
    """The bodies after they were seen with these extents (n, 2), from the sensor (2,) at centres (n, 2)."""
    recent = np.concatenate([bodies.recent_m[:, 1:], seen_m[:, None, :]], axis=1)
    lasting = recent.min(axis=1)
    seen_from = np.abs(np.einsum("nij,nj->ni", axes_at(bodies.yaw_rad), sensor_m - centre_m))
    distance = np.maximum(np.linalg.norm(sensor_m - centre_m, axis=1), 1e-6)
    beyond = np.maximum(seen_from - bodies.extent_m / 2, 0.0) / distance[:, None]
    squareness = beyond[:, ::-1]  # the side along one axis faces along the other
    gain = np.where(lasting > bodies.extent_m, GROWING_GAIN, 0.0)
    gain = np.where(recent.max(axis=1) < bodies.extent_m, SHRINKING_GAIN * squareness, gain)
    target = np.where(lasting > bodies.extent_m, lasting, recent.max(axis=1))
    return replace(bodies, extent_m=bodies.extent_m + gain * (target - bodies.extent_m), recent_m=recent)


def moved_bodies(
    bodies: Bodies,
    seen_at_m: FloatArray,
    completed_at_m: FloatArray,
    grown_m: FloatArray,
    expected_step_m: FloatArray,
    noise_m: float,
) -> Bodies:
    """The bodies after their seen and fully completed centres (n, 2) came to lie there.

    grown_m: (n, 2) how far the completed centre moved because the extents are now known better, which
    is no motion; expected_step_m: (n, 2) by velocity since the last time.
    """
    jolts = np.stack(
        [
            ((seen_at_m - bodies.seen_at_m - expected_step_m) ** 2).sum(axis=1),
            ((completed_at_m - bodies.completed_at_m - expected_step_m) ** 2).sum(axis=1),
        ],
        axis=-1,
    )
    # The noise's share keeps the ratio of two well-behaved centres near one.
    jolt = bodies.jolt_m2 + (jolts + noise_m**2 - bodies.jolt_m2) / JOLT_MEMORY_HITS
    return replace(bodies, seen_at_m=seen_at_m, completed_at_m=completed_at_m + grown_m, jolt_m2=jolt)


def carried_bodies(bodies: Bodies, step_m: FloatArray) -> Bodies:
    """The bodies a step (n, 2) on, with nothing learned on the way."""
    return replace(bodies, seen_at_m=bodies.seen_at_m + step_m, completed_at_m=bodies.completed_at_m + step_m)


def followed_yaw(
    yaw: FloatArray, variance: FloatArray, seen_yaw: FloatArray, seen_variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """One scalar Kalman update of angles (...) modulo a quarter turn. A measurement that departs by more
    than both deviations allow is trusted only as far as its departure."""
    difference = np.mod(seen_yaw - yaw + np.pi / 4, np.pi / 2) - np.pi / 4
    seen_variance = np.maximum(seen_variance, difference**2 - variance)
    gain = variance / (variance + seen_variance)
    return yaw + gain * difference, (1.0 - gain) * variance
