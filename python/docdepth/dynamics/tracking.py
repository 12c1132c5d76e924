"""Objects tracked over time, and the evidence that tracks carry (ours, beyond the paper)."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import docdepth._core as _core
from docdepth.dynamics.voting import Votes
from docdepth.geometry.points import DYNAMIC, GROUND, STATIC
from docdepth.geometry.se3 import transform_points
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

MAX_OCCUPIED_SHARE = 0.8
"""The rest of an object that moves in part stays static above this share of points that were always
observed occupied: it is another object that touches the first [-]."""

ALWAYS_OCCUPIED = 8
"""A point was always observed occupied if no key frame found it free, and so many found it
occupied. Half of the key frames suffice where these are fewer than twice as many."""

BOX_MARGIN = 0.5
"""A dynamic point without an object belongs to the box of a track up to this distance [m]."""

_PAIRS = 200_000
"""So many pairs of a point and a box are compared at once: where all moves, there are millions."""

MAX_POROUS_SHARE = 0.2
"""Points that no track follows stand where a larger share of those among them that were found free
is porous [-]."""

MIN_DYNAMIC_SHARE = 0.5
"""Where less of what was found free is dynamic, what no track follows stands [-]."""

MIN_FREE_RATIO = 2
"""Ground that no track follows moves only where more than so many times as many key frames found
its place free as occupied [-]: a whole car may be taken for ground; but of the ground itself, seen
at a flat angle, many key frames seem to look under it."""

_CELL = 2.0
"""What is around a point is told by cells of this edge, its own and those beside it [m]."""

_DENSE_CELL = 0.5
_MIN_DENSE = 40
_DENSE_FREE_RATIO = 3
_DENSE_HEIGHT = 0.25
"""So many points in a cell of this edge [m], spread over as much height [m], move, whatever is
around them, if together more than so many times as many key frames found their places free as
occupied: somebody who walks along parked cars is one object with them, and no track follows him. Of
panels of fences up to 2.4 times as many did [-], and more of planks, which single rings hit."""

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
    """What :func:`track_objects` finds in a sweep."""

    # (n,): objects that belong to a track: ``first`` row (as :func:`cluster_objects` gives it),
    # ``track``, and ``is_dynamic``, 1 if the track makes it dynamic
    members: NDArray[np.void] = np.zeros(0, _MEMBER)
    # (K,): objects in the frame of :func:`local_poses`: ``track``, ``is_moving``, 1 if it moves in
    # this sweep, ``T_box_world`` (3, 4) and ``half_size`` (3,) in metres. Points above the ground
    # inside of a moving one are dynamic unless their votes are clearly static
    boxes: NDArray[np.void] = np.zeros(0, _BOX)
    # (m,): numbers of the voxels in which nearly everything moved in the sweeps just before and
    # after; the same holds inside
    voxels: NDArray[np.uint64] = np.zeros(0, np.uint64)

    def __bool__(self) -> bool:
        return any(len(found) > 0 for found in self)

    @property
    def dynamic(self) -> NDArray[np.uint32]:
        """First rows of the objects that tracks make dynamic."""
        return np.ascontiguousarray(self.members["first"][self.members["is_dynamic"] > 0])


TakeSweep = Callable[[TrackedSweep], None]
"""Takes what tracks found in a sweep."""


def local_poses(trajectory: Trajectory) -> NDArray[np.float64]:
    """Poses (n, 4, 4) from the first position of each part, where float32 resolves centimetres."""
    poses = trajectory.poses.copy()
    for part in trajectory.parts:
        poses[part.start : part.stop, :3, 3] -= trajectory.poses[part.start, :3, 3]
    return poses


def track_objects(
    read: Callable[[int], _core.Detections],
    trajectory: Trajectory,
    take: TakeSweep,
    threads: int = 0,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Track]:
    """Track dynamic objects through the drive, to find them also where votes do not.

    Tracks start at objects that the votes make dynamic and go forward and backward in time, but not
    over a gap. An
    object of the next sweep continues a track when it overlaps the predicted points of the last two
    detections and is not larger than the whole object. So a track reaches sweeps in which the
    object waits or parks, or no key frame looked.

    A track is cut where the surfaces say that it went on with another object. Where a rigid object
    is at a time follows from its surfaces, registered onto each other; so a car that has stopped
    stands. How high it is follows from the ground around it. Tracks that touch a vehicle all the
    while, or stay within it while it goes on, are parts of it, and joined with it.

    Where a track adds an object, the place must have been observed free before or after, or been
    occupied only while the tracked object stood there; otherwise it is another one: a parked car
    that was passed, a pole, a wall. It may also not show more of its surface than was seen to move
    at once; of a vehicle, than in all sweeps together. A pedestrian who touches a parked car is
    merged with it for some sweeps: what is as wide as a vehicle only while little of it is
    transient is none.

    Between its detections a tracked object is where its motion predicts it, even where its points
    are too few to be an object. The voxels of a result hold such points, too.

    Parameters
    ----------
    read : callable
        Gives the detections of a sweep, which count sweeps from the first of its part. It is called
        from one thread, four or five times a sweep: those of few sweeps are held at once, since a
        drive may not fit into memory.
    trajectory : Trajectory
        Of the LiDAR; one pose a sweep.
    take : callable
        Called with what is found in each sweep, in order.
    threads : int
        0 for all cores. The result does not depend on it.
    progress : callable, optional
        Called with the number of sweeps that are done.

    Returns
    -------
    list of Track
        Track 1, 2, ...
    """
    tracks, found = list[Track](), 0
    for part in trajectory.parts:

        def take_numbered(sweep: tuple[Any, Any, Any], before: int = found) -> None:
            for rows in sweep[:2]:
                rows["track"] += before
            take(TrackedSweep(*sweep))

        def tell(share: float, part: range = part) -> None:
            progress(int(part.start + share * len(part)))

        times = trajectory.times[part.start : part.stop]
        objects = _core.track_objects(
            lambda index, part=part: read(part[index]),
            (times - times[0]) * 1e-9,
            threads,
            take_numbered,
            _HELD_SWEEPS,
            tell,
        )
        tracks += _tracks_of(objects, found, times, trajectory.poses[part.start, :3, 3])
        found += len(objects)
    if found > MAX_TRACKS:
        log.warning(
            "%d objects move in this drive, more than ids; those after %d get instance 0",
            found, MAX_TRACKS,
        )  # fmt: skip
    return tracks


def _tracks_of(
    objects: list[Any], before: int, times: NDArray[np.int64], origin: NDArray[np.float64]
) -> list[Track]:
    """Objects of a part of the drive, as many as there are ids after those ``before``."""
    tracks = []
    for k, found in enumerate(objects[: max(0, MAX_TRACKS - before)]):
        sweeps, points, poses, velocities, deviations, of_surface, size, rigid = found
        objects[k] = None
        poses[:, :3, 3] += origin
        size = np.maximum(size, MIN_SIZE)
        kind = _kind(size, float(np.linalg.norm(velocities, axis=1).max()), rigid)
        path = times[sweeps], poses, velocities
        tracks.append(Track(before + k + 1, kind, *path, size, points, deviations, of_surface))
    return tracks


def _kind(size: NDArray[np.float64], speed: float, rigid: bool) -> Kind:
    """What an object is by its size [m] and its highest speed [m/s]."""
    length, width, height = size
    if length <= PERSON_SIZE[0] and width <= PERSON_SIZE[1] and height <= PERSON_SIZE[2]:
        return "person" if height >= MIN_PERSON_HEIGHT and speed <= MAX_CYCLING else "other"
    return "vehicle" if rigid and height >= MIN_VEHICLE_HEIGHT else "other"


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


def withdraw_untracked(
    classid: NDArray[np.uint16],
    untracked: NDArray[np.bool_],
    ground: NDArray[np.bool_],
    points: NDArray[np.float32],
    votes: Votes,
    porous: NDArray[np.bool_],
) -> NDArray[np.uint16]:
    """Make points stand that no track follows: those of porous things, and doubtful ground.

    Rays hit and pass fences and twigs in turn, and each sweep hits other parts of them, of which
    some seem to have been free. What is around these tells: where many places that were found free
    are porous, or most of them stand, a point that seems to move does not, unless many right beside
    it seem to, too. How many are porous is asked only of what no track follows.

    Parameters
    ----------
    classid : ndarray of uint16, shape (N,)
        With tracks.
    untracked : ndarray of bool, shape (N,)
        Dynamic points of no track.
    ground : ndarray of bool, shape (N,)
    points : ndarray of float32, shape (N, 3)
        The deskewed sweep, LiDAR frame, metres.
    porous : ndarray of bool, shape (N,)
        Of :class:`docdepth.dynamics.voting.OccupancyIntervals`.

    Returns
    -------
    ndarray of uint16, shape (N,)
    """
    left = ~ground & (votes.dynamic > 0)
    cells, cell = np.unique(_cell_keys(points[left]), return_inverse=True)
    moves = classid[left] >= DYNAMIC
    followed = moves & ~untracked[left]
    of_each = None, moves, ~followed, porous[left] & ~followed
    counts = np.stack([np.bincount(cell, of, minlength=len(cells)) for of in of_each])
    rows = np.flatnonzero(untracked)
    around = np.zeros((len(counts), len(rows)))
    if len(cells):
        here = _cell_keys(points[rows])
        for step in itertools.product((-1, 0, 1), repeat=3):
            there = here + _cell_keys(np.array([step], np.float32) * _CELL)
            at = np.minimum(np.searchsorted(cells, there), len(cells) - 1)
            around += np.where(cells[at] == there, counts[:, at], 0)
    free, free_dynamic, unfollowed, unfollowed_porous = around
    among_porous = unfollowed_porous > MAX_POROUS_SHARE * unfollowed
    among_static = free_dynamic < MIN_DYNAMIC_SHARE * free
    is_clear = votes.dynamic[rows] > MIN_FREE_RATIO * votes.static[rows].astype(np.int64)
    _, cell, size = np.unique(
        _cell_keys(points[rows], _DENSE_CELL), return_inverse=True, return_counts=True
    )
    dynamic, static = np.bincount(cell, votes.dynamic[rows]), np.bincount(cell, votes.static[rows])
    low, high = np.full(len(size), np.inf), np.full(len(size), -np.inf)
    np.minimum.at(low, cell, points[rows, 2])
    np.maximum.at(high, cell, points[rows, 2])
    is_many = (size >= _MIN_DENSE) & (high - low >= _DENSE_HEIGHT)
    is_dense = (is_many & (dynamic > _DENSE_FREE_RATIO * static))[cell]
    is_doubtful = (among_porous | among_static) & ~is_dense
    stands = rows[is_doubtful | (ground[rows] & ~is_clear)]
    classid = classid.copy()
    classid[stands] = np.where(ground[stands], GROUND, STATIC)
    return classid


def _cell_keys(points: NDArray[np.float32], edge: float = _CELL) -> NDArray[np.int64]:
    """Numbers of the cells of points; those of steps between cells can be added to them."""
    x, y, z = np.floor(points / edge).astype(np.int64).T
    return (x * 2**20 + y) * 2**20 + z


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
    if len(result.boxes):
        T = result.boxes["T_box_world"]
        for some in np.array_split(loose, len(loose) * len(T) // _PAIRS + 1):
            places = transform_points(T_world_lidar, points[some])
            inside = np.einsum("kij,nj->kni", T[:, :, :3], places) + T[:, None, :, 3]
            off = np.abs(inside) - result.boxes["half_size"][:, None]
            distance = np.linalg.norm(np.maximum(off, 0), axis=2)
            nearest = distance.argmin(axis=0)
            near = distance[nearest, np.arange(len(some))] <= BOX_MARGIN
            instance[some[near]] = result.boxes["track"][nearest[near]]
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
