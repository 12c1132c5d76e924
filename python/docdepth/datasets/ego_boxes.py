"""Points of the vehicle that carries the LiDAR, left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from docdepth.datasets.base import Dataset, Sweep, View


def without_ego(sweep: Sweep, boxes: Sequence[ArrayLike]) -> Sweep:
    """A sweep whose points within the boxes are no returns.

    Rows stay, so that times, rings and labels keep theirs.

    Parameters
    ----------
    sweep : Sweep
    boxes : sequence of six numbers, or of three pairs
        Least and greatest x, y and z, metres in the LiDAR frame.
    """
    if not boxes:
        return sweep
    points = sweep.points.copy()
    points[in_boxes(points, boxes)] = np.nan
    return replace(sweep, points=points)


def in_boxes(points: NDArray[np.float32], boxes: Sequence[ArrayLike]) -> NDArray[np.bool_]:
    """Which points (N, 3) are in one of the boxes, as those of :func:`without_ego`."""
    inside = np.zeros(len(points), bool)
    for box in boxes:
        low, high = np.array(box, np.float32).reshape(3, 2).T
        inside |= ((points >= low) & (points <= high)).all(axis=1)
    return inside


class WithoutEgo(View):
    """A recording without what its LiDAR sees of its own vehicle.

    Parameters
    ----------
    whole : Dataset
    boxes : sequence of array_like
        As for :func:`without_ego`.
    """

    def __init__(self, whole: Dataset, boxes: Sequence[ArrayLike]) -> None:
        super().__init__(whole)
        self._boxes = boxes

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index``; points in the boxes are NaN."""
        return without_ego(super().sweep(index), self._boxes)
