"""Transforms over time, against scipy's Slerp, by hand, and by invariance."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from adcbf_cli.core.frames import (
    StampedTransform,
    TfBuffer,
    Trajectory,
    clean_frame_id,
    invert,
    invert_all,
    pose_matrix,
    quaternion_from_rotation,
    rotation_from_quaternion,
    slerp,
)

SECOND = 1_000_000_000
T0 = 1_700_000_000 * SECOND
seeds = st.integers(0, 2**32 - 1)


def random_pose(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return rng.normal(size=3) * 10, Rotation.random(random_state=rng.integers(2**31)).as_quat()


@given(seeds)
@settings(max_examples=50, deadline=None)
def test_interpolation_is_scipys_slerp_and_linear(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stamps = T0 + np.sort(rng.choice(2_000_000_000, size=6, replace=False)).astype(np.int64)
    poses = [random_pose(rng) for _ in stamps]
    trajectory = Trajectory()
    for stamp, (position, quaternion) in zip(stamps, poses, strict=True):
        trajectory.add(int(stamp), position, quaternion * rng.choice([-1.0, 1.0]))
    wanted = rng.integers(stamps[0], stamps[-1], size=20)
    matrices, known = trajectory.at(wanted, 10 * SECOND)
    assert known.all()
    seconds = (stamps - T0) * 1e-9
    at = (wanted - T0) * 1e-9
    expected = Slerp(seconds, Rotation.from_quat([q for _, q in poses]))(at).as_matrix()
    np.testing.assert_allclose(matrices[:, :3, :3], expected, atol=1e-9)
    for axis in range(3):
        linear = np.interp(at, seconds, [position[axis] for position, _ in poses])
        np.testing.assert_allclose(matrices[:, axis, 3], linear, atol=1e-8)


def test_slerp_of_nearly_equal_rotations_stays_a_rotation() -> None:
    start = np.array([[0.0, 0.0, 0.0, 1.0]])
    end = Rotation.from_rotvec([0, 0, 1e-7]).as_quat()[None]
    middle = slerp(start, end, np.array([0.5]))[0]
    np.testing.assert_allclose(Rotation.from_quat(middle).as_rotvec(), [0, 0, 5e-8], atol=1e-15)


def test_known_times_and_gaps() -> None:
    trajectory = Trajectory()
    for second, x in ((0, 0.0), (1, 1.0), (5, 5.0), (6, 6.0)):
        trajectory.add(T0 + second * SECOND, np.array([x, 0, 0]), np.array([0, 0, 0, 1.0]))
    asked = T0 + (np.array([-0.05, 0.0, 0.5, 1.0, 2.0, 5.0, 5.5, 6.05, 6.2]) * SECOND).astype(np.int64)
    matrices, known = trajectory.at(asked, SECOND)
    assert known.tolist() == [False, True, True, True, False, True, True, False, False]
    matrices, known = trajectory.at(asked, SECOND, extrapolate_ns=SECOND // 10)
    assert known.tolist() == [True, True, True, True, False, True, True, True, False]
    np.testing.assert_allclose(matrices[known, 0, 3], [-0.05, 0, 0.5, 1, 5, 5.5, 6.05], atol=1e-9)


def test_a_gap_at_rest_is_bridged_only_when_allowed() -> None:
    trajectory = Trajectory()
    for second in (0, 60):
        trajectory.add(T0 + second * SECOND, np.array([1.0, 2, 3]), np.array([0, 0, 0, 1.0]))
    middle = np.array([T0 + 30 * SECOND])
    assert not trajectory.at(middle, SECOND)[1][0]
    matrices, known = trajectory.at(middle, SECOND, allow_rest=True)
    assert known[0]
    np.testing.assert_allclose(matrices[0, :3, 3], [1, 2, 3])
    assert not trajectory.at(np.array([T0 + 62 * SECOND]), SECOND, allow_rest=True)[1][0]


def test_samples_out_of_order_and_repeated() -> None:
    trajectory = Trajectory()
    turn = np.array([0, 0, 0, 1.0])
    for second, x in ((2, 2.0), (0, 0.0), (1, 9.0), (1, 1.0)):
        trajectory.add(T0 + second * SECOND, np.array([x, 0, 0]), turn)
    assert len(trajectory) == 3
    matrices, _ = trajectory.at(np.array([T0 + SECOND // 2, T0 + 3 * SECOND // 2]), 2 * SECOND)
    np.testing.assert_allclose(matrices[:, 0, 3], [0.5, 1.5])


def test_pruning_changes_no_later_pose_and_bounds_memory() -> None:
    full, pruned = Trajectory(), Trajectory()
    for i in range(5000):
        stamp = T0 + i * SECOND // 100
        position = np.array([np.sin(i * 0.01), i * 0.1, 0])
        turn = Rotation.from_rotvec([0, 0, i * 0.01]).as_quat()
        full.add(stamp, position, turn)
        pruned.add(stamp, position, turn)
        pruned.prune(stamp - SECOND // 10)
        assert len(pruned) <= 80
    late = np.array([T0 + 4992 * SECOND // 100 + 3, T0 + 4995 * SECOND // 100])
    np.testing.assert_array_equal(full.at(late, SECOND)[0], pruned.at(late, SECOND)[0])
    assert pruned.at(late, SECOND)[1].all()


def test_tf_chain_by_hand() -> None:
    # A robot at (10, 0) facing +y, its sensor 1 m ahead of it and turned right by 90 degrees (facing +x again).
    left = np.array([0, 0, np.sin(np.pi / 4), np.cos(np.pi / 4)])
    buffer = TfBuffer()
    for stamp in (T0, T0 + SECOND):
        buffer.add(StampedTransform(stamp, "odom", "base", np.array([10.0, 0, 0]), left))
    buffer.add_static("base", "sensor", pose_matrix(np.array([1.0, 0, 0]), left * [1, 1, -1, 1]))
    matrices, known = buffer.lookup("odom", "sensor", np.array([T0 + SECOND // 2]), SECOND)
    assert known[0]
    np.testing.assert_allclose(matrices[0], [[1, 0, 0, 10], [0, 1, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]], atol=1e-12)
    back, _ = buffer.lookup("sensor", "odom", np.array([T0 + SECOND // 2]), SECOND)
    np.testing.assert_allclose(back[0] @ matrices[0], np.eye(4), atol=1e-12)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_any_lookup_through_a_random_tree_is_the_product_of_its_edges(seed: int) -> None:
    rng = np.random.default_rng(seed)
    buffer = TfBuffer()
    world_from: dict[str, np.ndarray] = {"f0": np.eye(4)}
    for i in range(1, 8):
        parent = f"f{rng.integers(i)}"
        position, turn = random_pose(rng)
        world_from[f"f{i}"] = world_from[parent] @ pose_matrix(position, turn)
        if rng.random() < 0.5:
            buffer.add_static(parent, f"f{i}", pose_matrix(position, turn))
        else:
            for stamp in (T0, T0 + SECOND):
                buffer.add(StampedTransform(stamp, parent, f"f{i}", position, turn))
    a, b = (f"f{k}" for k in rng.choice(8, size=2))
    matrices, known = buffer.lookup(a, b, np.array([T0, T0 + 7]), SECOND)
    assert known.all()
    expected = np.linalg.inv(world_from[a]) @ world_from[b]
    np.testing.assert_allclose(matrices, [expected, expected], atol=1e-8)


def test_tf_loops_and_strangers_are_no_paths() -> None:
    buffer = TfBuffer()
    buffer.add_static("a", "b", np.eye(4))
    buffer.add_static("b", "a", np.eye(4))
    assert buffer.ancestors("a") == ("a", "b")
    assert not buffer.connected("a", "c")
    assert not buffer.lookup("a", "c", np.array([T0]), SECOND)[1].any()


def test_a_fixed_extrinsic_wins_over_the_log() -> None:
    buffer = TfBuffer()
    mine = pose_matrix(np.array([1.0, 0, 0]), np.array([0, 0, 0, 1.0]))
    buffer.add_static("base", "lidar", mine, fixed=True)
    buffer.add_static("base", "lidar", np.eye(4))
    buffer.add(StampedTransform(T0, "base", "lidar", np.zeros(3), np.array([0, 0, 0, 1.0])))
    np.testing.assert_array_equal(buffer.lookup("base", "lidar", np.array([T0]), SECOND)[0][0], mine)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_rotations_agree_with_scipy_and_inverses_undo(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = Rotation.random(5, random_state=rng.integers(2**31))
    matrices = rotation_from_quaternion(turn.as_quat() * rng.uniform(0.5, 2))
    np.testing.assert_allclose(matrices, turn.as_matrix(), atol=1e-12)
    q = quaternion_from_rotation(matrices[0])
    assert q[3] >= 0
    np.testing.assert_allclose(rotation_from_quaternion(q), matrices[0], atol=1e-12)
    poses = np.array([pose_matrix(rng.normal(size=3), quaternion) for quaternion in turn.as_quat()])
    np.testing.assert_allclose(invert_all(poses) @ poses, np.tile(np.eye(4), (5, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(invert_all(poses)[0], invert(poses[0]), atol=1e-12)


@pytest.mark.parametrize(("given_name", "clean"), [("/map", "map"), ("map", "map"), (" //odom ", "odom"), ("", "")])
def test_frame_ids_lose_their_slash(given_name: str, clean: str) -> None:
    assert clean_frame_id(given_name) == clean


def test_asking_in_between_changes_nothing() -> None:
    """Samples at the end, in between, again, and pruning, with questions after each: as one asked at last."""
    rng = np.random.default_rng(5)
    asked, plain = Trajectory(), Trajectory()
    for step in range(300):
        stamp = int(step * 100 + rng.integers(-250, 60))
        sample = rng.normal(size=3), np.array([0.0, 0.0, 0.0, 1.0])
        for one in (asked, plain):
            one.add(stamp, *sample)
            if step == 200:
                one.prune(15_000)
        asked.at(np.array([stamp - 30]), 10_000)
    times = np.arange(15_000, 30_000, 37)
    for mine, other in zip(asked.at(times, 10_000), plain.at(times, 10_000), strict=True):
        np.testing.assert_array_equal(mine, other)
