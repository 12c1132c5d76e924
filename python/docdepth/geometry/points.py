"""Points of a sweep: checks, usable returns and class ids."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError


def usable_points(points: NDArray[np.float32], min_range: float = 0.5) -> NDArray[np.bool_]:
    """Which rows are returns: finite, and not at the origin (``min_range`` in metres).

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    x, y, z = points[:, 0], points[:, 1], points[:, 2]
    with np.errstate(invalid="ignore", over="ignore"):
        squared = x * x + y * y + z * z  # overflows only beyond 1e19 m, where nothing returns
        usable: NDArray[np.bool_] = np.isfinite(squared) & (squared >= min_range * min_range)
    return usable


def check_sweep(
    points: NDArray[np.float32], ground: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Contiguous points and ground flags, or an error that says what to change."""
    points, ground = np.asarray(points), np.asarray(ground)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype != np.float32:
        raise InputError(
            f"points must be float32 of shape (N, 3), got {points.dtype} {points.shape}; "
            "convert them once where they are read"
        )
    if ground.dtype != np.bool_ or ground.shape != points.shape[:1]:
        raise InputError(
            f"ground must be bool of shape ({len(points)},), one flag a point, "
            f"got {ground.dtype} {ground.shape}"
        )
    return np.ascontiguousarray(points), np.ascontiguousarray(ground)


GROUND, STATIC, DYNAMIC = 0, 50, 100
"""Values of ``classid``, as ``frames/*.ply`` stores it."""
