"""The returns of a sweep in which a board is looked for, and where their rays begin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.lidar_frame import SensorRig, lidar_views
from docdepth.geometry.points import usable_points

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class BoardSweep:
    """The usable returns of one sweep."""

    points: Floats  # (N, 3): LiDAR frame [m]
    origins: Floats  # (N, 3): where the ray of each return begins, LiDAR frame [m]
    # (N,): returns in the box that was given by hand. The others are not of the board, so their
    # rays went past it
    may_be_board: NDArray[np.bool_] | None = None

    @cached_property
    def ranges(self) -> Floats:
        """Distance of each return from the origin, shape (N,) [m]."""
        return np.asarray(np.linalg.norm(self.points, axis=1))

    @cached_property
    def directions(self) -> Floats:
        """Unit vector from the origin to each return, shape (N, 3)."""
        return np.asarray(self.points / self.ranges[:, None])

    def around(self, place: Floats, radius: float) -> BoardSweep:
        """The returns whose line of sight passes a place (3,) at less than ``radius`` [m]."""
        away = float(np.linalg.norm(place))
        if away <= radius:
            return self
        rows = self.directions @ (place / away) > np.sqrt(1.0 - (radius / away) ** 2)
        boxed = self.may_be_board
        return BoardSweep(
            self.points[rows], self.origins[rows], None if boxed is None else boxed[rows]
        )


def board_sweep(
    points: NDArray[np.float32], rig: SensorRig | None = None, box: Floats | None = None
) -> BoardSweep:
    """The usable returns of a sweep.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame [m], unusable rows too.
    rig : SensorRig, optional
        Where the rays begin; at the origin if left out.
    box : ndarray of float64, shape (3, 2), optional
        The board is in here: least and greatest x, y and z [m].
    """
    kept = usable_points(points)
    origins = np.zeros((len(points), 3))
    for view in lidar_views(points, rig):
        R, place = view.T_lidar_sensor[:3, :3], view.T_lidar_sensor[:3, 3]
        rows, begin = np.isfinite(view.points).all(axis=1), view.ray_origins()
        origins[rows] = place if begin is None else begin[rows] @ R.T + place
    places, may_be_board = points[kept].astype(np.float64), None
    if box is not None:
        may_be_board = np.asarray(((places > box[:, 0]) & (places < box[:, 1])).all(axis=1))
    return BoardSweep(places, origins[kept], may_be_board)
