"""Every setting, one frozen model a stage, units in the names.

Defaults are the paper's where it gives a number. A field's description is what `adcbf config
schema` shows; `adcbf config dump` prints the values in force.
"""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

Positive = Annotated[float, Field(gt=0, le=1e6)]
NonNegative = Annotated[float, Field(ge=0, le=1e6)]
AtLeastThousandth = Annotated[float, Field(ge=1e-3, le=1e6)]
"""For what others are divided by: no millisecond or millimetre is finer in any log. The upper bounds keep
seconds, as nanoseconds and times a thousand steps, within int64."""

Probability = Annotated[float, Field(gt=0, lt=1)]


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
    clusterer: Literal["hdbscan", "dbscan"] = "hdbscan"
    min_cluster_size: Annotated[int, Field(ge=2)] = Field(5, description="Grid cells of the smallest obstacle.")
    planar_min_cluster_size: Annotated[int, Field(ge=2)] = Field(
        2, description="The same for a 2-D laser, where a leg is two cells."
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
    model: Literal["cv", "ca", "ct"] = Field(
        "cv", description="Constant velocity, constant acceleration, coordinated turn."
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
        1.0, description="An unseen track goes on for this long, or as long as it had been followed, if that is less."
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


class Config(StageConfig):
    """The whole configuration."""

    read: ReadConfig = ReadConfig()
    perception: PerceptionConfig = PerceptionConfig()
    tracking: TrackingConfig = TrackingConfig()
    prediction: PredictionConfig = PredictionConfig()
    evaluation: EvaluationConfig = EvaluationConfig()
