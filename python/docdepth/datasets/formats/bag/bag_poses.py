"""Poses of the LiDAR from a topic of a bag: odometry, poses, a path, or transforms."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.formats.bag.bag_file import BagFile
from docdepth.datasets.formats.bag.bag_frames import TRANSFORMS, read_transforms
from docdepth.datasets.formats.bag.opened_bag import OpenedBag
from docdepth.datasets.pose_tables import pose_of
from docdepth.datasets.settings import transform
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


def poses_of_topic(
    bag: OpenedBag, topic: str, lidar_frame: str, times: NDArray[np.int64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which sweeps lie within the messages of a topic, and ``T_world_lidar`` of these.

    The topic is of odometry, poses, a path, or transforms. ``lidar_frame`` is that of the points,
    ``times`` (n,) are nanoseconds of the sweeps.
    """
    file, settings = bag.file, bag.settings
    kinds = {t: k for t, k in file.topics.items() if k in _KINDS and not t.endswith("tf_static")}
    kind, by_record = kinds.get(topic), settings.stamps == "record"
    if kind is None:
        raise DatasetError(
            f"{settings.file}: {bag.path} has no odometry {topic}; its topics of odometry, poses, "
            f"paths and transforms are {', '.join(kinds) or 'none'}"
        )
    if kind == TRANSFORMS:
        start = (settings.odometry_frame or lidar_frame).lstrip("/")
        place = _place(bag, topic, lidar_frame, start)
        links = [*read_transforms(file, topic, by_record, bag.frames, start), place]
        return _product(links, topic, times, bag)
    if kind == _PATH:
        if by_record:
            raise DatasetError(
                f"{settings.file}: poses of the path {topic} have the stamps of their headers "
                "alone; leave out stamps: record, or poses"
            )
        trajectory, told = _path(file, topic), None
    else:
        trajectory, told = _poses(file, topic, by_record, kind)
    return _product([trajectory, _place(bag, topic, lidar_frame, told)], topic, times, bag)


def _place(bag: OpenedBag, topic: str, lidar_frame: str, told: str | None) -> NDArray[np.float64]:
    """``T_body_lidar`` (4, 4) on the frame that messages tell, or that the user says."""
    settings = bag.settings
    if settings.T_odometry_lidar is not None:
        return transform(settings.T_odometry_lidar, f"{settings.file}: T_odometry_lidar")
    frame = (settings.odometry_frame or "").lstrip("/") or told
    if frame is None:
        raise CalibrationError(
            f"{settings.file}: {topic} does not tell of which frame its poses are; say "
            "odometry_frame: NAME, or T_odometry_lidar"
        )
    T = bag.frames.between(frame, lidar_frame)
    if T is None:
        raise CalibrationError(
            f"{settings.file}: {topic} is of the frame {frame!r}, points are in {lidar_frame!r}, "
            "and no static transform connects them; say T_odometry_lidar"
        )
    return T


def _product(
    links: Sequence[Trajectory | NDArray[np.float64]],
    topic: str,
    times: NDArray[np.int64],
    bag: OpenedBag,
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which sweeps lie within all links from the world to the LiDAR, and the poses of these."""
    moving = [link for link in links if isinstance(link, Trajectory)]
    inside = np.logical_and.reduce([link.covers(times) for link in moving])
    if not inside.any():
        first = max(link.times[0] for link in moving) * 1e-9
        last = min(link.times[-1] for link in moving) * 1e-9
        raise DatasetError(
            f"{bag.path}: no sweep ({times[0] * 1e-9:.3f} to {times[-1] * 1e-9:.3f} s) lies "
            f"within {topic} ({first:.3f} to {last:.3f} s): are they on different clocks? "
            "Say stamps: record, or leave poses out"
        )
    if not inside.all():
        log.warning(
            "%s: %d of %d sweeps are before the first or after the last message of %s and are "
            "left out", bag.path, (~inside).sum(), len(times), topic,
        )  # fmt: skip
    poses = np.repeat(np.eye(4)[None], int(inside.sum()), axis=0)
    for link in links:
        if isinstance(link, Trajectory):
            _refuse_gaps(link, topic, times, inside, bag.path)
            poses = poses @ link.interpolate(times[inside])
        else:
            poses = poses @ link
    return inside, poses


def _refuse_gaps(
    link: Trajectory, topic: str, times: NDArray[np.int64], inside: NDArray[np.bool_], path: Path
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
            f"{path}: {topic} has a gap of {gaps[frame] * 1e-9:.1f} s around sweep "
            f"{times[frame]} (frame {frame}); cut the bag there, or leave poses out"
        )


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
