"""Which points are ground: voxels, seeds and a growing front (paper III-C1)."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import GroundParameters
from docdepth.errors import InputError
from docdepth.geometry.se3 import check_rigid
from docdepth.geometry.trajectory import Trajectory

logger = logging.getLogger(__name__)

# A drive has a few parts in a hundred of ground at the very least; below this share of the voxels
# the seeds died.
_NEXT_TO_NONE = 0.01


class GroundMap:
    """The merged sweeps of a chunk of the drive, and the ground that grows in them.

    Sweeps are merged into voxels as they come and not kept, so memory follows the surface seen and
    not the number of sweeps.

    Parameters
    ----------
    parameters : GroundParameters, optional
    threads : int
        0 takes every core. The labels do not depend on it.

    Examples
    --------
    >>> ground_map = GroundMap()
    >>> for points, pose in zip(sweeps, poses):        # doctest: +SKIP
    ...     ground_map.insert(points, pose)
    >>> ground_map.grow()                              # doctest: +SKIP
    >>> ground = ground_map.label(sweeps[0], poses[0])  # doctest: +SKIP
    """

    def __init__(self, parameters: GroundParameters | None = None, threads: int = 0) -> None:
        self._map = _core.GroundMap(_core_parameters(parameters or GroundParameters()), threads)
        self._grown = False

    def __len__(self) -> int:
        """Number of voxels."""
        return len(self._map)

    def insert(self, points: NDArray[np.float32], T_world_lidar: NDArray[np.float64]) -> None:
        """Merge one sweep and its pose.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
            LiDAR frame, metres.
        T_world_lidar : ndarray of float64, shape (4, 4)
            The ground is sought below this pose.

        Raises
        ------
        InputError
            An array has the wrong shape or holds NaN, or lies too far from the first pose.
        """
        points, pose = _checked(points, T_world_lidar)
        try:
            self._map.insert(points, pose)
        except IndexError as error:
            raise InputError(
                f"{error}: a million voxels is the reach of a map; start a new one for each "
                "chunk of the drive and drop wild returns"
            ) from None
        self._grown = False

    def grow(self) -> int:
        """Seed below every pose and grow over all that was inserted.

        Near a pose there may be nothing but the ego's own body: while less than ``least_share`` of
        the voxels are ground, seeds are sought farther away. Nothing flat leads on behind a kerb:
        there ground goes on from low places that are no more than ``step_height`` higher or lower
        than that beside them.

        Returns
        -------
        int
            Number of ground voxels. A warning is logged when there is next to none.
        """
        count: int = self._map.grow()
        self._grown = True
        logger.info("ground: %d of %d voxels", count, len(self))
        if count < _NEXT_TO_NONE * len(self):
            logger.warning(
                "next to no ground was found (%d of %d voxels): the seeds may be outliers below "
                "the road, or z of the LiDAR does not point up",
                count,
                len(self),
            )
        return count

    def label(
        self, points: NDArray[np.float32], T_world_lidar: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Carry the labels back to points through their voxels.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
            LiDAR frame, metres; as inserted.
        T_world_lidar : ndarray of float64, shape (4, 4)

        Returns
        -------
        ndarray of bool, shape (N,)
            True for ground.

        Raises
        ------
        InputError
            As for :meth:`insert`, or nothing has been grown since the last sweep was inserted.
        """
        if not self._grown:
            raise InputError("there are no labels yet; call grow() after the last insert()")
        points, pose = _checked(points, T_world_lidar)
        ground: NDArray[np.bool_] = self._map.label(points, pose)
        return ground


def grow_ground(
    sweeps: Sequence[NDArray[np.float32]],
    poses: NDArray[np.float64],
    parameters: GroundParameters | None = None,
    threads: int = 0,
) -> list[NDArray[np.bool_]]:
    """Ground labels of a whole drive in memory, chunk by chunk (paper III-C1).

    Parameters
    ----------
    sweeps : sequence of ndarray of float32, shape (N_i, 3)
        LiDAR frame, metres.
    poses : ndarray of float64, shape (n, 4, 4)
        ``T_world_lidar`` of each sweep.
    parameters : GroundParameters, optional
    threads : int
        0 takes every core.

    Returns
    -------
    list of ndarray of bool, shape (N_i,)
        True for ground.

    Raises
    ------
    InputError
        There are not as many poses as sweeps, or as for :meth:`GroundMap.insert`.
    """
    parameters = parameters or GroundParameters()
    poses = np.ascontiguousarray(poses, dtype=np.float64)
    if poses.shape != (len(sweeps), 4, 4):
        raise InputError(
            f"{len(sweeps)} sweeps need poses of shape ({len(sweeps)}, 4, 4); got {poses.shape}"
        )
    labels: list[NDArray[np.bool_]] = []
    if not len(sweeps):
        return labels
    for frames, merged in chunks(Trajectory(np.arange(len(poses)), poses), parameters):
        ground_map = GroundMap(parameters, threads)
        for i in merged:
            ground_map.insert(sweeps[i], poses[i])
        ground_map.grow()
        labels += [ground_map.label(sweeps[i], poses[i]) for i in frames]
    return labels


def chunks(
    trajectory: Trajectory, parameters: GroundParameters | None = None
) -> list[tuple[list[int], list[int]]]:
    """Cut a drive into chunks of path length, in order (paper III-C1, l).

    Returns
    -------
    list of (list of int, list of int)
        Frames of each chunk, which are labelled, and the frames that are merged for it: also those
        on ``chunk_overlap`` of path before and after, since they see the ground of the first and
        the last frames from nearby.
    """
    p, arc = parameters or GroundParameters(), trajectory.arc_length
    number = (arc // p.chunk_length).astype(np.int64)
    found = []
    for c in sorted(set(number.tolist())):
        frames = np.flatnonzero(number == c)
        near = (arc >= arc[frames[0]] - p.chunk_overlap) & (
            arc <= arc[frames[-1]] + p.chunk_overlap
        )
        found.append((frames.tolist(), np.flatnonzero(near).tolist()))
    return found


def _core_parameters(parameters: GroundParameters) -> _core.GroundParameters:
    core = _core.GroundParameters()
    core.voxel_size = parameters.voxel_size
    core.seed_radius = parameters.seed_radius
    core.seed_quantile = parameters.seed_quantile
    core.least_share = parameters.least_share
    core.step_height = parameters.step_height
    core.neighbors = parameters.neighbors
    core.plane_distance = parameters.plane_distance
    core.max_slope = float(np.radians(parameters.max_slope_deg))
    return core


def _checked(
    points: NDArray[np.float32], T_world_lidar: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    points = np.ascontiguousarray(points, dtype=np.float32)
    pose = np.ascontiguousarray(T_world_lidar, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"points must have shape (N, 3); got {points.shape}")
    if pose.shape != (4, 4):
        raise InputError(f"T_world_lidar must have shape (4, 4); got {pose.shape}")
    check_rigid(pose[None])
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise InputError(
            f"point {row} is {points[row].tolist()}; leave out what is no return "
            "(docdepth.datasets.base.usable_points tells)"
        )
    return points, pose
