"""Level ground in few points, so that its rings do not hold the vehicle back.

A spinning LiDAR draws rings on a flat road, and they move with it: registered on each other, they
say that it stands. VGICP weighs distances along a surface by a thousandth of those across it, but
on a motorway nine of ten points lie on the road, and with 16 beams they win. Level ground tells
height, roll and pitch, and needs few points for that. In a city it is the smaller part of a sweep,
walls hold the vehicle, and all its points stay: they average the errors of the lasers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_LEVEL = 0.1  # metres between the returns of a column; kerbs, walls and twigs have more


def split_level_ground(
    points: NDArray[np.float64], edge: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What rises above an open road, and the road in one point for each level column.

    Parameters
    ----------
    points : ndarray of float64, shape (N, 3)
        LiDAR frame, z up [m].
    edge : float
        Edge of a column, a square in x and y [m]. It is level if the heights of its points differ
        by less than 0.1 m.

    Returns
    -------
    ndarray of float64, shape (M, 3)
        Points of the other columns, in their order; ``points`` itself if at most half of them lie
        in level columns.
    ndarray of float64, shape (K, 3)
        Means of the level columns; none if at most half of the points lie in them.
    """
    none = np.zeros((0, 3))
    if not len(points):
        return points, none
    order, first, count, level = _columns(points, edge)
    if count[level].sum() <= 0.5 * len(points):
        return points, none
    means = np.add.reduceat(points[order], first)[level] / count[level, None]
    others = np.sort(order[np.repeat(~level, count)])
    return points[others], means


def rising_rows(points: NDArray[np.float64], edge: float) -> NDArray[np.int64]:
    """Rows of the points (N, 3) in columns that are not level, however many these are."""
    if not len(points):
        return np.zeros(0, np.int64)
    order, _, count, level = _columns(points, edge)
    return np.sort(order[np.repeat(~level, count)])


def _columns(
    points: NDArray[np.float64], edge: float
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Rows sorted by column, and of each column its first, their number and whether it is level."""
    x, y = np.floor(points[:, :2] / edge).astype(np.int64).T
    column = (x << 32) + y
    order = np.argsort(column, kind="stable")
    column, height = column[order], points[order, 2]
    first = np.flatnonzero(np.append(True, column[1:] != column[:-1]))
    count = np.diff(np.append(first, len(column)))
    level = np.maximum.reduceat(height, first) - np.minimum.reduceat(height, first) < _LEVEL
    return order, first, count, level
