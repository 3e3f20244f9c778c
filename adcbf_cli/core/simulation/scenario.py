"""The scenario file: what a simulated world holds, who moves in it, and what the sensor is like.

A scenario is YAML, read into frozen models that refuse unknown keys. Coordinates are in the world
frame (x east, y north, z up), whose origin is also the odometry's origin. Times count from the
log's start.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from adcbf_cli.core.config import NonNegative, Positive, StageConfig

Point2 = tuple[float, float]
Length = Annotated[float, Field(gt=0, le=1000)]
Share = Annotated[float, Field(ge=0, lt=1)]

MAX_RAYS_PER_SCAN = 500_000
MAX_TERRAIN_CELLS = 1_000_000
LEAST_FREE_M = 0.5
"""What is drawn at random is never nearer to the ego's start: more than half the ego's size."""


class StandPath(StageConfig):
    """Stay in one place."""

    kind: Literal["stand"]
    at_m: Point2
    yaw_deg: float = 0.0


class LinePath(StageConfig):
    """Wait at one end, go straight to the other, stay there."""

    kind: Literal["line"]
    from_m: Point2
    to_m: Point2
    speed_mps: Positive
    start_s: NonNegative = 0.0

    @model_validator(mode="after")
    def _has_length(self) -> LinePath:
        if self.from_m == self.to_m:
            raise ValueError("from_m and to_m must differ (use kind: stand)")
        return self


class WaypointPath(StageConfig):
    """Pass through points, by a time for each, or at one speed with an optional pause at each."""

    kind: Literal["waypoints"]
    points_m: Annotated[tuple[Point2, ...], Field(min_length=2, max_length=1000)]
    times_s: tuple[NonNegative, ...] | None = None
    speed_mps: Positive | None = None
    pauses_s: tuple[NonNegative, ...] | None = None
    start_s: NonNegative = 0.0
    smooth: bool = Field(False, description="Follow a Catmull-Rom curve through the points instead of straight legs.")

    @model_validator(mode="after")
    def _is_consistent(self) -> WaypointPath:
        count = len(self.points_m)
        if (self.times_s is None) == (self.speed_mps is None):
            raise ValueError("give either times_s or speed_mps")
        if any(a == b for a, b in zip(self.points_m, self.points_m[1:], strict=False)):
            raise ValueError("points_m holds the same point twice in a row (use pauses_s for a stop)")
        if self.times_s is not None:
            if self.pauses_s is not None or self.start_s:
                raise ValueError("pauses_s and start_s go with speed_mps, not with times_s")
            if len(self.times_s) != count:
                raise ValueError(f"times_s has {len(self.times_s)} values for {count} points")
            if any(b <= a for a, b in zip(self.times_s, self.times_s[1:], strict=False)):
                raise ValueError("times_s must increase")
        if self.pauses_s is not None and len(self.pauses_s) != count:
            raise ValueError(f"pauses_s has {len(self.pauses_s)} values for {count} points")
        return self


class CirclePath(StageConfig):
    """The paper's equation 11: x = x0 - A sin(2 pi w t), y = y0 - A cos(2 pi w t)."""

    kind: Literal["circle"]
    centre_m: Point2
    radius_m: Length
    frequency_hz: float = Field(description="Revolutions per second; negative turns the other way.")
    start_angle_deg: float = Field(0.0, description="Added to 2 pi w t.")

    @model_validator(mode="after")
    def _turns(self) -> CirclePath:
        if self.frequency_hz == 0:
            raise ValueError("frequency_hz must not be 0 (use kind: stand)")
        return self


class CrossingPath(StageConfig):
    """Walk straight over the route, timed by when an ego is there. Only a scenario file holds one: it becomes
    the line that it means."""

    kind: Literal["crossing"]
    along_m: NonNegative = Field(description="Where on the route, as arc length from its start.")
    angle_deg: float = Field(90.0, description="Direction of motion from the route's: 90 is from right to left.")
    speed_mps: Positive
    meets_s: NonNegative | None = Field(
        None, description="When it is on the route; null: when an ego at 0.75 m/s is there."
    )
    early_s: float = Field(0.0, description="It is there this much before the ego; negative: after.")
    before_m: Length = Field(5.0, description="Way walked before the route.")
    after_m: Length = Field(5.0, description="Way walked after the route.")

    @model_validator(mode="after")
    def _is_timed_once(self) -> CrossingPath:
        if self.meets_s is not None and self.early_s:
            raise ValueError("give either meets_s or early_s")
        return self


Path = Annotated[StandPath | LinePath | WaypointPath | CirclePath, Field(discriminator="kind")]


class Terrain(StageConfig):
    """The ground: a plane, with a slope and bumps if asked."""

    kind: Literal["flat", "bumps"] = "flat"
    centre_m: Point2 = (0.0, 0.0)
    size_m: Length = Field(100.0, description="Side of the square of ground.")
    slope_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    uphill_deg: float = Field(0.0, description="Azimuth of the slope's rise, from x towards y.")
    amplitude_m: Annotated[float, Field(ge=0, le=1000)] = Field(
        0.1, description="Bumps: largest height above or below the plane."
    )
    wavelength_m: Length = Field(3.0, description="Bumps: shortest wavelength; the longest is four times it.")
    cell_m: Length = Field(0.25, description="Bumps: side of the mesh's cells.")

    @model_validator(mode="after")
    def _resolves_its_bumps(self) -> Terrain:
        if self.kind == "bumps":
            if self.cell_m > self.wavelength_m / 4:
                raise ValueError("cell_m must be at most a quarter of wavelength_m")
            if (self.size_m / self.cell_m) ** 2 > MAX_TERRAIN_CELLS:
                raise ValueError(f"size_m / cell_m gives more than {MAX_TERRAIN_CELLS} cells")
        return self


class Tree(StageConfig):
    """A trunk with a crown on top. Its ground truth box is the trunk's: the crown hangs over free space."""

    kind: Literal["tree"]
    at_m: Point2
    trunk_radius_m: Length = 0.15
    trunk_height_m: Length = 3.5
    crown_radius_m: Length = 1.2
    crown_height_m: Length = 2.5


class Rock(StageConfig):
    """An irregular lump, half of it in the ground; its size is what shows."""

    kind: Literal["rock"]
    at_m: Point2
    size_m: tuple[Length, Length, Length] = (0.8, 0.6, 0.5)
    yaw_deg: float = 0.0


class Wall(StageConfig):
    """A straight wall that follows the ground from one end to the other."""

    kind: Literal["wall"]
    from_m: Point2
    to_m: Point2
    height_m: Length = 2.0
    thickness_m: Length = 0.2

    @model_validator(mode="after")
    def _has_length(self) -> Wall:
        if self.from_m == self.to_m:
            raise ValueError("from_m and to_m must differ")
        return self


class Box(StageConfig):
    """A box standing on the ground: length (along its yaw), width, height."""

    kind: Literal["box"]
    at_m: Point2
    size_m: tuple[Length, Length, Length]
    yaw_deg: float = 0.0


StaticObject = Annotated[Tree | Rock | Wall | Box, Field(discriminator="kind")]


class Person(StageConfig):
    """A torso, a head and two legs that swing with the distance walked."""

    kind: Literal["person"]
    path: Path
    height_m: Annotated[float, Field(ge=0.8, le=2.5)] = 1.75
    width_m: Annotated[float, Field(ge=0.25, le=1.0)] = 0.5
    depth_m: Annotated[float, Field(ge=0.15, le=1.0)] = 0.3
    stride_m: Length = Field(1.4, description="Ground covered by one swing of each leg.")


class Vehicle(StageConfig):
    """A box that follows the ground under its wheels: length, width, height."""

    kind: Literal["vehicle"]
    path: Path
    size_m: tuple[Length, Length, Length] = (4.2, 1.8, 1.5)
    ground_clearance_m: NonNegative = 0.2


class Cylinder(StageConfig):
    """An upright cylinder: the paper's circular obstacle."""

    kind: Literal["cylinder"]
    path: Path
    radius_m: Length = 0.48
    height_m: Length = 1.5


Mover = Annotated[Person | Vehicle | Cylinder, Field(discriminator="kind")]


class Route(StageConfig):
    """The way that a robot which decides for itself is asked to go: its reference path."""

    points_m: Annotated[tuple[Point2, ...], Field(min_length=2, max_length=1000)]
    smooth: bool = Field(False, description="Follow a Catmull-Rom curve through the points instead of straight legs.")
    length_m: Length | None = Field(
        None, description="Scale the points about the first one, so that the path gets this length."
    )
    keep_free_m: Annotated[float, Field(ge=LEAST_FREE_M, le=1000)] = Field(
        1.0, description="What is drawn at random keeps this far from the start, and what rests also from the goal."
    )
    passage_m: NonNegative = Field(
        0.0, description="Objects that are drawn at random leave at least this much room between one another."
    )

    @model_validator(mode="after")
    def _leads_somewhere(self) -> Route:
        if len(set(self.points_m)) == 1:
            raise ValueError("points_m are all the same place")
        return self


class Ego(StageConfig):
    """The robot that carries the sensor. It follows the ground under its four wheels.

    path: as scripted; null where the scenario has a route: then at 0.75 m/s along it.
    """

    path: Path | None = None
    wheelbase_m: Length = 0.5
    track_m: Length = 0.45


class Mount(StageConfig):
    """Where the sensor sits on base_link, whose origin is on the ground between the wheels."""

    x_m: float = 0.0
    y_m: float = 0.0
    height_m: Length = 0.8
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0


class _Ranging(StageConfig):
    """What both kinds of LiDAR share."""

    azimuth_step_deg: Annotated[float, Field(gt=0, le=30)] = 0.4
    rate_hz: Annotated[float, Field(gt=0, le=200)] = 10.0
    instantaneous: bool = Field(False, description="All rays at the stamp, as Gazebo's LiDAR; no per-point times.")
    range_sigma_m: NonNegative = 0.02
    dropout_probability: Share = 0.0
    min_range_m: Length = 0.3
    max_range_m: Length = 50.0
    mount: Mount = Mount()
    frame_id: str = "lidar"

    @model_validator(mode="after")
    def _has_a_range(self) -> _Ranging:
        if self.max_range_m <= self.min_range_m:
            raise ValueError("max_range_m must exceed min_range_m")
        return self


class SpinningLidar(_Ranging):
    """A 3-D LiDAR: all channels fire together, one azimuth after the other, once around per scan."""

    kind: Literal["spinning"]
    channels: Annotated[int, Field(ge=1, le=256)] = 16
    lowest_elevation_deg: Annotated[float, Field(ge=-90, le=90)] = -15.0
    highest_elevation_deg: Annotated[float, Field(ge=-90, le=90)] = 15.0
    elevations_deg: Annotated[tuple[float, ...], Field(max_length=256)] | None = Field(
        None, description="Each channel's elevation, instead of the evenly spread ones."
    )
    start_azimuth_deg: float = Field(
        -180.0, description="Where a revolution, and a scan, begins; it turns to the left."
    )
    topic: str = "/points"

    @model_validator(mode="after")
    def _fires_a_sane_number_of_rays(self) -> SpinningLidar:
        channels = len(self.elevations_deg) if self.elevations_deg is not None else self.channels
        if channels * 360.0 / self.azimuth_step_deg > MAX_RAYS_PER_SCAN:
            raise ValueError(f"more than {MAX_RAYS_PER_SCAN} rays a scan: raise azimuth_step_deg or lower channels")
        if self.elevations_deg is None and self.highest_elevation_deg < self.lowest_elevation_deg:
            raise ValueError("highest_elevation_deg is below lowest_elevation_deg")
        return self


class PlanarLaser(_Ranging):
    """A 2-D laser: one row of rays over a field of view."""

    kind: Literal["planar"]
    first_azimuth_deg: Annotated[float, Field(ge=-360, le=360)] = -135.0
    last_azimuth_deg: Annotated[float, Field(ge=-360, le=360)] = 135.0
    topic: str = "/scan"

    @model_validator(mode="after")
    def _has_a_view(self) -> PlanarLaser:
        view = self.last_azimuth_deg - self.first_azimuth_deg
        if not 0 < view <= 360:
            raise ValueError("last_azimuth_deg must be above first_azimuth_deg by at most 360")
        if view / self.azimuth_step_deg > MAX_RAYS_PER_SCAN:
            raise ValueError(f"more than {MAX_RAYS_PER_SCAN} rays a scan: raise azimuth_step_deg")
        return self


Lidar = Annotated[SpinningLidar | PlanarLaser, Field(discriminator="kind")]


class Odometry(StageConfig):
    """The pose source. All noise terms zero: exact. Otherwise a planar random walk in the robot's
    own frame, whose variance grows with distance and with turning."""

    rate_hz: Annotated[float, Field(gt=0, le=200)] = 50.0
    translation_sigma_m_per_sqrt_m: NonNegative = 0.0
    heading_sigma_rad_per_sqrt_m: NonNegative = 0.0
    heading_sigma_rad_per_sqrt_rad: NonNegative = 0.0

    @property
    def drifts(self) -> bool:
        noise = (
            self.translation_sigma_m_per_sqrt_m,
            self.heading_sigma_rad_per_sqrt_m,
            self.heading_sigma_rad_per_sqrt_rad,
        )
        return any(value > 0 for value in noise)


class Scenario(StageConfig):
    """A whole scenario file."""

    duration_s: Annotated[float, Field(gt=0, le=3600)]
    seed: Annotated[int, Field(ge=0)] = 0
    start_time_s: Annotated[int, Field(ge=0, le=4_000_000_000)] = Field(
        1_700_000_000, description="The first scan's stamp, in Unix time."
    )
    terrain: Terrain = Terrain()
    objects: Annotated[tuple[StaticObject, ...], Field(max_length=1000)] = ()
    movers: Annotated[tuple[Mover, ...], Field(max_length=200)] = ()
    route: Route | None = None
    ego: Ego = Ego()
    lidar: Lidar
    odometry: Odometry = Odometry()

    @model_validator(mode="after")
    def _holds_a_scan(self) -> Scenario:
        if self.duration_s * self.lidar.rate_hz < 1:
            raise ValueError("duration_s is shorter than one scan")
        return self

    @model_validator(mode="after")
    def _goes_somewhere(self) -> Scenario:
        if self.ego.path is None and self.route is None:
            raise ValueError("give ego.path, a scripted way, or route, one to be driven")
        return self
