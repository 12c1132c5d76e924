"""The first motion of a drive, sought among straight motions in all directions.

Registration that starts from standstill at the speed of a motorway finds a wrong motion and keeps
it. Between lorries it finds theirs, even if it starts from the right one. So straight motions are
tried first. The best one brings most points of the next sweeps onto surfaces of the first. Each
motion also deskews the sweeps: those of a rosette fit in no other way.

A LiDAR may be mounted with any side ahead, so all directions are tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.datasets.base import Sweep
from docdepth.odometry.deskewing import deskew
from docdepth.odometry.registration import FEWEST_POINTS, Registration, rising_rows
from docdepth.odometry.sweeps import SweepPart, ThinnedSweeps, motion_times

FIRST_SWEEPS = 4
"""Sweeps from which the first motion is found. A motorway is straight for so long."""

_COMPARED = 3  # of them, while the direction is sought; a street bends sooner
_DIRECTIONS = np.radians(np.arange(-180, 180, 10)).tolist()
_SPEEDS = np.arange(0, 5.1, 0.25).tolist()  # metres a sweep; 5 is 180 km/h at 10 sweeps a second
_BEST = 3  # directions around which finer steps are tried
_FINER_DIRECTIONS = np.radians([-5, -2.5, 0, 2.5, 5]).tolist()
_FINER_SPEEDS = np.arange(-0.1, 0.11, 0.05).tolist()
_AHEAD, _CLEARLY_MORE = np.radians(15), 1.2
"""As a rule x looks ahead. A direction farther from it than this angle has to fit so many times
better."""

_ON, _COARSELY_ON, _NEAR = 0.25, 0.5, 1.0
"""A point lies on a surface if it is within so many metres of its plane, and of a measured point.
The second is for coarse steps of speed and direction."""
_FAR_BETTER = 2.0
"""A motion by which so many times as many high points agree is right, and the other wrong. At 152
places of exact drives with lorries, the right motion never had less than 0.69 of the best."""
_ALIKE, _SIDE, _PEAK = 0.3, 1.0, 1.5
"""No other motion is sought if such a share of the points agrees, so many times more than by
motions so many metres to each side; along a tunnel those agree as well. Of what registration found
from standstill on exact motorways 0.00 to 0.08 agreed, of right motions 0.42 to 0.8."""
_STANDS = 0.25  # metres a sweep; a slower motion does not tell which side looks ahead
_NEIGHBORS = 10  # points from which the plane of a surface is taken
_SURFACE, _POINTS = 4000, 500  # points of the first sweep, and of each next one, at most

# Lorries at the vehicle's own speed, and rings on the road, fit best at standstill.
_COLUMN = 1.0  # metres, edge of the columns that tell the road from what rises above it
_HIGH = 3.0  # metres above the LiDAR, or 5 above the road: nothing that drives is higher
_ASIDE = 12.0  # metres from the path, three lanes

_VOXEL, _SAMPLING, _MAP_NEIGHBORS = 1.0, 0.5, 20  # metres, metres; for registration


class _Points(NamedTuple):
    """Points (N, 3) of a sweep, and their times (N,) in sweeps after the first stamp."""

    points: NDArray[np.float32]
    time: NDArray[np.float32]

    def moved(self, motion: NDArray[np.float64]) -> NDArray[np.float32]:
        """In the frame of the first sweep."""
        if (motion[:3, :3] == np.eye(3)).all():  # as deskewing does it; most of those tried are
            return self.points + self.time[:, None] * motion[:3, 3].astype(np.float32)
        return deskew(self.points, self.time, motion)

    def rows(self, chosen: NDArray[np.bool_] | NDArray[np.int64] | slice) -> _Points:
        return _Points(self.points[chosen], self.time[chosen])

    def fewer(self, most: int) -> _Points:
        """At most so many of the points."""
        return self.rows(slice(None, None, max(1, -(-len(self.points) // most))))


def first_motion(sweeps: ThinnedSweeps | SweepPart, indices: range) -> NDArray[np.float64] | None:
    """Motion (4, 4) in one sweep's duration at the first of these sweeps.

    Parameters
    ----------
    indices : range
        The first :data:`FIRST_SWEEPS` of them are read.

    Returns
    -------
    ndarray of float64, shape (4, 4), or None
        None if there are fewer than two sweeps, or too few of their points rise above the road.
    """
    found = _search(sweeps, indices)
    return None if found is None else found[0]


def checked_motion(
    sweeps: ThinnedSweeps | SweepPart, indices: range, motion: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """A motion, or the first motion of these sweeps if far more points agree with that.

    Only points that are higher than any lorry are asked.

    Parameters
    ----------
    motion : ndarray of float64, shape (4, 4)
        What is taken for the motion in one sweep's duration.

    Returns
    -------
    ndarray of float64, shape (4, 4), or None
        None if there are too few such points.
    """
    found = _search(sweeps, indices, only_high=True)
    if found is None:
        return None
    other, points = found
    far_better = _agreement(points, other) > _FAR_BETTER * _agreement(points, motion)
    return other if far_better else motion


def _search(
    sweeps: ThinnedSweeps | SweepPart, indices: range, only_high: bool = False
) -> tuple[NDArray[np.float64], list[_Points]] | None:
    """The first motion of these sweeps, and the points by which it was judged."""
    whole = _timed([sweeps[k] for k in indices[:FIRST_SWEEPS]])
    rising = [s.rows(rising_rows(s.points.astype(np.float64), _COLUMN)) for s in whole]
    if len(rising) < 2 or min(len(s.points) for s in rising) < FEWEST_POINTS:
        return None
    if only_high and min(np.count_nonzero(_high(s)) for s in rising) < FEWEST_POINTS:
        return None
    trusted = _beyond_traffic(rising)
    found = _from_standstill(whole, trusted)
    if found is not None:
        return found
    points, straight = _best_straight(trusted or dict.fromkeys(_DIRECTIONS, rising))
    tried = [np.eye(4), *straight]
    tried += [_registered(whole, start) for start in tried]
    return max(tried, key=partial(_agreement, points)), points


def _timed(sweeps: Sequence[Sweep]) -> list[_Points]:
    """The sweeps up to the first that holds too few points."""
    period = float(np.median(np.diff([sweep.time for sweep in sweeps]))) if len(sweeps) > 1 else 1.0
    timed = []
    for sweep in sweeps:
        if len(sweep.points) < FEWEST_POINTS:
            break
        time = np.full(len(sweep.points), (sweep.time - sweeps[0].time) / period, np.float32)
        late = motion_times(sweep)
        if late is not None:
            time += late
        # Points without a time are refused, by name, when the sweep is registered.
        timed.append(_Points(sweep.points, time).rows(np.isfinite(time)))
    return timed


def _high(sweep: _Points) -> NDArray[np.bool_]:
    high: NDArray[np.bool_] = sweep.points[:, 2] > _HIGH
    return high


def _beyond_traffic(rising: list[_Points]) -> dict[float, list[_Points]]:
    """For each direction, points where no vehicle drives along: high ones, and those far aside.

    Directions with too few of them are left out.
    """
    high = [_high(s) for s in rising]
    if min(map(np.count_nonzero, high)) >= FEWEST_POINTS:
        points = [s.rows(rows) for s, rows in zip(rising, high, strict=True)]
        return dict.fromkeys(_DIRECTIONS, points)
    trusted = {}
    for direction in _DIRECTIONS:
        path = 0.0 if abs(direction) <= _AHEAD else direction
        left = np.array([-np.sin(path), np.cos(path)])
        points = [
            s.rows(rows | (np.abs(s.points[:, :2] @ left) > _ASIDE))
            for s, rows in zip(rising, high, strict=True)
        ]
        if min(len(s.points) for s in points) >= FEWEST_POINTS:
            trusted[direction] = points
    return trusted


def _from_standstill(
    whole: list[_Points], trusted: dict[float, list[_Points]]
) -> tuple[NDArray[np.float64], list[_Points]] | None:
    """What registration finds that starts from standstill, if the points fit by no other motion.

    They do at the speeds of a city, and the search would take ten times as long.
    """
    motion = _registered(whole, _registered(whole, np.eye(4)))
    x, y = motion[:2, 3] if np.hypot(*motion[:2, 3]) > _STANDS else (1.0, 0.0)
    points = trusted.get(max(_DIRECTIONS, key=lambda d: x * np.cos(d) + y * np.sin(d)))
    if points is None:
        return None
    beside = np.repeat(motion[None], 4, axis=0)
    beside[:, :2, 3] += ((_SIDE, 0), (-_SIDE, 0), (0, _SIDE), (0, -_SIDE))
    others = max(_agreement(points, other) for other in beside)
    fits = _agreement(points, motion) > max(_ALIKE, _PEAK * others)
    return (motion, points) if fits else None


def _best_straight(
    trusted: dict[float, list[_Points]],
) -> tuple[list[_Points], list[NDArray[np.float64]]]:
    """The points that fit best, and the straight motions (4, 4) by which they do, best first."""
    best: list[tuple[float, float, float]] = []
    normals, seen = np.zeros((0, 3), np.float32), None
    for direction, points in trusted.items():
        if points is not seen:
            # Once for all coarse steps: they would take most of the time.
            normals, seen = _normals(points[0], np.eye(4)), points
        agreement = [
            _agreement(points[:_COMPARED], _straight(direction, speed), _COARSELY_ON, normals)
            for speed in _SPEEDS
        ]
        most = int(np.argmax(agreement))
        clearly = 1.0 if abs(direction) <= _AHEAD else _CLEARLY_MORE
        best.append((agreement[most] / clearly, direction, _SPEEDS[most]))
    best.sort(reverse=True)
    points, motions = trusted[best[0][1]], []
    for _, direction, speed in best[:_BEST]:
        finer = [
            _straight(direction + turn, speed + step)
            for turn in _FINER_DIRECTIONS
            for step in _FINER_SPEEDS
        ]
        motions.append(max(finer, key=partial(_agreement, points)))
    return points, motions


def _straight(direction: float, speed: float) -> NDArray[np.float64]:
    """Motion (4, 4) of so many metres a sweep, towards an angle from x to y."""
    motion = np.eye(4)
    motion[:2, 3] = speed * np.cos(direction), speed * np.sin(direction)
    return motion


def _agreement(
    sweeps: list[_Points],
    motion: NDArray[np.float64],
    on: float = _ON,
    normals: NDArray[np.float32] | None = None,
) -> float:
    """Share of the points of the next sweeps that lie on surfaces of the first, by a motion."""
    first, *others = sweeps
    surface = first.fewer(_SURFACE).moved(motion)
    if normals is None:
        normals = _normals(first, motion)
    points = [sweep.fewer(_POINTS).moved(motion) for sweep in others]
    together = np.concatenate(points)  # one tree for all of them: it takes most of the time
    rows, distance = _core.nearest_neighbors(surface, together, 1)
    off = np.abs(np.einsum("ij,ij->i", normals[rows], together - surface[rows]))
    known = normals[rows].any(axis=1)
    agree = (known & (distance < _NEAR)) * np.clip(1 - off / on, 0, None)
    ends = np.cumsum([len(p) for p in points])[:-1]
    return float(np.mean([share.mean() for share in np.split(agree, ends)]))


def _normals(first: _Points, motion: NDArray[np.float64]) -> NDArray[np.float32]:
    """Normals (N, 3) of the surfaces that a sweep shows, by a motion."""
    return _core.OrientedPoints(first.fewer(_SURFACE).moved(motion), _NEIGHBORS, 1).normals


def _registered(sweeps: list[_Points], motion: NDArray[np.float64]) -> NDArray[np.float64]:
    """What registration of the second sweep on the first makes of a motion."""
    registration, start = Registration(_VOXEL, _SAMPLING, _MAP_NEIGHBORS, 1), np.eye(4)
    registration.take(sweeps[0].moved(motion), start)
    registration.insert(start)
    registration.take(sweeps[1].moved(motion), start)
    more: NDArray[np.float64] = registration.align(start).pose @ motion
    return more
