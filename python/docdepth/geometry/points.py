"""Points of a sweep: class ids, labels, checks and usable returns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError

GROUND, STATIC, DYNAMIC = 0, 50, 100
"""Values of ``classid`` as ``frames/*.ply`` stores it; below 50 is ground, from 100 on dynamic."""

OUTLIER_LABEL, STATIC_LABEL, MOVING_LABEL = 1, 9, 251
"""Values of ``labels/*.label``, of SemanticKITTI's moving object segmentation."""

MOVING_LABELS = tuple(range(251, 260))
"""SemanticKITTI's classes of what moves; 251 stands for all of them."""

GROUND_LABELS = (40, 44, 48, 49, 60, 72)
"""SemanticKITTI's road, parking, sidewalk, other ground, lane marking and terrain."""


def usable_points(points: NDArray[np.float32], min_range: float = 0.5) -> NDArray[np.bool_]:
    """Which rows are returns: finite, and not at the origin.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        Metres.
    min_range : float
        Nearer rows count as at the origin [m].

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    with np.errstate(invalid="ignore", over="ignore"):
        squared = x * x + y * y + z * z  # overflows only beyond 1e19 m, where nothing returns
        usable: NDArray[np.bool_] = np.isfinite(squared) & (squared >= min_range * min_range)
    return usable


def spread(values: NDArray[Any], rows: NDArray[Any], count: int, fill: Any = 0) -> NDArray[Any]:
    """Values of some rows, numbers or a mask, as values of all ``count`` rows."""
    if len(values) == count:
        return values
    every = np.full(count, fill, values.dtype)
    every[rows] = values
    return every


def check_points(points: NDArray[Any]) -> NDArray[np.float32]:
    """Points as a contiguous array.

    Raises
    ------
    InputError
        They are not float32 of shape (N, 3).
    """
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype != np.float32:
        raise InputError(
            f"points must be float32 of shape (N, 3), got {points.dtype} {points.shape}; "
            "convert them once where they are read: np.asarray(points, np.float32)[:, :3]"
        )
    return np.ascontiguousarray(points)


def check_sweep(
    points: NDArray[np.float32], ground: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Points and their ground flags as contiguous arrays.

    Raises
    ------
    InputError
        As for :func:`check_points`, or ground is not bool of shape (N,).
    """
    points, ground = check_points(points), np.asarray(ground)
    if ground.dtype != np.bool_ or ground.shape != points.shape[:1]:
        raise InputError(
            f"ground must be bool of shape ({len(points)},), one flag a point, "
            f"got {ground.dtype} {ground.shape}"
        )
    return points, np.ascontiguousarray(ground)
