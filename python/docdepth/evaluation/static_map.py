"""Evaluation of the map that remains when dynamic points are removed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.evaluation.label_counts import HEADER, NOTE, LabelCounts, ignored, moving
from docdepth.evaluation.map_protocols import (
    PreservationRejection,
    nearest_neighbor_protocol,
    voxel_protocol,
)
from docdepth.evaluation.tables import Table, number, plain


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

    def as_dict(self) -> dict[str, Any]:
        """All metrics by name, ready for JSON; None replaces NaN."""
        result = {
            "poses": self.poses,
            "nearest_neighbor": {"distance": self.distance, **self.nearest.as_dict()},
            "voxels": {"voxel_size": self.voxel_size, **self.voxels.as_dict()},
        }
        return dict(plain(result))

    def table(self) -> Table:
        """One row per protocol."""
        voxels = self.voxels
        rows = (
            (f"nearest neighbour {self.distance:g} m", *self.nearest.cells()),
            (
                f"voxels {self.voxel_size:g} m (PR, RR in place of SA, DA)",
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
        return Table(f"cleaned map; poses: {self.poses}", ("protocol", *HEADER), rows, NOTE)


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
