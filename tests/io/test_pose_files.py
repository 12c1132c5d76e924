"""Poses of one's own SLAM: TUM and KITTI files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from docdepth.datasets.pose_tables import read_poses_at
from docdepth.errors import OdometryError
from docdepth.geometry.se3 import poses_from, rotation_exp
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.frames import write_trajectory
from docdepth.io.ply import write_vertices
from docdepth.io.poses import read_poses, read_tum, write_kitti, write_tum

POSE = np.eye(4)[None]


def turning(count: int) -> Trajectory:
    vectors = np.linspace([0, 0, 0], [0.02, -0.01, 0.3], count)
    poses = poses_from(list(rotation_exp(vectors)), np.linspace([0, 0, 0], [5, 1, 0.2], count))
    return Trajectory(1317042145051199337 + np.arange(count) * 103_000_001, poses)


def test_pose_files_round_trip(tmp_path: Path) -> None:
    given = turning(5)
    write_tum(tmp_path / "tum.txt", given)
    write_kitti(tmp_path / "kitti.txt", given.poses)
    write_trajectory(tmp_path / "t.ply", given, np.arange(5))
    for name, error in (("tum.txt", 1e-8), ("kitti.txt", 1e-11), ("t.ply", 1e-12)):
        np.testing.assert_allclose(read_poses(tmp_path / name, 5), given.poses, atol=error)
    np.testing.assert_array_equal(read_tum(tmp_path / "tum.txt").times, given.times)
    for shape, dtype, error in ((4, np.float64, 0), (3, np.float64, 0), (4, np.float32, 1e-6)):
        np.save(tmp_path / "p.npy", given.poses[:, :shape].astype(dtype))
        found = read_poses(tmp_path / "p.npy", 5)
        assert found.dtype == np.float64
        np.testing.assert_allclose(found, given.poses, atol=error)


def test_broken_ply_and_npy(tmp_path: Path) -> None:
    given = turning(3)
    write_trajectory(tmp_path / "two.ply", given, np.array([0, 2, 3]))
    write_vertices(tmp_path / "points.ply", np.zeros(3, [("x", "<f4")]), [])
    arrays = {"flat": np.zeros((3, 12)), "text": np.full((3, 4, 4), "a"), "empty": POSE[:0],
              "scaled": 2 * POSE, "fine": POSE}  # fmt: skip
    for name, array in arrays.items():
        np.save(tmp_path / f"{name}.npy", array)
    (tmp_path / "cut.npy").write_bytes((tmp_path / "fine.npy").read_bytes()[:150])
    np.save(tmp_path / "object.npy", np.array([{}], object))
    for name, match in (
        ("two.ply", "not numbered 0, 1, 2"),
        ("points.ply", "no trajectory of a run"),
        ("none.ply", "it is not there"),
        ("none.npy", "none.npy is missing"),
        ("none.txt", r"none\.txt is missing"),
        ("flat.npy", r"of shape \(3, 12\)"),
        ("text.npy", "poses are numbers"),
        ("empty.npy", "holds no poses"),
        ("scaled.npy", "frame 0 is not a rotation and a translation"),
        ("fine.npy", "1 poses for 2 sweeps"),
        ("cut.npy", "cannot be read as NPY"),
        ("object.npy", "cannot be read as NPY"),
    ):
        with pytest.raises(OdometryError, match=match):
            read_poses(tmp_path / name, 2)


@pytest.mark.parametrize(
    "heading",
    ["#stamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []", "# t x y z qw qx qy qz"],
)
def test_a_heading_names_the_order_of_quaternions(tmp_path: Path, heading: str) -> None:
    """As EuRoC's files and those of its followers have it, times in nanoseconds, too."""
    turn = Rotation.from_euler("z", 30, degrees=True)
    x, y, z, w = turn.as_quat().tolist()
    rows = [f"{1520530308199447626 + k},1,2,{k},{w},{x},{y},{z}" for k in range(3)]
    (tmp_path / "a.csv").write_text("\n".join([heading, *rows]) + "\n")
    found = read_tum(tmp_path / "a.csv")
    np.testing.assert_allclose(found.poses[2, :3, :3], turn.as_matrix(), atol=1e-12)
    assert found.times.tolist() == [1520530308199447626 + k for k in range(3)]


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
        ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0\n", "pose 1: .* is not 8 numbers but 7"),
        ("0 0 0 0 0 0 0 1\n1,0,0,0,0,0,0,1,9\n", "pose 1: .* is not 8 numbers but 9"),
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


@pytest.mark.parametrize(("late_ns", "told"), [(0, 0), (90_000_000, 1), (10**12, 0)])
def test_other_times_are_told_unless_they_are_of_another_clock(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, late_ns: int, told: int
) -> None:
    given = turning(5)
    write_tum(tmp_path / "p.txt", Trajectory(given.times + late_ns, given.poses))
    read_poses_at(tmp_path / "p.txt", given.times)
    assert len(caplog.records) == told


def test_times_of_another_clock_are_compared_by_it(tmp_path: Path, caplog) -> None:
    """Their steps tell that a pose is missing and another one was added."""
    given = turning(5)
    times = 10**15 + np.array([0, 100, 300, 400, 500]) * 10**6
    write_tum(tmp_path / "p.txt", Trajectory(times, given.poses))
    read_poses_at(tmp_path / "p.txt", given.times)
    (record,) = caplog.records
    assert "by the clock of the sweeps, sweep 1 of" in record.getMessage()


def test_poses_of_another_rate_are_interpolated(tmp_path: Path) -> None:
    """Ten a sweep, and every second sweep alone."""
    given = turning(9)
    fine = given.times[0] + np.linspace(0, np.ptp(given.times), 81).astype(np.int64)
    write_tum(tmp_path / "fine.txt", Trajectory(fine, given.interpolate(fine)))
    found = read_poses_at(tmp_path / "fine.txt", given.times)
    np.testing.assert_allclose(found, given.poses, atol=1e-8)
    write_tum(tmp_path / "half.txt", Trajectory(given.times[::2], given.poses[::2]))
    found = read_poses_at(tmp_path / "half.txt", given.times)
    np.testing.assert_allclose(found[::2], given.poses[::2], atol=1e-8)
    between = Trajectory(given.times[::2], given.poses[::2]).interpolate(given.times[1::2])
    np.testing.assert_allclose(found[1::2], between, atol=1e-8)
    write_tum(tmp_path / "part.txt", Trajectory(fine[:60], given.interpolate(fine[:60])))
    with pytest.raises(OdometryError, match="60 poses for 9 sweeps, and none near sweep 8"):
        read_poses_at(tmp_path / "part.txt", given.times)
    write_tum(tmp_path / "late.txt", Trajectory(fine + 10**13, given.interpolate(fine)))
    with pytest.raises(OdometryError, match="81 poses for 9 sweeps, at times of another clock"):
        read_poses_at(tmp_path / "late.txt", given.times)
    write_kitti(tmp_path / "kitti.txt", given.poses[:8])
    with pytest.raises(OdometryError, match="8 poses for 9 sweeps; bring one pose a sweep"):
        read_poses_at(tmp_path / "kitti.txt", given.times)
