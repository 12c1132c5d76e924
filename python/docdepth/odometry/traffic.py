"""Traffic left out of what is registered, on roads where little else holds the vehicle.

Between lorries at its own speed a vehicle seems to stand. On an open road they may be most of what
rises above it, so registration follows them by centimetres to metres a sweep. What stands still is
where it was, seen from farther behind; what drives along was there before only as seen from the
vehicle.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import inverse

SEEN = 15
"""Sweeps that are looked back at. At a metre a sweep the first of them is 15 m behind."""

_NEAREST, _FARTHEST = 6.0, 15.0
"""Metres behind the vehicle at which sweeps tell what stands: where a car is now, none of it was
then, as it is shorter; farther behind, another one may have been there."""
_THERE = 0.5  # metres; what stands was met so near by
_FASTER, _ASIDE = 1.0, 0.3
"""Metres a sweep that traffic moves along the way and aside, as seen from the vehicle. A vehicle
that goes less than the first cannot tell traffic from what stands."""
_THREADS = 1  # of small_gicp


class Traffic:
    """What drives along, told by the last sweeps."""

    def __init__(self) -> None:
        self._seen: deque[_Sweep] = deque(maxlen=SEEN)

    def left_out(self, points: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points of the next sweep drive along.

        Parameters
        ----------
        points : ndarray of float64, shape (N, 3)
            What rises above the road, LiDAR frame [m]; none if the sweep is of no open road.
        pose : ndarray of float64, shape (4, 4)
            Where the sweep was taken, about.

        Returns
        -------
        ndarray of bool, shape (N,)
        """
        along = np.zeros(len(points), bool)
        behind = [(float(np.linalg.norm(_from(s.pose, pose)[:3, 3])), s) for s in self._seen]
        if len(points) and behind and behind[-1][0] > _FASTER and len(behind[-1][1].points):
            standing = [s for far, s in behind if _NEAREST <= far <= _FARTHEST and len(s.points)]
            if standing:
                rows = np.flatnonzero(_moved_little(points, pose, behind[-1][1]))
                for sweep in standing:
                    T = _from(sweep.pose, pose)
                    there = points[rows] @ T[:3, :3].T + T[:3, 3]
                    rows = rows[sweep.distance(there) > _THERE]
                along[rows] = True
        self._seen.append(_Sweep(pose, points))
        return along


class _Sweep:
    """A sweep that was seen."""

    def __init__(self, pose: NDArray[np.float64], points: NDArray[np.float64]) -> None:
        self.pose, self.points = pose, points
        self._tree: Any = None

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of points (n, 3) in its frame to its nearest point [m]."""
        if self._tree is None:
            self._tree = _tree(self.points)
        return _distance(self._tree, points)


def _from(pose: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """From the frame of another pose to that of a pose (4, 4)."""
    T: NDArray[np.float64] = inverse(pose) @ other
    return T


def _moved_little(
    points: NDArray[np.float64], pose: NDArray[np.float64], before: _Sweep
) -> NDArray[np.bool_]:
    """Which points have a point of the sweep before near by, as seen from the vehicle."""
    ahead = _from(before.pose, pose)[:3, 3]
    ahead = ahead / np.linalg.norm(ahead)
    # Distances aside count as much more as they may be smaller.
    stretch = np.eye(3) + (_FASTER / _ASIDE - 1) * (np.eye(3) - np.outer(ahead, ahead))
    near: NDArray[np.bool_] = _distance(_tree(before.points @ stretch), points @ stretch) < _FASTER
    return near


def _tree(points: NDArray[np.float64]) -> Any:
    import small_gicp

    return small_gicp.KdTree(points, _THREADS)


def _distance(tree: Any, points: NDArray[np.float64]) -> NDArray[np.float64]:
    if not len(points):
        return np.zeros(0)
    squared = np.asarray(tree.batch_nearest_neighbor_search(points, _THREADS)[1])
    return np.sqrt(squared)
