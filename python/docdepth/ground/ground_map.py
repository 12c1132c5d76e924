"""The ground of merged sweeps: voxels, seeds below the poses and a front (paper IV-A)."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.config import GroundParameters
from docdepth.errors import InputError
from docdepth.geometry.se3 import check_rigid

logger = logging.getLogger(__name__)

MIN_GROUND_SHARE = 0.01
"""Even a narrow street has several times this share of ground; with less the seeds failed [-]."""


class GroundMap:
    """The merged sweeps of a chunk of the drive, and the ground that grows in them.

    Sweeps are merged into voxels and not kept, so memory grows with the area seen and not with the
    number of sweeps.

    Parameters
    ----------
    parameters : GroundParameters, optional
    threads : int
        0 for all cores. The labels do not depend on it.
    corner : ndarray of float64, shape (3,), optional
        Of some voxel, in the world [m]. Maps with the same one have the same voxels where they
        overlap. The position of the first pose if left out.

    Examples
    --------
    >>> ground_map = GroundMap()
    >>> for points, pose in zip(sweeps, poses):         # doctest: +SKIP
    ...     ground_map.insert(points, pose)
    >>> ground_map.grow()                              # doctest: +SKIP
    >>> ground = ground_map.label(sweeps[0], poses[0])  # doctest: +SKIP
    """

    def __init__(
        self,
        parameters: GroundParameters | None = None,
        threads: int = 0,
        corner: NDArray[np.float64] | None = None,
    ) -> None:
        core = _core_parameters(parameters or GroundParameters())
        self._map = _core.GroundMap(core, threads, corner)
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
            A seed of the ground is chosen below this pose.

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
                f"{error}: a map reaches a million voxels in each direction; start a new one for "
                "each chunk of the drive and leave out stray returns"
            ) from None
        self._grown = False

    def grow(self) -> int:
        """Choose seeds below every pose and grow over all that was inserted.

        The nearest returns may be the vehicle's own body. So with ``seed_quantile`` above 0, while
        less than one voxel in a hundred is ground, seeds are chosen twice as far away, up to 16 m.
        No plane leads over a kerb. So ground also continues in a square metre without ground whose
        lowest voxels lie within ``step_height`` of the ground beside it.

        Returns
        -------
        int
            Number of ground voxels. A warning is logged when there is almost none.
        """
        count: int = self._map.grow()
        self._grown = True
        logger.info("ground: %d of %d voxels", count, len(self))
        if count < MIN_GROUND_SHARE * len(self):
            logger.warning(
                "almost no ground was found (%d of %d voxels): the seeds may be outliers below "
                "the road, or the LiDAR's z axis does not point up",
                count,
                len(self),
            )
        return count

    def label(
        self, points: NDArray[np.float32], T_world_lidar: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Label points by their voxels.

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


def _core_parameters(parameters: GroundParameters) -> _core.GroundParameters:
    core = _core.GroundParameters()
    core.voxel_size = parameters.voxel_size
    core.seed_radius = parameters.seed_radius
    core.seed_quantile = parameters.seed_quantile
    if not parameters.seed_quantile:
        core.least_share = 0  # the paper does not widen the search for seeds
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
            "(see docdepth.geometry.points.usable_points)"
        )
    return points, pose
