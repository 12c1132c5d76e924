"""The own vehicle: returns that stay in their place of the LiDAR's frame while the world goes by.

A few sweeps are read, spread over the drive, each with the one after it. Registration of the two
tells how fast the vehicle was: sweeps count that are metres apart on its way, so a vehicle that
stands gives no evidence. Traffic that keeps its distance does so to decimetres, the vehicle itself
to centimetres. What reaches farther than a vehicle is a wall or a rail along a straight way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.datasets import Dataset, Sweep, usable_points
from docdepth.datasets.views import in_boxes
from docdepth.geometry.ground_plane import GroundPlane, find_ground, level_turn
from docdepth.geometry.points import evenly
from docdepth.io.inputs import Box
from docdepth.odometry.registration import FEWEST_POINTS, Registration

_SAMPLES = 10  # sweeps of a drive
_FEWEST, _APART, _PATH = 6, 1.0, 10.0
"""So many sweeps count at least, so many metres apart, on a path so long. On a shorter one a
straight wall stays, too."""

_REGISTERED = (3.0, 40.0)  # metres; nearer returns may be of the vehicle
_THINNED, _VOXEL, _SAMPLING, _NEIGHBORS = 0.25, 3.0, 0.5, 20
"""Metres. Voxels of 3 m take motions of 2 m from standstill, and are right to a decimetre."""
_MOVING = 0.1  # metres from one sweep to the next

_REACH, _BESIDE = 10.0, 3.0  # metres from a LiDAR along the way and beside it: a vehicle's
_AROUND = 15.0  # metres; of what is looked at
_ABOVE_GROUND = 0.3  # metres; rings on the ground stay with the LiDAR, too
_BELOW_GROUND = 0.5  # metres; nothing lies there but mirror images
_STAYS, _OFTEN = 0.05, 0.8  # metres from a return in such a share of the other sweeps
_NOISE, _AT_TIMES = 0.1, 0.5  # the same at the edges of what stays, where returns come and go
_LINK = 0.5  # metres between returns of one part of the vehicle
_FIRM = 0.3  # share of the returns of a part that stay: 0.5 to 1, of a follower's 0.01
_FEWEST_RETURNS = 5  # a sweep
_WORLD_STAYS, _ASKED = 0.1, 1000
"""Share of the returns beyond the vehicle, and how many of a sweep are asked. If more stay, it
stood, or drove along one wall."""

Cloud = NDArray[np.float32]


@dataclass(frozen=True)
class OwnVehicle:
    """Where a LiDAR sees the vehicle that carries it.

    Attributes
    ----------
    boxes : tuple of ((x, x), (y, y), (z, z))
        Least and greatest coordinates of its parts and their mirror images, metres in the LiDAR
        frame.
    returns : int
        In the boxes, in a sweep, on average.
    reach : float
        Metres of the farthest from the nearest LiDAR.
    mirrored : bool
        Whether mirror images below the ground are among them.
    """

    boxes: tuple[Box, ...]
    returns: int
    reach: float
    mirrored: bool


def find_own_vehicle(recording: Dataset) -> OwnVehicle | None:
    """What a drive shows of the own vehicle; None if it shows none, or if the vehicle stands.

    Parameters
    ----------
    recording : Dataset
        Twenty of its sweeps are read at most. In motion compensated sweeps the vehicle is smeared
        along its path; it is found where its speed is nearly the same in all of them.
    """
    if len(recording) <= _FEWEST:
        return None
    sampled = evenly(len(recording) - 1, _SAMPLES)
    clouds, pairs = [], []
    for k in sampled:
        sweep = recording.sweep(k)
        clouds.append(sweep.points[usable_points(sweep.points)])
        pairs.append((_thinned(sweep), _thinned(recording.sweep(k + 1))))
    ground = find_ground(clouds[::2])
    if ground is None:
        return None
    turn = level_turn(ground.up).T
    motions = np.array([_motion(*(cloud @ turn for cloud in pair)) for pair in pairs])
    ahead = np.linalg.svd(motions)[2][0] @ turn.T
    times = np.asarray(recording.times * 1e-9, np.float64)
    metres: NDArray[np.float64] = np.linalg.norm(motions, axis=1)
    speeds = np.where(metres > _MOVING, metres, 0) / (times[np.array(sampled) + 1] - times[sampled])
    chosen = sweeps_on_the_way(times[sampled], speeds)
    lidars = [lidar.T_lidar_sensor[:3, 3] for lidar in recording.lidars.values()]
    places = np.array(lidars or [np.zeros(3)])
    return vehicle_of([clouds[k] for k in chosen], ground, places, ahead)


def _thinned(sweep: Sweep) -> NDArray[np.float64]:
    times = np.zeros(len(sweep.points), np.float32)
    points = np.ascontiguousarray(sweep.points)
    return _core.thin_sweep(points, times, _THINNED, *_REGISTERED)[0].astype(np.float64)


def _motion(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres (3,) from one sweep to the next, z up; zeros where that cannot be told.

    Registration starts from standstill. Where it fails, it stays near there.
    """
    if min(len(first), len(second)) < FEWEST_POINTS:
        return np.zeros(3)
    registration, start = Registration(_VOXEL, _SAMPLING, _NEIGHBORS, 1), np.eye(4)
    registration.take(first.astype(np.float32), start)
    registration.insert(start)
    registration.take(second.astype(np.float32), start)
    return registration.align(start).pose[:3, 3]


def sweeps_on_the_way(times: NDArray[np.float64], speeds: NDArray[np.float64]) -> list[int]:
    """Which of some sweeps are metres apart on the way of the vehicle; none if there are few.

    Parameters
    ----------
    times : ndarray of float64, shape (n,)
        Seconds.
    speeds : ndarray of float64, shape (n,)
        Metres a second. Between two sweeps the vehicle drives at the lower of theirs at least.
    """
    steps = np.minimum(speeds[1:], speeds[:-1]) * np.diff(times)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    chosen = [0]
    for k in range(1, len(path)):
        if path[k] - path[chosen[-1]] >= _APART:
            chosen.append(k)
    return chosen if len(chosen) >= _FEWEST and path[-1] >= _PATH else []


def vehicle_of(
    clouds: Sequence[Cloud],
    ground: GroundPlane,
    lidars: NDArray[np.float64],
    ahead: NDArray[np.float64],
) -> OwnVehicle | None:
    """The returns that stay in their place from sweep to sweep.

    Parameters
    ----------
    clouds : sequence of ndarray of float32, shape (N, 3)
        Usable points of sweeps from different places.
    lidars : ndarray of float64, shape (k, 3)
        Where the LiDARs are.
    ahead : ndarray of float64, shape (3,)
        Unit vector along the way, forwards or backwards.
    """
    if not clouds:
        return None
    left = np.cross(ground.up, ahead)[:, None]

    def beside(points: Cloud) -> NDArray[np.float64]:
        return _distance(points @ left, lidars @ left)

    around = [_off_ground(cloud, ground, lidars) for cloud in clouds]
    if _world_stays([cloud[_distance(cloud, lidars) > _REACH] for cloud in around]):
        return None
    around = [cloud[beside(cloud) < _BESIDE + _LINK] for cloud in around]
    firm = _staying(around, around, _STAYS, _OFTEN)
    staying = np.concatenate([c[rows] for c, rows in zip(around, firm, strict=True)])
    if len(staying) < _FEWEST_RETURNS * len(around):
        return None
    found = [_whole(part, around) for part in _parts(staying)]
    parts = [
        p
        for p in found
        if len(p) and _distance(p, lidars).max() <= _REACH and beside(p).max() <= _BESIDE
    ]
    if not parts:
        return None
    boxes = tuple(_box_around(part) for part in parts)
    returns = sum(int(in_boxes(cloud, boxes).sum()) for cloud in clouds) / len(clouds)
    reach = max(float(_distance(part, lidars).max()) for part in parts)
    mirrored = any((part @ ground.up + ground.height < 0).any() for part in parts)
    return OwnVehicle(boxes, round(returns), round(reach, 1), mirrored)


def _world_stays(beyond: Sequence[Cloud]) -> bool:
    """Whether much stays that is farther away than the vehicle reaches."""
    asked = [cloud[:: max(1, len(cloud) // _ASKED)] for cloud in beyond]
    stay = np.concatenate(_staying(asked, beyond, _STAYS, _OFTEN))
    return bool(stay.sum() > _WORLD_STAYS * len(stay))


def _whole(part: Cloud, around: Sequence[Cloud]) -> Cloud:
    """A part with what adjoins it and comes and goes, as returns at edges do.

    None of it if most returns there do not stay: on what keeps its distance a few do, by chance.
    """
    wide = [_box_around(part, _LINK)]
    near = [cloud[in_boxes(cloud, wide)] for cloud in around]
    rows = _staying(near, around, _NOISE, _AT_TIMES)
    whole = np.concatenate([part, *(c[r] for c, r in zip(near, rows, strict=True))])
    box = [_box_around(whole)]
    returns = sum(int(in_boxes(cloud, box).sum()) for cloud in around)
    is_firm = len(part) >= len(around) and len(part) > _FIRM * returns
    return whole if is_firm else whole[:0]


def _off_ground(cloud: Cloud, ground: GroundPlane, lidars: NDArray[np.float64]) -> Cloud:
    """Points near the LiDARs that are not on the ground."""
    high = cloud @ ground.up.astype(np.float32) + ground.height
    off = (high > _ABOVE_GROUND) | (high < -_BELOW_GROUND)
    return cloud[off & (_distance(cloud, lidars) < _AROUND)]


def _distance(points: NDArray[Any], lidars: NDArray[np.float64]) -> NDArray[np.float64]:
    """From the nearest LiDAR, (N,)."""
    return np.min([np.linalg.norm(points - lidar, axis=1) for lidar in lidars], axis=0)


def _staying(
    asked: Sequence[Cloud], clouds: Sequence[Cloud], within: float, share: float
) -> list[NDArray[np.bool_]]:
    """Which points of each sweep have one ``within`` metres in a ``share`` of the others."""
    few = int((1 - share) * (len(clouds) - 1) + 1e-9)  # sweeps in which it may be missing
    missed = [np.zeros(len(points), np.int64) for points in asked]
    for k, cloud in enumerate(clouds):
        tree = _Tree(cloud)
        for other, (points, misses) in enumerate(zip(asked, missed, strict=True)):
            if other != k:
                left = np.flatnonzero(misses <= few)
                misses[left] += tree.squared(points[left]) > within**2
    return [misses <= few for misses in missed]


class _Tree:
    """Distances to the nearest point of a cloud."""

    def __init__(self, cloud: Cloud) -> None:
        import small_gicp

        self._tree = small_gicp.KdTree(cloud.astype(np.float64), 1) if len(cloud) else None

    def squared(self, points: Cloud) -> NDArray[np.float64]:
        """Of each point (N, 3), square metres, (N,)."""
        if self._tree is None or not len(points):
            return np.full(len(points), np.inf)
        return np.asarray(self._tree.batch_nearest_neighbor_search(points.astype(float), 1)[1])


def _parts(points: Cloud) -> list[Cloud]:
    """Points divided where there are gaps."""
    cells, of_cell = np.unique(np.floor(points / _LINK).astype(int), axis=0, return_inverse=True)
    left = {tuple(cell): k for k, cell in enumerate(cells.tolist())}
    part_of = np.zeros(len(cells), np.int64)
    around = np.argwhere(np.ones((3, 3, 3))) - 1
    count = 0
    while left:
        reached = [left.popitem()]
        for cell, k in reached:  # grows meanwhile
            part_of[k] = count
            for other in map(tuple, (around + cell).tolist()):
                if other in left:
                    reached.append((other, left.pop(other)))
        count += 1
    part = part_of[of_cell.ravel()]
    return [points[part == k] for k in range(count)]


def _box_around(points: Cloud, margin: float = _NOISE) -> Box:
    low = np.floor(100 * (points.min(axis=0) - margin)) / 100
    high = np.ceil(100 * (points.max(axis=0) + margin)) / 100
    x, y, z = np.stack([low, high], axis=1).astype(np.float64).round(2).tolist()
    return tuple(x), tuple(y), tuple(z)
