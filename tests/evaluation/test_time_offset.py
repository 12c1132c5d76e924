"""Clocks of camera and LiDAR that differ, found from points followed in images."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from command_line import cli
from docdepth.datasets import CameraStream
from docdepth.datasets.times import read_times
from docdepth.errors import CalibrationError
from docdepth.evaluation.followed_points import Window, follow, smooth_pose
from docdepth.evaluation.time_offset import TimeOffset, offset_of
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.geometry.trajectory import Trajectory

K = np.array([[150.0, 0, 80], [0, 150, 50], [0, 0, 1]])
CAMERA = Camera(K, 160, 100)
T_CAMERA_LIDAR = np.array([[0, -1, 0, 0.1], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1.0]])
ROOM = np.array([[-60.0, -25, -2], [60, 25, 8]])
V, U = np.indices((100, 160)).reshape(2, -1)
RAYS = np.column_stack([U, V, np.ones(len(U))]) @ np.linalg.inv(K).T


def lidar_pose(second: float, turns: float = 0.25, speed: float = 8) -> np.ndarray:
    """A vehicle that sways in its lane; exact at any time."""
    T = np.eye(4)
    T[:3, :3] = rotation_exp(np.array([0, 0, turns * np.sin(1.3 * second)]))
    T[:3, 3] = speed * second - 20, 2 * turns * np.sin(1.3 * second), 0
    return T


def depth_of(T_world_camera: np.ndarray) -> np.ndarray:
    """Depth of each pixel in the room, (h, w)."""
    d = RAYS @ T_world_camera[:3, :3].T
    d[np.abs(d) < 1e-9] = 1e-9
    walls = (np.where(d > 0, ROOM[1], ROOM[0]) - T_world_camera[:3, 3]) / d
    return walls.min(axis=1).reshape(100, 160).astype(np.float32)


def made(offset: float, jitter: float = 0.0, **motion: float) -> tuple:
    """Windows whose stamps lack ``offset`` seconds, the camera, and the LiDAR's trajectory."""
    rng = np.random.default_rng(0)
    times = np.arange(0, 60) * 100_000_000
    poses = np.array([lidar_pose(t * 1e-9, **motion) for t in times])
    poses[:, :3, 3] += rng.normal(0, jitter, (60, 3))
    windows = []
    for start in np.arange(0.4, 5.0, 0.5):
        T_world_camera = [
            lidar_pose(second, **motion) @ inverse(T_CAMERA_LIDAR)
            for second in (start, start + offset, start + offset + 0.5)
        ]
        by_stamp, first = (depth_of(T) for T in T_world_camera[:2])
        rows = rng.choice(len(U), 200, replace=False)
        points = RAYS[rows] * first.ravel()[rows, None]
        motion_of = inverse(T_world_camera[2]) @ T_world_camera[1]
        seen = (points @ motion_of[:3, :3].T + motion_of[:3, 3]) @ K.T
        ahead = seen[:, 2] > 1
        pixels = seen[ahead, :2] / seen[ahead, 2:] + rng.normal(0, 0.2, (ahead.sum(), 2))
        pixels[:5] += 30  # lost and found elsewhere
        start_pixels = np.column_stack([U, V])[rows][ahead].astype(float)
        at = round(1e9 * start)
        windows.append(Window(at, at + 500_000_000, start_pixels, pixels, by_stamp))
    stream = CameraStream("front", CAMERA, T_CAMERA_LIDAR, times, [str(t) for t in times])
    return windows, stream, Trajectory(times, poses), Path("run")


@pytest.mark.parametrize("offset", [0.0, 0.02, -0.02, 0.05, -0.05, 0.1, -0.1])
def test_offsets_are_found(offset) -> None:
    found = offset_of(*made(offset))
    assert found.seconds == pytest.approx(offset, abs=0.003)
    assert found.error < 0.004
    right = "the times of the images are right" in found.lines[0]
    assert right == (offset == 0)
    if not right:
        assert f"too {'early' if offset > 0 else 'late'}" in found.lines[0]


def test_poses_that_jitter_do_not_pull_to_half_a_sweep() -> None:
    found = offset_of(*made(0.0, jitter=0.03))
    assert abs(found.seconds) < max(0.006, 2.5 * found.error)


@pytest.mark.parametrize("motion", [{"turns": 0, "speed": 0}, {"turns": 0}, {"turns": 0.02}])
def test_a_vehicle_that_hardly_turns_does_not_tell(motion) -> None:
    with pytest.raises(CalibrationError, match="does not turn enough"):
        offset_of(*made(0.05, **motion))


def test_a_camera_that_is_not_quite_where_it_should_be() -> None:
    windows, stream, *others = made(0.05)
    T = stream.T_camera_lidar.copy()
    T[2, 3] += 0.05
    found = offset_of(windows, replace(stream, T_camera_lidar=T), *others)
    assert found.seconds == pytest.approx(0.05, abs=0.004)


def test_few_points_do_not_tell() -> None:
    windows, *others = made(0.0)
    with pytest.raises(CalibrationError, match="in 3 half seconds"):
        offset_of(windows[:3], *others)


def test_points_are_followed() -> None:
    rng = np.random.default_rng(1)
    grain = rng.integers(0, 255, (120, 160)).astype(np.uint8)
    big = cv2.GaussianBlur(grain, (0, 0), 2)
    images = [big[k : k + 100, 2 * k : 2 * k + 120].copy() for k in range(4)]
    first, last = follow(images, np.ones((100, 120), bool))
    assert len(first) > 50
    np.testing.assert_allclose(np.median(last - first, axis=0), [-6, -3], atol=0.1)
    assert not len(follow(images, np.zeros((100, 120), bool))[0])


def test_smooth_poses_lie_on_the_way() -> None:
    _, _, trajectory, _ = made(0.0)
    pose = smooth_pose(trajectory, 2_130_000_000)
    np.testing.assert_allclose(pose, lidar_pose(2.13), atol=0.005)


def test_corrected_times_can_be_read(tmp_path) -> None:
    found = TimeOffset(-0.05, 0.001, 500, 9, 0.3)
    times = np.array([1_317_000_000_120_000_001, 1_317_000_000_220_000_001])
    (tmp_path / "times.txt").write_text(found.corrected(times))
    np.testing.assert_array_equal(read_times(tmp_path / "times.txt"), times - 50_000_000)
    assert found.corrected(np.array([20_000_000])) == "-0.030000000\n"


def test_the_verb_needs_half_seconds(finished) -> None:
    ended = cli("calibrate", "--time", finished[0])
    assert ended.exit_code == 2
    assert "are needed to compare clocks" in str(ended.exception)
    ended = cli("calibrate", "--time", finished[0], "--square", "0.1")
    assert "leave the others out" in str(ended.exception)
