"""Objects of a sweep, and evidence shared within them (ours, beyond the paper)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.geometry.points import check_sweep
from docdepth.geometry.scan_mesh import ScanMesh


def cluster_objects(
    points: NDArray[np.float32], ground: NDArray[np.bool_], mesh: ScanMesh | None = None
) -> NDArray[np.uint32]:
    """Cluster the points above the ground into objects, along the edges of the sweep's mesh.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    mesh : ScanMesh, optional
        Of these points; made here when not given.

    Returns
    -------
    ndarray of uint32, shape (N,)
        For each point the first row of its object; a ground point is an object of its own.

    Raises
    ------
    InputError
        A shape or dtype is wrong.
    """
    points, ground = check_sweep(points, ground)
    return _core.cluster_objects(points, ground, (mesh or ScanMesh(points)).core)


def classify_objects(
    points: NDArray[np.float32],
    ground: NDArray[np.bool_],
    objects: NDArray[np.uint32],
    static: NDArray[np.uint16],
    dynamic: NDArray[np.uint16],
    mesh: ScanMesh,
) -> NDArray[np.bool_]:
    """Decide by objects which points are dynamic.

    Dynamic points without dynamic neighbours become static. An object is dynamic as a whole when
    most of its points are; also when it stood for a while, and enough of its points were observed
    free at another time.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
    ground : ndarray of bool, shape (N,)
    objects : ndarray of uint32, shape (N,)
        From :func:`cluster_objects`.
    static, dynamic : ndarray of uint16, shape (N,)
        Votes.
    mesh : ScanMesh
        Of these points.

    Returns
    -------
    ndarray of bool, shape (N,)
        True for dynamic.
    """
    moving = _core.classify_objects(points, ground, objects, static, dynamic, mesh.core)
    return moving.view(np.bool_)
