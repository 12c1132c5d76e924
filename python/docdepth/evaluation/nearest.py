"""Nearest neighbours between point clouds, for depth as points and for cleaned maps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core

_QUERIES = 50_000
"""Points of a cloud that look for their neighbour in the other, evenly chosen: thousands tell the
mean, and a dense image has half a million."""


def nearest_neighbors(
    points: NDArray[np.floating[Any]], queries: NDArray[np.floating[Any]], threads: int = 0
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The nearest point of each query, found with a k-d tree in single precision.

    Parameters
    ----------
    points, queries : ndarray of float, shape (N, 3) and (M, 3)
        In the same frame [m], finite.
    threads : int
        0 uses all cores. The result does not depend on it.

    Returns
    -------
    index : ndarray of int64, shape (M,)
        Row of ``points``.
    distance : ndarray of float64, shape (M,)
        Metres, in double precision; infinite without points.
    """
    if not len(points) or not len(queries):
        return np.zeros(len(queries), np.int64), np.full(len(queries), np.inf)
    # Single precision suffices near the origin; float32 points are searched as they are.
    origin = points.mean(axis=0) if points.dtype == np.float64 else np.zeros(3, points.dtype)
    found, _ = _core.nearest_neighbors(
        np.ascontiguousarray(points - origin, np.float32),
        np.ascontiguousarray(queries - origin, np.float32),
        threads,
    )
    index = found.astype(np.int64)
    offset = points[index].astype(np.float64) - queries
    return index, np.sqrt(np.einsum("ij,ij->i", offset, offset))


def cloud_distance(cloud: NDArray[np.float64], other: NDArray[np.float64]) -> tuple[float, int]:
    """Distance between two clouds: from each point to the nearest of the other, both ways.

    Parameters
    ----------
    cloud, other : ndarray of float64, shape (N, 3)
        The same frame [m].

    Returns
    -------
    (float, int)
        Sum of the distances [m], and how many there are.
    """
    total, count = 0.0, 0
    if not len(cloud) or not len(other):
        return total, count
    for points, queries in ((cloud, other), (other, cloud)):
        _, distance = nearest_neighbors(points, queries[:: -(-len(queries) // _QUERIES)])
        total, count = total + float(distance.sum()), count + len(distance)
    return total, count
