"""How LiDARs sit: which way is up, where rays begin, and recordings turned so that z is up."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import docdepth._core as _core
from docdepth.datasets.base import Dataset, LidarStream, Sweep
from docdepth.datasets.files import readable
from docdepth.datasets.merged_lidars import Cloud, Place, find_lidars, lidar_ends, rig_in_order
from docdepth.datasets.views import RecordingView
from docdepth.geometry.ground_plane import GroundPlane, find_ground, level_turn
from docdepth.geometry.lidar_frame import SensorRig
from docdepth.geometry.points import evenly, usable_points
from docdepth.geometry.scan_mesh import share_in_triangles
from docdepth.geometry.se3 import inverse

LEVEL_DEG = 6.0
"""Frames whose z is nearer to up stay as they are: vehicles pitch and roads slope by as much."""

_GROUND_SWEEPS = 12  # sweeps of a drive that tell where its ground is
_SAMPLES = 3  # sweeps that tell in which frame returns have neighbours


def ground_of(
    recording: Dataset, rotations: NDArray[np.float64] | None = None
) -> GroundPlane | None:
    """The ground around the LiDAR of a drive, by some of its sweeps; None if they do not agree.

    ``rotations`` (n, 3, 3) take each sweep's points into the frame that the ground is wanted in;
    it is the LiDAR frame if they are left out.
    """
    clouds = []
    for k in evenly(len(recording), _GROUND_SWEEPS):
        points = recording.sweep(k).points
        points = points[usable_points(points)]
        clouds.append(points if rotations is None else points @ rotations[k].T.astype(np.float32))
    return find_ground(clouds)


class LevelledRecording(RecordingView):
    """A recording with what was found of the mount of its LiDAR.

    Its LiDAR frame is turned so that z is up: points, poses, extrinsics of cameras and places of
    LiDARs belong to the turned frame. Rows and their times stay.

    Parameters
    ----------
    up : array_like, shape (3,), optional
        Unit vector that points up, LiDAR frame of the recording. Without it nothing is turned.
    sensor_origin : array_like, shape (3,) or (k, 3), optional
        Where the rays of the LiDAR begin, metres in the LiDAR frame of the recording; of several
        LiDARs, in the order of their returns in a sweep.

    Attributes
    ----------
    T_level_lidar : ndarray of float64, shape (4, 4)
        Takes points from the LiDAR frame of the recording to the turned one.
    """

    def __init__(
        self, tilted: Dataset, up: ArrayLike | None = None, sensor_origin: ArrayLike | None = None
    ) -> None:
        super().__init__(tilted)
        self._up = up
        places = np.array([] if sensor_origin is None else sensor_origin, np.float64).reshape(-1, 3)
        self._places: list[Place] = [(x, y, z) for x, y, z in places.tolist()]
        self._lidar_ends: dict[int, NDArray[np.intp]] = {}
        self.T_level_lidar = np.eye(4)
        if up is not None:
            self.T_level_lidar[:3, :3] = level_turn(up)
        self._back = inverse(self.T_level_lidar)
        self.cameras = {
            name: replace(stream, T_camera_lidar=stream.T_camera_lidar @ self._back)
            for name, stream in tilted.cameras.items()
        }

    @cached_property
    def partial_poses(self) -> NDArray[np.float64] | None:
        """Poses of the turned frame."""
        known = super().partial_poses
        return None if known is None else known @ self._back

    def _lidar(self, lidar: LidarStream) -> LidarStream:
        """The first one leans in the turned frame."""
        return replace(lidar, T_lidar_sensor=self.T_level_lidar @ lidar.T_lidar_sensor)

    def sweep(self, index: int) -> Sweep:
        """Sweep ``index``, turned."""
        sweep = super().sweep(index)
        if self._places and sweep.sensor_rig is None:
            sweep = replace(sweep, sensor_rig=self._rig(index, sweep.points))
        return sweep if self._up is None else self._turned(sweep, self._leans)

    def _rig(self, index: int, points: NDArray[np.float32]) -> SensorRig:
        """Which LiDAR measured each point; it is found once for each sweep."""
        if len(self._places) == 1:
            return SensorRig.single(self._places[0], len(points))
        if index not in self._lidar_ends:
            self._lidar_ends[index] = lidar_ends(points, self._places)
        return rig_in_order(self._places, self._lidar_ends[index])

    def _turned(self, sweep: Sweep, leans: bool) -> Sweep:
        points = sweep.points.astype(np.float64) @ self.T_level_lidar[:3, :3].T
        rig = sweep.sensor_rig
        if rig is None and leans:
            rig = SensorRig.single((0, 0, 0), len(points))
        if rig is not None:
            rig = replace(rig, T_lidar_sensor=self.T_level_lidar @ rig.T_lidar_sensor)
        return replace(sweep, points=points.astype(np.float32), sensor_rig=rig)

    @cached_property
    def _leans(self) -> bool:
        """Whether the LiDAR itself leans, and not only the frame its points are given in.

        Its mesh is drawn around the axis about which it turns: around another one, returns near the
        poles lack neighbours.
        """
        shares = np.zeros(2)
        wanted = evenly(len(self), _SAMPLES)
        for sweep in readable(self.whole.sweep, wanted, len(self)).values():
            usable = usable_points(sweep.points)
            for leans in (False, True):
                turned = self._turned(sweep, leans)
                rig = turned.sensor_rig
                rig = None if rig is None else rig.select(usable)
                points = np.ascontiguousarray(turned.points[usable])
                shares[int(leans)] += share_in_triangles(points, rig)
        return bool(shares[1] > shares[0])


LEAST_IN_TRIANGLES = 0.75
"""Share of returns with neighbours: 0.94 to 0.98, and 0.38 to 0.70 from 1.9 m beside the LiDAR."""

_ALWAYS_LONELY = 0.01  # share of returns that nothing is known of
_PER_METRE, _PER_SPREAD = 0.06, 0.25  # fewer lonely returns, relatively, make up for them
_RAYS, _NEAREST = 1500, 1.0  # that are asked for the ray next to them; metres
_OF_RING, _ON_CIRCLES = 100, 0.002
"""Points of a ring that are asked; how far their directions may be from a plane: those of sweeps
that are compensated for motion are farther."""
_ORIGIN = (0.0, 0.0, 0.0)
_LESS_LONELY = 0.8  # times the lonely returns of one mesh: then there are several LiDARs
_ORIGIN_SAMPLES, _FEWEST = 2, 500  # sweeps, and points of one; fewer tell nothing
_HEIGHTS = (0.0, 1.0, 2.0)  # metres above the origin, where a search may start
_STEPS = (1.0, 0.5, 0.25, 0.1)  # metres
_FINE_STEPS = (*_STEPS, 0.05, 0.02)
_AXES = np.concatenate([np.eye(3), -np.eye(3)])
_ALL_WAYS = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=3)))
_FARTHEST = 4.0  # metres from the origin along each axis: no LiDAR sits farther from its vehicle's


class SensorOrigin(NamedTuple):
    """Where the LiDARs of a sweep are, in the frame of its points."""

    places: list[Place]  # x, y, z in metres. Of several LiDARs, in the order of their returns
    share: float  # of the returns that have neighbours, seen from there
    at_origin: float  # the same, seen from the origin


def estimate_sensor_origin(recording: Dataset) -> SensorOrigin | None:
    """The place from which fewest returns are lonely, if the origin clearly is not it.

    Returns that are neighbours as seen from the LiDAR lie on one surface. Seen from elsewhere, near
    and far returns are mixed, and some are lonely. Of two places between which that hardly decides,
    as of one above the other, the one is taken from which rays are evenly spaced, or that is nearer
    to the origin.

    Where returns of several LiDARs lie one after the other, there are several places. They hide
    each other: even from one place they are less lonely in meshes of their own. Parts of what one
    LiDAR measured are not.

    If points have ring numbers, these decide: the directions of a ring lie on a circle as seen from
    the LiDAR, and from nowhere else. Rings of several LiDARs do not, nor do lines that no mirror
    turns on a cone.

    Returns
    -------
    SensorOrigin or None
        None if returns have neighbours as seen from the origin, or if the recording tells where its
        rays begin.
    """
    if recording.sweep(0).sensor_rig is not None:
        return None
    clouds, rings = [], []
    for k in sorted(
        {int(k) for k in np.linspace(0, len(recording) - 1, _ORIGIN_SAMPLES + 2)[1:-1]}
    ):
        sweep = recording.sweep(k)
        usable = usable_points(sweep.points)
        if usable.sum() > _FEWEST:
            clouds.append(np.ascontiguousarray(sweep.points[usable]))
            rings += [] if sweep.ring is None else _rings(clouds[-1], sweep.ring[usable])
    if not clouds:
        return None
    at_origin = _share(clouds, _ORIGIN)
    if at_origin >= LEAST_IN_TRIANGLES:
        return None
    if rings:
        circles = np.stack(rings).astype(np.float64)
        place = _best_place(lambda place: _off_circles(circles, place), _FINE_STEPS, _ALL_WAYS)
        if _off_circles(circles, place) < _ON_CIRCLES:
            return SensorOrigin([place], _share(clouds, place), at_origin)
    place = _best_place(lambda place: _lonely_cost(clouds, place), _STEPS, _AXES)
    best = SensorOrigin([place], _share(clouds, place), at_origin)
    places = find_lidars(clouds, place) if len(clouds) == _ORIGIN_SAMPLES else [place]
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


def _best_place(
    value: Callable[[Place], float], steps: Sequence[float], ways: NDArray[np.float64]
) -> Place:
    """Where the value is least, by steps that become finer, from the best of some places."""
    known = cache(value)
    place = min(((0.0, 0.0, z) for z in _HEIGHTS), key=known)
    for step in steps:
        while True:
            around = (np.array(place) + step * ways).round(3)
            best = min(((x, y, z) for x, y, z in around.tolist()), key=known)
            if known(best) >= known(place) or np.abs(best).max() > _FARTHEST:
                break
            place = best
    return place


def _lonely_cost(clouds: list[Cloud], place: Place) -> float:
    """Logarithm of the share of lonely returns, and a little for what decides between equals."""
    lonely = 1 - _share(clouds, place) + _ALWAYS_LONELY
    spread = float(np.mean([_spread(cloud, place) for cloud in clouds]))
    little = _PER_SPREAD * spread + _PER_METRE * float(np.linalg.norm(place))
    return float(np.log(lonely)) + little


def _rings(cloud: Cloud, ring: NDArray[np.uint16]) -> list[Cloud]:
    """As many of the points of each ring, evenly spaced in it."""
    order = np.argsort(ring, kind="stable")
    of_rings = np.split(cloud[order], np.flatnonzero(np.diff(ring[order])) + 1)
    return [own[np.linspace(0, len(own) - 1, _OF_RING).astype(int)] for own in of_rings]


def _off_circles(rings: NDArray[np.float64], place: Place) -> float:
    """How far directions are from the plane through those of their ring, root mean square."""
    rays = rings - place
    rays /= np.maximum(np.linalg.norm(rays, axis=2, keepdims=True), _NEAREST)
    rays -= rays.mean(axis=1, keepdims=True)
    off = np.linalg.eigvalsh(rays.transpose(0, 2, 1) @ rays)[:, 0]
    return float(np.sqrt(np.maximum(off, 0).mean() / _OF_RING))


def _share(clouds: list[Cloud], place: Place) -> float:
    shares = [share_in_triangles(c, SensorRig.single(place, len(c))) for c in clouds]
    return float(np.mean(shares))


def _spread(cloud: Cloud, place: Place) -> float:
    """Spread of the angle from a ray to the next one, as the logarithm of its quartiles' ratio."""
    rays = cloud - np.array(place, np.float32)
    ranges = np.linalg.norm(rays, axis=1)
    rays = rays[ranges > _NEAREST] / ranges[ranges > _NEAREST, None]
    asking = np.zeros(len(rays), np.bool_)
    asking[:: max(2, -(-len(rays) // _RAYS))] = True
    angles = _core.nearest_neighbors(
        np.ascontiguousarray(rays[~asking]), np.ascontiguousarray(rays[asking]), 1
    )[1]
    low, high = np.quantile(angles, [0.25, 0.75])
    return float(np.log(max(high, 1e-6) / max(low, 1e-6)))
