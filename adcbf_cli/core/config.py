"""Every setting, one frozen model a stage, units in the names.

Defaults are the paper's where it gives a number. A field's description is what `adcbf config
schema` shows; `adcbf config dump` prints the values in force.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from adcbf_cli.core.errors import UsageError

Positive = Annotated[float, Field(gt=0, le=1e6)]
NonNegative = Annotated[float, Field(ge=0, le=1e6)]
AtLeastThousandth = Annotated[float, Field(ge=1e-3, le=1e6)]
"""For what others are divided by: no millisecond or millimetre is finer in any log. The upper bounds keep
seconds, as nanoseconds and times a thousand steps, within int64."""

Probability = Annotated[float, Field(gt=0, lt=1)]

CLUSTERERS = ("hdbscan", "dbscan")
MOTION_MODELS = ("cv", "ca", "ct")
"""Those built in; installed packages may offer more (`core.plugins`)."""


def _known_clusterer(name: str) -> str:
    return name if name in CLUSTERERS else _offered("CLUSTERER", name, CLUSTERERS)


def _known_motion_model(name: str) -> str:
    return name if name in MOTION_MODELS else _offered("MOTION_MODEL", name, MOTION_MODELS)


def _offered(kind: str, name: str, built_in: tuple[str, ...]) -> str:
    """The name, if exactly one installed package offers it. Packages are looked through for strange names only."""
    from adcbf_cli.core.plugins import Kind, find_plugin

    try:
        return find_plugin(Kind[kind], name, built_in).name
    except UsageError as error:
        raise PydanticCustomError("unknown_name", "{reason}", {"reason": str(error)}) from None


class StageConfig(BaseModel):
    """Immutable, and strict: an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ReadConfig(StageConfig):
    """Which topics to read, and how scans are placed in the world."""

    lidar: tuple[str, ...] = Field((), description="LiDAR topics; empty: detected. Two or more are fused.")
    pose: str | None = Field(None, description="Pose topic, 'tf', 'none', or PCD scans' pose file; null: detected.")
    world_frame: str | None = Field(None, description="Fixed frame of the results; null: the pose source's own.")
    extrinsics: tuple[str, ...] = Field(
        (), description="'parent>child:x,y,z,roll,pitch,yaw' (m, rad), for transforms the log lacks."
    )
    deskew: bool = Field(True, description="Correct motion within a scan where times and poses allow it.")
    max_pose_gap_s: Positive = Field(1.0, description="Poses farther apart than this are not interpolated.")
    object_rate_hz: Annotated[float, Field(ge=0.1, le=1000)] = Field(
        10.0, description="Object list: how often each object is seen."
    )
    object_noise_m: NonNegative = Field(0.03, description="Object list: noise of a seen centre, sigma per axis.")
    object_radius_m: Positive = Field(0.3, description="Object list: radius of an object without a size.")
    object_seed: Annotated[int, Field(ge=0)] = Field(0, description="Object list: seed of the noise.")


class PerceptionConfig(StageConfig):
    """From points to obstacles."""

    range_m: Positive = Field(
        4.0, description="Half the side of the square kept around the sensor; 4.0 is the paper's 8 x 8 m."
    )
    min_range_m: NonNegative = Field(0.1, description="Closer points are the sensor's own housing or mount.")
    max_height_m: float = Field(
        2.5,
        description="Points higher above the local ground are overhangs, dropped (ground 'none': above the sensor).",
    )
    smoothing: bool = Field(True, description="Statistical outlier removal, on the grid cells.")
    smoothing_neighbours: Annotated[int, Field(ge=1)] = Field(
        8, description="Neighbours whose mean distance is judged; never more than a smallest cluster has."
    )
    smoothing_std_ratio: Positive = 2.0
    ground: Literal["patchwork", "plane", "band", "none"] = Field(
        "patchwork", description="Ground removal for 3-D LiDARs."
    )
    sensor_height_m: Positive | None = Field(
        None, description="LiDAR above ground; null: estimated from the log's first scans."
    )
    ground_clearance_m: NonNegative = Field(0.15, description="Points this little above the local ground are ground.")
    cell_m: AtLeastThousandth = Field(0.1, description="Side of the grid cells that thin the cloud.")
    clusterer: Annotated[str, AfterValidator(_known_clusterer)] = Field(
        "hdbscan", description="hdbscan, dbscan, or one that an installed package offers.", examples=[*CLUSTERERS]
    )
    min_cluster_size: Annotated[int, Field(ge=2)] = Field(
        5, description="Grid cells of the smallest obstacle, or as many returns in two or more cells."
    )
    planar_min_cluster_size: Annotated[int, Field(ge=2)] = Field(
        2, description="Grid cells of a 2-D laser's smallest obstacle: a leg is two."
    )
    min_samples: Annotated[int, Field(ge=1)] = Field(
        2, description="A point's density is the distance to this neighbour, itself counted."
    )
    min_gap_m: NonNegative = Field(
        0.3, description="HDBSCAN: nearer clusters stay one, as two legs or a car's parts do."
    )
    max_gap_m: Positive = Field(1.0, description="HDBSCAN: an obstacle never spans a wider gap.")
    min_probability: Annotated[float, Field(ge=0, le=1)] = Field(
        0.3, description="HDBSCAN: members held more loosely, and beyond min_gap_m, are strays: noise."
    )
    dbscan_eps_m: Positive = 0.5
    centre: Literal["auto", "circle", "box", "mean"] = Field(
        "auto", description="Obstacle centre: fitted circle, fitted rectangle, mean, or circle where one fits else box."
    )
    range_noise_m: Positive = Field(
        0.03, description="The LiDAR's range noise: residuals of this size do not speak against a circle."
    )
    max_radius_m: Positive = Field(
        1.0, description="Over-long clusters are split into circles no larger; compact ones may exceed it."
    )
    max_length_m: Positive = Field(
        6.0, description="Clusters up to this length stay whole unless they are thin as a wall: cars, groups."
    )
    point_labels: bool = Field(False, description="Also keep each point's cluster (table `points`).")


class TrackingConfig(StageConfig):
    """From obstacles to tracks."""

    filter: Literal["ukf", "ekf", "kf"] = "ukf"
    model: Annotated[str, AfterValidator(_known_motion_model)] = Field(
        "cv",
        description="Constant velocity, constant acceleration, coordinated turn, or one that an installed package "
        "offers.",
        examples=[*MOTION_MODELS],
    )
    ukf_alpha: Positive = 0.001
    ukf_beta: NonNegative = 2.0
    ukf_kappa: NonNegative = 0.0
    sigma_range_m: Positive = 0.05
    sigma_azimuth_rad: Positive = 0.01
    sigma_elevation_rad: Positive = 0.02
    sigma_extent_ratio: NonNegative = Field(
        0.1, description="Measurement noise of a centre, as a fraction of the obstacle's radius (half height)."
    )
    adaptive_noise: bool = Field(
        True, description="Scale each track's measurement noise by what its innovations show (1/10 to 5 times)."
    )
    sigma_accel_mps2: Positive = Field(
        1.5, description="Process noise of a manoeuvre (cv, ct): rms change of velocity over one second."
    )
    sigma_jerk_mps3: Positive = Field(1.0, description="The same for ca: rms change of acceleration over one second.")
    sigma_turn_radps2: Positive = Field(0.3, description="The same for ct's turn rate, over one second.")
    vertical_ratio: Annotated[float, Field(gt=0, le=1)] = Field(
        0.2, description="Vertical process noise, as a fraction of the horizontal one."
    )
    cruise_ratio: Annotated[float, Field(gt=0, le=1)] = Field(
        0.03,
        description="Process noise of an obstacle that keeps its course, as a fraction of a manoeuvre's; "
        "1: one noise level for all.",
    )
    cruise_s: Positive = Field(10.0, description="Mean time between manoeuvres.")
    manoeuvre_s: Positive = Field(1.0, description="Mean time that a manoeuvre lasts.")
    sigma_speed_mps: Positive = Field(5.0, description="Speed that a new obstacle may have, one sigma per axis.")
    gate_probability: Probability = Field(0.999, description="Chi-square gate for association.")
    size_ratio: Annotated[float, Field(gt=1)] = Field(
        3.0, description="A cluster whose radius differs from the track's by more than this factor ..."
    )
    size_difference_m: NonNegative = Field(0.5, description="... and by more than this is another obstacle.")
    confirm_hits: Annotated[int, Field(ge=1)] = 3
    confirm_window: Annotated[int, Field(ge=1)] = Field(
        5, description="A track is confirmed by confirm_hits among its first confirm_window frames."
    )
    max_coast_s: Positive = Field(
        1.0,
        description="An unseen track goes on for this long, or as long as it had been followed, if that is less; up "
        "to three times as long while something nearer hides it from a 3-D LiDAR.",
    )
    static_window_s: Positive = Field(1.5, description="Time over which motion is looked for.")
    static_speed_mps: Positive = Field(0.1, description="Slower obstacles stand still.")
    structure_length_m: Positive = Field(
        6.0, description="A split cluster longer than this is a wall or hedge: its pieces stand still."
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.filter == "kf" and self.model == "ct":
            raise ValueError("filter 'kf' needs a linear motion model; take 'ukf' or 'ekf' with model 'ct'")
        if self.confirm_window < self.confirm_hits:
            raise ValueError("confirm_window is smaller than confirm_hits")
        return self


class PredictionConfig(StageConfig):
    """From tracks to where they will be."""

    steps: Annotated[int, Field(ge=1, le=1000)] = 30
    step_s: AtLeastThousandth = 0.1
    probability: Probability = Field(0.95, description="Coverage of the ellipse and of the conformal radius.")
    calibration: Literal["none", "past", "file"] = Field("past", description="Where conformal residuals come from.")
    calibration_window: Annotated[int, Field(ge=10, le=1_000_000)] = Field(
        2000, description="Residuals kept a step, the newest, for calibration from the past."
    )


class EvaluationConfig(StageConfig):
    """How results are scored. docs/metrics.md says how each setting enters a metric."""

    range_m: Positive | None = Field(
        None,
        description="Objects and tracks farther than this from the sensor are not scored; "
        "null: as far as perception looked.",
    )
    match_m: Positive = Field(1.0, description="Centre distance up to which a cluster or track may match an object.")
    box_margin_m: NonNegative = Field(
        0.25, description="A centre inside the object's box, enlarged by this on every side, matches too."
    )
    hota_zero_m: Positive = Field(2.0, description="Centre distance at which HOTA's similarity is zero.")
    horizons_s: tuple[Positive, ...] = Field((1.0, 2.0, 3.0), description="Horizons that get metrics of their own.")
    max_gap_s: Positive = Field(0.5, description="Positions farther apart in time than this are not interpolated.")
    background_classes: tuple[str, ...] = Field(
        ("tree", "rock", "wall", "box", "pole", "building", "background"),
        description="Labelled classes that count for detection but not for tracking and prediction: scenery.",
    )
    truth_fov_deg: tuple[float, float] | None = Field(
        None,
        description="Azimuths in the sensor's frame, start and end counter-clockwise, that were labelled; "
        "null: what the source says.",
    )
    truth_exhaustive: bool | None = Field(
        None,
        description="Whether everything that moves there is labelled, so that a moving track without a label is "
        "false; null: what the source says (label files: yes, a single object's poses: no).",
    )
    truth_first_frame: int = Field(0, description="KITTI labels: the label frame of the log's first scan.")
    bootstrap_block_s: AtLeastThousandth = Field(
        5.0, description="Length of the time blocks that intervals are drawn over."
    )


class VehicleConfig(StageConfig):
    """The vehicle that plans are made for."""

    kind: Literal["unicycle", "ackermann"] = Field(
        "unicycle", description="Four-wheel differential drive, or front-wheel steering."
    )
    body_radius_m: Positive = Field(0.3, description="The paper's r_c: the circle that holds the vehicle.")
    min_speed_mps: float = Field(0.0, ge=-100, le=0, description="Negative: it may reverse.")
    max_speed_mps: Annotated[float, Field(gt=0, le=100)] = 1.0
    max_accel_mps2: Annotated[float, Field(gt=0, le=100)] = Field(1.0, description="Speeding up and braking.")
    max_yaw_rate_radps: Annotated[float, Field(gt=0, le=100)] = Field(1.0, description="Unicycle.")
    max_yaw_accel_radps2: Annotated[float, Field(gt=0, le=1000)] = Field(3.0, description="Unicycle.")
    wheelbase_m: Positive = Field(0.6, description="Ackermann.")
    max_steer_rad: Annotated[float, Field(gt=0, lt=1.5)] = Field(0.6, description="Ackermann.")
    max_steer_rate_radps: Annotated[float, Field(gt=0, le=100)] = Field(1.0, description="Ackermann.")


class PlanningConfig(StageConfig):
    """How plans are made. docs/planning.md says what each setting does in which planner."""

    reference_speed_mps: Annotated[float, Field(gt=0, le=100)] | None = Field(
        None, description="Speed along the reference; null: 0.75, or the vehicle's top speed if that is lower."
    )
    safety_distance_m: NonNegative = Field(0.2, description="The paper's r_s, kept between vehicle and obstacle.")
    steps: Annotated[int, Field(ge=2, le=200)] = Field(30, description="Horizon N.")
    step_s: Annotated[float, Field(ge=1e-2, le=5)] = 0.1
    rate_hz: Annotated[float, Field(ge=0.1, le=1000)] = Field(
        30.0, description="Planning rate of the replay; each plan's deadline is its inverse."
    )
    solver: Literal["sqp", "piqp", "ipopt", "fatrop"] = Field(
        "sqp", description="sqp: the fast one (piqp: its fallback without Numba); ipopt, fatrop: oracles."
    )
    min_iterations: Annotated[int, Field(ge=1)] = 5
    max_iterations: Annotated[int, Field(ge=1, le=1000)] = Field(10, description="SQP iterations a start.")
    starts: Annotated[int, Field(ge=1, le=5)] = Field(
        3,
        description="1: shifted plan; 2: also the reference; n above: also the n - 1 best of sampled ways, where those "
        "violate a barrier or stand.",
    )
    max_obstacles: Annotated[int, Field(ge=1, le=32)] = Field(
        16, description="The nearest this many enter the problem; the rest are counted."
    )
    obstacle_set: Literal["predicted", "paper"] = Field(
        "predicted",
        description="For planners that use predictions. paper: each moving obstacle twice, held and predicted.",
    )
    uncertainty: Literal["none", "sigma", "conformal"] = Field(
        "sigma", description="What the predicted position's uncertainty adds to an obstacle's radius."
    )
    max_margin_m: NonNegative = Field(
        0.3, description="It adds at most this: three seconds ahead, someone may be anywhere."
    )
    hard: bool = Field(False, description="No slack: what cannot be met is infeasible, and counted.")
    fallback: Literal["ladder", "none"] = Field(
        "ladder",
        description="none: the MPC planners' solutions are driven whatever they are, and the last one goes on where "
        "there is none: to see what the ladder is worth.",
    )
    slack_weight: Positive = Field(1000.0, description="Cost of a barrier violation, per m^2 (L1).")
    decay_weight: Positive = Field(10.0, description="od-ad-cbf-mpc: cost of (decay - 1)^2.")
    gamma_fixed: Annotated[float, Field(gt=0, le=1)] = Field(0.1, description="mpc-cbf, d-cbf-mpc.")
    gamma_form: Literal["cdf", "printed"] = Field("cdf", description="Adaptive gamma: Gaussian CDF, or as printed.")
    gamma_at: Literal["inside", "previous"] = Field(
        "inside", description="Adaptive gamma: a function inside the problem, or taken from the previous plan."
    )
    gamma_amplitude: Positive = 0.5
    gamma_distance_m: Positive = 2.0
    gamma_radius_m: Positive = 0.4
    gamma_distance_sigma_m: Positive = 0.6
    gamma_radius_sigma_m: Positive = 0.2
    gamma_floor: float | None = Field(0.05, ge=0, le=1, description="Lower clip of adaptive gamma; null: none.")
    gamma_ceiling: float | None = Field(1.0, gt=0, le=10, description="Upper clip of adaptive gamma; null: none.")
    barrier_form: Literal["product", "printed"] = Field(
        "product", description="dh >= -gamma h, or the printed dh >= -gamma."
    )
    barrier_steps: Annotated[int, Field(ge=1)] | None = Field(
        None, description="The paper's M_CBF: stages with a barrier; null: all."
    )
    accept_invalid_barrier: bool = Field(
        False, description="Build a barrier that is no class-K function all the same, to see what it does."
    )
    weight_position: NonNegative = Field(0.5, description="Tracking the reference, per m^2.")
    weight_heading: NonNegative = Field(0.5, description="Per rad^2.")
    weight_speed: NonNegative = Field(2.0, description="Per (m/s)^2.")
    weight_turn: NonNegative = Field(0.1, description="Turning, per (rad/s)^2 (Ackermann: rad^2).")
    weight_accel: NonNegative = Field(0.05, description="Smoothness, per (m/s^2)^2.")
    weight_turn_accel: NonNegative = Field(0.01, description="Per (rad/s^2)^2 (Ackermann: (rad/s)^2).")
    weight_terminal: NonNegative = Field(20.0, description="Factor on the last stage's position and heading.")


class ReplayConfig(StageConfig):
    """The closed loop of a planner against a recorded world, and how driving is scored."""

    range_m: Positive | None = Field(
        None, description="The ego knows obstacles within this distance; null: perception.range_m."
    )
    goal_tolerance_m: Positive = 0.3
    timeout_factor: Annotated[float, Field(gt=1, le=100)] = Field(
        3.0, description="Times the nominal time, after which a run that is not there has failed."
    )
    divergence_m: Positive = Field(
        1.0, description="Ego farther from the log's vehicle than this: the sensor would have seen something else."
    )
    near_m: Positive = Field(2.0, description="Surface distance within which an obstacle counts as near (Vel-var).")
    clearance_m: Positive = Field(0.2, description="Time below this surface distance is reported.")
    freeze_speed_mps: Positive = Field(0.05, description="Slower than this away from the goal is freezing.")
    start_offset_m: NonNegative = Field(
        0.3, description="Seeds other than 0: sideways displacement of the start, sigma."
    )
    start_delay_s: NonNegative = Field(2.0, description="Seeds from 1 on: latest start, uniform from 0.")


class Config(StageConfig):
    """The whole configuration."""

    read: ReadConfig = ReadConfig()
    perception: PerceptionConfig = PerceptionConfig()
    tracking: TrackingConfig = TrackingConfig()
    prediction: PredictionConfig = PredictionConfig()
    evaluation: EvaluationConfig = EvaluationConfig()
    vehicle: VehicleConfig = VehicleConfig()
    planning: PlanningConfig = PlanningConfig()
    replay: ReplayConfig = ReplayConfig()


CLOSED_LOOP = Config.model_validate({"perception": {"range_m": 8.0, "min_gap_m": 0.2}, "replay": {"range_m": 7.0}})
"""The defaults where a planner drives by a sensor of its own. At 1 m/s against 1.5 m/s the paper's 4 m are over in
1.3 s, and what the crop cuts off has no right centre and speed yet: so it looks farther, and is told a metre less. Two
things that are one cluster have no right centre and speed either, and nothing in a simulated scene comes in two parts
as legs do."""
