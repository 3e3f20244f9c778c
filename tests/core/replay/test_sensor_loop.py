"""A planner in a simulated scene: what it sees is what its log says, and the vehicle obeys its plans."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adcbf_cli.core.config import Config
from adcbf_cli.core.errors import UsageError
from adcbf_cli.core.perception.pipeline import Perception
from adcbf_cli.core.planning.presets import make_planner
from adcbf_cli.core.replay.records import Result
from adcbf_cli.core.replay.sensor_loop import SceneDrive, control_ticks, drive_scene
from adcbf_cli.core.simulation.scenario import Scenario
from adcbf_cli.core.simulation.simulator import Simulator
from adcbf_cli.core.types import Clusters, Notes
from adcbf_cli.core.vehicles.vehicle import Vehicle
from adcbf_cli.io.frame_reader import FrameReader
from adcbf_cli.io.simulation_log import write_log

SCENE: dict[str, Any] = {
    "duration_s": 20,
    "seed": 3,
    "terrain": {"kind": "bumps", "size_m": 40, "amplitude_m": 0.12, "wavelength_m": 3},
    "route": {"points_m": [[0, 0], [4, 0]]},
    "objects": [{"kind": "tree", "at_m": [3, 1.6]}, {"kind": "box", "at_m": [1, -2], "size_m": [0.6, 0.5, 0.8]}],
    "movers": [
        {"kind": "person", "path": {"kind": "line", "from_m": [2, -2.5], "to_m": [2, 3], "speed_mps": 0.7}},
        {"kind": "cylinder", "radius_m": 0.3, "path": {"kind": "stand", "at_m": [-2, 1]}},
    ],
    "lidar": {"kind": "spinning", "azimuth_step_deg": 1.0, "instantaneous": True, "max_range_m": 20},
}


def driven(planner: str = "ad-cbf-mpc", knowledge: Any = "perception", **changes: Any) -> SceneDrive:
    """One drive through SCENE."""
    return drive(planner, knowledge, [], **changes)


def drive(planner: str, knowledge: Any, seen: list[Clusters], **changes: Any) -> SceneDrive:
    config, notes = Config(), Notes()
    made = make_planner(planner, Vehicle.from_config(config.vehicle), config.planning, notes)
    scenario = Scenario.model_validate(SCENE | changes)
    return drive_scene(scenario, scenario.seed, made, config, notes, lambda: 0, knowledge, on_clusters=seen.append)


@pytest.mark.parametrize(
    "sensing",
    [
        {},
        {"lidar": SCENE["lidar"] | {"instantaneous": False}},
        {"odometry": {"rate_hz": 30, "heading_sigma_rad_per_sqrt_m": 0.05, "translation_sigma_m_per_sqrt_m": 0.05}},
    ],
    ids=["instantaneous", "turning", "drifting"],
)
def test_reading_the_drives_log_gives_the_clusters_that_it_drove_by(tmp_path: Path, sensing: dict[str, Any]) -> None:
    lived: list[Clusters] = []
    ran = drive("ad-cbf-mpc", "perception", lived, **sensing)
    scenario = Scenario.model_validate(SCENE | sensing)
    simulator = Simulator(scenario, scenario.seed, ran.motion)
    write_log(tmp_path / "run.mcap", simulator, simulator)
    perceive = Perception(Config().perception, Notes())
    with FrameReader(tmp_path / "run.mcap", Config().read, Notes()) as reader:
        read = [perceive(frame) for frame in reader]
    assert len(read) >= len(lived) > 30
    assert sum(len(clusters) for clusters in lived) > 50
    for mine, again in zip(lived, read, strict=False):
        assert mine.stamp_ns == again.stamp_ns
        np.testing.assert_array_equal(mine.world_from_sensor, again.world_from_sensor)
        for column in ("centre_m", "radius_m", "height_m", "length_m", "width_m", "yaw_rad", "points", "probability"):
            np.testing.assert_array_equal(getattr(mine, column), getattr(again, column), err_msg=column)


def test_the_ego_lets_the_person_pass_and_arrives() -> None:
    ran = driven()
    assert ran.drive.result is Result.SUCCESS
    assert np.nanmin(ran.drive.clearance_m) > 0.1
    assert set(ran.known_since_ns) == {0, 1, 2, 3}
    start_ns = int(ran.drive.stamp_ns[0])
    assert all(start_ns < since_ns for since_ns in ran.known_since_ns.values()), "a track takes several scans"
    assert np.hypot(*(ran.drive.pose[-1, :2] - ran.goal_m)) <= 0.3


def test_the_same_seed_drives_the_same_way_and_another_does_not() -> None:
    first, again, other = driven(), driven(), driven(seed=4)
    np.testing.assert_array_equal(first.drive.pose, again.drive.pose)
    assert not np.array_equal(first.drive.pose, other.drive.pose)


def test_scans_are_taken_from_where_the_ego_is_tilted_by_the_ground() -> None:
    lived: list[Clusters] = []
    ran = drive("pure-pursuit", "perception", lived)
    stamps = np.array([clusters.stamp_ns for clusters in lived])
    expected = ran.motion.at(stamps)
    for clusters, pose in zip(lived, expected, strict=True):
        place = clusters.world_from_sensor
        tilt = np.arccos(np.clip(place[2, 2], -1, 1))
        assert np.hypot(*(place[:2, 3] - pose[:2])) <= 0.8 * np.sin(tilt) + 1e-6, "0.8 m up, it leans with the ground"
    assert max(np.arccos(np.clip(c.world_from_sensor[2, 2], -1, 1)) for c in lived) > 0.02


def test_with_perfect_knowledge_no_scan_is_taken() -> None:
    lived: list[Clusters] = []
    ran = drive("ad-cbf-mpc", "perfect", lived)
    assert ran.drive.result is Result.SUCCESS
    assert not lived
    assert set(ran.stage_ms) == {"plan"}


def test_what_nobody_sees_is_hit() -> None:
    """The person is too quick for a planner that never looks farther than it stands off."""
    config = Config.model_validate({"perception": {"range_m": 0.35}})
    notes = Notes()
    made = make_planner("ad-cbf-mpc", Vehicle.from_config(config.vehicle), config.planning, notes)
    wall = {"kind": "wall", "from_m": [2, -3], "to_m": [2, 3], "height_m": 1.5}
    scenario = Scenario.model_validate(SCENE | {"objects": [wall], "movers": []})
    ran = drive_scene(scenario, 0, made, config, notes, lambda: 0)
    assert ran.drive.result is Result.COLLISION
    assert ran.drive.nearest_id[-1] == 0


def test_a_scene_without_a_route_is_refused() -> None:
    ego = {"path": {"kind": "stand", "at_m": [0, 0]}}
    with pytest.raises(UsageError, match="no route"):
        driven(route=None, ego=ego)


def test_the_world_is_placed_ahead_at_the_very_ticks_that_are_driven() -> None:
    driven_ns = driven().drive.stamp_ns
    ahead_ns = control_ticks(int(driven_ns[0]), int(driven_ns[-1]), Config().planning.rate_hz)
    np.testing.assert_array_equal(ahead_ns[: len(driven_ns)], driven_ns)


def test_with_perfect_knowledge_a_thing_is_known_from_when_it_is_in_range() -> None:
    """The post of 0.2 m radius is 4 m away, surface to centre, when the vehicle is at x = 1.8 m."""
    post = {"kind": "cylinder", "radius_m": 0.2, "path": {"kind": "stand", "at_m": [6, 0]}}
    ran = driven(
        "pure-pursuit", "perfect", movers=[post, post | {"path": {"kind": "stand", "at_m": [15, 0]}}], objects=[]
    )
    first = np.flatnonzero(ran.drive.pose[:, 0] >= 1.8)[0]
    assert ran.known_since_ns == {0: int(ran.drive.stamp_ns[first])}
