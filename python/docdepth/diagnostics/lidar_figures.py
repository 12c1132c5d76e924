"""What a sweep tells of the LiDAR that measured it: beams, spacing, rows, times of points."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import Sweep, usable_points
from docdepth.geometry.lidar_frame import lidar_views
from docdepth.geometry.scan_mesh import ScanMesh

_TAIL = 0.005  # share of the points that lie outside the vertical field of view at each end
_FEW_IN_A_DEGREE = 0.1  # of the usual number of points in a degree of azimuth; less is no view
_BIN_DEG = 0.02  # of elevation, in which beams are told apart
_SMOOTH_DEG = 0.04
_FAR = 3.0  # metres; motion compensation hardly turns rays that are longer
_PEAK = 0.1  # of the usual peak: less is no beam
_VALLEY = 0.5  # of the peaks beside it: a higher valley does not tell beams apart
_MOST_BEAMS = 256
_SHARP = 0.1  # the same in all directions: beams were not moved
_SECTORS = 12
_FEWEST_POINTS = 500  # in which beams are looked for
_SAME_RAY_DEG = 0.01
_SAME_PLACE = 0.02  # metres between points that are one


def lidar_figures(sweep: Sweep, names: Sequence[str]) -> list[dict[str, object]]:
    """Figures of each LiDAR of a sweep, ready for JSON.

    Parameters
    ----------
    names : sequence of str
        Of the LiDARs; numbers are taken where there are others.

    Returns
    -------
    list of dict
        ``points``; ``range_m`` (least, median, 99 % and largest); ``field_of_view_deg``:
        ``horizontal`` and the lower and upper end ``vertical``; ``beams`` (None where they cannot
        be told apart); ``spacing_deg``: between neighbouring points (median) along and across
        beams; ``same_ray``: share of the points that lie on the ray of another one;
        ``same_point``: share of them that are where it is.
    """
    result, kept = [], usable_points(sweep.points)
    for number, view in enumerate(lidar_views(sweep.points, sweep.sensor_rig)):
        origins = view.ray_origins()
        rays = view.points if origins is None else view.points - origins
        mine = kept & np.isfinite(view.points).all(axis=1)
        rays = rays[mine].astype(np.float64)
        if not len(rays):
            continue
        ranges = np.linalg.norm(rays, axis=1)
        azimuth, elevation = np.arctan2(rays[:, 1], rays[:, 0]), np.arcsin(rays[:, 2] / ranges)
        same_ray, same_point = shared_rays(azimuth, elevation, ranges)
        low, high = np.degrees(np.quantile(elevation, [_TAIL, 1 - _TAIL]))
        result.append(
            {
                "name": names[number] if number < len(names) else f"LiDAR {number}",
                "points": len(rays),
                "range_m": np.quantile(ranges, [0, 0.5, 0.99, 1]).round(2).tolist(),
                "field_of_view_deg": {
                    "horizontal": horizontal_field(azimuth),
                    "vertical": [round(float(low), 1), round(float(high), 1)],
                },
                "beams": _beams(
                    sweep,
                    mine,
                    view.lasers is not None,
                    azimuth[ranges > _FAR],
                    elevation[ranges > _FAR],
                ),
                "spacing_deg": spacing(rays.astype(np.float32)),
                "same_ray": round(same_ray, 4),
                "same_point": round(same_point, 4),
            }
        )
    return result


def _beams(
    sweep: Sweep,
    mine: NDArray[np.bool_],
    has_lasers: bool,
    azimuth: NDArray[np.float64],
    elevation: NDArray[np.float64],
) -> int | None:
    """By their numbers in the recording, by the lasers of the rig, or by elevation."""
    if sweep.ring is not None:
        count = len(np.unique(sweep.ring[mine]))
        if count > 1:
            return count
    if has_lasers and sweep.sensor_rig is not None:
        count = len(np.unique(sweep.sensor_rig.index[mine]))
        if count > 4:
            return count
    return beams_by_elevation(azimuth, elevation)


def horizontal_field(azimuth: NDArray[np.float64]) -> int:
    """Degrees of azimuth in which there are points; ``azimuth`` in radians."""
    counts = np.bincount(np.floor(np.degrees(azimuth)).astype(int) % 360, minlength=360)
    seen = counts > _FEW_IN_A_DEGREE * np.median(counts[counts > 0])
    return int(seen.sum())


def beams_by_elevation(azimuth: NDArray[np.float64], elevation: NDArray[np.float64]) -> int | None:
    """Number of beams, counted as peaks of the elevations; None where there are none.

    Motion compensation moves each side of the beams another way: then the number is that of most
    sectors.

    Parameters
    ----------
    azimuth, elevation : ndarray of float64, shape (N,)
        Radians.
    """
    count, valley = _peaks(elevation)
    if valley > _SHARP:
        sectors = np.floor(azimuth * _SECTORS / (2 * np.pi)).astype(np.int64) % _SECTORS
        found = [_peaks(elevation[sectors == sector]) for sector in range(_SECTORS)]
        told_apart = [peaks for peaks, valley in found if valley < _VALLEY]
        count = int(np.bincount(told_apart).argmax()) if told_apart else 0
    return count if 1 < count <= _MOST_BEAMS else None


def _peaks(elevation: NDArray[np.float64]) -> tuple[int, float]:
    """Number of peaks of elevations, and the valleys between them as a share of these (median)."""
    if len(elevation) < _FEWEST_POINTS:
        return 0, 1.0
    degrees = np.degrees(elevation)
    bins = np.arange(degrees.min() - 1, degrees.max() + 1, _BIN_DEG)
    counts = np.histogram(degrees, bins)[0].astype(np.float64)
    reach = round(3 * _SMOOTH_DEG / _BIN_DEG)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) * _BIN_DEG / _SMOOTH_DEG) ** 2)
    smooth = np.convolve(counts, kernel / kernel.sum(), "same")
    inner = smooth[1:-1]
    peaks = 1 + np.flatnonzero((inner > smooth[:-2]) & (inner >= smooth[2:]))
    if len(peaks) < 2:
        return 0, 1.0
    high = np.quantile(smooth[peaks], 0.8)
    peaks = peaks[smooth[peaks] > _PEAK * high]
    valleys = [smooth[a:b].min() for a, b in pairwise(peaks)]
    beside = np.minimum(smooth[peaks[:-1]], smooth[peaks[1:]])
    return len(peaks), float(np.median(valleys / beside)) if len(valleys) else 1.0


def spacing(rays: NDArray[np.float32]) -> list[float] | None:
    """Degrees between neighbouring points (median): along beams, and across them.

    These are the shortest and the middle side of the triangles of the sweep's mesh.
    """
    mesh = ScanMesh(rays)
    corners = mesh.triangles[~mesh.discontinuity].astype(np.int64)
    if not len(corners):
        return None
    units = rays.astype(np.float64)
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    a, b, c = np.moveaxis(units[corners], 1, 0)
    chords = np.sort([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    shortest, middle = np.degrees(2 * np.arcsin(np.median(chords[:2], axis=1) / 2))
    return [round(float(shortest), 3), round(float(middle), 3)]


def shared_rays(
    azimuth: NDArray[np.float64], elevation: NDArray[np.float64], ranges: NDArray[np.float64]
) -> tuple[float, float]:
    """Share of the points that lie on the ray of another one, and of those that are where it is.

    A LiDAR that records two returns measures two points along one ray.

    Parameters
    ----------
    azimuth, elevation : ndarray of float64, shape (N,)
        Radians.
    ranges : ndarray of float64, shape (N,)
        Metres.
    """
    step = np.radians(_SAME_RAY_DEG)
    cells = np.rint(azimuth / step).astype(np.int64) * 2**32 + np.rint(elevation / step).astype(
        np.int64
    )
    order = np.lexsort((ranges, cells))
    same = np.diff(cells[order]) == 0
    one = same & (np.diff(ranges[order]) < _SAME_PLACE)
    on_shared: NDArray[np.bool_] = np.zeros(len(cells), np.bool_)
    on_shared[1:] |= same
    on_shared[:-1] |= same
    return float(on_shared.mean()), float(one.mean()) if len(one) else 0.0


_CLOSE = 0.5  # metres; nearer points are of the LiDAR itself


def row_shares(points: NDArray[np.float32]) -> dict[str, float]:
    """Shares of the rows of a sweep: not finite, at the origin, close to it, in one other place.

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
