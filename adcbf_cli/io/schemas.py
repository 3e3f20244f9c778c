"""Every table's columns, with their types; units are in the names. docs/tables.md explains each."""

from __future__ import annotations

import pyarrow as pa

from adcbf_cli.core.evaluation.driving import METRICS

_FRAME_KEYS = [("timestamp_ns", pa.int64()), ("frame_index", pa.int32())]
_DRIVE_KEYS = [("planner", pa.string()), ("seed", pa.int32())]
_TICK_KEYS = [*_DRIVE_KEYS, ("timestamp_ns", pa.int64()), ("tick", pa.int32())]
POSE = ["sensor_x_m", "sensor_y_m", "sensor_z_m", "sensor_qx", "sensor_qy", "sensor_qz", "sensor_qw"]
COUNTS = ["read", "in_range", "smoothed", "above_ground", "clustered"]


def _floats(*names: str) -> list[tuple[str, pa.DataType]]:
    return [(name, pa.float64()) for name in names]


SCHEMAS: dict[str, pa.Schema] = {
    "frames": pa.schema(
        [
            *_FRAME_KEYS,
            *_floats(*POSE),
            ("pose_known", pa.bool_()),
            ("planar", pa.bool_()),
            *[(f"points_{name}", pa.int32()) for name in COUNTS],
            ("clusters", pa.int32()),
        ]
    ),
    "clusters": pa.schema(
        [
            *_FRAME_KEYS,
            ("cluster_id", pa.int32()),
            *_floats("x_m", "y_m", "z_m", "sensor_frame_x_m", "sensor_frame_y_m", "sensor_frame_z_m"),
            *_floats("radius_m", "height_m", "length_m", "width_m", "yaw_rad"),
            ("points", pa.int32()),
            *_floats("probability"),
            ("split_from", pa.int32()),
        ]
    ),
    "points": pa.schema([*_FRAME_KEYS, *_floats("x_m", "y_m", "z_m"), ("cluster_id", pa.int32())]),
    "tracks": pa.schema(
        [
            *_FRAME_KEYS,
            ("track_id", pa.int64()),
            ("status", pa.string()),
            *_floats("x_m", "y_m", "z_m", "vx_mps", "vy_mps", "vz_mps", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2"),
            *_floats("radius_m", "height_m"),
            ("is_static", pa.bool_()),
            ("cluster_id", pa.int32()),
            *_floats("age_s"),
            ("hits", pa.int32()),
            ("misses", pa.int32()),
            *_floats("nis", "manoeuvre_probability"),
            ("model", pa.string()),
            ("state", pa.list_(pa.float64())),
            ("covariance_upper", pa.list_(pa.float64())),
        ]
    ),
    "predictions": pa.schema(
        [
            *_FRAME_KEYS,
            ("track_id", pa.int64()),
            ("step", pa.int32()),
            ("target_ns", pa.int64()),
            *_floats("x_m", "y_m", "z_m", "vx_mps", "vy_mps", "cov_xx_m2", "cov_xy_m2", "cov_yy_m2"),
            *_floats("radius_m", "sigma_radius_m", "conformal_radius_m"),
            ("is_static", pa.bool_()),
        ]
    ),
    "timings": pa.schema([*_FRAME_KEYS, ("stage", pa.string()), *_floats("time_ms")]),
    "drives": pa.schema(
        [
            *_DRIVE_KEYS,
            *_floats("period_s", "nominal_s", "reference_length_m", "reference_speed_mps"),
            ("result", pa.string()),
            ("ticks", pa.int32()),
        ]
    ),
    "trajectories": pa.schema(
        [
            *_TICK_KEYS,
            *_floats("x_m", "y_m", "yaw_rad", "speed_mps", "turn_input", "clearance_m"),
            ("nearest_id", pa.int64()),
            *_floats("ttc_s", "reference_m", "along_m", "log_m"),
            ("recorded", pa.bool_()),
            ("goal_reachable", pa.bool_()),
        ]
    ),
    "plans": pa.schema(
        [
            *_TICK_KEYS,
            ("outcome", pa.string()),
            ("status", pa.string()),
            ("start", pa.string()),
            ("iterations", pa.int32()),
            *_floats("merit", "violation_m2", "decay"),
            ("feasible", pa.bool_()),
            ("obstacles", pa.int32()),
            ("dropped", pa.int32()),
            ("conflict", pa.bool_()),
            *_floats("deviation_m"),
        ]
    ),
    "plan_stages": pa.schema(
        [
            *_TICK_KEYS,
            ("stage", pa.int32()),
            *_floats("x_m", "y_m", "yaw_rad", "speed_mps", "turn_input", "barrier_m2", "gamma", "slack_m2"),
            ("track_id", pa.int64()),
            *_floats("plan_error_m"),
        ]
    ),
    "solve_times": pa.schema([*_TICK_KEYS, *_floats("solve_ms")]),
    "runs": pa.schema(
        [
            *_DRIVE_KEYS,
            ("knowledge", pa.string()),
            ("result", pa.string()),
            *_floats("duration_s"),
            ("error", pa.string()),
            ("movers", pa.int32()),
            *_floats("fastest_mps"),
            ("standing", pa.int32()),
            *_floats("bumps_m", "slope_deg"),
            ("hit_object_id", pa.int64()),
            ("hit_kind", pa.string()),
            ("hit_moving", pa.bool_()),
            *_floats("hit_at_s", "hit_known_since_s"),
            ("hit_avoidable", pa.bool_()),
            *_floats("hit_avoidable_until_s"),
            ("escape_exists", pa.bool_()),
            ("log", pa.string()),
            *_floats(*(metric.name for metric in METRICS)),
        ]
    ),
    "gamma": pa.schema([("planner", pa.string()), *_floats("distance_m", "radius_m", "gamma")]),
    "score_blocks": pa.schema(
        [
            ("metric", pa.string()),
            ("block", pa.int64()),
            *_floats("sum", "count"),
            ("dealt", pa.bool_()),
            ("form", pa.string()),
        ]
    ),
    "summary": pa.schema(
        [
            ("path", pa.string()),
            ("command", pa.string()),
            ("status", pa.string()),
            ("exit_code", pa.int32()),
            ("error", pa.string()),
            ("source_sha256", pa.string()),
            ("run_folder", pa.string()),
            ("frames", pa.int64()),
            *_floats("span_s"),
            ("warnings", pa.list_(pa.string())),
            ("losses", pa.list_(pa.string())),
            ("thresholds_missed", pa.list_(pa.string())),
        ]
    ),
    "metrics": pa.schema(
        [
            ("metric", pa.string()),
            *_floats("value"),
            ("unit", pa.string()),
            ("n", pa.int64()),
            ("sample", pa.string()),
            *_floats("low", "high"),
            ("headline", pa.bool_()),
        ]
    ),
}
