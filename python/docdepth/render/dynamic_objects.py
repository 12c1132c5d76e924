"""Objects that move: whose points a sweep holds, and where they are at the time of an image (ours).

A track tells which points are one object and where it is at any time. What a sweep saw of it is
carried along the track to the time of the image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC, STATIC
from docdepth.geometry.se3 import inverse, rotation_exp, transform_points
from docdepth.geometry.track import Track, Tracks

TOUCH = 0.2
"""A dynamic point without an instance that is this near to the box of a track is carried with it
[m]: boxes hold what was seen, so a mirror or a foot may stick out by as much."""


@dataclass(frozen=True)
class DynamicObjects:
    """The dynamic points of a sweep by object."""

    # (N,): 0 of static points, else the number of the point's object in this sweep, from 1 on
    object_index: NDArray[np.uint16]
    # of objects 1, 2, ...: the id of its track, or 0 of the points that are not followed
    instances: tuple[int, ...]
    # the time at which each object is held: the mean time of its measurements [ns]
    times: tuple[int, ...]
    # (objects, 4, 4): from the LiDAR to each object at that time; identity for points that are not
    # followed
    T_object_lidar: NDArray[np.float64]
    # (objects, 4): velocity of each object in the LiDAR frame [m/s], and its time [s after the
    # stamp]
    motion: NDArray[np.float32]
    # (N,): seconds from the stamp to each measurement
    time_offset: NDArray[np.float32] | None = None
    # (N, 3): moves each point from where it was measured to where it is at the time of its object
    # [m]
    displacement: NDArray[np.float32] | None = None
    # (objects,): which objects images draw; all if absent. The others are not placed
    visible: NDArray[np.bool_] | None = None

    def select(self, rows: NDArray[np.bool_]) -> DynamicObjects:
        """The objects of some points."""
        late = None if self.time_offset is None else self.time_offset[rows]
        moved = None if self.displacement is None else self.displacement.compress(rows, axis=0)
        return replace(
            self, object_index=self.object_index[rows], time_offset=late, displacement=moved
        )


def dynamic_objects(
    frame: LidarFrame,
    time: int = 0,
    T_world_lidar: NDArray[np.float64] | None = None,
    tracks: Tracks | None = None,
    is_drawn: Callable[[int, int], bool] | None = None,
) -> DynamicObjects:
    """Divide the dynamic points of a sweep into objects, each held at one time.

    A sweep takes a tenth of a second, in which a car moves by metres. Each point is moved with its
    track from the time of its measurement to the mean time of its object.

    Parameters
    ----------
    frame : LidarFrame
        With classes. Its points are deskewed with the motion of the LiDAR alone. Where it has
        instances, they are ids of ``tracks``.
    time : int
        Stamp of the sweep [ns].
    T_world_lidar : ndarray of float64, shape (4, 4)
        Pose at the stamp. It and ``time`` matter for tracks only.
    is_drawn : callable, optional
        Whether images draw what was seen of a track, given its id, at a time [ns]; they draw all
        tracks if absent.
    """
    points, instance, time_offset = frame.points, frame.instance, frame.time_offset
    tracks = tracks or Tracks()
    pose = np.eye(4) if T_world_lidar is None else T_world_lidar
    inside = _inside_boxes(frame, time, pose, tracks)
    rows = np.flatnonzero((frame.classes >= DYNAMIC) | (inside > 0))
    ids = inside[rows]
    delay = np.zeros(len(rows)) if time_offset is None else time_offset[rows].astype(np.float64)
    world = points[rows].astype(np.float64)
    if tracks:
        world = transform_points(pose, world)
        if instance is not None:
            known = (frame.classes[rows] >= DYNAMIC) & np.isin(instance[rows], tracks.ids)
            ids[known] = instance[rows][known]
        _assign_to_tracks(ids, world, time, tracks)
    instances, number = np.unique(ids, return_inverse=True)
    object_index = np.zeros(len(points), np.uint16)
    object_index[rows] = number + 1
    count = len(instances)
    times: list[int] = []
    visible = np.ones(count, np.bool_)
    motion, T_object_lidar = np.zeros((count, 4), np.float32), np.repeat(np.eye(4)[None], count, 0)
    displacement = np.zeros(points.shape, np.float32) if instances.any() else None
    for k, of in enumerate(instances.tolist()):
        own = number == k
        late = float(delay[own].mean())
        times.append(int(time) + round(late * 1e9))
        motion[k, 3] = late
        visible[k] = not of or not is_drawn or is_drawn(of, times[k])
        if not of or not visible[k] or displacement is None:
            continue
        track = tracks[of]
        T_object_lidar[k] = inverse(track.pose_at(times[k])) @ pose
        motion[k, :3] = track.velocity_at(times[k]) @ pose[:3, :3]
        moved = _at_time(world[own], late - delay[own], track, times[k])
        displacement[rows[own]] = (moved - world[own]) @ pose[:3, :3]
    return DynamicObjects(
        object_index,
        tuple(instances.tolist()),
        tuple(times),
        T_object_lidar,
        motion,
        None if time_offset is None else time_offset.astype(np.float32),
        displacement,
        visible,
    )


def _at_time(
    world: NDArray[np.float64], earlier: NDArray[np.float64], track: Track, time: int
) -> NDArray[np.float64]:
    """Points measured ``earlier`` seconds before ``time``, as the object is at ``time``."""
    velocity, centre = track.velocity_at(time), track.pose_at(time)[:3, 3]
    turn_rate = track.turn_rate_at(time)
    then = centre - earlier[:, None] * velocity
    if not turn_rate.any():
        return np.asarray(centre + (world - then))
    turn = rotation_exp(earlier[:, None] * turn_rate)
    return np.asarray(centre + np.einsum("nij,nj->ni", turn, world - then))


def _inside_boxes(
    frame: LidarFrame, time: int, T_world_lidar: NDArray[np.float64], tracks: Tracks
) -> NDArray[np.int64]:
    """For each static point off the ground the track in whose box it lies, else 0, (N,).

    Nothing else is where an object is. A hundredth of the points of a lorry are labelled static.
    """
    ids = np.zeros(len(frame.points), np.int64)
    static = np.flatnonzero((frame.classes >= STATIC) & (frame.classes < DYNAMIC))
    x, y = frame.points[static, 0], frame.points[static, 1]
    late = 0.0 if frame.time_offset is None else np.abs(frame.time_offset).max(initial=0)
    for track in reversed(tracks.between(time, time)):
        T_object_lidar = inverse(track.pose_at(time)) @ T_world_lidar
        velocity = T_object_lidar[:3, :3] @ T_world_lidar[:3, :3].T @ track.velocity_at(time)
        reach = 0.5 * np.linalg.norm(track.size) + late * np.linalg.norm(velocity)
        middle = inverse(T_object_lidar)[:3, 3]
        low, high = (middle - reach).astype(np.float32), (middle + reach).astype(np.float32)
        near = static[(x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])]
        local = transform_points(T_object_lidar, frame.points[near])
        if frame.time_offset is not None:
            local -= frame.time_offset[near, None] * velocity
        half = 0.5 * track.size
        ids[near[(np.abs(local - (0, 0, half[2])) <= half).all(axis=1)]] = track.id
    return ids


def _assign_to_tracks(
    ids: NDArray[np.int64], world: NDArray[np.float64], time: int, tracks: Tracks
) -> None:
    """Give dynamic points without an instance to the track whose box they lie in or touch."""
    unassigned = np.flatnonzero(ids == 0)
    for track in tracks.between(time, time):
        if not len(unassigned):
            return
        T = inverse(track.pose_at(time))
        local = transform_points(T, world[unassigned])
        half = 0.5 * track.size + TOUCH
        inside = (np.abs(local - (0, 0, 0.5 * track.size[2])) <= half).all(axis=1)
        ids[unassigned[inside]] = track.id
        unassigned = unassigned[~inside]
