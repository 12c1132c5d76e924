"""Poses from topics of odometry, poses, paths and transforms: ``poses: /topic`` beside a bag."""

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
FRAME = {"odometry_frame": "/base_link"}


class Bag(BagWriter):
    """The made-up drive with base_link, on which the LiDAR sits."""

    def __init__(self, folder: Path, kind: str = "db3", static: bool = True, **said) -> None:
        super().__init__(folder / ("drive.bag" if kind == "ros1" else "drive"), kind)
        self.static = static
        beside = folder if kind == "ros1" else self.path
        self.said = beside / "docdepth.yaml", yaml.safe_dump(said)

    def __enter__(self) -> Bag:
        super().__enter__()
        if self.static:
            message = self.transform("lidar", "base_link", T_BODY_LIDAR)
            self.write("/tf_static", message, int(DRIVE.times[0]))
        for k, time in enumerate(DRIVE.times.tolist()):
            self.write("/points", self.cloud(padded_rows(k), time), time)
        return self

    def __exit__(self, *_: object) -> None:
        super().__exit__()
        self.said[0].write_text(self.said[1])

    def pose(self, pose: np.ndarray):
        x, y, z, w = matrix_to_quaternion(pose[:3, :3])
        return self.make(
            "geometry_msgs/msg/Pose",
            self.make("geometry_msgs/msg/Point", *pose[:3, 3].tolist()),
            self.make("geometry_msgs/msg/Quaternion", x, y, z, w),
        )

    def stamped(self, time: int, pose: np.ndarray):
        header = self.header(time, "map")
        return self.make("geometry_msgs/msg/PoseStamped", header, self.pose(pose))

    def covariant(self, time: int, pose: np.ndarray):
        place = self.make("geometry_msgs/msg/PoseWithCovariance", self.pose(pose), np.zeros(36))
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        return self.make(kind, self.header(time, "map"), place)

    def odometry(self, time: int, pose: np.ndarray, child: str = "base_link"):
        zero = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = self.make("geometry_msgs/msg/Twist", zero, zero)
        return self.make(
            "nav_msgs/msg/Odometry",
            self.header(time, "odom"),
            child,
            self.make("geometry_msgs/msg/PoseWithCovariance", self.pose(pose), np.zeros(36)),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
        )

    def path_of(self, times, poses):
        stamped = [self.stamped(t, p) for t, p in zip(times.tolist(), poses, strict=True)]
        return self.make("nav_msgs/msg/Path", self.header(int(BODY.times[0]), "map"), stamped)

    def move(self, child: str, parent: str, times, poses) -> None:
        for time, pose in zip(times.tolist(), poses, strict=True):
            self.write("/tf", self.transform(child, parent, pose, time), time + 5_000_000)


def with_odometry(folder: Path, times: np.ndarray, poses=None, child="base_link", **said) -> Path:
    """A bag with odometry of a frame at some times, which arrives 5 ms later."""
    poses = BODY.interpolate(times) if poses is None else poses
    with Bag(folder, poses="/pose", **said) as bag:
        for time, pose in zip(times.tolist(), poses, strict=True):
            bag.write("/pose", bag.odometry(time, pose, child), time + 5_000_000)
    return bag.path


@pytest.mark.parametrize(
    ("kind", "message"), [("ros1", "stamped"), ("mcap", "covariant"), ("db3", "odometry")]
)
def test_poses(tmp_path, kind, message):
    """50 messages a second, in disorder, some of them twice; those at sweeps tell the poses.

    Stamped poses do not tell of which frame they are; docdepth.yaml does.
    """
    between = DRIVE.times[0] + 19_876_543 * np.arange(1, 20)
    times = np.concatenate([DRIVE.times, between, between[:3]])
    times = np.random.default_rng(0).permutation(times)
    with Bag(tmp_path, kind, poses="/pose", **({} if message == "odometry" else FRAME)) as bag:
        for time, pose in zip(times.tolist(), BODY.interpolate(times), strict=True):
            bag.write("/pose", getattr(bag, message)(time, pose), time + 5_000_000)
    dataset = open_dataset(bag.path)
    check(dataset, "bag")
    np.testing.assert_allclose(dataset.poses, DRIVE.poses, atol=1e-9)


def test_sweeps_outside_are_left_out(tmp_path, caplog):
    dataset = open_dataset(with_odometry(tmp_path, DRIVE.times[1:4]))
    check(dataset, "bag")
    assert "2 of 5 sweeps are before the first or after the last message of /pose" in caplog.text
    np.testing.assert_array_equal(dataset.times, DRIVE.times[1:4])
    np.testing.assert_allclose(dataset.poses, DRIVE.poses[1:4], atol=1e-9)
    np.testing.assert_array_equal(dataset.sweep(0).points, DRIVE.points(1))


def test_the_place_on_the_body_may_be_said(tmp_path):
    said = {"T_odometry_lidar": T_BODY_LIDAR.ravel().tolist()}
    path = with_odometry(tmp_path, DRIVE.times, static=False, **said)
    np.testing.assert_allclose(open_dataset(path).poses, DRIVE.poses, atol=1e-9)
    path = with_odometry(tmp_path, DRIVE.times, static=False)
    with pytest.raises(CalibrationError, match=r"of the frame 'base_link', points are in 'lidar'"):
        open_dataset(path)


def test_times_of_recording(tmp_path):
    """Messages are recorded 5 ms after their stamps, so the poses are those of 5 ms before."""
    dataset = open_dataset(with_odometry(tmp_path, DRIVE.times, stamps="record"))
    expected = BODY.interpolate(DRIVE.times[1:] - 5_000_000) @ T_BODY_LIDAR
    np.testing.assert_allclose(dataset.poses, expected, atol=1e-4)


@pytest.mark.parametrize("topic", ["/odom", "/points"])
def test_a_topic_that_is_not_there(tmp_path, topic):
    path = with_odometry(tmp_path, DRIVE.times)
    (path / "docdepth.yaml").write_text(f"poses: {topic}\n")
    with pytest.raises(DatasetError, match=f"no odometry {topic}; its topics .* are /pose"):
        open_dataset(path)


def test_odometry_that_does_not_fit(tmp_path):
    since_boot = DRIVE.times - DRIVE.times[0] + 10**9
    with pytest.raises(DatasetError, match=r"no sweep .* lies within /pose .*different clocks"):
        open_dataset(with_odometry(tmp_path, since_boot, BODY.poses))
    poses = BODY.poses.copy()
    poses[2, 0, 3] = np.nan
    with pytest.raises(DatasetError, match=r"/pose \(message 2\)"):
        open_dataset(with_odometry(tmp_path, DRIVE.times, poses))
    with Bag(tmp_path, poses="/pose") as bag:
        for time, pose in zip(DRIVE.times.tolist(), BODY.poses, strict=True):
            bag.write("/pose", bag.odometry(0, pose, "lidar"), time)
    with pytest.raises(DatasetError, match=r"headers have no stamps"):
        open_dataset(bag.path)


def test_poses_of_a_frame_that_nobody_tells(tmp_path):
    with Bag(tmp_path, poses="/pose") as bag:
        for time, pose in zip(BODY.times.tolist(), BODY.poses, strict=True):
            bag.write("/pose", bag.stamped(time, pose), time)
    with pytest.raises(CalibrationError, match=r"/pose does not tell .*say odometry_frame: NAME"):
        open_dataset(bag.path)


def test_a_path_that_grows(tmp_path):
    """The last message has the whole path, and what a loop has corrected."""
    with Bag(tmp_path, poses="/path", **FRAME) as bag:
        for n in range(1, DRIVE.count + 1):
            poses = BODY.poses[:n].copy()
            poses[:, 1, 3] += 0.1 * (DRIVE.count - n)
            bag.write("/path", bag.path_of(BODY.times[:n], poses), int(BODY.times[n - 1]))
    np.testing.assert_allclose(open_dataset(bag.path).poses, DRIVE.poses, atol=1e-9)


def test_a_path_that_forgets(tmp_path):
    """Messages hold the last three poses; what the last one says of a stamp counts."""
    with Bag(tmp_path, poses="/path", **FRAME) as bag:
        bag.write("/path", bag.path_of(BODY.times[:0], []), int(BODY.times[0]))
        for n in range(1, DRIVE.count + 1):
            own = slice(max(n - 3, 0), n)
            poses = BODY.poses[own].copy()
            if n < DRIVE.count:
                poses[-1, 1, 3] += 0.3
            bag.write("/path", bag.path_of(BODY.times[own], poses), int(BODY.times[n - 1]))
    np.testing.assert_allclose(open_dataset(bag.path).poses, DRIVE.poses, atol=1e-9)


def test_a_path_has_no_times_of_recording(tmp_path):
    with Bag(tmp_path, poses="/path", stamps="record", **FRAME) as bag:
        bag.write("/path", bag.path_of(BODY.times, BODY.poses), int(BODY.times[0]))
    with pytest.raises(DatasetError, match=r"path /path have the stamps of their headers alone"):
        open_dataset(bag.path)


@pytest.mark.parametrize("kind", ["ros1", "db3"])
def test_transforms(tmp_path, kind):
    """map to odom changes slowly and is told twice a second, odom to base_link fast."""
    first, last = int(DRIVE.times[0]), int(DRIVE.times[-1])
    slow = np.array([first - 10, first + 250_000_000, last + 10])
    turns = [rotation_exp([0, 0, 0.1 * k]) for k in range(3)]
    T_map_odom = Trajectory(slow, poses_from(turns, [[k, 2.0, 0] for k in range(3)]))
    with Bag(tmp_path, kind, poses="/tf") as bag:
        bag.move("odom", "map", slow, T_map_odom.poses)
        T_odom_base = inverse(T_map_odom.interpolate(BODY.times)) @ BODY.poses
        bag.move("base_link", "odom", BODY.times, T_odom_base)
        bag.move("wheel", "base_link", BODY.times, BODY.poses)
        bag.move("base_link", "odom", BODY.times[:2], T_odom_base[:2])
    dataset = open_dataset(bag.path)
    check(dataset, "bag")
    np.testing.assert_allclose(dataset.poses, DRIVE.poses, atol=1e-9)


def test_transforms_of_a_frame_that_is_said(tmp_path):
    said = {"odometry_frame": "base_link", "T_odometry_lidar": T_BODY_LIDAR.ravel().tolist()}
    with Bag(tmp_path, static=False, poses="/tf", **said) as bag:
        bag.move("base_link", "map", BODY.times, BODY.poses)
    np.testing.assert_allclose(open_dataset(bag.path).poses, DRIVE.poses, atol=1e-9)


def test_transforms_that_do_not_move_the_lidar(tmp_path):
    with Bag(tmp_path, static=False, poses="/tf") as bag:
        bag.move("base_link", "map", BODY.times, BODY.poses)
    with pytest.raises(DatasetError, match=r"no frame above 'lidar' moves.*are of base_link"):
        open_dataset(bag.path)


def test_two_parents_and_a_circle(tmp_path):
    with Bag(tmp_path, poses="/tf") as bag:
        bag.move("base_link", "map", BODY.times, BODY.poses)
        bag.move("base_link", "utm", BODY.times, BODY.poses)
    with pytest.raises(DatasetError, match=r"'base_link' has several parents: map, utm"):
        open_dataset(bag.path)
    with Bag(tmp_path, poses="/tf") as bag:
        bag.move("base_link", "map", BODY.times, BODY.poses)
        bag.move("map", "base_link", BODY.times, BODY.poses)
    with pytest.raises(DatasetError, match=r"frames turn in a circle"):
        open_dataset(bag.path)


def test_a_gap_in_transforms(tmp_path):
    times = DRIVE.times[[0, -1]] + np.array([0, 200_000_000])
    with Bag(tmp_path, poses="/tf") as bag:
        bag.move("base_link", "map", times, BODY.poses[[0, -1]])
    with pytest.raises(DatasetError, match=r"/tf has a gap of 0.6 s around sweep .*\(frame 1\)"):
        open_dataset(bag.path)
