"""Transforms of a bag that change over time: the topic ``/tf``."""

from __future__ import annotations

from array import array
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.formats.bag.bag_file import BagFile
from docdepth.datasets.formats.bag.ros_frames import TRANSFORMS, Link, StaticFrames
from docdepth.errors import DatasetError, InputError
from docdepth.geometry.se3 import poses_from, quaternion_to_matrix
from docdepth.geometry.trajectory import Trajectory


@dataclass
class _Edge:
    """Transforms of one frame, numbers packed: a drive has millions."""

    parents: set[str] = field(default_factory=set)
    stamps: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))

    def link(self, where: str) -> Trajectory | NDArray[np.float64]:
        """Its poses over time; one pose if it never moves."""
        stamps, first = np.unique(np.array(self.stamps, np.int64), return_index=True)
        rows = np.array(self.numbers).reshape(-1, 7)[first]
        try:
            rotations = [quaternion_to_matrix(row[3:]) for row in rows]
            poses = poses_from(rotations, rows[:, :3])
            trajectory = Trajectory(stamps, poses)
        except InputError as error:
            raise DatasetError(f"{where}: {error}") from None
        return trajectory if (poses != poses[0]).any() else trajectory.poses[0]


def read_transforms(
    bag: BagFile, topic: str, by_record: bool, frames: StaticFrames, start: str
) -> list[Trajectory | NDArray[np.float64]]:
    """The links from the highest frame down to the frame ``start``.

    Parameters
    ----------
    bag : BagFile
    topic : str
        Of tf2_msgs/TFMessage.
    by_record : bool
        Times of recording count, not those of headers.
    frames : StaticFrames
    start : str

    Raises
    ------
    DatasetError
        No frame above ``start`` moves, a frame has two parents, or a transform is none.
    """
    edges = _read_edges(bag, topic, by_record)
    links: list[Trajectory | NDArray[np.float64]] = []
    frame, passed = start, {start}
    while True:
        edge, still = edges.get(frame), frames.parent(frame)
        if edge is not None:
            if len(edge.parents) > 1:
                raise DatasetError(
                    f"{bag.path}, {topic}: {frame!r} has several parents: "
                    f"{', '.join(sorted(edge.parents))}; record one of them, or name a topic of "
                    "odometry"
                )
            links.insert(0, edge.link(f"{bag.path}, {topic}, {frame!r}"))
            frame = next(iter(edge.parents))
        elif still is not None:
            frame, T = still
            links.insert(0, T)
        else:
            break
        if frame in passed:
            raise DatasetError(f"{bag.path}, {topic}: frames turn in a circle at {frame!r}")
        passed.add(frame)
    if not any(isinstance(link, Trajectory) for link in links):
        raise DatasetError(
            f"{bag.path}, {topic}: no frame above {start!r} moves; transforms are of "
            f"{', '.join(sorted(edges)) or 'none'}; say odometry_frame, or leave poses out"
        )
    return links


def still_transforms(bag: BagFile) -> list[Link]:
    """Those of all topics of transforms that are the same in each message."""
    found: list[Link] = []
    for topic, kind in bag.topics.items():
        if kind != TRANSFORMS or topic.endswith("tf_static"):
            continue
        for child, edge in _read_edges(bag, topic, by_record=True).items():
            with suppress(DatasetError):  # one that is no transform connects nothing
                link = edge.link(f"{bag.path}, {topic}, {child!r}")
                if len(edge.parents) == 1 and not isinstance(link, Trajectory):
                    found.append((next(iter(edge.parents)), child, link))
    return found


def _read_edges(bag: BagFile, topic: str, by_record: bool) -> dict[str, _Edge]:
    """The transforms of each child frame."""
    edges: dict[str, _Edge] = {}
    for recorded, message in bag.each(topic):
        for one in message.transforms:
            edge = edges.setdefault(one.child_frame_id.lstrip("/"), _Edge())
            edge.parents.add(one.header.frame_id.lstrip("/"))
            stamp, place = one.header.stamp, one.transform
            seconds, nanoseconds = int(stamp.sec), int(stamp.nanosec)
            edge.stamps.append(recorded if by_record else seconds * 10**9 + nanoseconds)
            t, q = place.translation, place.rotation
            edge.numbers.extend((t.x, t.y, t.z, q.x, q.y, q.z, q.w))
    return edges
