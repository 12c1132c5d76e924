"""Objects of a sweep, and evidence shared within them and carried along them over time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import DynamicsParameters
from docdepth.geometry.points import check_sweep
from docdepth.geometry.scan_mesh import ScanMesh


def cluster_objects(
    points: NDArray[np.float32],
    ground: NDArray[np.bool_],
    surface: ScanMesh | None = None,
    parameters: DynamicsParameters | None = None,
) -> NDArray[np.uint32]:
    """Find the objects of a sweep: points off the ground that its surface connects.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    surface : Surface, optional
        Of these points; made here when left out.
    parameters : DynamicsParameters, optional

    Returns
    -------
    ndarray of uint32, shape (N,)
        Row of the first point of each point's object; a point of the ground is alone.

    Raises
    ------
    InputError
        A shape or dtype is wrong.
    """
    points, ground = check_sweep(points, ground)
    p = _object_parameters(parameters or DynamicsParameters())
    return _core.cluster_objects(points, ground, (surface or ScanMesh(points)).core, p)


def classify_objects(
    points: NDArray[np.float32],
    ground: NDArray[np.bool_],
    objects: NDArray[np.uint32],
    static: NDArray[np.uint16],
    dynamic: NDArray[np.uint16],
    surface: ScanMesh,
    parameters: DynamicsParameters,
) -> NDArray[np.bool_]:
    """Which points are dynamic when evidence is shared within objects; all arrays a value a point.

    Dynamic points that stand alone are withdrawn, the other points of an object follow most of
    them, and an object that stands for a while moves when enough of its place was seen free.
    """
    p = _object_parameters(parameters)
    moving = _core.classify_objects(points, ground, objects, static, dynamic, surface.core, p)
    return moving.view(np.bool_)


def _object_parameters(p: DynamicsParameters) -> _core.ObjectParameters:
    objects = _core.ObjectParameters()
    objects.cluster_distance, objects.cluster_distance_growth = p.link, p.link_growth
    objects.min_cluster_size, objects.neighbor_radius = p.companions, p.company
    objects.clear_votes, objects.clear_ratio = p.clear_votes, p.clear_ratio
    objects.min_object_points, objects.dynamic_share = p.object_points, p.object_share
    objects.min_dynamic_share = p.object_least
    objects.min_object_width, objects.min_object_height = p.object_width, p.object_height
    objects.observed_free_share, objects.observed_free_votes = p.freed_share, p.freed_votes
    objects.max_static_ratio, objects.isolated_votes = p.freed_ratio, p.loose_votes
    return objects
