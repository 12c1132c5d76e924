"""Where the rays of a sweep begin, found by what makes neighbours of its returns.

Returns that are neighbours as seen from the LiDAR lie on one surface. Seen from elsewhere, near and
far returns are mixed, and some are lonely. Of two places between which that hardly decides, as of
one above the other, the one is taken from which rays are evenly spaced, or that is nearer to the
origin.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.datasets.base import Dataset
from docdepth.datasets.merged_lidars import Cloud, Place, find_lidars, lidar_ends, rig_in_order
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.points import usable_points
from docdepth.geometry.scan_mesh import share_in_triangles

LEAST_IN_TRIANGLES = 0.75
"""Share of returns with neighbours: 0.94 to 0.98, and 0.38 to 0.70 from 1.9 m beside the LiDAR."""

_ALWAYS_LONELY = 0.01  # share of returns that nothing is known of
_PER_METRE, _PER_SPREAD = 0.06, 0.25  # fewer lonely returns, relatively, make up for them
_RAYS, _NEAREST = 1500, 1.0  # that are asked for the ray next to them; metres
_ORIGIN = (0.0, 0.0, 0.0)
_LESS_LONELY = 0.8  # times the lonely returns of one mesh: then there are several LiDARs
_SAMPLES, _FEWEST = 2, 500  # sweeps, and points of one; fewer tell nothing
_HEIGHTS = (0.0, 1.0, 2.0)  # metres above the origin, where a search may start
_STEPS = (1.0, 0.5, 0.25, 0.1)  # metres
_FARTHEST = 4.0  # metres from the origin along each axis: no LiDAR sits farther from its vehicle's


class SensorOrigin(NamedTuple):
    """Where the LiDARs of a sweep are, in the frame of its points."""

    places: list[Place]  # x, y, z in metres. Of several LiDARs, in the order of their returns
    share: float  # of the returns that have neighbours, seen from there
    at_origin: float  # the same, seen from the origin


def estimate_sensor_origin(recording: Dataset) -> SensorOrigin | None:
    """The place from which fewest returns are lonely, if the origin clearly is not it.

    Where returns of several LiDARs lie one after the other, there are several places. They hide
    each other: even from one place they are less lonely in meshes of their own. Parts of what one
    LiDAR measured are not.

    Returns
    -------
    SensorOrigin or None
        None if returns have neighbours as seen from the origin, or if the recording tells where its
        rays begin.
    """
    if recording.sweep(0).sensor_rig is not None:
        return None
    clouds = []
    for k in sorted({int(k) for k in np.linspace(0, len(recording) - 1, _SAMPLES + 2)[1:-1]}):
        measured = recording.sweep(k).points
        points = np.ascontiguousarray(measured[usable_points(measured)])
        clouds += [points] if len(points) > _FEWEST else []
    if not clouds:
        return None
    at_origin = _share(clouds, _ORIGIN)
    if at_origin >= LEAST_IN_TRIANGLES:
        return None
    place = _best_place(clouds)
    best = SensorOrigin([place], _share(clouds, place), at_origin)
    places = find_lidars(clouds, place) if len(clouds) == _SAMPLES else [place]
    if len(places) == 1:
        return best
    ends = [lidar_ends(cloud, places) for cloud in clouds]
    one_place = _share_apart(clouds, [place] * len(places), ends)
    apart = _share_apart(clouds, places, ends)
    lonely = _LESS_LONELY * (1 - best.share)
    if 1 - one_place < lonely and 1 - apart < lonely:
        return SensorOrigin(places, apart, at_origin)
    return best


def _share_apart(clouds: list[Cloud], places: list[Place], ends: list[NDArray[np.intp]]) -> float:
    """Share of returns that have neighbours in the meshes of several LiDARs."""
    shares = [
        share_in_triangles(cloud, rig_in_order(places, own))
        for cloud, own in zip(clouds, ends, strict=True)
    ]
    return float(np.mean(shares))


def _best_place(clouds: list[Cloud]) -> Place:
    """By steps that become finer, from the best of some places above the origin."""
    known: dict[Place, float] = {}
    place = min(((0.0, 0.0, z) for z in _HEIGHTS), key=lambda p: _known(clouds, p, known))
    for step in _STEPS:
        while True:
            ways = itertools.product(range(3), (-step, step))
            around = [_moved(place, axis, by) for axis, by in ways]
            best = min(around, key=lambda p: _known(clouds, p, known))
            if known[best] >= _known(clouds, place, known) or np.abs(best).max() > _FARTHEST:
                break
            place = best
    return place


def _moved(place: Place, axis: int, by: float) -> Place:
    x, y, z = (round(value + by * (k == axis), 3) for k, value in enumerate(place))
    return x, y, z


def _known(clouds: list[Cloud], place: Place, known: dict[Place, float]) -> float:
    """Logarithm of the share of lonely returns, and a little for what decides between equals."""
    if place not in known:
        lonely = 1 - _share(clouds, place) + _ALWAYS_LONELY
        spread = float(np.mean([_spread(cloud, place) for cloud in clouds]))
        little = _PER_SPREAD * spread + _PER_METRE * float(np.linalg.norm(place))
        known[place] = float(np.log(lonely)) + little
    return known[place]


def _share(clouds: list[Cloud], place: Place) -> float:
    shares = [share_in_triangles(c, SensorRig.single(place, len(c))) for c in clouds]
    return float(np.mean(shares))


def _spread(cloud: Cloud, place: Place) -> float:
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
