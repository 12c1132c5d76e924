"""The outline of a board in a sweep: which rays it stopped, and which passed beside it.

Each ray meets the plane of the board somewhere. Those that the board stopped (*on*) met it inside
its outline, those that went on (*past*) outside. So both sides tell where the outline is, for any
pattern of rays, and rays that something in front has stopped tell nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.calibration.sweeps import BoardSweep

Floats = NDArray[np.float64]

NEAR_PLANE = 0.06
"""Returns within this distance of the plane are on it [m]: three times the noise of most LiDARs."""

PAST = 0.15
"""Rays that go this far past the plane were not stopped by the board [m]; nearer ones, which may
have met the board and what is behind it, tell nothing."""

_OFFSET = 0.3  # metres between the origin and where rays begin
_GRAZING = 0.1  # cosine; rays that are closer to the plane do not tell where they meet it


@dataclass(frozen=True)
class BoardRays:
    """The rays around a board."""

    # points, origins: (n, 3): returns, and where their rays begin, LiDAR frame [m]
    points: Floats
    origins: Floats
    on: NDArray[np.bool_]  # (n,): the board stopped the ray; else it went past
    places: Floats  # (n, 2): where each ray meets the plane, board frame [m]

    def __len__(self) -> int:
        return len(self.points)

    def select(self, rows: NDArray[np.bool_]) -> BoardRays:
        return BoardRays(self.points[rows], self.origins[rows], self.on[rows], self.places[rows])


def crossings(points: Floats, origins: Floats, T_board_lidar: Floats) -> tuple[Floats, Floats]:
    """Where rays meet the plane of a board.

    Parameters
    ----------
    points, origins : ndarray of float64, shape (N, 3)
        LiDAR frame [m].
    T_board_lidar : ndarray of float64, shape (4, 4) or (N, 4, 4)

    Returns
    -------
    places : ndarray of float64, shape (N, 2)
        Board frame [m]; NaN for rays along the plane or away from it.
    height : ndarray of float64, shape (N,)
        z of the returns, board frame [m]: positive behind the front.
    """
    R, t = T_board_lidar[..., :3, :3], T_board_lidar[..., :3, 3]
    end = np.einsum("...ij,...j->...i", R, points) + t
    start = np.einsum("...ij,...j->...i", R, origins) + t
    way = end - start
    length = np.linalg.norm(way, axis=-1)
    towards = np.abs(way[..., 2]) > _GRAZING * length
    with np.errstate(divide="ignore", invalid="ignore"):
        share = -start[..., 2] / way[..., 2]
        places = start[..., :2] + share[..., None] * way[..., :2]
    places[~towards | (share <= 0)] = np.nan
    return places, end[..., 2]


def rays_near(
    sweep: BoardSweep, board: Board, T_board_lidar: Floats, margin: float, flat: float = NEAR_PLANE
) -> BoardRays:
    """The rays that meet the plane within ``margin`` [m] of the board, on it or past it."""
    centre = -T_board_lidar[:3, :3].T @ T_board_lidar[:3, 3]
    # Rays need not begin at the origin, so some room is left.
    near_sight = sweep.around(centre, 0.5 * board.diagonal + margin + _OFFSET)
    points, origins = near_sight.points, near_sight.origins
    places, height = crossings(points, origins, T_board_lidar)
    on, past = np.abs(height) < flat, height > PAST
    if near_sight.may_be_board is not None:
        past |= ~near_sight.may_be_board & (height > -flat)
        on &= near_sight.may_be_board
    with np.errstate(invalid="ignore"):
        kept = (board.distance(places) < margin) & (on | past)
    return BoardRays(points, origins, on, places).select(kept)
