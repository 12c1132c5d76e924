"""Checks of poses: those that a user brings, and trajectories that jump."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.config import OdometryParameters
from docdepth.datasets.base import Dataset
from docdepth.errors import InputError, OdometryError
from docdepth.geometry.se3 import check_rigid, inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.odometry.registration import first_motion
from docdepth.odometry.sweeps import DeskewedSweeps

log = logging.getLogger(__name__)

_MOVING = 0.15  # metres from sweep to sweep; smaller steps may be errors of registration
_SAME_POSE = 1e-3  # metres, and entries of rotations; poses that differ less are one pose
_JUMP = 1.0  # metres by which the step from sweep to sweep changes; a vehicle cannot do that


def check_given_poses(
    dataset: Dataset, poses: ArrayLike, parameters: OdometryParameters
) -> NDArray[np.float64]:
    """Check the poses that a user brings for a drive; see :func:`register_drive`.

    Logs a warning if all poses are the same though the sweeps move, or if they look like poses of a
    camera.

    Returns
    -------
    ndarray of float64, shape (n, 4, 4)

    Raises
    ------
    OdometryError
        Poses are not rigid, or not one for each sweep.
    """
    given = np.ascontiguousarray(poses, dtype=np.float64)
    if given.ndim != 3 or given.shape[1:] != (4, 4):
        raise OdometryError(f"poses must be (n, 4, 4) matrices T_world_lidar, got {given.shape}")
    if len(given) != len(dataset):
        raise OdometryError(
            f"there are {len(given)} poses for {len(dataset)} sweeps; bring one pose a sweep"
        )
    try:
        check_rigid(given)
    except InputError as error:
        raise OdometryError(str(error)) from None
    if len(given) > 1 and np.ptp(given, axis=0).max() < _SAME_POSE:
        _warn_of_motion(dataset, parameters)
    steps = np.abs((inverse(given[:-1]) @ given[1:])[:, :3, 3])
    steps = steps[np.linalg.norm(steps, axis=1) > _MOVING]
    if len(steps) and np.median(steps[:, 2]) > 2 * np.median(steps[:, 0]):
        log.warning(
            "along the poses the LiDAR moves upwards (z), not forwards (x): if they are poses of "
            "a camera, convert them by Tr^-1 T Tr"
        )
    return given


def _warn_of_motion(dataset: Dataset, parameters: OdometryParameters) -> None:
    """Log a warning if the sweeps move; the poses do not."""
    sweeps, n = DeskewedSweeps(dataset, None), len(dataset)
    for frames in (range(n), range(n // 2, n)):
        step = np.linalg.norm(first_motion(sweeps, frames, parameters)[:3, 3])
        if step > _MOVING:
            log.warning(
                "all poses are the same, yet near frame %d the LiDAR moves by %.2f m a sweep; "
                "give T_world_lidar of each sweep, or no poses", frames[0], step,
            )  # fmt: skip


def warn_of_jumps(trajectory: Trajectory) -> None:
    """Log a warning where the step from one sweep to the next changes by metres."""
    if len(trajectory) < 3:
        return
    seconds = np.diff(trajectory.times) * 1e-9
    velocity = np.diff(trajectory.poses[:, :3, 3], axis=0) / seconds[:, None]
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) * float(np.median(seconds))
    worst = int(np.argmax(change))
    if change[worst] > _JUMP:
        log.warning(
            "the trajectory jumps: at frame %d the step from sweep to sweep changes by %.1f m; "
            "check the poses and times around it", worst + 1, change[worst],
        )  # fmt: skip
