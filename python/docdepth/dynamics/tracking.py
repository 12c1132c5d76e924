"""Objects tracked over time, and the evidence that tracks carry (ours, beyond the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.dynamics.clustering import OBJECT_PARAMETERS
from docdepth.dynamics.voting import Votes
from docdepth.errors import InputError
from docdepth.geometry.points import DYNAMIC, STATIC, check_sweep
from docdepth.geometry.trajectory import Trajectory

TRACK_PARAMETERS = _core.TrackParameters()
"""Constants of :func:`track_objects`: the defaults of the C++ structure."""

MAX_OCCUPIED_SHARE = 0.8
"""The rest of an object that moves in part stays static above this share of points that were always
observed occupied: it is another object that touches the first [-]."""


class TrackingResult(NamedTuple):
    """What :func:`track_objects` finds in a sweep.

    Attributes
    ----------
    objects : ndarray of uint32, shape (n,)
        Objects that are dynamic, too: their first rows, as :func:`cluster_objects` gives them.
    boxes : ndarray of float32, shape (K, 6)
        Low and high corners of tracked objects in the frame of :func:`local_poses`. Points above
        the ground inside are dynamic unless their votes are clearly static.
    voxels : ndarray of uint64, shape (m,)
        Numbers of the voxels in which nearly everything moved in the sweeps just before and after;
        the same holds inside.
    """

    objects: NDArray[np.uint32]
    boxes: NDArray[np.float32]
    voxels: NDArray[np.uint64] = np.zeros(0, np.uint64)

    def __bool__(self) -> bool:
        return any(len(found) > 0 for found in self)


class Detections:
    """The objects of a sweep, small enough to keep those of a whole drive in memory.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    objects : ndarray of uint32, shape (N,)
        From :func:`cluster_objects`.
    moving : ndarray of bool, shape (N,)
        Points that the votes on this sweep make dynamic.
    T_world_lidar : ndarray of float64, shape (4, 4)
        From :func:`local_poses`.

    Raises
    ------
    InputError
        A shape or dtype is wrong.
    """

    def __init__(
        self,
        points: NDArray[np.float32],
        ground: NDArray[np.bool_],
        objects: NDArray[np.uint32],
        moving: NDArray[np.bool_],
        T_world_lidar: NDArray[np.float64],
    ) -> None:
        points, ground = check_sweep(points, ground)
        self._core = _core.Detections(points, ground, objects, moving, T_world_lidar)

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """All of it as arrays, to be written to a file."""
        return self._core.arrays

    @classmethod
    def of(cls, arrays: Sequence[NDArray[Any]]) -> Detections:
        """The detections whose :attr:`arrays` these are."""
        self = cls.__new__(cls)
        self._core = _core.Detections.of(*arrays)
        return self


def local_poses(trajectory: Trajectory) -> NDArray[np.float64]:
    """Poses (n, 4, 4) with the first position as origin, where float32 resolves centimetres."""
    poses = trajectory.poses.copy()
    poses[:, :3, 3] -= trajectory.poses[0, :3, 3]
    return poses


def track_objects(
    detections: Sequence[Detections], times: NDArray[np.int64], threads: int = 0
) -> list[TrackingResult]:
    """Track dynamic objects through the drive, to find them also where votes do not.

    Tracks start at objects that the votes make dynamic and go forward and backward in time. An
    object of the next sweep continues a track when it overlaps the predicted points of the last two
    detections and is not larger than the whole object. So a track reaches sweeps in which the
    object waits or parks, or no key frame looked.

    An object that a track adds must have been observed free while the tracked object was elsewhere;
    otherwise it is another one: a parked car that was passed, a pole, a wall. It may also not have
    more points than were seen to move at once, or an eighth of all that were.

    Between its detections a tracked object is where its motion predicts it, even where its points
    are too few to be an object. The voxels of a result hold such points, too.

    Parameters
    ----------
    detections : sequence of Detections
        Of every sweep, in order.
    times : ndarray of int64, shape (n,)
        Stamps of the sweeps, nanoseconds.
    threads : int
        0 for all cores. The result does not depend on it.

    Returns
    -------
    list of TrackingResult
        One for each sweep.

    Raises
    ------
    InputError
        The numbers of detections and times differ.
    """
    if len(detections) != len(times):
        raise InputError(f"{len(detections)} detections and {len(times)} times; give one of each")
    seconds = (np.asarray(times) - times[0]) * 1e-9 if len(times) else np.zeros(0)
    found = _core.track_objects([of._core for of in detections], seconds, TRACK_PARAMETERS, threads)
    return [TrackingResult(*sweep) for sweep in found]


def apply_tracks(
    points: NDArray[np.float32],
    objects: NDArray[np.uint32],
    votes: Votes,
    classid: NDArray[np.uint16],
    result: TrackingResult,
    T_world_lidar: NDArray[np.float64],
) -> NDArray[np.uint16]:
    """Add to the classes of a sweep what tracks found in it.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    objects : ndarray of uint32, shape (N,)
        From :func:`cluster_objects`.
    votes : Votes
    classid : ndarray of uint16, shape (N,)
        By the votes on this sweep.
    result : TrackingResult
        Of this sweep.
    T_world_lidar : ndarray of float64, shape (4, 4)
        From :func:`local_poses`.

    Returns
    -------
    ndarray of uint16, shape (N,)
    """
    moving, ground = classid >= DYNAMIC, classid < STATIC
    moving[_tracked_rows(objects, result.objects, votes, moving)] = True
    static, dynamic = votes.static, votes.dynamic
    inside = _core.add_points_inside(
        points,
        ground,
        static,
        dynamic,
        T_world_lidar,
        result.boxes,
        result.voxels,
        moving,
        OBJECT_PARAMETERS,
    ).view(np.bool_)
    every = _core.add_isolated_points(
        points, ground, objects, static, dynamic, inside, OBJECT_PARAMETERS
    )
    return np.where(every, np.uint16(DYNAMIC), classid)


def _tracked_rows(
    objects: NDArray[np.uint32],
    tracked: NDArray[np.uint32],
    votes: Votes,
    moving: NDArray[np.bool_],
) -> NDArray[np.intp]:
    """Rows of tracked objects that become dynamic: all that are not yet, or none of an object.

    Where a part of an object moves by votes, the rest stays static if nearly all of it was always
    observed occupied.
    """
    rows = np.flatnonzero(_rows_of(tracked, objects) & ~moving)
    of, count = objects[rows], len(objects)
    occupied = votes.static[rows] >= OBJECT_PARAMETERS.max_static_ratio
    occupied &= votes.dynamic[rows] == 0
    of_object = np.bincount(of, minlength=count)
    stays = np.bincount(of, occupied, count) > MAX_OCCUPIED_SHARE * of_object
    return rows[~(stays[of] & _rows_of(objects[moving], objects)[rows])]


def _rows_of(some: NDArray[np.uint32], objects: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Whether each row belongs to one of some objects."""
    among = np.zeros(len(objects), bool)
    among[some] = True
    return among[objects]
