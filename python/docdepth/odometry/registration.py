"""A sweep without traffic registered on a map, distribution to distribution."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.geometry.se3 import inverse, nearest_rigid, transform_points

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
    """What drives along, told by the last sweeps.

    Between lorries at its own speed a vehicle seems to stand. On an open road they may be most of
    what rises above it, so registration follows them by centimetres to metres a sweep. What stands
    still is where it was, seen from farther behind; what drives along was there before only as seen
    from the vehicle.
    """

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
            there = transform_points(T, points[rows])
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


_LEVEL = 0.1  # metres between the returns of a column; kerbs, walls and twigs have more


def split_level_ground(
    points: NDArray[np.float64], edge: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What rises above an open road, and the road in one point for each level column.

    A spinning LiDAR draws rings on a flat road, and they move with it: registered on each other,
    they say that it stands. VGICP weighs distances along a surface by a thousandth of those across
    it, but on a motorway nine of ten points lie on the road, and with 16 beams they win. Level
    ground tells height, roll and pitch, and needs few points for that. In a city it is the smaller
    part of a sweep, walls hold the vehicle, and all its points stay: they average the errors of the
    lasers.

    Parameters
    ----------
    points : ndarray of float64, shape (N, 3)
        LiDAR frame, z up [m].
    edge : float
        Edge of a column, a square in x and y [m]. It is level if the heights of its points differ
        by less than 0.1 m.

    Returns
    -------
    ndarray of float64, shape (M, 3)
        Points of the other columns, in their order; ``points`` itself if at most half of them lie
        in level columns.
    ndarray of float64, shape (K, 3)
        Means of the level columns; none if at most half of the points lie in them.
    """
    none = np.zeros((0, 3))
    if not len(points):
        return points, none
    order, first, count, level = _columns(points, edge)
    if count[level].sum() <= 0.5 * len(points):
        return points, none
    means = np.add.reduceat(points[order], first)[level] / count[level, None]
    others = np.sort(order[np.repeat(~level, count)])
    return points[others], means


def rising_rows(points: NDArray[np.float64], edge: float) -> NDArray[np.int64]:
    """Rows of the points (N, 3) in columns that are not level, however many these are."""
    if not len(points):
        return np.zeros(0, np.int64)
    order, _, count, level = _columns(points, edge)
    return np.sort(order[np.repeat(~level, count)])


def _columns(
    points: NDArray[np.float64], edge: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Rows sorted by column, and of each column its first, their number and whether it is level."""
    x, y = np.floor(points[:, :2] / edge).astype(np.int64).T
    column = (x << 32) + y
    order = np.argsort(column, kind="stable")
    column, height = column[order], points[order, 2]
    first = np.flatnonzero(np.append(True, column[1:] != column[:-1]))
    count = np.diff(np.append(first, len(column)))
    level = np.maximum.reduceat(height, first) - np.minimum.reduceat(height, first) < _LEVEL
    return order, first, count, level


FEWEST_POINTS = 50
"""A sweep with fewer usable points is not registered: its pose is predicted."""

UNKNOWN = 1e2  # metres and radians; standard deviation of a pose that was not measured


class Found(NamedTuple):
    """What registration found of a sweep."""

    pose: NDArray[np.float64]  # (4, 4)
    # (6, 6): of its rotation [rad^2] and its position [m^2], about the axes of the world
    covariance: NDArray[np.float64]
    # it has points enough. Otherwise its pose is the predicted one, and the map does not get it
    usable: bool
    fitting: float = 1.0  # share of its points that find their surfaces in the map


class Registration:
    """A map of voxels, each a normal distribution, on which sweeps are registered (VGICP).

    Parameters
    ----------
    voxel_size : float
        Edge of a voxel of the map [m].
    sampling : float, optional
        Edge of a voxel in which a sweep keeps one point [m]; None where sweeps are thin enough.
    neighbors : int
        Points from which the normal of a point is taken.
    tolerance : float
        Distance from a surface at which a point counts half [m].
    """

    def __init__(
        self,
        voxel_size: float,
        sampling: float | None,
        neighbors: int,
        threads: int,
        tolerance: float = 0.3,
    ) -> None:
        self._map = _core.GaussianVoxelMap(voxel_size, tolerance)
        self._voxel_size, self._sampling, self._threads = voxel_size, sampling, threads
        self._neighbors, self._empty, self._traffic = neighbors, True, Traffic()
        self._cloud: _core.OrientedPoints | None = None

    def take(self, points: NDArray[np.float32], guess: NDArray[np.float64]) -> None:
        """Take the next deskewed sweep, without traffic: its points get their normals.

        Parameters
        ----------
        guess : ndarray of float64, shape (4, 4)
            Where it was taken, about.
        """
        if self._sampling is not None:
            times = np.zeros(len(points), np.float32)
            points, _ = _core.thin_sweep(points, times, self._sampling, 0.0, 1e6)
        # One point in each voxel of the map; and level ground, if it is most of them.
        rising, road = split_level_ground(points.astype(np.float64), self._voxel_size)
        seen = rising if len(road) else np.zeros((0, 3))
        along = self._traffic.left_out(seen, guess)
        rising = rising[~along] if along.any() else rising
        kept = np.concatenate([rising, road]) if len(road) else rising
        self._cloud = _core.OrientedPoints(kept.astype(np.float32), self._neighbors, self._threads)

    def align(self, *guesses: NDArray[np.float64]) -> Found:
        """Register the sweep that was taken, from initial guesses (4, 4).

        The one from which most points find their surfaces is right, as a rule: from a guess that is
        metres off, a fifth of them do not.
        """
        if self._empty:
            return Found(guesses[0].copy(), np.zeros((6, 6)), True)  # it is the frame of all poses
        assert self._cloud is not None
        found = [self._map.align(self._cloud, guess, self._threads) for guess in guesses]
        pose, hessian, inliers = max(found, key=lambda one: int(one[2]))
        # With too few inliers the guess stays.
        if inliers < FEWEST_POINTS or not np.isfinite(pose).all():
            return Found(guesses[0].copy(), UNKNOWN**2 * np.eye(6), True, 0.0)
        covariance = np.linalg.inv(hessian + UNKNOWN**-2 * np.eye(6))
        fitting = int(inliers) / len(self._cloud.normals)
        return Found(nearest_rigid(pose), covariance, True, fitting)

    def insert(self, pose: NDArray[np.float64]) -> None:
        """Add the sweep that was taken to the map."""
        assert self._cloud is not None
        self._map.insert(self._cloud, pose)
        self._empty = False
