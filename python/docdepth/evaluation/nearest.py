"""Nearest neighbours between point clouds, for cleaned maps and for depth as points."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core

# Queries per piece, so that temporary arrays stay below a hundred megabytes.
_BATCH = 1_000_000


def nearest_neighbors(
    points: NDArray[np.floating[Any]],
    queries: NDArray[np.floating[Any]],
    max_distance: float,
    threads: int = 0,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The nearest point of each query, found with a k-d tree in single precision.

    Parameters
    ----------
    points : ndarray of float, shape (N, 3)
        Metres, finite.
    queries : ndarray of float, shape (M, 3)
        In the same frame [m], finite.
    max_distance : float
        Farther points are no neighbours [m].
    threads : int
        0 uses all cores. The result does not depend on it.

    Returns
    -------
    index : ndarray of int64, shape (M,)
        Row of ``points``; meaningless where there is no neighbour.
    distance : ndarray of float64, shape (M,)
        Metres, in double precision; infinite where there is no neighbour.
    """
    distance = np.full(len(queries), np.inf)
    if not len(points) or not len(queries):
        return np.zeros(len(queries), dtype=np.int64), distance
    # Single precision suffices near the origin; float32 points are searched as they are.
    origin = points.mean(axis=0) if points.dtype == np.float64 else np.zeros(3, points.dtype)
    found, _ = _core.nearest_neighbors(
        np.ascontiguousarray(points - origin, np.float32),
        np.ascontiguousarray(queries - origin, np.float32),
        threads,
    )
    index = found.astype(np.int64)
    for start in range(0, len(queries), _BATCH):
        batch = slice(start, start + _BATCH)
        offset = points[index[batch]].astype(np.float64) - queries[batch]
        distance[batch] = np.sqrt(np.einsum("ij,ij->i", offset, offset))
    distance[distance > max_distance] = np.inf
    return index, distance


_QUERIES = 50_000
"""Points of a cloud that look for their neighbour in the other, evenly chosen: thousands tell the
mean, and a dense image has half a million."""


def cloud_distance(
    cloud: NDArray[np.float64], other: NDArray[np.float64], threads: int = 0
) -> tuple[float, int]:
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
        chosen = queries[:: -(-len(queries) // _QUERIES)]
        _, distance = nearest_neighbors(points, chosen, np.inf, threads)
        total, count = total + float(distance.sum()), count + len(distance)
    return total, count
