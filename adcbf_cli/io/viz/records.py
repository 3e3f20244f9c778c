"""What viewers are shown, in the order of time: a `SceneFrame` for each scan, a `DriveTick` for each planning step.

Plain arrays in the world's frame, in metres, radians and int64 nanoseconds; what a viewer's own format asks for is
its writer's business.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from adcbf_cli.core.replay.records import LOGGED
from adcbf_cli.core.types import Clusters, FloatArray, IntArray, Predictions, Tracks


@dataclass(frozen=True, slots=True)
class Show:
    """What holds for the whole log. drives: those that `DriveTick`s will come from."""

    source_sha256: str
    world_frame: str
    sensor_frame: str
    body_radius_m: Mapping[str, float]
    """By mode: `plan` and `replay` may have driven different vehicles."""
    probability: float
    """Of the ellipses around tracks."""
    drives: tuple[DriveName, ...]

    def planner_number(self, planner: str) -> int:
        """A planner's place among those shown, the same in open and closed loop."""
        return list(dict.fromkeys(drive.planner for drive in self.drives)).index(planner)


@dataclass(frozen=True, slots=True)
class DriveName:
    """A planner's drive. mode: `open_loop` or `replay`, the folder that it is from. topic: nobody else's, such as
    /replay/ad_cbf_mpc."""

    mode: str
    planner: str
    seed: int
    topic: str

    @property
    def has_own_path(self) -> bool:
        """False for a planner in open loop: it plans from where the log's vehicle was."""
        return self.mode == "replay" or self.planner == LOGGED


@dataclass(frozen=True, slots=True)
class LabelledCloud:
    """A scan's n points. points_m: (n, 3) in the sensor's frame. cluster_id: (n,) the obstacle that each belongs to.
    track_id: (n,) the track that this obstacle updated. NO_ID for none."""

    points_m: FloatArray
    cluster_id: IntArray
    track_id: IntArray


@dataclass(frozen=True, slots=True)
class SceneFrame:
    """One scan, and what was made of it.

    cloud: None where the log could not be read. tracks, predictions: None where that stage has not run.
    cluster_track: one a cluster, the track that it updated in this frame, or NO_ID.
    floor_m: height in the world to draw on what has none: the bottoms of the obstacles around, smoothed.
    driven: (k, 3) positions of the sensor so far, thinned, the last one now; None where its pose is not known, and in
        frames that do not bring it up to date.
    """

    stamp_ns: int
    clusters: Clusters
    cluster_track: IntArray
    tracks: Tracks | None
    predictions: Predictions | None
    cloud: LabelledCloud | None
    floor_m: float
    driven: FloatArray | None


@dataclass(frozen=True, slots=True)
class DriveTick:
    """One planning step of one drive.

    pose: (x, y, yaw). plan: (N + 1, 3) poses from now on, None where the drive has none (the log's own driver).
    driven: (k, 3) poses so far, thinned, the last one now; None at ticks that do not bring it up to date.
    outcome: "" for none. clearance_m: NaN where no obstacle is known. floor_m: as of the scan before.
    """

    drive: DriveName
    stamp_ns: int
    pose: FloatArray
    speed_mps: float
    clearance_m: float
    outcome: str
    plan: FloatArray | None
    driven: FloatArray | None
    floor_m: float = 0.0


Record = SceneFrame | DriveTick
