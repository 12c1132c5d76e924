"""A sweep registered on a map by small_gicp, distribution to distribution."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import nearest_rigid
from docdepth.odometry.level_ground import split_level_ground
from docdepth.odometry.traffic import Traffic

FEWEST_POINTS = 50
"""A sweep with fewer usable points is not registered: its pose is predicted."""

UNKNOWN = 1e2  # metres and radians; standard deviation of a pose that was not measured

_THREADS = 1  # sums of several threads come in any order: poses would differ from run to run
_ALIGN = {
    "max_correspondence_distance": 1.0,  # metres, to the mean of a voxel
    "num_threads": _THREADS,
    "max_iterations": 30,
    "rotation_epsilon": 1e-4,  # radians
    "translation_epsilon": 5e-4,  # metres
}


class Registration:
    """small_gicp's map of voxels, each a normal distribution, and its VGICP.

    Parameters
    ----------
    voxel_size : float
        Edge of a voxel of the map [m].
    sampling : float, optional
        Edge of a voxel in which a sweep keeps one point [m]; None where sweeps are thin enough.
    neighbors : int
        Points from which the normal of a point is taken.
    threads : int
        For the normals of a sweep.
    """

    def __init__(
        self, voxel_size: float, sampling: float | None, neighbors: int, threads: int
    ) -> None:
        import small_gicp

        self._small_gicp = small_gicp
        self._map = small_gicp.GaussianVoxelMap(voxel_size)
        self._voxel_size, self._sampling = voxel_size, sampling
        self._neighbors, self._threads = neighbors, threads
        self._empty, self._traffic = True, Traffic()
        self._cloud: Any = None

    def take(self, points: NDArray[np.float32], guess: NDArray[np.float64]) -> None:
        """Take the next deskewed sweep, without traffic: its points get their distributions.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
        guess : ndarray of float64, shape (4, 4)
            Where it was taken, about.
        """
        small_gicp, thinned = self._small_gicp, points.astype(np.float64)
        if self._sampling is not None:
            thinned = small_gicp.voxelgrid_sampling(thinned, self._sampling).points()[:, :3]
        # One point in each voxel of the map; and level ground, if it is most of them.
        rising, road = split_level_ground(thinned, self._voxel_size)
        seen = rising if len(road) else np.zeros((0, 3))
        along = self._traffic.left_out(seen, guess)
        rising = rising[~along] if along.any() else rising
        cloud = small_gicp.PointCloud(np.concatenate([rising, road]) if len(road) else rising)
        tree = small_gicp.KdTree(cloud)
        small_gicp.estimate_covariances(cloud, tree, self._neighbors, self._threads)
        self._cloud = cloud

    def align(self, guess: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Register the sweep that was taken, from an initial guess (4, 4).

        Returns
        -------
        pose : ndarray of float64, shape (4, 4)
        covariance : ndarray of float64, shape (6, 6)
            Of its rotation [rad^2] and its position [m^2], about the axes of the world.
        """
        pose, covariance = guess.copy(), UNKNOWN**2 * np.eye(6)
        if self._empty:
            covariance = np.zeros((6, 6))  # it is the frame of all poses
        else:
            found = self._small_gicp.align(
                self._map, self._cloud, init_T_target_source=guess, **_ALIGN
            )
            # With too few inliers the guess stays.
            if found.num_inliers >= FEWEST_POINTS and np.isfinite(found.T_target_source).all():
                # Row by row, as poses are stored: products of other layouts differ in the last bit.
                pose = np.array(nearest_rigid(found.T_target_source), order="C")
                covariance = _covariance(found.H, pose)
        return pose, covariance

    def insert(self, pose: NDArray[np.float64]) -> None:
        """Add the sweep that was taken to the map."""
        self._map.insert(self._cloud, pose)
        self._empty = False


def _covariance(hessian: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariance (6, 6) about the axes of the world, of a Hessian about those of the LiDAR."""
    turn = np.kron(np.eye(2), pose[:3, :3])
    inverse_hessian = np.linalg.inv(np.asarray(hessian) + UNKNOWN**-2 * np.eye(6))
    covariance: NDArray[np.float64] = turn @ inverse_hessian @ turn.T
    return covariance
