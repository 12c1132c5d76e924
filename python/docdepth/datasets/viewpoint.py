"""Where the rays of a sweep begin, found by what makes neighbours of its returns."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.datasets.base import Dataset
from docdepth.geometry.points import usable_points
from docdepth.geometry.scan_mesh import share_in_triangles
from docdepth.geometry.sensor_rig import SensorRig

LEAST_IN_TRIANGLES = 0.75
"""Share of returns with neighbours: 0.94 to 0.98, and 0.38 to 0.70 from 1.9 m beside the LiDAR."""

_RAYS, _NEAREST = 1500, 1.0  # that are asked for the ray next to them; metres
_SAMPLES, _FEWEST = 2, 500  # sweeps, and points of one; fewer tell nothing
_HEIGHTS = (0.0, 1.0, 2.0)  # metres above the origin, where a search may start
_STEPS = (1.0, 0.5, 0.25, 0.1)  # metres
_FARTHEST = 4.0  # metres from the origin along each axis: no LiDAR sits farther from its vehicle's


class Viewpoint(NamedTuple):
    """Where a LiDAR is in the frame of its points.

    Attributes
    ----------
    place : tuple of float
        x, y, z in metres.
    share : float
        Of the returns that have neighbours, seen from there.
    at_origin : float
        The same, seen from the origin.
    """

    place: tuple[float, float, float]
    share: float
    at_origin: float


def find_viewpoint(recording: Dataset) -> Viewpoint | None:
    """The place from which most returns have neighbours, if the origin clearly is not it.

    Returns that are neighbours as seen from the LiDAR lie on one surface. Seen from elsewhere, near
    and far returns are mixed; from above that shows little, but there the rays of a LiDAR are no
    longer evenly spaced.

    Returns
    -------
    Viewpoint or None
        None if returns have neighbours as seen from the origin, or if the recording tells where its
        rays begin.
    """
    clouds = []
    for k in sorted({int(k) for k in np.linspace(0, len(recording) - 1, _SAMPLES + 2)[1:-1]}):
        sweep = recording.sweep(k)
        if sweep.sensor_rig is not None:
            return None
        points = np.ascontiguousarray(sweep.points[usable_points(sweep.points)])
        clouds += [points] if len(points) > _FEWEST else []
    if not clouds:
        return None
    origin = (0.0, 0.0, 0.0)
    at_origin = _share(clouds, origin)
    if at_origin >= LEAST_IN_TRIANGLES:
        return None
    known: dict[tuple[float, float, float], float] = {}
    place = max(((0.0, 0.0, z) for z in _HEIGHTS), key=lambda p: _known(clouds, p, known))
    for step in _STEPS:
        while True:
            ways = itertools.product(range(3), (-step, step))
            around = [_moved(place, axis, by) for axis, by in ways]
            best = max(around, key=lambda p: _known(clouds, p, known))
            if known[best] <= _known(clouds, place, known) or np.abs(best).max() > _FARTHEST:
                break
            place = best
    return Viewpoint(place, _share(clouds, place), at_origin)


def _moved(place: tuple[float, float, float], axis: int, by: float) -> tuple[float, float, float]:
    x, y, z = (round(value + by * (k == axis), 3) for k, value in enumerate(place))
    return x, y, z


def _known(
    clouds: list[NDArray[np.float32]],
    place: tuple[float, float, float],
    known: dict[tuple[float, float, float], float],
) -> float:
    if place not in known:
        spread = np.mean([_spread(cloud, place) for cloud in clouds])
        known[place] = _share(clouds, place) - float(spread)
    return known[place]


def _share(clouds: list[NDArray[np.float32]], place: tuple[float, float, float]) -> float:
    shares = [share_in_triangles(c, SensorRig.single(place, len(c))) for c in clouds]
    return float(np.mean(shares))


def _spread(cloud: NDArray[np.float32], place: tuple[float, float, float]) -> float:
    """Spread of the angle from a ray to the next one, as the logarithm of its quartiles' ratio."""
    rays = cloud - np.array(place, np.float32)
    ranges = np.linalg.norm(rays, axis=1)
    rays = rays[ranges > _NEAREST] / ranges[ranges > _NEAREST, None]
    asking = np.zeros(len(rays), np.bool_)
    asking[:: -(-len(rays) // _RAYS)] = True
    angles = _core.nearest_neighbors(
        np.ascontiguousarray(rays[~asking]), np.ascontiguousarray(rays[asking]), 1
    )[1]
    low, high = np.quantile(angles, [0.25, 0.75])
    return float(np.log(max(high, 1e-6) / max(low, 1e-6)))
