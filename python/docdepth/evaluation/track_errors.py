"""Errors of tracked boxes against exact ones, in the frame of the true box."""

from __future__ import annotations

from collections import defaultdict
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track

Floats: TypeAlias = NDArray[np.float64]
ERRORS = ("along", "across", "heading_deg", "velocity")
"""Of the box's centre along and across its heading [m], of heading [deg] and velocity [m/s]."""


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
    boxes = [inverse(T) @ t.pose_at(time) for t, T in ((true, T_true_lidar), (made, T_made_lidar))]
    apart = inverse(boxes[0]) @ boxes[1]
    heading = abs(float(np.degrees(np.arctan2(apart[1, 0], apart[0, 0]))))
    there, here = T_true_lidar[:3, :3].T, T_made_lidar[:3, :3].T
    velocity = here @ made.velocity_at(time) - there @ true.velocity_at(time)
    along, across = np.abs(apart[:2, 3]).tolist()
    return along, across, heading, float(np.linalg.norm(velocity))


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
