"""Frames of a bag: the static transforms between them."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.pose_tables import pose_of
from docdepth.errors import DatasetError
from docdepth.geometry.se3 import inverse

log = logging.getLogger(__name__)

TRANSFORMS = "tf2_msgs/msg/TFMessage"

Link: TypeAlias = tuple[str, str, NDArray[np.float64]]


class StaticFrames:
    """A graph of frames that do not move against each other.

    Parameters
    ----------
    messages : iterable of tf2_msgs/TFMessage
        Each transform takes points of ``child_frame_id`` to ``header.frame_id``.
    others : callable, optional
        Parent, child and ``T_parent_child`` (4, 4) of frames that stay still though they might
        move. Asked for where the static transforms do not connect two frames: drivers of ROS 1
        send those of the sensors over and over.
    """

    def __init__(
        self, messages: Iterable[Any], others: Callable[[], Iterable[Link]] | None = None
    ) -> None:
        self._others = others
        self._edges: dict[str, dict[str, NDArray[np.float64]]] = {}
        self._parents: dict[str, str] = {}
        for message in messages:
            for one in message.transforms:
                parent, child = (
                    name.lstrip("/") for name in (one.header.frame_id, one.child_frame_id)
                )
                try:
                    self._connect(parent, child, _rigid(one.transform))
                    self._parents[child] = parent
                except DatasetError as error:
                    log.warning(
                        "the static transform of %r in %r is left out: %s", child, parent, error
                    )

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


def _rigid(transform: Any) -> NDArray[np.float64]:
    t, q = transform.translation, transform.rotation
    return pose_of([q.w, q.x, q.y, q.z], [t.x, t.y, t.z], "it")
