"""Blooming: ghost returns that some sensors report around retro-reflectors, where nothing is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BRIGHT = 0.9
"""Share of the full scale of intensity that signs and number plates exceed."""

_NOISE = 0.05  # metres, of range
_PROBE = 2.2  # blooming angles from the reflector to the place that should be empty beyond a ghost
_EMPTY = 0.7  # blooming angles around that place without any return
_NEIGHBORS = 50  # returns beside a reflector that decide together whether it stands alone


def blooming_points(
    points: NDArray[np.float32], intensity: NDArray[np.float32], blooming_deg: float
) -> NDArray[np.bool_]:
    """Find ghost returns: echoes of a retro-reflector in beams that pass beside it.

    A ghost return is dim, lies at most ``blooming_deg`` beside a bright return at the same range,
    and twice as far from the reflector on the same side there is no return: the post of a sign goes
    on there, so its returns are real. Beside a plate on a car or a wall most returns go on, and
    none of them is a ghost.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame, metres. Rows without a return (not finite, or at the origin) are False.
    intensity : ndarray of float32, shape (N,)
        The full scale is 1, 255 or 65535, the smallest that holds all values.
    blooming_deg : float
        How far beyond its outline a reflector is reported [deg].
    """
    from small_gicp import KdTree

    ghost = np.zeros(len(points), bool)
    rows = np.flatnonzero(np.isfinite(points).all(axis=1) & points.any(axis=1))
    returns = points[rows].astype(np.float64)
    scale = next((s for s in (1, 255) if np.fmax.reduce(intensity[rows], initial=0) <= s), 65535)
    bright = intensity[rows] > BRIGHT * scale
    if not bright.any():
        return ghost
    reach = np.radians(blooming_deg) * np.linalg.norm(returns, axis=1)
    nearest, squared = KdTree(returns[bright]).batch_nearest_neighbor_search(returns)
    beside = ~bright & (np.asarray(squared) <= (reach + _NOISE) ** 2)
    rows, reach = rows[beside], reach[beside]
    reflector = returns[bright][np.asarray(nearest)[beside]]
    outward = returns[beside] - reflector
    outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-9)[:, None]
    beyond = reflector + _PROBE * reach[:, None] * outward
    _, squared = KdTree(returns).batch_nearest_neighbor_search(beyond)
    ends = np.asarray(squared) > (_EMPTY * reach + _NOISE) ** 2
    around, _ = KdTree(reflector).batch_knn_search(reflector, min(_NEIGHBORS, len(reflector)))
    ghost[rows] = ends & (ends[np.asarray(around)].mean(axis=1) > 0.5)
    return ghost
