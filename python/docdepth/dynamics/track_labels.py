"""Classes of a sweep with the evidence that tracks carry (ours, beyond the paper)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.dynamics.tracking import TrackedSweep
from docdepth.dynamics.voting import Votes
from docdepth.geometry.points import DYNAMIC, STATIC
from docdepth.geometry.track import MAX_TRACKS

MAX_OCCUPIED_SHARE = 0.8
"""The rest of an object that moves in part stays static above this share of points that were always
observed occupied: it is another object that touches the first [-]."""

ALWAYS_OCCUPIED = 8
"""A point was always observed occupied if no key frame found it free, and so many found it
occupied. Half of the key frames suffice where these are fewer than twice as many."""

BOX_MARGIN = 0.5
"""A dynamic point without an object belongs to the box of a track up to this distance [m]."""


def label_by_tracks(
    points: NDArray[np.float32],
    objects: NDArray[np.uint32],
    votes: Votes,
    classid: NDArray[np.uint16],
    result: TrackedSweep,
    T_world_lidar: NDArray[np.float64],
    key_frames: int,
) -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Add to the classes of a sweep what tracks found in it, and tell which track each point is of.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    objects : ndarray of uint32, shape (N,)
        From :func:`cluster_objects`.
    votes : Votes
    classid : ndarray of uint16, shape (N,)
        By the votes on this sweep.
    result : TrackedSweep
        Of this sweep.
    T_world_lidar : ndarray of float64, shape (4, 4)
        From :func:`local_poses`.
    key_frames : int
        How many key frames voted on this sweep.

    Returns
    -------
    classid, instance : ndarray of uint16, shape (N,)
        The instance is the track of each dynamic point, 0 if it is of none.
    """
    moving, ground = classid >= DYNAMIC, classid < STATIC
    always = min(ALWAYS_OCCUPIED, key_frames / 2)
    occupied = (votes.static >= always) & (votes.dynamic == 0)
    moving[_tracked_rows(objects, result.dynamic, occupied, moving)] = True
    static, dynamic = votes.static, votes.dynamic
    inside = _core.add_points_inside(
        points,
        ground,
        static,
        dynamic,
        T_world_lidar,
        result.boxes[result.boxes["is_moving"] > 0],
        result.voxels,
        moving,
    ).view(np.bool_)
    every = _core.add_isolated_points(points, ground, objects, static, dynamic, inside)
    classid = np.where(every, np.uint16(DYNAMIC), classid)
    return classid, _instances(points, objects, classid >= DYNAMIC, result, T_world_lidar)


def _instances(
    points: NDArray[np.float32],
    objects: NDArray[np.uint32],
    dynamic: NDArray[np.bool_],
    result: TrackedSweep,
    T_world_lidar: NDArray[np.float64],
) -> NDArray[np.uint16]:
    """The track of each dynamic point: that of its object, else that of the nearest box."""
    track_of = np.zeros(len(objects), np.uint32)
    members = result.members[::-1]  # the longest track has the lowest number
    track_of[members["first"]] = members["track"]
    instance = np.where(dynamic, track_of[objects], 0)
    loose = np.flatnonzero(dynamic & (instance == 0))
    if len(loose) and len(result.boxes):
        places = points[loose] @ T_world_lidar[:3, :3].T + T_world_lidar[:3, 3]
        T = result.boxes["T_box_world"]
        inside = np.einsum("kij,nj->kni", T[:, :, :3], places) + T[:, None, :, 3]
        off = np.abs(inside) - result.boxes["half_size"][:, None]
        distance = np.linalg.norm(np.maximum(off, 0), axis=2)
        nearest = distance.argmin(axis=0)
        near = distance[nearest, np.arange(len(loose))] <= BOX_MARGIN
        instance[loose[near]] = result.boxes["track"][nearest[near]]
    return np.where(instance <= MAX_TRACKS, instance, 0).astype(np.uint16)


def _tracked_rows(
    objects: NDArray[np.uint32],
    tracked: NDArray[np.uint32],
    occupied: NDArray[np.bool_],
    moving: NDArray[np.bool_],
) -> NDArray[np.intp]:
    """Rows of tracked objects that become dynamic: all that are not yet, or none of an object.

    Where a part of an object moves by votes, the rest stays static if nearly all of it was always
    observed occupied.
    """
    rows = np.flatnonzero(_rows_of(tracked, objects) & ~moving)
    of, count = objects[rows], len(objects)
    of_object = np.bincount(of, minlength=count)
    stays = np.bincount(of, occupied[rows], count) > MAX_OCCUPIED_SHARE * of_object
    return rows[~(stays[of] & _rows_of(objects[moving], objects)[rows])]


def _rows_of(some: NDArray[np.uint32], objects: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Whether each row belongs to one of some objects."""
    among = np.zeros(len(objects), bool)
    among[some] = True
    return among[objects]
