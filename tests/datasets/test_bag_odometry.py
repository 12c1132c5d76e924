"""Poses from a topic of odometry: ``poses: /odom`` beside a bag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from bags import BagWriter, padded_rows
from conformance import check
from made_up import DRIVE

from docdepth.datasets import open_dataset
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.se3 import inverse, matrix_to_quaternion, poses_from, rotation_exp
from docdepth.geometry.trajectory import Trajectory

pytest.importorskip("rosbags")

T_BODY_LIDAR = poses_from([rotation_exp([0.02, 0.3, -0.4])], [[1.2, 0.1, 1.7]])[0]
BODY = Trajectory(DRIVE.times, DRIVE.poses @ inverse(T_BODY_LIDAR))


def pose_of(bag: BagWriter, pose: np.ndarray):
    x, y, z, w = matrix_to_quaternion(pose[:3, :3])
    return bag.make(
        "geometry_msgs/msg/Pose",
        bag.make("geometry_msgs/msg/Point", *pose[:3, 3].tolist()),
        bag.make("geometry_msgs/msg/Quaternion", x, y, z, w),
    )


def odometry(bag: BagWriter, time: int, pose: np.ndarray, child: str = "base_link"):
    place = pose_of(bag, pose)
    zero = bag.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    twist = bag.make("geometry_msgs/msg/Twist", zero, zero)
    return bag.make(
        "nav_msgs/msg/Odometry",
        bag.header(time, "odom"),
        child,
        bag.make("geometry_msgs/msg/PoseWithCovariance", place, np.zeros(36)),
        bag.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
    )


def write(
    folder: Path, times, kind: str = "db3", static: bool = True, poses=None, child="base_link",
    **said,
) -> Path:  # fmt: skip
    """A bag with sweeps, and odometry of base_link at some times."""
    path = folder / ("drive.bag" if kind == "ros1" else "drive")
    where = BODY.interpolate(times) if poses is None else poses
    with BagWriter(path, kind) as bag:
        if static:
            message = bag.transform("lidar", "base_link", T_BODY_LIDAR)
            bag.write("/tf_static", message, int(DRIVE.times[0]))
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
        for time, pose in zip(np.asarray(times).tolist(), where, strict=True):
            bag.write("/odom", odometry(bag, time, pose, child), time + 5_000_000)
    entries = {"poses": "/odom", **said}
    beside = path if path.is_dir() else path.parent
    (beside / "docdepth.yaml").write_text(yaml.safe_dump(entries))
    return path


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_odometry_of_the_vehicle_becomes_poses_of_the_lidar(tmp_path, kind):
    """50 messages a second, in disorder, some of them twice; those at sweeps tell the poses."""
    between = DRIVE.times[0] + 19_876_543 * np.arange(1, 20)
    times = np.concatenate([DRIVE.times, between, between[:3]])
    dataset = open_dataset(write(tmp_path, np.random.default_rng(0).permutation(times), kind))
    check(dataset, "bag")
    np.testing.assert_allclose(dataset.poses, DRIVE.poses, atol=1e-9)


def test_poses_lie_between_messages(tmp_path):
    """Straight ahead at 10 m/s, told ten times a second and never at a sweep."""
    first = int(DRIVE.times[0])
    times = first - 30_000_000 + 100_000_000 * np.arange(6)
    poses = np.repeat(np.eye(4)[None], 6, axis=0)
    poses[:, 0, 3] = 10.0 * (times - first) * 1e-9
    dataset = open_dataset(write(tmp_path, times, poses=poses, child="lidar"))
    expected = np.repeat(np.eye(4)[None], len(dataset), axis=0)
    expected[:, 0, 3] = 10.0 * (DRIVE.times - first) * 1e-9
    np.testing.assert_allclose(dataset.poses, expected, atol=1e-9)


def test_sweeps_outside_are_left_out(tmp_path, caplog):
    dataset = open_dataset(write(tmp_path, DRIVE.times[1:4]))
    check(dataset, "bag")
    assert "2 of 5 sweeps are before the first or after the last message of /odom" in caplog.text
    np.testing.assert_array_equal(dataset.times, DRIVE.times[1:4])
    np.testing.assert_allclose(dataset.poses, DRIVE.poses[1:4], atol=1e-9)
    np.testing.assert_array_equal(dataset.sweep(0).points, DRIVE.points(1))


def test_the_place_on_the_body_may_be_said(tmp_path):
    said = {"T_odometry_lidar": T_BODY_LIDAR.ravel().tolist()}
    path = write(tmp_path, DRIVE.times, static=False, **said)
    np.testing.assert_allclose(open_dataset(path).poses, DRIVE.poses, atol=1e-9)
    path = write(tmp_path, DRIVE.times, static=False)
    with pytest.raises(CalibrationError, match=r"of the frame 'base_link', points are in 'lidar'"):
        open_dataset(path)


def test_times_of_recording(tmp_path):
    """Messages are recorded 5 ms after their stamps, so the poses are those of 5 ms before."""
    path = write(tmp_path, DRIVE.times, stamps="record")
    dataset = open_dataset(path)
    expected = BODY.interpolate(DRIVE.times[1:] - 5_000_000) @ T_BODY_LIDAR
    np.testing.assert_allclose(dataset.poses, expected, atol=1e-4)


def test_a_topic_that_is_not_there(tmp_path):
    path = write(tmp_path, DRIVE.times)
    for wrong in ("/pose", "/points"):
        (path / "docdepth.yaml").write_text(f"poses: {wrong}\n")
        with pytest.raises(DatasetError, match=f"no odometry {wrong}; its topics .* are /odom"):
            open_dataset(path)


def test_another_clock(tmp_path):
    since_boot = DRIVE.times - DRIVE.times[0] + 10**9
    with pytest.raises(DatasetError, match=r"no sweep .* lies within /odom .*different clocks"):
        open_dataset(write(tmp_path, since_boot, poses=BODY.poses))


def test_a_gap(tmp_path):
    times = DRIVE.times[[0, -1]] + np.array([0, 200_000_000])
    poses = BODY.poses[[0, -1]]
    with pytest.raises(DatasetError, match=r"/odom has a gap of 0.6 s around sweep .*\(frame 1\)"):
        open_dataset(write(tmp_path, times, poses=poses))


def test_messages_that_are_no_poses(tmp_path):
    poses = BODY.poses.copy()
    poses[2, 0, 3] = np.nan
    with pytest.raises(DatasetError, match=r"/odom \(message 2\): its position is not finite"):
        open_dataset(write(tmp_path, DRIVE.times, poses=poses))
    with pytest.raises(DatasetError, match=r"headers have no stamps"):
        open_dataset(write_without_stamps(tmp_path))


def write_without_stamps(folder: Path) -> Path:
    path = folder / "drive"
    with BagWriter(path, "db3") as bag:
        for k, time in enumerate(DRIVE.times.tolist()):
            bag.write("/points", bag.cloud(padded_rows(k), time), time)
            bag.write("/odom", odometry(bag, 0, BODY.poses[k], "lidar"), time)
    (path / "docdepth.yaml").write_text("poses: /odom\n")
    return path
