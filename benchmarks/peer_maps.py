"""Cleaned maps against labelled points, by the protocols of two benchmarks.

DynamicMap_Benchmark asks for each labelled point whether the cleaned map still has a point near it.
ERASOR compares voxels. For the same result both give other values than a comparison point by point.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from docdepth.evaluation.label_counts import LabelCounts, ignored, moving
from docdepth.evaluation.pixels import nearest_neighbors

DISTANCE = 0.05
"""Radius of the search of DynamicMap_Benchmark [m]."""

VOXEL_SIZE = 0.2
"""Edge of a voxel of ERASOR [m]."""

Points = NDArray[np.float32]
Flags = NDArray[np.bool_]


def nearest_neighbor_protocol(points: Points, dynamic: Flags, cleaned: Points) -> LabelCounts:
    """Label points by the cleaned map: static if the map has a point near them.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        Labelled points, world frame [m].
    dynamic : ndarray of bool, shape (N,)
        Their true labels.
    cleaned : ndarray of float32, shape (M, 3)
        Points that a method kept as static, world frame [m].

    Returns
    -------
    LabelCounts
        DynamicMap_Benchmark's HA is ``100 * f1``, its AA is ``aa``.
    """
    return LabelCounts.of(dynamic, nearest_neighbors(cleaned, points)[1] > DISTANCE)


def voxel_protocol(points: Points, dynamic: Flags, kept: Flags) -> LabelCounts:
    """Preservation rate PR (``sa``) and rejection rate RR (``da``) on voxels (ERASOR).

    The labelled points and the kept points are both reduced to one centroid per voxel. A centroid
    has the label of the point nearest to it. Each true centroid is matched with the nearest kept
    centroid within half a voxel diagonal; its voxel is preserved if both have the same label.

    Parameters
    ----------
    points, dynamic
        As of :func:`nearest_neighbor_protocol`.
    kept : ndarray of bool, shape (N,)
        Which points the cleaned map keeps.
    """
    truth, truth_dynamic = _voxelise(points, dynamic)
    left, left_dynamic = _voxelise(points[kept], dynamic[kept])
    index, distance = nearest_neighbors(left, truth)
    preserved = distance < VOXEL_SIZE * math.sqrt(3) / 2
    preserved[preserved] = truth_dynamic[preserved] == left_dynamic[index[preserved]]
    return LabelCounts.of(truth_dynamic, ~preserved)


def _voxelise(points: Points, dynamic: Flags) -> tuple[NDArray[np.float64], Flags]:
    """Centroid of each occupied voxel, with the label of the point nearest to it."""
    if not len(points):
        return np.empty((0, 3)), np.empty(0, bool)
    cells = np.floor(points.astype(np.float64) / VOXEL_SIZE).astype(np.int64)
    cells -= cells.min(axis=0)
    keys = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    sorted_points = points[order].astype(np.float64)
    counts = np.diff(first, append=len(points))
    centroids = np.add.reduceat(sorted_points, first, axis=0) / counts[:, None]
    voxel = np.repeat(np.arange(len(first)), counts)
    away = ((sorted_points - centroids[voxel]) ** 2).sum(axis=1)
    nearest = np.lexsort((away, voxel))[first]
    return centroids, dynamic[order[nearest]]


def compare_map(
    sweeps: Iterable[tuple[Points, NDArray[np.uint32], Flags]],
) -> tuple[LabelCounts, LabelCounts]:
    """The map that remains when dynamic points are removed, by the nearest points and by voxels.

    All points are in memory, and a search tree of them: meant for a few hundred sweeps.

    Parameters
    ----------
    sweeps : iterable of (points, labels, dynamic)
        Points in the world frame, float32 (N, 3) [m]; their true SemanticKITTI labels, unlabelled
        points stay in the cleaned map; and which points the method labelled dynamic.
    """
    columns = zip(*sweeps, strict=True)
    points, labels, dynamic = (np.concatenate(column) for column in columns)
    finite = np.isfinite(points).all(axis=1)
    points, labels, dynamic = points[finite], labels[finite], dynamic[finite]
    labelled, truth = ~ignored(labels), moving(labels)
    # A kept point is its own neighbour: only removed points need the search.
    removed, kept = labelled & dynamic, labelled & ~dynamic
    nearest = nearest_neighbor_protocol(points[removed], truth[removed], points[~dynamic])
    nearest += LabelCounts.of(truth[kept], dynamic[kept])
    return nearest, voxel_protocol(points[labelled], truth[labelled], ~dynamic[labelled])
