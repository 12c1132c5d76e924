"""Poses of the LiDAR from a topic of odometry of a bag."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.bag_file import BagFile
from docdepth.datasets.ros_frames import StaticFrames
from docdepth.errors import CalibrationError, DatasetError, InputError
from docdepth.geometry.se3 import poses_from, quaternion_to_matrix
from docdepth.geometry.trajectory import Trajectory

log = logging.getLogger(__name__)

_KIND = "nav_msgs/msg/Odometry"
_LONGEST_GAP = 500_000_000
"""Nanoseconds from message to message over which poses are interpolated: a vehicle may turn in
more."""


@dataclass(frozen=True)
class BagOdometry:
    """A topic of ``nav_msgs/Odometry``: where a frame of the vehicle is over time.

    Attributes
    ----------
    topic : str
    trajectory : Trajectory
        ``T_world_body`` at the stamps of the messages.
    body : str
        The frame that messages tell the place of.
    """

    topic: str
    trajectory: Trajectory
    body: str

    def poses(
        self, times: NDArray[np.int64], T_body_lidar: NDArray[np.float64], where: str
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Which sweeps lie within the odometry, and ``T_world_lidar`` of these.

        Raises
        ------
        DatasetError
            None does, or messages are too far apart around a sweep.
        """
        inside, known = self.trajectory.covers(times), self.trajectory.times
        if not inside.any():
            raise DatasetError(
                f"{where}: no sweep ({times[0] * 1e-9:.3f} to {times[-1] * 1e-9:.3f} s) lies "
                f"within {self.topic} ({known[0] * 1e-9:.3f} to {known[-1] * 1e-9:.3f} s): are "
                "they on different clocks? Say stamps: record, or leave poses out"
            )
        left_out = np.flatnonzero(~inside)
        if len(left_out):
            log.warning(
                "%s: %d of %d sweeps are before the first or after the last message of %s and are "
                "left out", where, len(left_out), len(times), self.topic,
            )  # fmt: skip
        after = np.searchsorted(known, times[inside]).clip(1, max(len(known) - 1, 1))
        gaps = np.diff(known)[after - 1] if len(known) > 1 else np.zeros(1, np.int64)
        on_time = np.isin(times[inside], known)
        far = np.flatnonzero((gaps > _LONGEST_GAP) & ~on_time)
        if len(far):
            frame = int(np.flatnonzero(inside)[far[0]])
            raise DatasetError(
                f"{where}: {self.topic} has a gap of {gaps[far[0]] * 1e-9:.1f} s around sweep "
                f"{times[frame]} (frame {frame}); cut the bag there, or leave poses out"
            )
        return inside, self.trajectory.interpolate(times[inside]) @ T_body_lidar


def read_odometry(bag: BagFile, topic: str, by_record: bool, where: str) -> BagOdometry:
    """The odometry of a topic.

    Parameters
    ----------
    bag : BagFile
    topic : str
    by_record : bool
        Times of recording count, not those of headers.
    where : str
        Where the topic is asked for, for errors.

    Raises
    ------
    DatasetError
        There is no such topic, or a message is no pose.
    """
    kinds = [name for name, kind in bag.topics.items() if kind == _KIND]
    if topic not in kinds:
        raise DatasetError(
            f"{where}: {bag.path} has no odometry {topic}; its topics of nav_msgs/Odometry are "
            f"{', '.join(kinds) or 'none'}"
        )
    index, messages = bag.index([topic])[topic], bag.read_all(topic)
    times = [m.recorded if by_record else m.stamp for m in index]
    if not messages or not any(times):
        raise DatasetError(
            f"{bag.path}, {topic}: "
            + ("headers have no stamps; say stamps: record" if messages else "there is no message")
        )
    poses = np.stack(
        [_pose(m, f"{bag.path}, {topic} (message {k})") for k, m in enumerate(messages)]
    )
    bodies = {message.child_frame_id.lstrip("/") for message in messages}
    if len(bodies) > 1:
        raise DatasetError(
            f"{bag.path}, {topic}: messages are of several frames: {', '.join(sorted(bodies))}"
        )
    stamps, first = np.unique(np.array(times, np.int64), return_index=True)
    return BagOdometry(topic, Trajectory(stamps, poses[first]), bodies.pop())


def place_on_body(
    odometry: BagOdometry, frames: StaticFrames, lidar: str, where: str
) -> NDArray[np.float64]:
    """``T_body_lidar`` (4, 4) by the static transforms.

    Raises
    ------
    CalibrationError
        Nothing connects both frames.
    """
    T = frames.between(odometry.body, lidar)
    if T is None:
        raise CalibrationError(
            f"{where}: {odometry.topic} is of the frame {odometry.body!r}, points are in "
            f"{lidar!r}, and no static transform connects them; say T_odometry_lidar"
        )
    return T


def _pose(message: Any, where: str) -> NDArray[np.float64]:
    p, q = message.pose.pose.position, message.pose.pose.orientation
    try:
        rotation = quaternion_to_matrix([q.x, q.y, q.z, q.w])
    except InputError as error:
        raise DatasetError(f"{where}: {error}") from None
    if not np.isfinite([p.x, p.y, p.z]).all():
        raise DatasetError(f"{where}: its position is not finite")
    return poses_from([rotation], [[p.x, p.y, p.z]])[0]
