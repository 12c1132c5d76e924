"""Trajectories against scipy's rotations and slerp."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from docdepth.errors import InputError
from docdepth.geometry.se3 import (
    inverse,
    matrix_to_quaternion,
    poses_from,
    quaternion_to_matrix,
    rotation_exp,
    rotation_log,
)
from docdepth.geometry.trajectory import Trajectory

RNG = np.random.default_rng(3)
START = 1317042145051199337  # nanoseconds beyond what a double can hold


def random_poses(count: int) -> np.ndarray:
    rotations = Rotation.random(count, rng=RNG).as_matrix()
    return poses_from(list(rotations), RNG.normal(0, 30, (count, 3)))


def straight(x: list[float]) -> Trajectory:
    positions = np.zeros((len(x), 3))
    positions[:, 0] = x
    return Trajectory(np.arange(len(x)) * 10**8, poses_from([np.eye(3)] * len(x), positions))


def special_vectors() -> np.ndarray:
    axes = Rotation.random(50, rng=RNG).as_rotvec()
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = [0, 1e-15, 1e-9, 1e-6, 1e-3, 0.5, 3.0, np.pi - 1e-7, np.pi - 1e-9]
    return np.concatenate([axes * angle for angle in angles])


# ---- rotations


def test_rotation_exp_is_scipys() -> None:
    vectors = special_vectors()
    expected = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotation_exp(vectors), expected, atol=2e-15)
    np.testing.assert_allclose(rotation_exp(vectors[-1]), expected[-1], atol=2e-15)


def test_rotation_log_is_scipys() -> None:
    for vector in special_vectors():
        rotation = Rotation.from_rotvec(vector)
        log = rotation_log(rotation.as_matrix())
        np.testing.assert_allclose(log, rotation.as_rotvec(), atol=5e-15)


def test_rotation_log_at_half_a_turn() -> None:
    for axis in ([1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0, -0.8], [-0.48, 0.6, 0.64]):
        log = rotation_log(Rotation.from_rotvec(np.pi * np.array(axis)).as_matrix())
        assert np.linalg.norm(log) == pytest.approx(np.pi)
        np.testing.assert_allclose(np.abs(log / np.pi @ axis), 1, atol=1e-12)


def test_quaternions_are_scipys() -> None:
    for rotation in Rotation.random(200, rng=RNG):
        expected = rotation.as_quat(canonical=True)
        quaternion = matrix_to_quaternion(rotation.as_matrix())
        np.testing.assert_allclose(quaternion, expected, atol=5e-15)
        back = quaternion_to_matrix(3.0 * expected)
        np.testing.assert_allclose(back, rotation.as_matrix(), atol=5e-15)


@pytest.mark.parametrize("bad", [[0, 0, 0, 0], [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_no_quaternion(bad: list[float]) -> None:
    with pytest.raises(InputError, match="is not a quaternion"):
        quaternion_to_matrix(bad)


def test_interpolation_takes_the_shorter_arc() -> None:
    poses = np.repeat(np.eye(4)[None], 2, axis=0)
    poses[1, :3, :3] = Rotation.from_rotvec([0, 0, np.deg2rad(270)]).as_matrix()
    third = Trajectory(np.array([0, 3]), poses).interpolate(1)[0, :3, :3]
    expected = Rotation.from_rotvec([0, 0, np.deg2rad(-30)]).as_matrix()
    np.testing.assert_allclose(third, expected, atol=1e-15)


def test_inverse() -> None:
    poses = random_poses(20)
    np.testing.assert_allclose(inverse(poses), np.linalg.inv(poses), atol=1e-13)
    np.testing.assert_allclose(inverse(poses[0]) @ poses[0], np.eye(4), atol=1e-13)


# ---- in time


def test_interpolation_is_slerp_and_linear() -> None:
    poses = random_poses(30)
    times = START + np.cumsum(RNG.integers(10**7, 2 * 10**8, 30))
    asked = RNG.integers(times[0], times[-1], 500)
    result = Trajectory(times, poses).interpolate(asked)
    seconds, asked_seconds = (times - START) * 1e-9, (asked - START) * 1e-9
    slerp = Slerp(seconds, Rotation.from_matrix(poses[:, :3, :3]))
    np.testing.assert_allclose(result[:, :3, :3], slerp(asked_seconds).as_matrix(), atol=1e-7)
    for axis in range(3):
        expected = np.interp(asked_seconds, seconds, poses[:, axis, 3])
        np.testing.assert_allclose(result[:, axis, 3], expected, atol=1e-5)
    np.testing.assert_array_equal(result[:, 3], np.tile([0, 0, 0, 1.0], (500, 1)))


def test_interpolation_at_the_sweeps_gives_their_poses() -> None:
    poses = random_poses(5)
    times = START + np.arange(5) * 10**8
    np.testing.assert_array_equal(Trajectory(times, poses).interpolate(times), poses)


def test_interpolation_is_exact_between_nanoseconds() -> None:
    poses = poses_from([np.eye(3)] * 2, [[0, 0, 0], [100.0, 0, 0]])
    result = Trajectory(np.array([START, START + 100]), poses).interpolate(START + 1)
    assert result[0, 0, 3] == pytest.approx(1.0)


@pytest.mark.parametrize("outside", [START - 1, START + 4 * 10**8 + 1])
def test_poses_are_not_extrapolated(outside: int) -> None:
    trajectory = Trajectory(START + np.arange(5) * 10**8, random_poses(5))
    assert trajectory.covers([START, outside, START + 5]).tolist() == [True, False, True]
    with pytest.raises(InputError, match=rf"1 times lie outside .* {outside} ns \(entry 1\)"):
        trajectory.interpolate([START, outside])


def test_a_single_pose() -> None:
    trajectory = Trajectory(np.array([START]), random_poses(1))
    np.testing.assert_array_equal(trajectory.interpolate(START)[0], trajectory.poses[0])
    assert trajectory.subsample(1.0).tolist() == [0]
    assert trajectory.arc_length.tolist() == [0.0]
    with pytest.raises(InputError):
        trajectory.interpolate(START + 1)


def test_velocity_in_the_frame_of_the_sensor() -> None:
    """On a circle of 10 m at 5 m/s, looking along its way, the left towards the middle."""
    angle = np.arange(5) * 0.05
    positions = np.stack([10 * np.sin(angle), 10 - 10 * np.cos(angle), 0 * angle], axis=1)
    rotations = [rotation_exp([0, 0, a]) for a in angle]
    trajectory = Trajectory(START + np.arange(5) * 10**8, poses_from(rotations, positions))
    np.testing.assert_allclose(trajectory.velocity(2), [5, 0, 0], atol=0.01)
    np.testing.assert_allclose(trajectory.velocity(0), [5, 0.125, 0], atol=0.01)
    last = trajectory.velocity(len(trajectory) - 1)
    np.testing.assert_array_equal(trajectory.velocity(-1), last)
    assert np.linalg.norm(last) > 4
    single = Trajectory(np.array([START]), random_poses(1))
    assert single.velocity(0).tolist() == [0, 0, 0]


# ---- along the path


def test_standing_adds_no_path_and_crawling_does() -> None:
    jitter = RNG.uniform(-0.01, 0.01, 1000)
    x = np.concatenate([np.arange(10.0), 9 + jitter, np.arange(10.0, 15.0)])
    assert straight(list(x)).arc_length[-1] == pytest.approx(14.0, abs=0.03)
    assert straight(list(0.01 * np.arange(1001))).arc_length[-1] == pytest.approx(10.0, abs=0.06)


def test_subsample_is_greedy() -> None:
    trajectory = straight([0.0, 0.6, 1.2, 1.8, 2.4, 3.0, 3.0, 7.0])
    assert trajectory.subsample(1.0).tolist() == [0, 2, 4, 7]
    assert trajectory.subsample(0.0).tolist() == list(range(8))


# ---- the same as by plain loops, and fast


def plain_arc_length(trajectory: Trajectory) -> np.ndarray:
    positions = trajectory.poses[:, :3, 3]
    arc, kept, base = [0.0], positions[0], 0.0
    for position in positions[1:]:
        distance = float(np.linalg.norm(position - kept))
        if distance >= 0.05:
            base, kept = base + distance, position
        arc.append(base)
    return np.array(arc)


def plain_subsample(trajectory: Trajectory, spacing: float, duration: float) -> list[int]:
    arc = plain_arc_length(trajectory)
    seconds, kept = (trajectory.times - trajectory.times[0]) * 1e-9, [0]
    for i in range(1, len(arc)):
        overdue = seconds[i] - seconds[kept[-1]] >= 0.95 * duration
        if overdue or arc[i] - arc[kept[-1]] >= spacing:
            kept.append(i)
    return kept + [len(arc) - 1] * bool(arc[-1] > arc[kept[-1]])


@pytest.mark.parametrize("seed", range(8))
def test_random_trajectories_agree_with_plain_loops_bit_for_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 400))
    steps = rng.exponential(rng.choice([0.01, 0.1, 2.0], count)[:, None], (count, 3))
    poses = poses_from([np.eye(3)] * count, np.cumsum(steps, axis=0))
    spacing = 2 * rng.integers(1, 5 * 10**7, count)  # even, so that there are ties
    trajectory = Trajectory(START + np.cumsum(spacing), poses)
    assert trajectory.arc_length.tobytes() == plain_arc_length(trajectory).tobytes()
    for distance, duration in [(0.0, np.inf), (1.0, np.inf), (5.0, 0.5), (np.inf, 0.4)]:
        expected = plain_subsample(trajectory, distance, duration)
        assert trajectory.subsample(distance, duration).tolist() == expected
    middles = (trajectory.times[:-1] + trajectory.times[1:]) // 2
    edges = [trajectory.times[0] - 10**9, trajectory.times[-1] + 10**9]
    random = rng.integers(trajectory.times[0] - 10, trajectory.times[-1] + 10, 200)
    for time in [*middles, *(middles + 1), *trajectory.times, *edges, *random]:
        assert trajectory.nearest(time) == np.argmin(np.abs(trajectory.times - time))
    asked = np.append(random, edges)
    start = trajectory.times[0]
    expected = np.interp(
        (asked - start).astype(float),
        (trajectory.times - start).astype(float),
        plain_arc_length(trajectory),
    )
    assert trajectory.arc_length_at(asked).tobytes() == expected.tobytes()


# ---- refused


def test_refused_trajectories() -> None:
    poses, times = random_poses(4), np.arange(4) * 10**8
    with pytest.raises(InputError, match=r"n times and \(n, 4, 4\) poses"):
        Trajectory(times[:3], poses)
    with pytest.raises(InputError, match=r"n times and"):
        Trajectory(times[:0], poses[:0])
    with pytest.raises(InputError, match="between frames 1 and 2"):
        Trajectory(times[[0, 2, 1, 3]], poses)
    with pytest.raises(InputError, match="between frames 0 and 1"):
        Trajectory(times[[0, 0, 1, 3]], poses)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda pose: pose.__setitem__((0, 3), np.nan),
        lambda pose: pose.__setitem__((0, 0), np.inf),
        lambda pose: pose.__setitem__((slice(3), 0), -pose[:3, 0]),
        lambda pose: pose.__setitem__((slice(3), slice(3)), 1.01 * pose[:3, :3]),
        lambda pose: pose.__setitem__((3, 0), 0.5),
        lambda pose: pose.__setitem__(slice(None), 0.0),
    ],
    ids=["nan", "inf", "mirror", "scale", "projective", "zero"],
)
def test_what_is_no_pose(spoil) -> None:
    poses = random_poses(4)
    spoil(poses[2])
    with pytest.raises(InputError, match="the pose of frame 2"):
        Trajectory(np.arange(4), poses)
