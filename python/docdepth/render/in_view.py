"""Which objects some image draws (ours).

A LiDAR looks all around, a camera ahead. What no camera sees of an object need not be made ready.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.camera import Camera, View
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.render.object_views import MAX_NONRIGID_SECONDS, object_radius, within_image
from docdepth.render.selection import DYNAMIC_SWEEPS

Floats: TypeAlias = NDArray[np.float64]

_ROUNDING = 1e-3
"""Here positions are computed in another order than where objects are drawn [m]."""


class TracksInView:
    """When images may show each track.

    A track may be said to be in view where it is not, never the other way round.

    Parameters
    ----------
    tracks : Tracks
    trajectory : Trajectory
        Poses and times of all sweeps.
    views : sequence of View
        All images that are drawn; those of each camera in order of time.
    """

    def __init__(self, tracks: Tracks, trajectory: Trajectory, views: Sequence[View]) -> None:
        self._tracks, self._trajectory = tracks, trajectory
        self._images = _by_camera(views)
        self._times_of = cache(self._find_times)

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

    def _find_times(self, instance: int) -> NDArray[np.int64]:
        return _times(self._tracks[instance], self._trajectory, self._images)


class _Images(NamedTuple):
    """The images of a camera: times (n,) [ns], ascending, and ``T_camera_world`` (n, 4, 4)."""

    camera: Camera
    times: NDArray[np.int64]
    T_camera_world: Floats


def _by_camera(views: Sequence[View]) -> list[_Images]:
    cameras = {id(view.camera): view.camera for view in views}
    found = []
    for camera in cameras.values():
        own = [view for view in views if view.camera is camera]
        times = np.array([view.time for view in own], np.int64)
        found.append(_Images(camera, times, np.stack([view.T_camera_world for view in own])))
    return found


def _times(track: Track, trajectory: Trajectory, images: Sequence[_Images]) -> NDArray[np.int64]:
    """Times of the images that may show a track, ascending [ns]."""
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
