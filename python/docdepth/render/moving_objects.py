"""Objects that move: whose points a sweep holds, and where they are at the time of an image (ours).

A track tells which points are one object and where it is at any time. What a sweep saw of it is
carried along the track to the time of the image.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse, rotation_exp
from docdepth.geometry.track import Track

Tracks = Mapping[int, Track]
"""Tracks by id."""

TOUCH = 0.2
"""A dynamic point without an instance that is this near to the box of a track is carried with it
[m]: boxes hold what was seen, so a mirror or a foot may stick out by as much."""


@dataclass(frozen=True)
class SweepObjects:
    """The dynamic points of a sweep by object.

    Attributes
    ----------
    owner : ndarray of uint16, shape (N,)
        0 of static points, else the number of the point's object in this sweep, from 1 on.
    instances : tuple of int
        Of objects 1, 2, ...: the id of its track, or 0 of the points that are not followed.
    times : tuple of int
        The time at which each object is held: the mean time of its measurements [ns].
    displacement : ndarray of float32, shape (N, 3), optional
        Moves each point from where it was measured to where it is at the time of its object [m].
    """

    owner: NDArray[np.uint16]
    instances: tuple[int, ...]
    times: tuple[int, ...]
    displacement: NDArray[np.float32] | None = None

    def select(self, rows: NDArray[np.bool_]) -> SweepObjects:
        """The objects of some points."""
        moved = None if self.displacement is None else self.displacement[rows]
        return replace(self, owner=self.owner[rows], displacement=moved)


def objects_of(
    points: NDArray[np.float32],
    classid: NDArray[np.uint16],
    time: int,
    T_world_lidar: NDArray[np.float64],
    instance: NDArray[np.uint16] | None = None,
    tracks: Tracks | None = None,
    time_offset: NDArray[np.float32] | None = None,
) -> SweepObjects:
    """Divide the dynamic points of a sweep into objects, each held at one time.

    A sweep takes a tenth of a second, in which a car moves by metres. Each point is moved with its
    track from the time of its measurement to the mean time of its object.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame, deskewed with the motion of the LiDAR [m].
    classid : ndarray of uint16, shape (N,)
    time : int
        Stamp of the sweep [ns].
    T_world_lidar : ndarray of float64, shape (4, 4)
        Pose at the stamp.
    instance : ndarray of uint16, shape (N,), optional
        Id of the track of each point, 0 = none.
    tracks : mapping of int to Track, optional
    time_offset : ndarray of float32, shape (N,), optional
        Seconds from the stamp to each measurement.
    """
    tracks = tracks or {}
    rows = np.flatnonzero(classid >= DYNAMIC)
    ids = np.zeros(len(rows), np.int64) if instance is None else instance[rows].astype(np.int64)
    ids[~np.isin(ids, list(tracks))] = 0
    world = points[rows].astype(np.float64) @ T_world_lidar[:3, :3].T + T_world_lidar[:3, 3]
    delay = np.zeros(len(rows)) if time_offset is None else time_offset[rows].astype(np.float64)
    _carry_strays(ids, world, time, tracks)
    instances, number = np.unique(ids, return_inverse=True)
    owner = np.zeros(len(points), np.uint16)
    owner[rows] = number + 1
    times, displacement = [], None
    if time_offset is not None and instances.any():
        displacement = np.zeros(points.shape, np.float32)
    for k, of in enumerate(instances.tolist()):
        own = number == k
        late = float(delay[own].mean())
        times.append(int(time) + round(late * 1e9))
        if displacement is not None and of:
            moved = _held(world[own], late - delay[own], tracks[of], times[-1])
            displacement[rows[own]] = (moved - world[own]) @ T_world_lidar[:3, :3]
    return SweepObjects(owner, tuple(instances.tolist()), tuple(times), displacement)


def _held(
    world: NDArray[np.float64], earlier: NDArray[np.float64], track: Track, time: int
) -> NDArray[np.float64]:
    """Points measured ``earlier`` seconds before ``time``, as the object is at ``time``."""
    velocity, centre = track.velocity_at(time), track.pose_at(time)[:3, 3]
    turn = rotation_exp(earlier[:, None] * track.turn_rate_at(time))
    then = centre - earlier[:, None] * velocity
    return np.asarray(centre + np.einsum("nij,nj->ni", turn, world - then))


def _carry_strays(
    ids: NDArray[np.int64], world: NDArray[np.float64], time: int, tracks: Tracks
) -> None:
    """Give dynamic points without an instance to the track whose box they lie in or touch."""
    strays = np.flatnonzero(ids == 0)
    for of, track in tracks.items():
        if not len(strays) or not track.covers(time):
            continue
        T = inverse(track.pose_at(time))
        local = world[strays] @ T[:3, :3].T + T[:3, 3]
        half = 0.5 * track.size + TOUCH
        inside = (np.abs(local - (0, 0, 0.5 * track.size[2])) <= half).all(axis=1)
        ids[strays[inside]] = of
        strays = strays[~inside]


def carried(
    track: Track | None, then: int, now: int, T_world_lidar: NDArray[np.float64]
) -> NDArray[np.float64]:
    """``T_world_lidar`` of a sweep, moved so that what it saw of an object is where it is ``now``.

    Parameters
    ----------
    track : Track, optional
        None of points that are not followed: they stay where they were seen.
    then : int
        Time at which the sweep holds the object [ns].
    now : int
        Time of the image [ns].
    T_world_lidar : ndarray of float64, shape (4, 4)
        Pose of the sweep.
    """
    if track is None:
        return T_world_lidar
    moved: NDArray[np.float64] = (
        track.pose_at(now) @ inverse(track.pose_at(then)) @ T_world_lidar
    )
    return moved


def by_id(tracks: Sequence[Track]) -> dict[int, Track]:
    """Tracks by their ids."""
    return {track.id: track for track in tracks}
