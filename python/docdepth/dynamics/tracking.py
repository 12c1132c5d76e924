"""Objects followed over time, and the evidence that they carry (ours, beyond the paper)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import DynamicsParameters
from docdepth.dynamics.clustering import _object_parameters
from docdepth.errors import InputError
from docdepth.geometry.points import check_sweep
from docdepth.geometry.trajectory import Trajectory


def apply_tracks(
    points: NDArray[np.float32],
    objects: NDArray[np.uint32],
    found: TrackingResult,
    static: NDArray[np.uint16],
    dynamic: NDArray[np.uint16],
    classid: NDArray[np.uint16],
    T_world_lidar: NDArray[np.float64],
    parameters: DynamicsParameters,
) -> NDArray[np.uint16]:
    """Classes with what :func:`track_objects` found in this sweep.

    The other arrays are those of :func:`classify_objects`, and the pose that of the sighting.
    """
    p = _object_parameters(parameters)
    moving, ground = classid >= 100, classid < 50
    moving[_carried_points(objects, found.objects, static, dynamic, moving, parameters)] = True
    inside = _core.add_points_inside(
        points, ground, static, dynamic, T_world_lidar, found.boxes, found.cubes, moving, p
    ).view(np.bool_)
    all_moving = _core.add_isolated_points(points, ground, objects, static, dynamic, inside, p)
    return np.where(all_moving, np.uint16(100), classid)


def _carried_points(
    objects: NDArray[np.uint32],
    followed: NDArray[np.uint32],
    static: NDArray[np.uint16],
    dynamic: NDArray[np.uint16],
    moving: NDArray[np.bool_],
    p: DynamicsParameters,
) -> NDArray[np.intp]:
    """Rows that move with what is followed: of each object all that are left, or none.

    What is left of an object that moves only in part stays where nearly all of it was always seen
    taken: something else stands there and is connected to it.
    """
    rows = np.flatnonzero(_rows_of(followed, objects) & ~moving)
    of, count = objects[rows], len(objects)
    stood = (static[rows] >= p.freed_ratio) & (dynamic[rows] == 0)
    stays = np.bincount(of, stood, count) > p.track_stood * np.bincount(of, minlength=count)
    return rows[~(stays[of] & _rows_of(objects[moving], objects)[rows])]


def _rows_of(some: NDArray[np.uint32], objects: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Whether each row is of some of the objects."""
    among = np.zeros(len(objects), bool)
    among[some] = True
    return among[objects]


class TrackingResult(NamedTuple):
    """What :func:`track_objects` finds in a sweep.

    Attributes
    ----------
    objects : ndarray of uint32
        First rows, as :func:`cluster_objects` names them, of those that are dynamic, too.
    boxes : ndarray of float32, shape (K, 6)
        Low and high corners, in the world of the sightings, of where something is on its way:
        points off the ground there are of it, unless votes call them clearly static.
    cubes : ndarray of uint64
        Numbers of the cubes in which sweeps near in time saw little but what moves; the
        same holds there.
    """

    objects: NDArray[np.uint32]
    boxes: NDArray[np.float32]
    cubes: NDArray[np.uint64] = np.zeros(0, np.uint64)

    def __bool__(self) -> bool:
        return any(len(found) > 0 for found in self)


class Detections:
    """What a sweep saw above the ground, object by object: little enough to keep a whole drive.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    objects : ndarray of uint32, shape (N,)
        From :func:`cluster_objects`.
    moving : ndarray of bool, shape (N,)
        Points that :func:`docdepth.dynamics.classifier.classify` calls dynamic.
    T_world_lidar : ndarray of float64, shape (4, 4)
        With an origin so near that float32 tells centimetres, see :func:`local_poses`.

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
        """All of it as arrays, to be written."""
        return self._core.arrays

    @classmethod
    def of(cls, arrays: Sequence[NDArray[Any]]) -> Detections:
        """The one that gave these arrays."""
        self = cls.__new__(cls)
        self._core = _core.Detections.of(*arrays)
        return self


def uses_tracking(parameters: DynamicsParameters | None = None) -> bool:
    """Whether objects are followed over time, which needs every sweep's votes first."""
    p = parameters or DynamicsParameters()
    return p.objects and p.tracks


def local_poses(trajectory: Trajectory) -> NDArray[np.float64]:
    """The poses with the first one's place as origin, for sightings."""
    poses = trajectory.poses.copy()
    poses[:, :3, 3] -= trajectory.poses[0, :3, 3]
    return poses


def track_objects(
    detections: Sequence[Detections],
    times: NDArray[np.int64],
    parameters: DynamicsParameters | None = None,
    threads: int = 0,
) -> list[TrackingResult]:
    """Carry evidence over time: find objects that move at another time of the drive.

    What the votes call dynamic is followed forward and backward. Objects of the next sweep that
    fall onto its places, those of its last two sightings, are the same one, unless together they
    are larger than it looks whole; so it is followed to where it waits or parks, and to where no
    key frame looked. What is carried along must have been free while the object was elsewhere, or
    else it is another thing: a parked car that was passed, a pole, a wall; and as many points must
    have been seen to move at once, or eight times as many in all. Between its sightings
    an object is where its way leads, though its points may be too few, too scattered or too little
    seen by key frames to be found without knowing it. So may points be that lie where the sweeps
    near in time saw little but what moves.

    Parameters
    ----------
    detections : sequence of Sighting
        Of every sweep, in order.
    times : ndarray of int64
        Stamps of the sweeps, nanoseconds.
    parameters : DynamicsParameters, optional
    threads : int
        0 for all cores. The result does not depend on it.

    Returns
    -------
    list of Followed
        For each sweep.

    Raises
    ------
    InputError
        There is not one time a sighting.
    """
    p = parameters or DynamicsParameters()
    if len(detections) != len(times):
        raise InputError(f"{len(detections)} detections and {len(times)} times; give one of each")
    tracks = _core.TrackParameters()
    tracks.min_detections, tracks.min_distance = p.track_sightings, p.track_distance
    tracks.max_speed = p.track_speed
    tracks.max_gap, tracks.max_gap_standing = p.track_gap, p.track_hold
    tracks.window = p.track_window
    seconds = (np.asarray(times) - times[0]) * 1e-9 if len(times) else np.zeros(0)
    found = _core.track_objects([seen._core for seen in detections], seconds, tracks, threads)
    return [TrackingResult(*sweep) for sweep in found]
