"""Frames of a bag: the static transforms between them."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import inverse, poses_from, quaternion_to_matrix

TRANSFORMS = "tf2_msgs/msg/TFMessage"


class StaticFrames:
    """A graph of frames that do not move against each other.

    Parameters
    ----------
    messages : iterable of tf2_msgs/TFMessage
        Each transform takes points of ``child_frame_id`` to ``header.frame_id``.
    """

    def __init__(self, messages: Iterable[Any]) -> None:
        self._edges: dict[str, dict[str, NDArray[np.float64]]] = {}
        self._parents: dict[str, str] = {}
        for message in messages:
            for one in message.transforms:
                parent, child = (
                    name.lstrip("/") for name in (one.header.frame_id, one.child_frame_id)
                )
                t, q = one.transform.translation, one.transform.rotation
                T = poses_from([quaternion_to_matrix([q.x, q.y, q.z, q.w])], [[t.x, t.y, t.z]])[0]
                self._edges.setdefault(parent, {})[child] = T
                self._edges.setdefault(child, {})[parent] = inverse(T)
                self._parents[child] = parent

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
