"""Every setting, one frozen model a stage, units in the names.

Defaults are the paper's where it gives a number. A field's description is what `adcbf config
schema` shows; `adcbf config dump` prints the values in force.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Probability = Annotated[float, Field(gt=0, lt=1)]


class StageConfig(BaseModel):
    """Immutable, and strict: an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ReadConfig(StageConfig):
    """Which topics to read, and how scans are placed in the world."""

    lidar: tuple[str, ...] = Field((), description="LiDAR topics; empty: detected. Two or more are fused.")
    pose: str | None = Field(None, description="Pose topic, 'tf' or 'none'; null: detected.")
    world_frame: str | None = Field(None, description="Fixed frame for poses from tf; null: detected.")
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
    min_range_m: NonNegative = Field(0.3, description="Closer points are the robot itself.")
    min_height_m: float = Field(-3.0, description="Lower points (levelled sensor frame) are dropped.")
    max_height_m: float = Field(2.5, description="Higher points (levelled sensor frame) are dropped: overhangs.")
    smoothing: bool = Field(True, description="Statistical outlier removal.")
    smoothing_neighbours: Annotated[int, Field(ge=1)] = 8
    smoothing_std_ratio: Positive = 2.0
    ground: Literal["patchwork", "plane", "band", "none"] = Field(
        "patchwork", description="Ground removal for 3-D LiDARs."
    )
    sensor_height_m: Positive | None = Field(
        None, description="LiDAR above ground; null: estimated from the log's first scans."
    )
    ground_clearance_m: NonNegative = Field(
        0.15, description="Points this near the ground are ground ('plane', 'band')."
    )
    cell_m: Positive = Field(0.1, description="Side of the grid cells that thin the cloud.")
    clusterer: Literal["hdbscan", "dbscan"] = "hdbscan"
    min_cluster_size: Annotated[int, Field(ge=2)] = 5
    min_samples: Annotated[int, Field(ge=1)] = 3
    dbscan_eps_m: Positive = 0.5
    max_radius_m: Positive = Field(1.0, description="Clusters with a larger circle are split along their length.")
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
    sigma_accel_mps2: Positive = Field(1.0, description="Process noise: white acceleration (cv, ct).")
    gate_probability: Probability = Field(0.99, description="Chi-square gate for association.")
    confirm_hits: Annotated[int, Field(ge=1)] = 3
    max_coast_s: Positive = 1.0


class PredictionConfig(StageConfig):
    """From tracks to where they will be."""

    steps: Annotated[int, Field(ge=1, le=1000)] = 30
    step_s: Positive = 0.1
    probability: Probability = Field(0.95, description="Coverage of the ellipse and of the conformal radius.")
    calibration: Literal["none", "past", "file"] = Field("past", description="Where conformal residuals come from.")


class EvaluationConfig(StageConfig):
    """How results are scored."""

    range_m: Positive = Field(
        20.0, description="Ground truth and tracks farther than this from the sensor are not scored."
    )
    match_m: Positive = Field(1.0, description="Centre distance up to which a track may match an object.")


class Config(StageConfig):
    """The whole configuration."""

    read: ReadConfig = ReadConfig()
    perception: PerceptionConfig = PerceptionConfig()
    tracking: TrackingConfig = TrackingConfig()
    prediction: PredictionConfig = PredictionConfig()
    evaluation: EvaluationConfig = EvaluationConfig()
