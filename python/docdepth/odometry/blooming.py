"""Phantoms around retro-reflectors: returns that some sensors make where there is nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from small_gicp import KdTree

from docdepth.errors import InputError

BRIGHT = 0.9
"""Share of the full scale of intensity that signs and number plates exceed."""

_NOISE = 0.05  # of range [m]
_AROUND = 50  # returns beside a reflector that tell together whether it stands free


def blooming_points(
    points: NDArray[np.float32], intensity: NDArray[np.float32], blooming_deg: float
) -> NDArray[np.bool_]:
    """Which returns are echoes of a retro-reflector from beams that pass beside it.

    They are dim, lie at most ``blooming_deg`` beside a bright return and as far away as it, and
    twice as far out on the same side there is nothing: where the post of a sign goes on, returns
    are real. Around a plate on a car or a wall most of them go on, and none is a phantom.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame, metres. Rows that are no returns (not finite, or at the origin) are no
        phantoms.
    intensity : ndarray of float32, shape (N,)
        Its full scale is 1, 255 or 65535, the least that holds all.
    blooming_deg : float
        How far beyond its outline the sensor sees a reflector [deg].

    Returns
    -------
    ndarray of bool, shape (N,)

    Raises
    ------
    InputError
        The shapes differ.
    """
    if points.ndim != 2 or points.shape[1] != 3 or intensity.shape != points.shape[:1]:
        raise InputError(
            f"points {points.shape} and intensity {intensity.shape} differ; give (N, 3) and (N,)"
        )
    phantom = np.zeros(len(points), bool)
    rows = np.flatnonzero(np.isfinite(points).all(axis=1) & points.any(axis=1))
    returns = points[rows].astype(np.float64)
    scale = next((s for s in (1, 255) if np.fmax.reduce(intensity[rows], initial=0) <= s), 65535)
    bright = intensity[rows] > BRIGHT * scale
    if not bright.any():
        return phantom
    reach = np.radians(blooming_deg) * np.linalg.norm(returns, axis=1)
    nearest, squared = KdTree(returns[bright]).batch_nearest_neighbor_search(returns)
    beside = ~bright & (np.asarray(squared) <= (reach + _NOISE) ** 2)
    rows, reach = rows[beside], reach[beside]
    mirror = returns[bright][np.asarray(nearest)[beside]]
    outward = returns[beside] - mirror
    outward /= np.maximum(np.linalg.norm(outward, axis=1), 1e-9)[:, None]
    beyond = mirror + 2.2 * reach[:, None] * outward
    _, squared = KdTree(returns).batch_nearest_neighbor_search(beyond)
    ends = np.asarray(squared) > (0.7 * reach + _NOISE) ** 2
    around, _ = KdTree(mirror).batch_knn_search(mirror, min(_AROUND, len(mirror)))
    phantom[rows] = ends & (ends[np.asarray(around)].mean(axis=1) > 0.5)
    return phantom
