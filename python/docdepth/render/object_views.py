"""What the sweeps of an image saw of the objects that move, placed at the time of the image (ours).

A car is rigid, so every sweep that saw it tells about it. A person is not: only the sweeps around
the image do. A LiDAR looks all around, a camera ahead: what no camera sees of an object need not be
made ready.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from operator import attrgetter
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.camera import Camera, View
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.render_sweep import RenderSweep
from docdepth.render.selection import (
    DYNAMIC_SWEEPS,
    DrawnSweeps,
    lidar_range,
    seen_to_its_top,
    sweeps_of_track,
)

MAX_NONRIGID_SECONDS = 0.12
"""Sweeps farther in time from the image are not used for objects that are not rigid [s]: a walking
leg moves noticeably beyond this."""

MOST_VIEWS = 24
"""Sweeps that an object is drawn from. Rings of one sweep lie up to a degree apart; two dozen, each
with rings elsewhere on the object, leave gaps of a pixel."""

MAX_SURFACE_DEVIATION = 0.1
"""Largest standard deviation of the surface across itself at which other sweeps are used [m];
otherwise they blur the object."""

MAX_POSITION_DEVIATION = 0.15
"""Largest standard deviation of the position, as a share of the object's length, at which other
sweeps are used [-]; otherwise they smear its outline."""

MAX_VEHICLE_RANGE = 30.0
"""Vehicles farther than this are drawn from the sweeps around the image alone [m]."""

MAX_RANGE_RATIO = 1.25
"""Sweeps that saw a vehicle from a larger multiple of the present range are not used [-]: they show
less of it than those around the image."""

EXTRAPOLATION_NS = 2_500_000_000
"""Boxes are extrapolated so long before the first and after the last observation [ns]: the object
comes over a hill, or into the view of a narrow LiDAR. The box may be metres off by then. That costs
a few pixels, of those only at which no ray looked."""

BOX_MARGIN = 1.0
"""An object may reach this far beyond the box of its track [m]."""

VEHICLE_HEIGHT, PERSON_HEIGHT = 4.2, 2.2
"""Road vehicles, and persons or cyclists, are no higher above the ground [m]: bridges on European
roads let 4.2 to 4.5 m pass."""

HEIGHT_MARGIN = 0.4
"""The box of a vehicle may lie this much too low [m]: where the road bends upwards, a van that is
seen from the front alone is tracked 0.4 m below its position."""

MOST_RAYS = 8
"""Sweeps whose rays tell where an object ends: those around the image and as many others."""

_ROUNDING = 1e-3
""":class:`TracksInView` computes positions in another order than where objects are drawn [m]."""

Floats: TypeAlias = NDArray[np.float64]
ObjectView: TypeAlias = tuple[Any, int, Floats, int]
"""A ``_core.MeshFrame``, the number of the object in it, ``T_camera_sensor``, and the number of the
sweep."""
Triple: TypeAlias = tuple[float, float, float]
PlacedBox: TypeAlias = tuple[Floats, Triple, Triple]
"""``T_camera_box``; length, width and height [m]; velocity in the frame of the camera [m/s]."""
ObjectViews: TypeAlias = tuple[int, list[ObjectView], list[ObjectView], list[ObjectView]]
"""Instance, views of sweeps around the image and of others, and those whose rays tell where the
object ends."""


class _Observation(NamedTuple):
    """An object in one sweep, and how far the sweep is from the image in time [ns]."""

    number: int
    sweep: int
    object_index: int
    time_distance: int


def object_views(
    view: View,
    trajectory: Trajectory,
    sweeps: Callable[[int], RenderSweep],
    drawn: DrawnSweeps,
    tracks: Tracks,
    first_number: int,
) -> list[ObjectViews]:
    """The argument ``objects`` of the core's renderers.

    The LiDARs of the sweeps ``drawn.with_objects`` are numbered from ``first_number`` on.
    """
    seen: dict[int, list[_Observation]] = {}
    number = first_number
    for sweep in drawn.with_objects:
        objects = sweeps(sweep).objects
        for object_index, instance in enumerate(objects.instances, 1):
            time_distance = abs(objects.times[object_index - 1] - view.time)
            seen.setdefault(instance, []).append(
                _Observation(number, sweep, object_index, time_distance)
            )
        number += len(sweeps(sweep).parts)
    found: list[ObjectViews] = []
    unassigned = [one for one in seen.pop(0, []) if one.sweep == drawn.dynamic[0]]
    for one in unassigned:
        T_camera_lidar = view.T_camera_world @ trajectory.poses[one.sweep]
        placed = _views_of(sweeps(one.sweep), one, T_camera_lidar)
        found.append((0, placed, [], placed))
    for instance in sorted(seen):
        if not any(one.sweep in drawn.dynamic for one in seen[instance]):
            continue  # nobody knows where it is by now
        T_camera_object = view.T_camera_world @ tracks[instance].pose_at(view.time)
        if not _in_view(view.camera, T_camera_object, tracks[instance]):
            continue
        near, far = _chosen(seen[instance], drawn, trajectory, tracks[instance], view.time)
        around, others, rays = (
            [
                placed
                for one in some
                for placed in _views_of(sweeps(one.sweep), one, T_camera_object)
            ]
            for some in (near, far, (near + far)[:MOST_RAYS])
        )
        if around:  # of what is not rigid those within MAX_NONRIGID_SECONDS
            found.append((instance, around, others, rays))
    return found


def boxes_in_view(view: View, trajectory: Trajectory, tracks: Tracks) -> list[PlacedBox]:
    """Objects that the camera may see: where they are, how large each may be, and how fast.

    A box that contains the camera or the LiDAR is none: the vehicle itself is there.
    """
    found = []
    T_camera_world = view.T_camera_world
    lidar = T_camera_world @ trajectory.interpolate(view.time)[0][:, 3]
    own = np.stack([np.zeros(3), lidar[:3]])
    for track in tracks.between(view.time - EXTRAPOLATION_NS, view.time + EXTRAPOLATION_NS):
        if track.deviation_at(view.time) > track.size[:2].max():
            continue  # it is more likely elsewhere than there
        T_camera_object = T_camera_world @ track.pose_at(view.time)
        if not _in_view(view.camera, T_camera_object, track):
            continue
        extent = _extent(track, trajectory)
        if not _contains(T_camera_object, extent, own):
            x, y, z = (T_camera_world[:3, :3] @ track.velocity_at(view.time)).tolist()
            found.append((T_camera_object, extent, (x, y, z)))
    return found


def _contains(T_camera_object: Floats, extent: Triple, places: Floats) -> bool:
    """Whether a box contains one of some places (n, 3); its origin is the middle of its bottom."""
    x, y, z = ((places - T_camera_object[:3, 3]) @ T_camera_object[:3, :3]).T
    length, width, height = extent
    inside = (np.abs(x) <= length / 2) & (np.abs(y) <= width / 2) & (z >= 0) & (z <= height)
    return bool(inside.any())


def _views_of(sweep: RenderSweep, seen: _Observation, T_camera_object: Floats) -> list[ObjectView]:
    """What each LiDAR of a sweep saw of an object, placed where the object is now.

    What is not followed stays in the frame of the sweep, whose ``T_object_lidar`` is the identity.
    """
    found = []
    T_camera_lidar = T_camera_object @ sweep.objects.T_object_lidar[seen.object_index - 1]
    for k in sweep.seen_by(seen.object_index):
        core, T_lidar_sensor = sweep.parts[k]
        found.append((core, seen.object_index, T_camera_lidar @ T_lidar_sensor, seen.number + k))
    return found


def _extent(track: Track, trajectory: Trajectory) -> Triple:
    """How long, wide and high an object may be: its height may never have been seen."""
    length, width, height = track.size.tolist()
    person = track.kind == "person"
    if not seen_to_its_top(track, trajectory):
        height = max(height, PERSON_HEIGHT if person else VEHICLE_HEIGHT)
    elif not person:
        height += HEIGHT_MARGIN
    return length, width, height


def _in_view(camera: Camera, T_camera_object: Floats, track: Track) -> bool:
    """Whether the camera may see something of the object."""
    middle = T_camera_object[:3, :3] @ (0, 0, 0.5 * track.size[2]) + T_camera_object[:3, 3]
    return bool(within_image(camera, middle, object_radius(track)))


def object_radius(track: Track) -> float:
    """No part of an object lies farther from the middle of its box [m]."""
    return float(np.linalg.norm(track.size)) / 2 + BOX_MARGIN


def within_image(camera: Camera, places: Floats, radius: float) -> NDArray[np.bool_]:
    """Whether an image may show something within ``radius`` [m] of each place (n, 3), or (3,)."""
    x, y, z = places.T
    shown = z >= -radius
    for offset, focal, centre, pixels in (
        (x, camera.K[0, 0], camera.K[0, 2], camera.width),
        (y, camera.K[1, 1], camera.K[1, 2], camera.height),
    ):
        for normal, limit in ((focal, centre), (-focal, pixels - centre)):
            # Distance to the plane through the camera and a border of the image.
            shown = shown & ((normal * offset + limit * z) / np.hypot(normal, limit) >= -radius)
    return np.asarray(shown)


def _is_known(track: Track, time: int) -> bool:
    """Whether the place of an object is known so well that other sweeps can draw it."""
    length = float(track.size[:2].max())
    return (
        track.surface_deviation_at(time) <= MAX_SURFACE_DEVIATION
        and track.deviation_at(time) <= MAX_POSITION_DEVIATION * length
    )


def _chosen(
    observations: list[_Observation],
    drawn: DrawnSweeps,
    trajectory: Trajectory,
    track: Track,
    time: int,
) -> tuple[list[_Observation], list[_Observation]]:
    """The observations of an object by the sweeps around the image, and by others, to draw."""
    around = sorted(
        (one for one in observations if one.sweep in drawn.dynamic), key=attrgetter("time_distance")
    )
    if track.kind != "vehicle":
        return [one for one in around if one.time_distance <= MAX_NONRIGID_SECONDS * 1e9], []
    distance = lidar_range(track, trajectory, time)
    if not _is_known(track, time) or distance > MAX_VEHICLE_RANGE:
        return around, []
    stamp = {one.sweep: int(trajectory.times[one.sweep]) for one in observations}
    known = [one for one in observations if _is_known(track, stamp[one.sweep])]
    others = sorted(
        (one for one in known if one.sweep not in drawn.dynamic), key=attrgetter("time_distance")
    )
    own = set(sweeps_of_track(track, trajectory, time))
    further = [one for one in others if one.sweep in own]
    others = [
        one
        for one in others
        if one.sweep not in own
        and one.sweep not in drawn.tracked
        and lidar_range(track, trajectory, stamp[one.sweep]) <= MAX_RANGE_RATIO * distance
    ]
    room = MOST_VIEWS - len(around) - len(further)
    if len(others) > room:
        spread = np.linspace(0, len(others) - 1, room).round().astype(int)
        others = [others[i] for i in spread.tolist()]
    return around, others + further


class TracksInView:
    """When images may show each track.

    A track may be said to be in view where it is not, never the other way round.

    Parameters
    ----------
    trajectory : Trajectory
        Poses and times of all sweeps.
    views : sequence of View
        All images that are drawn; those of each camera in order of time.
    """

    def __init__(self, tracks: Tracks, trajectory: Trajectory, views: Sequence[View]) -> None:
        self._tracks = tracks
        by_camera: dict[int, list[View]] = {}
        for view in views:
            by_camera.setdefault(id(view.camera), []).append(view)
        images = [
            (
                own[0].camera,
                np.array([view.time for view in own], np.int64),
                np.stack([view.T_camera_world for view in own]),
            )
            for own in by_camera.values()
        ]
        self._times_of = cache(
            lambda instance: _times_in_view(tracks[instance], trajectory, images)
        )

    def draws(self, instance: int, time: int) -> bool:
        """Whether an image draws what was seen of a track at ``time`` [ns].

        A vehicle is drawn from all sweeps that saw it, anything else from those around the image.
        """
        track, times = self._tracks[instance], self._times_of(instance)
        if not track.covers(time) or not len(times):
            return bool(len(times))
        if track.kind == "vehicle":
            return True
        reach = round(MAX_NONRIGID_SECONDS * 1e9)
        first = int(np.searchsorted(times, np.int64(time - reach)))
        return first < len(times) and int(times[first]) <= time + reach


def _times_in_view(
    track: Track,
    trajectory: Trajectory,
    images: Sequence[tuple[Camera, NDArray[np.int64], Floats]],
) -> NDArray[np.int64]:
    """Times of the images that may show a track, ascending [ns].

    ``images`` are each camera, the times of its images, ascending, and ``T_camera_world``.
    """
    stamps, reach = trajectory.times, DYNAMIC_SWEEPS + 1
    # A track is drawn only if one of the sweeps around the image saw it.
    begin, end = np.searchsorted(stamps, track.times[[0, -1]])
    low, high = stamps[max(begin - reach, 0)], stamps[min(end + reach, len(stamps) - 1)]
    found = []
    for camera, times, T_camera_world in images:
        first, last = np.searchsorted(times, low), np.searchsorted(times, high, side="right")
        some = times[first:last]
        T = T_camera_world[first:last]
        places = np.einsum("nij,nj->ni", T[:, :3, :3], _positions(track, some)) + T[:, :3, 3]
        # Its middle lies half its height above its position, wherever it leans to.
        radius = object_radius(track) + 0.5 * track.size[2] + _ROUNDING
        found.append(some[within_image(camera, places, radius)])
    return np.sort(np.concatenate(found)) if found else np.empty(0, np.int64)


def _positions(track: Track, times: NDArray[np.int64]) -> Floats:
    """Where a track is, shape (n, 3); before and after it is known it goes on as it moves there."""
    elapsed = (times - track.times[0]).astype(np.float64)
    known = (track.times - track.times[0]).astype(np.float64)
    positions = np.stack(
        [np.interp(elapsed, known, track.poses[:, axis, 3]) for axis in range(3)], axis=1
    )
    early, late = np.minimum(elapsed, 0), np.maximum(elapsed - known[-1], 0)
    for beyond, end in ((early, 0), (late, -1)):
        positions += 1e-9 * beyond[:, None] * track.velocities[end]
    return positions
