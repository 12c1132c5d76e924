"""Frames of a bag: the static transforms between them, and those that change, of ``/tf``."""

from __future__ import annotations

import logging
from array import array
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.formats.bag.bag_file import BagFile
from docdepth.datasets.pose_tables import pose_of
from docdepth.errors import DatasetError, InputError
from docdepth.geometry.se3 import inverse, poses_from, quaternion_to_matrix
from docdepth.geometry.trajectory import Trajectory

log = logging.getLogger(__name__)

TRANSFORMS = "tf2_msgs/msg/TFMessage"

_ROUNDED = 1e-3  # metres, and of a rotation matrix

Link: TypeAlias = tuple[str, str, NDArray[np.float64]]


class StaticFrames:
    """A graph of frames that do not move against each other.

    Each transform of ``messages``, of TFMessage, takes points of ``child_frame_id`` to
    ``header.frame_id``. ``others`` gives parent, child and ``T_parent_child`` (4, 4) of frames that
    stay still though they might move. It is asked where the static transforms do not connect two
    frames: drivers of ROS 1 send those of the sensors over and over.
    """

    def __init__(
        self, messages: Iterable[Any], others: Callable[[], Iterable[Link]] | None = None
    ) -> None:
        self._others = others
        self._edges: dict[str, dict[str, NDArray[np.float64]]] = {}
        self._parents: dict[str, str] = {}
        parents: dict[str, dict[str, NDArray[np.float64]]] = {}
        for message in messages:
            for one in message.transforms:
                parent, child = (
                    name.lstrip("/") for name in (one.header.frame_id, one.child_frame_id)
                )
                try:
                    T, known = _rigid(one.transform), parents.setdefault(child, {})
                    known.pop(parent, None)  # in the order in which they were sent last
                    known[parent] = T
                    self._parents[child] = parent
                except DatasetError as error:
                    log.warning(
                        "the static transform of %r in %r is left out: %s", child, parent, error
                    )
        for child, known in parents.items():
            for parent, T in list(known.items())[:1]:
                self._connect(parent, child, T)
        for child, known in parents.items():
            for before, parent in pairwise(known):
                self._replace(before, parent, child, known[parent])

    def _replace(self, before: str, parent: str, child: str, T: NDArray[np.float64]) -> None:
        """Connect a frame with another parent. Of two that disagree the later counts, as in ROS."""
        other = self._way(parent, child)
        if other is not None and not _agree(other, T):
            log.warning(
                "static transforms put %r in %r and elsewhere in %r; the later counts, %r. If that "
                "is wrong, say T_camera_lidar or T_lidar_sensor in docdepth.yaml",
                child, before, parent, parent,
            )  # fmt: skip
            for one, end in ((before, child), (child, before)):
                self._edges[one].pop(end, None)
        self._connect(parent, child, T)

    def _connect(self, parent: str, child: str, T: NDArray[np.float64]) -> None:
        self._edges.setdefault(parent, {})[child] = T
        self._edges.setdefault(child, {})[parent] = inverse(T)

    @property
    def names(self) -> list[str]:
        """All frames that a transform names."""
        return sorted(self._edges)

    def parent(self, frame: str) -> tuple[str, NDArray[np.float64]] | None:
        """The frame above, and ``T_parent_frame`` (4, 4); None for the highest."""
        above = self._parents.get(frame)
        return None if above is None else (above, self._edges[above][frame])

    def between(self, target: str, source: str) -> NDArray[np.float64] | None:
        """``T_target_source`` (4, 4) along the shortest way; None where nothing connects them."""
        found = self._way(target, source)
        if found is None and self._others is not None:
            others, self._others = self._others, None
            for parent, child, T in others():
                if child not in self._parents:
                    self._connect(parent, child, T)
            found = self._way(target, source)
        return found

    def _way(self, target: str, source: str) -> NDArray[np.float64] | None:
        found = {target: np.eye(4)}
        waiting = deque([target])
        while waiting:
            at = waiting.popleft()
            if at == source:
                return found[at]
            for other, T in self._edges.get(at, {}).items():
                if other not in found:
                    found[other] = found[at] @ T
                    waiting.append(other)
        return None


def _agree(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    """Whether two poses (4, 4) are one, but for the digits with which they were written."""
    return bool(np.abs(first - second).max() < _ROUNDED)


def _rigid(transform: Any) -> NDArray[np.float64]:
    t, q = transform.translation, transform.rotation
    return pose_of([q.w, q.x, q.y, q.z], [t.x, t.y, t.z], "it")


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
    """The links from the highest frame down to the frame ``start``, of a topic of TFMessage.

    ``by_record``: times of recording count, not those of headers.
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
