"""Rows without a return, points that stay with the LiDAR, and times of points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import Sweep, usable_points
from docdepth.geometry.ground_plane import GroundPlane

_CLOSE = 0.5  # metres; nearer points are of the LiDAR itself
_EGO_REACH = 5.0  # metres from the LiDAR within which its vehicle lies
_EGO_VOXEL = 0.2  # metres
_EGO_SHARE = 0.9  # of the sweeps in which a part of the vehicle is seen
_EGO_FEWEST = 20  # points a sweep
_ABOVE_GROUND = 0.3  # metres; rings on the ground stay with the LiDAR, too
_BELOW_GROUND = 0.5  # metres; nothing lies there but mirror images
_BOX_MARGIN = 0.05  # metres around the points, whose ranges are noisy
_FEWEST_SWEEPS = 4


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


def ego_body(
    sweeps: Sequence[NDArray[np.float32]], ground: GroundPlane | None
) -> dict[str, object] | None:
    """The boxes of points that stay with the LiDAR while it moves: its vehicle.

    Parameters
    ----------
    sweeps : sequence of ndarray of float32, shape (N, 3)
        From different places.
    ground : GroundPlane, optional
        Rings on the ground stay, too; without the plane nothing can be told.

    Returns
    -------
    dict or None
        ``boxes_m``: least and greatest x, y and z of the vehicle, and of its mirror image below the
        ground; ``mirrored``: whether there is one; ``points``: how many of a sweep these are, on
        average. None if there are none.
    """
    if ground is None or len(sweeps) < _FEWEST_SWEEPS:
        return None
    above, below = [], []
    for points in sweeps:
        cloud = points[usable_points(points)]
        cloud = cloud[np.linalg.norm(cloud, axis=1) < _EGO_REACH]
        high = cloud @ ground.up.astype(np.float32) + ground.height
        above.append(cloud[high > _ABOVE_GROUND])
        below.append(cloud[high < -_BELOW_GROUND])
    bodies = [_steady(above), _steady(below)]
    found = [body for body in bodies if body is not None]
    if not found:
        return None
    return {
        "boxes_m": [_box_around(body) for body in found],
        "mirrored": bodies[1] is not None,
        "points": round(sum(map(len, found)) / len(sweeps)),
    }


def _box_around(points: NDArray[np.float32]) -> list[list[float]]:
    low = np.floor(100 * (points.min(axis=0) - _BOX_MARGIN)) / 100
    high = np.ceil(100 * (points.max(axis=0) + _BOX_MARGIN)) / 100
    box: list[list[float]] = np.stack([low, high], axis=1).astype(np.float64).round(2).tolist()
    return box


def _steady(near: Sequence[NDArray[np.float32]]) -> NDArray[np.float32] | None:
    """Points of places that are seen in nearly all sweeps; None if there are few."""
    voxels = [np.floor(cloud / _EGO_VOXEL).astype(np.int64) for cloud in near]
    every = [np.unique(v, axis=0) for v in voxels]
    if not sum(map(len, every)):
        return None
    found, counts = np.unique(np.concatenate(every), axis=0, return_counts=True)
    steady = {tuple(v) for v in found[counts >= _EGO_SHARE * len(near)].tolist()}
    body = [
        cloud[[tuple(v) in steady for v in own.tolist()]]
        for cloud, own in zip(near, voxels, strict=True)
        if len(cloud)
    ]
    points = np.concatenate(body)
    return points if len(points) >= _EGO_FEWEST * len(near) else None


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
