"""Cleaned maps against labelled points: the protocols of two benchmarks.

DynamicMap_Benchmark asks for every labelled point whether the cleaned map still has a point near
it; ERASOR compares voxels. Both give other figures than labels by identity for the same result,
so they are printed with their names and distances.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError, MissingExtraError
from docdepth.evaluation.labels import HEADER, LabelCounts, ignored, moving
from docdepth.evaluation.tables import Table, number, percent, plain, ratio

# Queries are answered in pieces of this many points, so that distances need no memory to speak of.
_PIECE = 2_000_000


@dataclass(frozen=True)
class PreservationRejection:
    """Voxels kept and removed (ERASOR).

    Attributes
    ----------
    static, static_preserved : int
        Static voxels of the truth, and those the cleaned map still has.
    dynamic, dynamic_left : int
        Dynamic voxels of the truth, and those the cleaned map still has.
    """

    static: int
    static_preserved: int
    dynamic: int
    dynamic_left: int

    @property
    def pr(self) -> float:
        """Preservation rate [%]."""
        return percent(self.static_preserved, self.static)

    @property
    def rr(self) -> float:
        """Rejection rate [%]."""
        return percent(self.dynamic - self.dynamic_left, self.dynamic)

    @property
    def f1(self) -> float:
        """Harmonic mean of both, 0..1."""
        return ratio(2 * self.pr * self.rr, self.pr + self.rr) / 100

    def as_dict(self) -> dict[str, float]:
        """Figures and counts by name."""
        figures = {"pr": self.pr, "rr": self.rr, "f1": self.f1}
        return {**figures, "static": self.static, "dynamic": self.dynamic}


def nearest_neighbor_protocol(
    points: NDArray[np.float32],
    dynamic: NDArray[np.bool_],
    cleaned: NDArray[np.float32],
    distance: float = 0.05,
) -> LabelCounts:
    """A labelled point counts as called static when the cleaned map has a point near it.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        Labelled points in the world [m].
    dynamic : ndarray of bool, shape (N,)
        Their truth.
    cleaned : ndarray of float32, shape (M, 3)
        The map that a method kept, in the world [m].
    distance : float
        Metres.

    Returns
    -------
    LabelCounts
        HA and AA of DynamicMap_Benchmark are its ``100 * f1`` and ``aa``.
    """
    called = np.ones(len(points), dtype=bool)
    if len(cleaned) and len(points):
        called = np.isinf(_distances(points, _crop(cleaned, points, distance), distance)[0])
    return LabelCounts.of(np.asarray(dynamic, dtype=bool), called)


def voxel_protocol(
    points: NDArray[np.float32],
    dynamic: NDArray[np.bool_],
    kept: NDArray[np.bool_],
    voxel_size: float = 0.2,
) -> PreservationRejection:
    """Preservation and rejection rates on voxels of 0.2 m (ERASOR).

    The labelled points and the kept ones are both reduced to one point a voxel, the centroid, with
    the label of the point of the voxel nearest to it. A voxel of the truth is matched by the
    nearest kept one within half a voxel's diagonal, and preserved when both have its label.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        Labelled points in the world [m].
    dynamic : ndarray of bool, shape (N,)
        Their truth.
    kept : ndarray of bool, shape (N,)
        Points of the cleaned map.
    voxel_size : float
        Metres.
    """
    dynamic = np.asarray(dynamic, dtype=bool)
    truth, truth_dynamic = _voxelise(points, dynamic, voxel_size)
    left, left_dynamic = _voxelise(points[kept], dynamic[kept], voxel_size)
    same = np.zeros(len(truth), dtype=bool)
    if len(left) and len(truth):
        reach = voxel_size * math.sqrt(3) / 2
        nearest, index = _distances(truth, left, reach)
        matched = nearest < reach
        same[matched] = truth_dynamic[matched] == left_dynamic[index[matched]]
    return PreservationRejection(
        static=int(np.count_nonzero(~truth_dynamic)),
        static_preserved=int(np.count_nonzero(same & ~truth_dynamic)),
        dynamic=int(np.count_nonzero(truth_dynamic)),
        dynamic_left=int(np.count_nonzero(same & truth_dynamic)),
    )


@dataclass(frozen=True)
class MapResult:
    """Figures of a merged map by both protocols.

    Attributes
    ----------
    poses : str
        Where the poses came from.
    distance, voxel_size : float
        Of the two protocols [m].
    nearest : LabelCounts
    voxels : PreservationRejection
    """

    poses: str
    distance: float
    voxel_size: float
    nearest: LabelCounts
    voxels: PreservationRejection

    def as_dict(self) -> dict[str, Any]:
        """Everything by name, ready for JSON; what is undefined is None."""
        result = {
            "poses": self.poses,
            "nearest_neighbor": {"distance": self.distance, **self.nearest.as_dict()},
            "voxels": {"voxel_size": self.voxel_size, **self.voxels.as_dict()},
        }
        return dict(plain(result))

    def table(self) -> Table:
        """Rows of text for a terminal or a report."""
        voxels = self.voxels
        rows = (
            (f"nearest neighbour {self.distance:g} m", *self.nearest.cells()),
            (
                f"voxels {self.voxel_size:g} m (PR, RR)",
                f"{voxels.static:,}",
                f"{voxels.dynamic:,}",
                number(voxels.pr, 2),
                number(voxels.rr, 2),
                "-",
                number(voxels.f1, 4),
                "-",
                "-",
            ),
        )
        return Table(f"cleaned map; poses: {self.poses}", ("protocol", *HEADER), rows)


class MapEvaluation:
    """The map that labels leave, by both protocols, a sweep at a time.

    Points of all sweeps are kept until :meth:`result`, 13 bytes each, and a search tree of them is
    made there: meant for a few hundred sweeps, not for a day of driving.

    Parameters
    ----------
    poses : str
        Where the poses came from, printed with the figures.
    distance, voxel_size : float
        Of the two protocols [m].
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
        """Merge one sweep.

        Parameters
        ----------
        points : ndarray of float32, shape (N, 3)
            In the world [m].
        labels : ndarray of uint32, shape (N,)
            SemanticKITTI labels of the truth; points without one stay in the cleaned map.
        dynamic : ndarray of bool, shape (N,)
            Points called dynamic.
        """
        if points.ndim != 2 or points.shape != (len(labels), 3) or len(dynamic) != len(labels):
            raise InputError(
                f"a point, a label and a flag each, got {points.shape}, {len(labels)}, "
                f"{len(dynamic)}"
            )
        finite = np.isfinite(points).all(axis=1)
        flags = np.stack([~ignored(labels), moving(labels), np.asarray(dynamic, dtype=bool)])
        self._points.append(points[finite].astype(np.float32, copy=False))
        self._flags.append(flags[:, finite])

    def result(self) -> MapResult:
        """The figures of everything added so far."""
        points = np.concatenate([np.empty((0, 3), np.float32), *self._points])
        flags = np.concatenate([np.empty((3, 0), np.bool_), *self._flags], axis=1)
        counted, truth, called = flags
        # A point that was kept is its own neighbour; only removed ones need the search.
        removed = counted & called
        left = counted & ~called
        nearest = nearest_neighbor_protocol(
            points[removed], truth[removed], points[~called], self._distance
        )
        nearest += LabelCounts.of(truth[left], called[left])
        voxels = voxel_protocol(points[counted], truth[counted], ~called[counted], self._voxel_size)
        return MapResult(self._poses, self._distance, self._voxel_size, nearest, voxels)


def _distances(
    queries: NDArray[np.floating[Any]], points: NDArray[np.floating[Any]], reach: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Distance and index of the nearest point; infinite beyond ``reach``."""
    try:
        from scipy.spatial import cKDTree
    except ImportError:
        raise MissingExtraError(
            'map protocols search neighbours with scipy: pip install "docdepth[eval]"'
        ) from None
    distances = np.full(len(queries), np.inf)
    index = np.zeros(len(queries), dtype=np.int64)
    if len(points):
        tree = cKDTree(points, balanced_tree=False, compact_nodes=False)
        for start in range(0, len(queries), _PIECE):
            piece = slice(start, start + _PIECE)
            distances[piece], index[piece] = tree.query(
                # The tree's own bound is strict.
                queries[piece],
                distance_upper_bound=np.nextafter(reach, np.inf),
            )
    return distances, index


def _crop(
    points: NDArray[np.float32], around: NDArray[np.float32], margin: float
) -> NDArray[np.float32]:
    """The points that lie in a cell where one of ``around`` lies, or in a cell next to such."""
    size = max(1.0, margin)
    origin = around.min(axis=0) - 2 * size
    shape = ((around.max(axis=0) - origin) / size).astype(np.int64) + 3
    if math.prod(shape.tolist()) > 200_000_000:
        return points
    occupied = np.zeros(shape, dtype=bool)
    cells = ((around - origin) / size).astype(np.int64)
    occupied[tuple(cells.T)] = True
    for axis in range(3):
        before = np.moveaxis(occupied, axis, 0)
        grown = before.copy()
        grown[1:] |= before[:-1]
        grown[:-1] |= before[1:]
        occupied = np.moveaxis(grown, 0, axis)
    place = np.floor((points - origin) / size)
    inside = ((place >= 0) & (place < shape)).all(axis=1)
    inside[inside] = occupied[tuple(place[inside].astype(np.int64).T)]
    return points[inside]


def _voxelise(
    points: NDArray[np.float32], dynamic: NDArray[np.bool_], size: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Centroids of occupied voxels, each with the label of its point nearest to the centroid."""
    if not len(points):
        return np.empty((0, 3)), np.empty(0, dtype=bool)
    cells = np.floor(points.astype(np.float64) / size).astype(np.int64)
    cells -= cells.min(axis=0)
    extent = cells.max(axis=0) + 1
    keys = (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]
    order = np.argsort(keys, kind="stable")
    ray_origins = np.flatnonzero(np.diff(keys[order], prepend=-1))
    sorted_points = points[order].astype(np.float64)
    counts = np.diff(ray_origins, append=len(points))
    centroids = np.add.reduceat(sorted_points, ray_origins, axis=0) / counts[:, None]
    voxel = np.repeat(np.arange(len(ray_origins)), counts)
    away = ((sorted_points - centroids[voxel]) ** 2).sum(axis=1)
    nearest = np.lexsort((away, voxel))[ray_origins]
    return centroids, dynamic[order[nearest]]
