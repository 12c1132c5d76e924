"""Cleaned maps against labelled points, by the protocols of two benchmarks.

DynamicMap_Benchmark asks for each labelled point whether the cleaned map still has a point near it.
ERASOR compares voxels. For the same result both give other values than a comparison point by point,
so tables print the protocol and its distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.label_counts import LabelCounts, ignored, moving
from docdepth.evaluation.nearest import nearest_neighbors
from docdepth.evaluation.tables import percent, ratio

# Above this number of cells the grid of :func:`_crop` would need too much memory.
_MAX_CELLS = 200_000_000


@dataclass(frozen=True)
class PreservationRejection:
    """Numbers of preserved and rejected voxels (ERASOR).

    Attributes
    ----------
    static, static_preserved : int
        Static voxels of the ground truth, and how many of them the cleaned map keeps.
    dynamic, dynamic_left : int
        Dynamic voxels of the ground truth, and how many of them the cleaned map keeps.
    """

    static: int
    static_preserved: int
    dynamic: int
    dynamic_left: int

    @property
    def pr(self) -> float:
        """Preservation rate PR [%]: share of static voxels that are kept."""
        return percent(self.static_preserved, self.static)

    @property
    def rr(self) -> float:
        """Rejection rate RR [%]: share of dynamic voxels that are removed."""
        return percent(self.dynamic - self.dynamic_left, self.dynamic)

    @property
    def f1(self) -> float:
        """Harmonic mean of PR and RR, 0..1."""
        return ratio(2 * self.pr * self.rr, self.pr + self.rr) / 100


def nearest_neighbor_protocol(
    points: NDArray[np.float32],
    dynamic: NDArray[np.bool_],
    cleaned: NDArray[np.float32],
    distance: float = 0.05,
) -> LabelCounts:
    """Label points by the cleaned map: static if the map has a point within ``distance``.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        Labelled points, world frame [m].
    dynamic : ndarray of bool, shape (N,)
        Their true labels.
    cleaned : ndarray of float32, shape (M, 3)
        Points that a method kept as static, world frame [m].
    distance : float
        Radius of the search [m].

    Returns
    -------
    LabelCounts
        DynamicMap_Benchmark's HA is ``100 * f1``, its AA is ``aa``.
    """
    labelled = np.ones(len(points), dtype=bool)
    if len(cleaned) and len(points):
        _, away = nearest_neighbors(_crop(cleaned, points, distance), points, distance)
        labelled = np.isinf(away)
    return LabelCounts.of(np.asarray(dynamic, dtype=bool), labelled)


def voxel_protocol(
    points: NDArray[np.float32],
    dynamic: NDArray[np.bool_],
    kept: NDArray[np.bool_],
    voxel_size: float = 0.2,
) -> PreservationRejection:
    """Preservation and rejection rates on voxels (ERASOR).

    The labelled points and the kept points are both reduced to one centroid per voxel. A centroid
    has the label of the point nearest to it. Each true centroid is matched with the nearest kept
    centroid within half a voxel diagonal; its voxel is preserved if both have the same label.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        Labelled points, world frame [m].
    dynamic : ndarray of bool, shape (N,)
        Their true labels.
    kept : ndarray of bool, shape (N,)
        Which points the cleaned map keeps.
    voxel_size : float
        Edge of a voxel [m].
    """
    dynamic = np.asarray(dynamic, dtype=bool)
    truth, truth_dynamic = _voxelise(points, dynamic, voxel_size)
    left, left_dynamic = _voxelise(points[kept], dynamic[kept], voxel_size)
    same = np.zeros(len(truth), dtype=bool)
    if len(left) and len(truth):
        half_diagonal = voxel_size * math.sqrt(3) / 2
        index, distance = nearest_neighbors(left, truth, half_diagonal)
        matched = distance < half_diagonal
        same[matched] = truth_dynamic[matched] == left_dynamic[index[matched]]
    return PreservationRejection(
        static=int(np.count_nonzero(~truth_dynamic)),
        static_preserved=int(np.count_nonzero(same & ~truth_dynamic)),
        dynamic=int(np.count_nonzero(truth_dynamic)),
        dynamic_left=int(np.count_nonzero(same & truth_dynamic)),
    )


def _crop(
    points: NDArray[np.float32], around: NDArray[np.float32], margin: float
) -> NDArray[np.float32]:
    """Keep the points in grid cells that hold a point of ``around``, or in neighbouring cells."""
    size = max(1.0, margin)
    origin = around.min(axis=0) - 2 * size
    shape = ((around.max(axis=0) - origin) / size).astype(np.int64) + 3
    if math.prod(shape.tolist()) > _MAX_CELLS:
        return points
    occupied = np.zeros(shape, dtype=bool)
    cells = ((around - origin) / size).astype(np.int64)
    occupied[tuple(cells.T)] = True
    for axis in range(3):
        cells_along = np.moveaxis(occupied, axis, 0)
        grown = cells_along.copy()
        grown[1:] |= cells_along[:-1]
        grown[:-1] |= cells_along[1:]
        occupied = np.moveaxis(grown, 0, axis)
    cell = np.floor((points - origin) / size)
    inside = ((cell >= 0) & (cell < shape)).all(axis=1)
    inside[inside] = occupied[tuple(cell[inside].astype(np.int64).T)]
    return points[inside]


def _voxelise(
    points: NDArray[np.float32], dynamic: NDArray[np.bool_], size: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Centroid of each occupied voxel, with the label of the point nearest to it."""
    if not len(points):
        return np.empty((0, 3)), np.empty(0, dtype=bool)
    cells = np.floor(points.astype(np.float64) / size).astype(np.int64)
    cells -= cells.min(axis=0)
    extent = cells.max(axis=0) + 1
    keys = (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]
    order = np.argsort(keys, kind="stable")
    first = np.flatnonzero(np.diff(keys[order], prepend=-1))
    sorted_points = points[order].astype(np.float64)
    counts = np.diff(first, append=len(points))
    centroids = np.add.reduceat(sorted_points, first, axis=0) / counts[:, None]
    voxel = np.repeat(np.arange(len(first)), counts)
    away = ((sorted_points - centroids[voxel]) ** 2).sum(axis=1)
    nearest = np.lexsort((away, voxel))[first]
    return centroids, dynamic[order[nearest]]


@dataclass(frozen=True)
class MapResult:
    """Metrics of a merged map by both protocols.

    Attributes
    ----------
    poses : str
        Source of the poses.
    distance, voxel_size : float
        Search radius and voxel size of the protocols [m].
    nearest : LabelCounts
    voxels : PreservationRejection
    """

    poses: str
    distance: float
    voxel_size: float
    nearest: LabelCounts
    voxels: PreservationRejection


class MapEvaluation:
    """Evaluates the map that remains when dynamic points are removed, by both protocols.

    The points of all sweeps stay in memory until :meth:`result`, 15 bytes each, which then builds a
    search tree of them: meant for a few hundred sweeps.

    Parameters
    ----------
    poses : str
        Source of the poses; printed with the metrics.
    distance, voxel_size : float
        Search radius and voxel size of the protocols [m].
    """

    def __init__(
        self, poses: str = "not stated", distance: float = 0.05, voxel_size: float = 0.2
    ) -> None:
        self._poses, self._distance, self._voxel_size = poses, distance, voxel_size
        self._points: list[NDArray[np.float32]] = []
        self._flags: list[NDArray[np.bool_]] = []

    def add(
        self,
        points: NDArray[np.float32],
        labels: NDArray[np.uint32],
        dynamic: NDArray[np.bool_],
    ) -> None:
        """Add one sweep to the map.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
            World frame [m].
        labels : ndarray of uint32, shape (N,)
            True SemanticKITTI labels; unlabelled points stay in the cleaned map.
        dynamic : ndarray of bool, shape (N,)
            Points that the method labelled dynamic.

        Raises
        ------
        InputError
            The arrays do not belong to the same points.
        """
        if points.ndim != 2 or points.shape != (len(labels), 3) or len(dynamic) != len(labels):
            raise InputError(
                f"points {points.shape}, {len(labels)} labels and {len(dynamic)} flags do not "
                "belong together; give one label and one flag per point"
            )
        finite = np.isfinite(points).all(axis=1)
        flags = np.stack([~ignored(labels), moving(labels), np.asarray(dynamic, dtype=bool)])
        self._points.append(points[finite].astype(np.float32, copy=False))
        self._flags.append(flags[:, finite])

    def result(self) -> MapResult:
        """Metrics of all sweeps added so far."""
        points = np.concatenate([np.empty((0, 3), np.float32), *self._points])
        flags = np.concatenate([np.empty((3, 0), np.bool_), *self._flags], axis=1)
        labelled, truth, dynamic = flags
        # A kept point is its own neighbour: only removed points need the search.
        removed = labelled & dynamic
        kept = labelled & ~dynamic
        nearest = nearest_neighbor_protocol(
            points[removed], truth[removed], points[~dynamic], self._distance
        )
        nearest += LabelCounts.of(truth[kept], dynamic[kept])
        voxels = voxel_protocol(
            points[labelled], truth[labelled], ~dynamic[labelled], self._voxel_size
        )
        return MapResult(self._poses, self._distance, self._voxel_size, nearest, voxels)
