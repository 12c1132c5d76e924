"""Poses of one's own SLAM: TUM and KITTI files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from docdepth.errors import OdometryError
from docdepth.geometry.se3 import poses_from, rotation_exp
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.poses import read_poses, read_tum, write_kitti, write_tum


def test_pose_files_round_trip(tmp_path: Path) -> None:
    vectors = np.linspace([0, 0, 0], [0.02, -0.01, 0.3], 5)
    poses = poses_from(list(rotation_exp(vectors)), np.linspace([0, 0, 0], [5, 1, 0.2], 5))
    times = 1317042145051199337 + np.arange(5) * 103_000_001
    write_tum(tmp_path / "tum.txt", Trajectory(times, poses))
    write_kitti(tmp_path / "kitti.txt", poses)
    np.testing.assert_allclose(read_poses(tmp_path / "tum.txt", 5), poses, atol=1e-8)
    np.testing.assert_allclose(read_poses(tmp_path / "kitti.txt", 5), poses, atol=1e-11)
    np.testing.assert_array_equal(read_tum(tmp_path / "tum.txt").times, times)


def test_tum_quaternions_are_x_y_z_w(tmp_path: Path) -> None:
    # A quarter turn to the left, as evo and ROS write it.
    (tmp_path / "p.txt").write_text("# comment\n0.0 1 2 3 0 0 0.70710678 0.70710678\n")
    pose = read_poses(tmp_path / "p.txt", 1)[0]
    np.testing.assert_allclose(pose @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-7)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("0 0 0 0 0 0 0 1\n", "1 poses for 2 sweeps"),
        ("0 0 0 0 0 0 0 1\n" * 3, "3 poses for 2 sweeps"),
        ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 0\n", "pose 1: .* not a quaternion"),
        ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0\n", "pose 1: .* is not 8 numbers"),
        ("0 0 nan 0 0 0 0 1\n" * 2, "frame 0 is not a rotation and a translation"),
        ("2 0 0 0 0 1 0 0 0 0 1 0\n" * 2, "frame 0 is not a rotation and a translation"),
        ("1 2 3\n" * 2, "3 columns; TUM poses have 8"),
        ("", "holds no poses"),
    ],
)
def test_broken_poses(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(OdometryError, match=match):
        read_poses(tmp_path / "poses.txt", 2)


def test_missing_poses(tmp_path: Path) -> None:
    with pytest.raises(OdometryError, match=r"poses\.txt is missing"):
        read_poses(tmp_path / "poses.txt", 2)
