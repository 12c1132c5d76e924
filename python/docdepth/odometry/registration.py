"""A sweep registered on a map, distribution to distribution."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.geometry.se3 import nearest_rigid
from docdepth.odometry.level_ground import split_level_ground
from docdepth.odometry.traffic import Traffic

FEWEST_POINTS = 50
"""A sweep with fewer usable points is not registered: its pose is predicted."""

UNKNOWN = 1e2  # metres and radians; standard deviation of a pose that was not measured


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
    threads : int
        The result does not depend on them.
    """

    def __init__(
        self, voxel_size: float, sampling: float | None, neighbors: int, threads: int
    ) -> None:
        self._map = _core.GaussianVoxelMap(voxel_size)
        self._voxel_size, self._sampling, self._threads = voxel_size, sampling, threads
        self._neighbors, self._empty, self._traffic = neighbors, True, Traffic()
        self._cloud: _core.OrientedPoints | None = None

    def take(self, points: NDArray[np.float32], guess: NDArray[np.float64]) -> None:
        """Take the next deskewed sweep, without traffic: its points get their normals.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
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

    def align(
        self, *guesses: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Register the sweep that was taken, from initial guesses (4, 4).

        The one from which most points find their surfaces is right, as a rule: from a guess that is
        metres off, a fifth of them do not.

        Returns
        -------
        pose : ndarray of float64, shape (4, 4)
        covariance : ndarray of float64, shape (6, 6)
            Of its rotation [rad^2] and its position [m^2], about the axes of the world.
        """
        if self._empty:
            return guesses[0].copy(), np.zeros((6, 6))  # it is the frame of all poses
        assert self._cloud is not None
        found = [self._map.align(self._cloud, guess, self._threads) for guess in guesses]
        pose, hessian, inliers = max(found, key=lambda one: int(one[2]))
        # With too few inliers the guess stays.
        if inliers < FEWEST_POINTS or not np.isfinite(pose).all():
            return guesses[0].copy(), UNKNOWN**2 * np.eye(6)
        return nearest_rigid(pose), np.linalg.inv(hessian + UNKNOWN**-2 * np.eye(6))

    def insert(self, pose: NDArray[np.float64]) -> None:
        """Add the sweep that was taken to the map."""
        assert self._cloud is not None
        self._map.insert(self._cloud, pose)
        self._empty = False
