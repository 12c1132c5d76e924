"""Nearest neighbours between point clouds, for the protocols on cleaned maps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import MissingExtraError

# Queries per call of the search: bounds its temporary memory to some tens of megabytes.
_BATCH = 2_000_000


def nearest_neighbors(
    points: NDArray[np.floating[Any]], queries: NDArray[np.floating[Any]], max_distance: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The nearest point of each query.

    Parameters
    ----------
    points : ndarray of float, shape (N, 3)
        Metres, finite.
    queries : ndarray of float, shape (M, 3)
        In the same frame [m], finite.
    max_distance : float
        Farther points are no neighbours [m].

    Returns
    -------
    index : ndarray of int64, shape (M,)
        Row of ``points``; meaningless where there is no neighbour.
    distance : ndarray of float64, shape (M,)
        Metres; infinite where there is no neighbour.

    Raises
    ------
    MissingExtraError
        scipy is not installed.
    """
    index = np.zeros(len(queries), dtype=np.int64)
    distance = np.full(len(queries), np.inf)
    if len(points) and len(queries):
        index, distance = _search(points, queries, max_distance)
        distance[distance > max_distance] = np.inf
    return index, distance


def _search(
    points: NDArray[np.floating[Any]], queries: NDArray[np.floating[Any]], max_distance: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Index and distance of the nearest point; farther ones may be left out."""
    try:
        from scipy.spatial import cKDTree
    except ImportError:
        raise MissingExtraError(
            'map protocols search neighbours with scipy: pip install "docdepth[eval]"'
        ) from None
    tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
    limit = np.nextafter(max_distance, np.inf)  # the bound of the tree is exclusive
    batches = [
        tree.query(queries[k : k + _BATCH], distance_upper_bound=limit)
        for k in range(0, len(queries), _BATCH)
    ]
    distance, index = (np.concatenate(arrays) for arrays in zip(*batches, strict=True))
    return index.astype(np.int64, copy=False), distance
