"""Objects of a sweep, and evidence shared within them and carried along them over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from docdepth import _core
from docdepth.config import DynamicsParameters
from docdepth.errors import InputError
from docdepth.surface import Surface
from docdepth.trajectory import Trajectory


def connect_objects(
    points: NDArray[np.float32],
    ground: NDArray[np.bool_],
    surface: Surface | None = None,
    parameters: DynamicsParameters | None = None,
) -> NDArray[np.uint32]:
    """Find the objects of a sweep: points off the ground that its surface connects.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    surface : Surface, optional
        Of these points; made here when left out.
    parameters : DynamicsParameters, optional

    Returns
    -------
    ndarray of uint32, shape (N,)
        Row of the first point of each point's object; a point of the ground is alone.

    Raises
    ------
    InputError
        A shape or dtype is wrong.
    """
    points, ground = check_sweep(points, ground)
    p = _object_parameters(parameters or DynamicsParameters())
    return _core.connect_objects(points, ground, (surface or Surface(points)).core, p)


def moving_points(
    points: NDArray[np.float32],
    ground: NDArray[np.bool_],
    objects: NDArray[np.uint32],
    static: NDArray[np.uint16],
    dynamic: NDArray[np.uint16],
    surface: Surface,
    parameters: DynamicsParameters,
) -> NDArray[np.bool_]:
    """Which points are dynamic when evidence is shared within objects; all arrays a value a point.

    Dynamic points that stand alone are withdrawn, the other points of an object follow most of
    them, and an object that stands for a while moves when enough of its place was seen free.
    """
    p = _object_parameters(parameters)
    moving = _core.moving_points(points, ground, objects, static, dynamic, surface.core, p)
    return moving.view(np.bool_)


def add_carried(
    points: NDArray[np.float32],
    objects: NDArray[np.uint32],
    found: Followed,
    static: NDArray[np.uint16],
    dynamic: NDArray[np.uint16],
    classid: NDArray[np.uint16],
    T_world_lidar: NDArray[np.float64],
    parameters: DynamicsParameters,
) -> NDArray[np.uint16]:
    """Classes with what :func:`follow` found in this sweep.

    The other arrays are those of :func:`moving_points`, and the pose that of the sighting.
    """
    p = _object_parameters(parameters)
    moving, ground = classid >= 100, classid < 50
    moving[_carried_points(objects, found.objects, static, dynamic, moving, parameters)] = True
    inside = _core.add_points_inside(
        points, ground, static, dynamic, T_world_lidar, found.boxes, found.cubes, moving, p
    ).view(np.bool_)
    all_moving = _core.add_loose_points(points, ground, objects, static, dynamic, inside, p)
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


class Followed(NamedTuple):
    """What :func:`follow` finds in a sweep.

    Attributes
    ----------
    objects : ndarray of uint32
        First rows, as :func:`connect_objects` names them, of those that are dynamic, too.
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


class Sighting:
    """What a sweep saw above the ground, object by object: little enough to keep a whole drive.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    objects : ndarray of uint32, shape (N,)
        From :func:`connect_objects`.
    moving : ndarray of bool, shape (N,)
        Points that :func:`docdepth.dynamics.classify` calls dynamic.
    T_world_lidar : ndarray of float64, shape (4, 4)
        With an origin so near that float32 tells centimetres, see :func:`poses_near_start`.

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
        self._core = _core.Sighting(points, ground, objects, moving, T_world_lidar)

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """All of it as arrays, to be written."""
        return self._core.arrays

    @classmethod
    def of(cls, arrays: Sequence[NDArray[Any]]) -> Sighting:
        """The one that gave these arrays."""
        self = cls.__new__(cls)
        self._core = _core.Sighting.of(*arrays)
        return self


def carries_evidence(parameters: DynamicsParameters | None = None) -> bool:
    """Whether objects are followed over time, which needs every sweep's votes first."""
    p = parameters or DynamicsParameters()
    return p.objects and p.tracks


def poses_near_start(trajectory: Trajectory) -> NDArray[np.float64]:
    """The poses with the first one's place as origin, for sightings."""
    poses = trajectory.poses.copy()
    poses[:, :3, 3] -= trajectory.poses[0, :3, 3]
    return poses


def follow(
    sightings: Sequence[Sighting],
    times: NDArray[np.int64],
    parameters: DynamicsParameters | None = None,
    threads: int = 0,
) -> list[Followed]:
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
    sightings : sequence of Sighting
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
    if len(sightings) != len(times):
        raise InputError(f"{len(sightings)} sightings and {len(times)} times; give one of each")
    tracks = _core.TrackParameters()
    tracks.sightings, tracks.distance = p.track_sightings, p.track_distance
    tracks.max_speed, tracks.gap, tracks.hold = p.track_speed, p.track_gap, p.track_hold
    tracks.window = p.track_window
    seconds = (np.asarray(times) - times[0]) * 1e-9 if len(times) else np.zeros(0)
    found = _core.follow([seen._core for seen in sightings], seconds, tracks, threads)
    return [Followed(*sweep) for sweep in found]


def _object_parameters(p: DynamicsParameters) -> _core.ObjectParameters:
    objects = _core.ObjectParameters()
    objects.link, objects.link_growth = p.link, p.link_growth
    objects.companions, objects.company = p.companions, p.company
    objects.clear_votes, objects.clear_ratio = p.clear_votes, p.clear_ratio
    objects.object_points, objects.share = p.object_points, p.object_share
    objects.least = p.object_least
    objects.width, objects.height = p.object_width, p.object_height
    objects.freed_share, objects.freed_votes = p.freed_share, p.freed_votes
    objects.freed_ratio, objects.loose_votes = p.freed_ratio, p.loose_votes
    return objects


def check_sweep(
    points: NDArray[np.float32], ground: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Contiguous points and ground flags, or an error that says what to change."""
    points, ground = np.asarray(points), np.asarray(ground)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype != np.float32:
        raise InputError(
            f"points must be float32 of shape (N, 3), got {points.dtype} {points.shape}; "
            "convert them once where they are read"
        )
    if ground.dtype != np.bool_ or ground.shape != points.shape[:1]:
        raise InputError(
            f"ground must be bool of shape ({len(points)},), one flag a point, "
            f"got {ground.dtype} {ground.shape}"
        )
    return np.ascontiguousarray(points), np.ascontiguousarray(ground)
