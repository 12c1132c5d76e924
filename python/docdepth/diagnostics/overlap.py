"""How well two sweeps lie on each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.ground_plane import GroundPlane

_REACH = (3.0, 40.0)  # metres from the LiDAR
_ABOVE_GROUND = 0.4  # metres; the ground lies on itself by any poses of a vehicle
_VOXEL = 0.3  # metres, in which one point is kept
_ON = 0.3  # metres between points that lie on each other


def share_on(
    first: NDArray[np.float32],
    second: NDArray[np.float32],
    motion: NDArray[np.float64],
    ground: GroundPlane | None = None,
) -> float:
    """Share of the points of a sweep that lie on those of an earlier one.

    Parameters
    ----------
    first, second : ndarray of float32, shape (N, 3)
        As measured, metres.
    motion : ndarray of float64, shape (4, 4)
        Takes points of the second to the frame of the first.
    ground : GroundPlane, optional
        Its points are left out.
    """
    import small_gicp

    target, source = (_sampled(points, ground) for points in (first, second))
    if not len(target) or not len(source):
        return 0.0
    moved = source @ motion[:3, :3].T + motion[:3, 3]
    _, squared = small_gicp.KdTree(target).batch_nearest_neighbor_search(moved)
    return float(np.mean(np.asarray(squared) < _ON**2))


def _sampled(points: NDArray[np.float32], ground: GroundPlane | None) -> NDArray[np.float64]:
    import small_gicp

    with np.errstate(invalid="ignore", over="ignore"):
        distance = np.linalg.norm(points, axis=1)
        kept = (distance > _REACH[0]) & (distance < _REACH[1])
        if ground is not None:
            kept &= points @ ground.up + ground.height > _ABOVE_GROUND
    if not kept.any():
        return np.zeros((0, 3))
    cloud = small_gicp.voxelgrid_sampling(points[kept].astype(np.float64), _VOXEL, num_threads=1)
    return np.asarray(cloud.points()[:, :3], np.float64)
