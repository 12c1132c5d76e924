"""Objects tracked over time, and the evidence that tracks carry (ours, beyond the paper)."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.dynamics.voting import OccupancyIntervals
from docdepth.geometry.points import check_sweep
from docdepth.geometry.scan_mesh import ScanMesh
from docdepth.geometry.track import MAX_TRACKS, Kind, Track
from docdepth.geometry.trajectory import Trajectory

log = logging.getLogger(__name__)

PERSON_SIZE = (2.2, 1.3, 2.2)
"""A person or cyclist is at most this long, wide and high [m]."""

MIN_PERSON_HEIGHT = 0.7
"""Of which a child or the seen half of a person has at least this [m]."""

MAX_CYCLING = 14.0
"""Fastest cyclist [m/s], 50 km/h."""

MIN_VEHICLE_HEIGHT = 0.6
"""Lower things are no vehicle [m]."""

MIN_SIZE = 0.1
"""Least side of a box [m]."""

_HELD_SWEEPS = 32
"""Sweeps whose detections are in memory while objects are tracked: more than the gap over which a
track goes on, so that few are read again."""


_MEMBER = np.dtype([("first", "u4"), ("track", "u4"), ("is_dynamic", "u4")])
_BOX = np.dtype(
    [
        ("track", "u4"),
        ("is_moving", "u4"),
        ("T_box_world", "f4", (3, 4)),
        ("half_size", "f4", (3,)),
    ]
)
"""Rows of the core."""


class TrackedSweep(NamedTuple):
    """What :func:`track_objects` finds in a sweep.

    Attributes
    ----------
    members : structured ndarray, shape (n,)
        Objects that belong to a track: ``first`` row (as :func:`cluster_objects` gives it),
        ``track``, and ``is_dynamic``, 1 if the track makes it dynamic.
    boxes : structured ndarray, shape (K,)
        Objects in the frame of :func:`local_poses`: ``track``, ``is_moving``, 1 if it moves in this
        sweep, ``T_box_world`` (3, 4) and ``half_size`` (3,) in metres. Points above the ground
        inside of a moving one are dynamic unless their votes are clearly static.
    voxels : ndarray of uint64, shape (m,)
        Numbers of the voxels in which nearly everything moved in the sweeps just before and after;
        the same holds inside.
    """

    members: NDArray[np.void] = np.zeros(0, _MEMBER)
    boxes: NDArray[np.void] = np.zeros(0, _BOX)
    voxels: NDArray[np.uint64] = np.zeros(0, np.uint64)

    def __bool__(self) -> bool:
        return any(len(found) > 0 for found in self)

    @property
    def dynamic(self) -> NDArray[np.uint32]:
        """First rows of the objects that tracks make dynamic."""
        return np.ascontiguousarray(self.members["first"][self.members["is_dynamic"] > 0])


TakeSweep = Callable[[TrackedSweep], None]
"""Takes what tracks found in a sweep."""


class Detections:
    """The objects of a sweep, with some of their points.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    ground : ndarray of bool, shape (N,)
    objects : ndarray of uint32, shape (N,)
        From :func:`cluster_objects`.
    moving : ndarray of bool, shape (N,)
        Points that the votes on this sweep make dynamic.
    occupancy : OccupancyIntervals
        By sweep.
    mesh : ScanMesh
        Of these points; tells the normals.
    T_world_lidar : ndarray of float64, shape (4, 4)
        From :func:`local_poses`.
    time_offset : ndarray of float32, shape (N,), optional
        Seconds from the stamp of the sweep to each measurement.

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
        occupancy: OccupancyIntervals,
        mesh: ScanMesh,
        T_world_lidar: NDArray[np.float64],
        time_offset: NDArray[np.float32] | None = None,
    ) -> None:
        points, ground = check_sweep(points, ground)
        self._core = _core.Detections(
            points,
            ground,
            objects,
            moving,
            occupancy.occupied_once,
            occupancy.first,
            occupancy.last,
            mesh.core,
            T_world_lidar,
            time_offset,
        )

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
    read: Callable[[int], Detections], trajectory: Trajectory, take: TakeSweep, threads: int = 0
) -> list[Track]:
    """Track dynamic objects through the drive, to find them also where votes do not.

    Tracks start at objects that the votes make dynamic and go forward and backward in time. An
    object of the next sweep continues a track when it overlaps the predicted points of the last two
    detections and is not larger than the whole object. So a track reaches sweeps in which the
    object waits or parks, or no key frame looked.

    A track is cut where the surfaces say that it went on with another object. Where a rigid object
    is at a time follows from its surfaces, registered onto each other; so a car that has stopped
    stands. How high it is follows from the ground around it. Tracks that touch a vehicle and go as
    fast, or stay within it while it goes on, are parts of it, and joined with it.

    Where a track adds an object, the place must have been observed free before or after, or been
    occupied only while the tracked object stood there; otherwise it is another one: a parked car
    that was passed, a pole, a wall. It may also not show more of its surface than was seen to move
    at once; of a vehicle, an eighth of all that was. What is as wide as a vehicle only while little
    of it passes is none: a person who brushes a parked car.

    Between its detections a tracked object is where its motion predicts it, even where its points
    are too few to be an object. The voxels of a result hold such points, too.

    Parameters
    ----------
    read : callable
        Gives the detections of a sweep. It is called from one thread, four or five times a sweep:
        those of few sweeps are held at once, since a drive may not fit into memory.
    trajectory : Trajectory
        Of the LiDAR; one pose a sweep.
    take : callable
        Called with what is found in each sweep, in order.
    threads : int
        0 for all cores. The result does not depend on it.

    Returns
    -------
    list of Track
        Track 1, 2, ...
    """
    times = trajectory.times
    objects = _core.track_objects(
        lambda sweep: read(sweep)._core,
        (times - times[0]) * 1e-9,
        threads,
        lambda found: take(TrackedSweep(*found)),
        _HELD_SWEEPS,
    )
    if len(objects) > MAX_TRACKS:
        log.warning(
            "%d objects move in this drive, more than ids; those after %d get instance 0",
            len(objects), MAX_TRACKS,
        )  # fmt: skip
    origin, tracks = trajectory.poses[0, :3, 3], []
    for number, of in enumerate(objects[:MAX_TRACKS], 1):
        tracks.append(_track(number, times, origin, *of))
        objects[number - 1] = None
    return tracks


def _track(
    number: int,
    times: NDArray[np.int64],
    origin: NDArray[np.float64],
    sweeps: NDArray[np.int64],
    points: NDArray[np.int64],
    poses: NDArray[np.float64],
    velocities: NDArray[np.float64],
    deviations: NDArray[np.float64],
    surface_deviations: NDArray[np.float64],
    size: NDArray[np.float64],
    rigid: bool,
) -> Track:
    poses[:, :3, 3] += origin
    size = np.maximum(size, MIN_SIZE)
    speed = float(np.linalg.norm(velocities, axis=1).max())
    kind = _kind(size, speed, rigid)
    known = (deviations, surface_deviations)
    return Track(number, kind, times[sweeps], poses, velocities, size, points, *known)


def _kind(size: NDArray[np.float64], speed: float, rigid: bool) -> Kind:
    """What an object is by its size [m] and its highest speed [m/s]."""
    length, width, height = size
    if length <= PERSON_SIZE[0] and width <= PERSON_SIZE[1] and height <= PERSON_SIZE[2]:
        return "person" if height >= MIN_PERSON_HEIGHT and speed <= MAX_CYCLING else "other"
    return "vehicle" if rigid and height >= MIN_VEHICLE_HEIGHT else "other"
