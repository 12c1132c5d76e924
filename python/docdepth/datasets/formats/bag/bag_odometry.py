"""Poses of the LiDAR from a topic of a bag: odometry, poses, a path, or transforms."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.formats.bag.bag_file import BagFile
from docdepth.datasets.formats.bag.bag_transforms import read_transforms
from docdepth.datasets.formats.bag.ros_frames import TRANSFORMS, StaticFrames
from docdepth.datasets.pose_tables import pose_of
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.trajectory import Trajectory

log = logging.getLogger(__name__)

_ODOMETRY = "nav_msgs/msg/Odometry"
_PATH = "nav_msgs/msg/Path"
_POSE = "geometry_msgs/msg/PoseStamped"
_KINDS = (_ODOMETRY, _PATH, _POSE, "geometry_msgs/msg/PoseWithCovarianceStamped", TRANSFORMS)
_LONGEST_GAP = 500_000_000
"""Nanoseconds from message to message over which poses are interpolated: a vehicle may turn in
more."""


@dataclass(frozen=True)
class Body:
    """Where the LiDAR sits on what a topic tells the place of.

    Attributes
    ----------
    frames : StaticFrames
    lidar : str
        Frame of its points.
    frame : str, optional
        Of which the topic tells the place, where its messages do not say it.
    T_body_lidar : ndarray of float64, shape (4, 4), optional
        By the static transforms if left out.
    where : str
        Where this is said, for errors.
    """

    frames: StaticFrames
    lidar: str
    frame: str | None
    T_body_lidar: NDArray[np.float64] | None
    where: str

    def place(self, topic: str, told: str | None) -> NDArray[np.float64]:
        """``T_body_lidar`` (4, 4) on the frame that messages tell, or that the user says.

        Raises
        ------
        CalibrationError
            The frame is not known, or nothing connects it and the LiDAR.
        """
        if self.T_body_lidar is not None:
            return self.T_body_lidar
        frame = self.frame or told
        if frame is None:
            raise CalibrationError(
                f"{self.where}: {topic} does not tell of which frame its poses are; say "
                "odometry_frame: NAME, or T_odometry_lidar"
            )
        T = self.frames.between(frame, self.lidar)
        if T is None:
            raise CalibrationError(
                f"{self.where}: {topic} is of the frame {frame!r}, points are in "
                f"{self.lidar!r}, and no static transform connects them; say T_odometry_lidar"
            )
        return T


@dataclass(frozen=True)
class BagPoses:
    """The way from the world to the LiDAR, over frames that move and frames that do not.

    Attributes
    ----------
    topic : str
    links : list of Trajectory or ndarray of float64, shape (4, 4)
        Their product, at any time, is ``T_world_lidar``.
    """

    topic: str
    links: Sequence[Trajectory | NDArray[np.float64]]

    def at(
        self, times: NDArray[np.int64], where: str
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Which sweeps lie within the messages, and ``T_world_lidar`` of these.

        Raises
        ------
        DatasetError
            None does, or messages are too far apart around a sweep.
        """
        moving = [link for link in self.links if isinstance(link, Trajectory)]
        inside = np.logical_and.reduce([link.covers(times) for link in moving])
        if not inside.any():
            first = max(link.times[0] for link in moving) * 1e-9
            last = min(link.times[-1] for link in moving) * 1e-9
            raise DatasetError(
                f"{where}: no sweep ({times[0] * 1e-9:.3f} to {times[-1] * 1e-9:.3f} s) lies "
                f"within {self.topic} ({first:.3f} to {last:.3f} s): are "
                "they on different clocks? Say stamps: record, or leave poses out"
            )
        if not inside.all():
            log.warning(
                "%s: %d of %d sweeps are before the first or after the last message of %s and are "
                "left out", where, (~inside).sum(), len(times), self.topic,
            )  # fmt: skip
        poses = np.repeat(np.eye(4)[None], int(inside.sum()), axis=0)
        for link in self.links:
            if isinstance(link, Trajectory):
                self._refuse_gaps(link, times, inside, where)
                poses = poses @ link.interpolate(times[inside])
            else:
                poses = poses @ link
        return inside, poses

    def _refuse_gaps(
        self,
        link: Trajectory,
        times: NDArray[np.int64],
        inside: NDArray[np.bool_],
        where: str,
    ) -> None:
        """Where nothing changes, messages may be far apart."""
        if len(link) == 1:
            return
        after = np.searchsorted(link.times, times).clip(1, len(link) - 1)
        gaps = link.times[after] - link.times[after - 1]
        changes = (link.poses[after] != link.poses[after - 1]).any(axis=(1, 2))
        on_time = np.isin(times, link.times)
        far = np.flatnonzero(inside & (gaps > _LONGEST_GAP) & changes & ~on_time)
        if len(far):
            frame = int(far[0])
            raise DatasetError(
                f"{where}: {self.topic} has a gap of {gaps[frame] * 1e-9:.1f} s around sweep "
                f"{times[frame]} (frame {frame}); cut the bag there, or leave poses out"
            )


def read_bag_poses(bag: BagFile, topic: str, by_record: bool, body: Body) -> BagPoses:
    """The poses of a topic.

    Parameters
    ----------
    bag : BagFile
    topic : str
        Of odometry, poses, a path, or transforms.
    by_record : bool
        Times of recording count, not those of headers.
    body : Body

    Raises
    ------
    DatasetError
        There is no such topic, or a message is no pose.
    CalibrationError
        Nothing tells where the LiDAR sits on what the topic is of.
    """
    kinds = {t: k for t, k in bag.topics.items() if k in _KINDS and not t.endswith("tf_static")}
    kind = kinds.get(topic)
    if kind is None:
        raise DatasetError(
            f"{body.where}: {bag.path} has no odometry {topic}; its topics of odometry, poses, "
            f"paths and transforms are {', '.join(kinds) or 'none'}"
        )
    if kind == TRANSFORMS:
        start = body.frame or body.lidar
        T = body.place(topic, start)
        links = read_transforms(bag, topic, by_record, body.frames, start)
        return BagPoses(topic, [*links, T])
    if kind == _PATH:
        if by_record:
            raise DatasetError(
                f"{body.where}: poses of the path {topic} have the stamps of their headers alone; "
                "leave out stamps: record, or poses"
            )
        trajectory, told = _path(bag, topic), None
    else:
        trajectory, told = _poses(bag, topic, by_record, kind)
    return BagPoses(topic, [trajectory, body.place(topic, told)])


def _poses(bag: BagFile, topic: str, by_record: bool, kind: str) -> tuple[Trajectory, str | None]:
    """Places of a frame, and its name where messages tell it."""
    index, messages = bag.index([topic])[topic], bag.read_all(topic)
    times = [m.recorded if by_record else m.stamp for m in index]
    if kind != _ODOMETRY:
        found = messages if kind == _POSE else [message.pose for message in messages]
        return _trajectory(times, [one.pose for one in found], bag, topic), None
    trajectory = _trajectory(times, [message.pose.pose for message in messages], bag, topic)
    bodies = {message.child_frame_id.lstrip("/") for message in messages}
    if len(bodies) > 1:
        raise DatasetError(
            f"{bag.path}, {topic}: messages are of several frames: {', '.join(sorted(bodies))}"
        )
    return trajectory, bodies.pop() or None


def _path(bag: BagFile, topic: str) -> Trajectory:
    """The poses of paths. Of several with a stamp the last counts: loops were closed by then."""
    index = bag.index([topic])[topic]
    if not index:
        raise DatasetError(f"{bag.path}, {topic}: there is no message")
    read = (bag.read(topic, message, f"{bag.path}, {topic}") for message in index)
    first = next((path for path in read if path.poses), None)
    last = bag.read(topic, index[-1], f"{bag.path}, {topic}")
    known = {_stamp(one) for one in last.poses}
    # A path that grows is whole in its last message; of one that forgets, all are needed.
    whole = first is None or all(_stamp(one) in known for one in first.poses)
    paths = [last] if whole else bag.read_all(topic)[::-1]
    poses = [one for path in paths for one in path.poses]
    return _trajectory([_stamp(one) for one in poses], [one.pose for one in poses], bag, topic)


def _stamp(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _trajectory(times: list[int], poses: list[Any], bag: BagFile, topic: str) -> Trajectory:
    """Poses by their stamps, of several with one the first."""
    if not poses or not any(times):
        raise DatasetError(
            f"{bag.path}, {topic}: "
            + ("headers have no stamps; say stamps: record" if poses else "there is no message")
        )
    found = np.stack([_pose(p, f"{bag.path}, {topic} (message {k})") for k, p in enumerate(poses)])
    stamps, first = np.unique(np.array(times, np.int64), return_index=True)
    return Trajectory(stamps, found[first])


def _pose(pose: Any, where: str) -> NDArray[np.float64]:
    p, q = pose.position, pose.orientation
    return pose_of([q.w, q.x, q.y, q.z], [p.x, p.y, p.z], where)
