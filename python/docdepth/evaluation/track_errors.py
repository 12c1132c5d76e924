"""Errors of tracked boxes against exact ones, in the frame of the true box, and of what tracks
state of them."""

from __future__ import annotations

from collections import defaultdict
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track

Floats: TypeAlias = NDArray[np.float64]
ERRORS = ("along", "across", "up", "heading_deg", "velocity")
"""Of the middle of the box's bottom along its heading, across it and upward [m], of the heading
[deg] and of the velocity [m/s]."""


def box_errors(
    true: Track, made: Track, time: int, T_true_lidar: Floats, T_made_lidar: Floats
) -> tuple[float, ...]:
    """Sizes of the errors of a box at one time, in the order of :data:`ERRORS`.

    Boxes are compared as the LiDAR sees them, so that errors of its poses do not count.

    Parameters
    ----------
    true, made : Track
    time : int
        [ns].
    T_true_lidar, T_made_lidar : ndarray of float64, shape (4, 4)
        Pose of the LiDAR in the world of either track.
    """
    apart = _apart(true, made, time, T_true_lidar, T_made_lidar)
    heading = abs(float(np.degrees(np.arctan2(apart[1, 0], apart[0, 0]))))
    there, here = T_true_lidar[:3, :3].T, T_made_lidar[:3, :3].T
    velocity = here @ made.velocity_at(time) - there @ true.velocity_at(time)
    along, across, up = np.abs(apart[:3, 3]).tolist()
    return along, across, up, heading, float(np.linalg.norm(velocity))


def _apart(
    true: Track, made: Track, time: int, T_true_lidar: Floats, T_made_lidar: Floats
) -> Floats:
    boxes = [inverse(T) @ t.pose_at(time) for t, T in ((true, T_true_lidar), (made, T_made_lidar))]
    return np.asarray(inverse(boxes[0]) @ boxes[1])


def offset_of(
    true: Track, made: Track, time: int, T_true_lidar: Floats, T_made_lidar: Floats
) -> Floats:
    """Where a box is along and across the true one at one time, shape (2,), as the LiDAR sees it.

    The arguments are those of :func:`box_errors`.
    """
    return _apart(true, made, time, T_true_lidar, T_made_lidar)[:2, 3]


class PathErrors:
    """How the paths of tracks err beside the deviations that the tracks state.

    An object may never have been seen whole. So the centre of its box is off by as much in all
    sweeps, which no deviation tells: of each track the weighted mean of its offsets is taken away.
    What remains, divided by the deviation, is 1 in the root mean square where the deviation is
    right. Its square is known as NEES, the normalised estimation error squared.
    """

    def __init__(self) -> None:
        self._boxes: dict[tuple[str, int, int], list[tuple[float, ...]]] = defaultdict(list)

    def add(self, kind: str, true: int, made: int, offset: Floats, deviation: float) -> None:
        """Add a box: kind and ids, :func:`offset_of` it, and its deviation [m]."""
        self._boxes[kind, true, made].append((float(offset[0]), float(offset[1]), deviation))

    def normalised(self, kinds: tuple[str, ...]) -> float:
        """Root mean square of the normalised errors; NaN without a track of two boxes."""
        total, free = 0.0, 0
        for (kind, *_), rows in self._boxes.items():
            along, across, deviation = np.array(rows).T
            if kind not in kinds or len(rows) < 2 or not (deviation > 0).all():
                continue
            weight = deviation**-2
            for offset in (along, across):
                total += float(weight @ (offset - weight @ offset / weight.sum()) ** 2)
            free += len(rows) - 1
        return float(np.sqrt(total / free)) if free else np.nan


class ErrorSums:
    """Errors of many boxes by kind of the true object."""

    def __init__(self) -> None:
        self._errors: dict[str, list[tuple[float, ...]]] = defaultdict(list)

    def add(self, kind: str, errors: tuple[float, ...]) -> None:
        self._errors[kind].append(errors)

    def of(self, kinds: tuple[str, ...]) -> dict[str, tuple[float, float]]:
        """Median and 95 % quantile of each error; NaN without a box."""
        rows = [row for kind in kinds for row in self._errors[kind]]
        if not rows:
            return dict.fromkeys(ERRORS, (np.nan, np.nan))
        quantiles = np.quantile(np.array(rows), (0.5, 0.95), axis=0)
        return {name: (float(a), float(b)) for name, a, b in zip(ERRORS, *quantiles, strict=True)}
