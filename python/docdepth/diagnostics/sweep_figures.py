"""Rows without a return, and times of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import Sweep, usable_points

_CLOSE = 0.5  # metres; nearer points are of the LiDAR itself


def row_shares(points: NDArray[np.float32]) -> dict[str, float]:
    """Shares of the rows of a sweep: not finite, at the origin, close to it, in one other place.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)

    Returns
    -------
    dict
        ``not_finite``; ``at_origin``: exactly; ``close``: nearer than half a metre, but not there;
        ``one_place``: of the place that most other rows have to the last bit.
    """
    count = max(len(points), 1)
    finite = np.isfinite(points).all(axis=1)
    kept = points[finite]
    origin = (kept == 0).all(axis=1)
    others = kept[~origin]
    close = np.linalg.norm(others.astype(np.float64), axis=1) < _CLOSE
    most = 0
    if len(others):
        keys = np.ascontiguousarray(others).view(np.dtype((np.void, others.dtype.itemsize * 3)))
        most = int(np.unique(keys.ravel(), return_counts=True)[1].max())
    return {
        "not_finite": float((~finite).sum() / count),
        "at_origin": float(origin.sum() / count),
        "close": float(close.sum() / count),
        "one_place": float(most / count) if most > 2 else 0.0,
    }


def time_figures(sweep: Sweep, period: float | None) -> dict[str, object] | None:
    """Times of the points of a sweep; None where they are not known.

    Parameters
    ----------
    sweep : Sweep
    period : float, optional
        Seconds between sweeps.

    Returns
    -------
    dict or None
        ``span``: first and last, as shares of the period after the stamp; ``span_s``, seconds;
        ``turn_deg``: by how much azimuth changes from one point to the next in time (median), of
        the points of one LiDAR.
    """
    if sweep.relative_time is None:
        return None
    kept = usable_points(sweep.points) & np.isfinite(sweep.relative_time)
    late = sweep.relative_time[kept].astype(np.float64)
    if not len(late):
        return None
    first, last = float(late.min()), float(late.max())
    points = sweep.points[kept]
    if sweep.sensor_rig is not None:
        rig = sweep.sensor_rig
        of_first = rig.lidar_id[rig.index[kept]] == rig.lidar_id[0]
        late, points = late[of_first], points[of_first]
    order = np.argsort(late, kind="stable")
    azimuth = np.arctan2(points[order, 1], points[order, 0])
    turns = np.abs((np.diff(azimuth) + np.pi) % (2 * np.pi) - np.pi)
    return {
        "span": [round(first, 3), round(last, 3)],
        "span_s": None if period is None else [round(first * period, 4), round(last * period, 4)],
        "turn_deg": round(float(np.degrees(np.median(turns))), 2) if len(turns) else 0.0,
    }
