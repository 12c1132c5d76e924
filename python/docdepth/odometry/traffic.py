"""Traffic left out of what is registered, on roads where little else holds the vehicle.

Between lorries at its own speed a vehicle seems to stand. On an open road they may be most of what
rises above it, so registration follows them by centimetres to metres a sweep. What stands still is
where it was, seen from farther behind; what drives along was there before only as seen from the
vehicle.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.geometry.se3 import inverse

SEEN = 15
"""Sweeps that are looked back at. At a metre a sweep the first of them is 15 m behind."""

_NEAREST, _FARTHEST = 6.0, 15.0
"""Sweeps taken so far behind tell what stands [m]. Nearer ones met a car at a part of its present
place, as it is that long. Farther behind, another car may have been there."""
_SAME_PLACE = 0.5  # metres; a sweep from behind met what stands so near by
_ALONG, _ASIDE = 1.0, 0.3
"""What traffic moves from sweep to sweep at most, as seen from the vehicle: along its way and aside
[m]. A vehicle that goes less than the first cannot tell traffic from what stands."""


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
        seen = [(float(np.linalg.norm((s.pose - pose)[:3, 3])), s) for s in self._seen]
        behind = [s for far, s in seen if _NEAREST <= far <= _FARTHEST and len(s.points)]
        self._seen.append(_Sweep(pose, points))
        if not len(points) or not behind:
            return along
        moved, before = seen[-1]
        if moved <= _ALONG or not len(before.points):
            return along
        rows = np.flatnonzero(_moved_little(points, pose, before))
        for sweep in behind:
            T = inverse(sweep.pose) @ pose
            there = points[rows] @ T[:3, :3].T + T[:3, 3]
            rows = rows[_distance(sweep.points, there) > _SAME_PLACE]
        along[rows] = True
        return along


@dataclass(frozen=True)
class _Sweep:
    """A sweep that was seen: its pose, and what rises above the road in its frame."""

    pose: NDArray[np.float64]
    points: NDArray[np.float64]


def _moved_little(
    points: NDArray[np.float64], pose: NDArray[np.float64], before: _Sweep
) -> NDArray[np.bool_]:
    """Which points have a point of the sweep before near by, as seen from the vehicle."""
    ahead = (inverse(before.pose) @ pose)[:3, 3]
    ahead = ahead / np.linalg.norm(ahead)
    # Distances aside count as much more as they may be smaller.
    stretch = np.eye(3) + (_ALONG / _ASIDE - 1) * (np.eye(3) - np.outer(ahead, ahead))
    near: NDArray[np.bool_] = _distance(before.points @ stretch, points @ stretch) < _ALONG
    return near


def _distance(others: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float32]:
    """From each point to the nearest of others."""
    return _core.nearest_neighbors(others.astype(np.float32), points.astype(np.float32), 1)[1]
