"""Tracks as labels of KITTI's tracking benchmark: boxes in the images of one camera."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import inverse
from docdepth.geometry.track import Track
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.atomic import WriteFile, write_atomically

KITTI_TRACKS = "tracks_kitti.txt"
"""Name of the file in a run, one for each camera."""

TYPES = {"vehicle": "Car", "person": "Pedestrian", "other": "Misc"}
"""KITTI's type of each kind of track."""

_NEAR = 0.1
"""Corners of a box that are nearer to the image plane are not projected [m]."""
_UNKNOWN_OCCLUSION = 3


def write_kitti_tracking(
    path: Path,
    tracks: Iterable[Track],
    camera: Camera,
    T_world_camera: Trajectory,
    indices: NDArray[np.int64],
    write_file: WriteFile = write_atomically,
) -> None:
    """Write the boxes of tracks that an image shows, ordered by image and id.

    Parameters
    ----------
    path : Path
    tracks : iterable of Track
        An image has the tracks whose time covers its own.
    camera : Camera
    T_world_camera : Trajectory
        At the time of each image.
    indices : ndarray of int64, shape (n,)
        Number of each image.
    write_file : callable
    """
    rows, times = [], T_world_camera.times
    for track in tracks:
        first = int(np.searchsorted(times, track.times[0]))
        end = int(np.searchsorted(times, track.times[-1], side="right"))
        for k in range(first, end):
            T_camera_object = inverse(T_world_camera.poses[k]) @ track.pose_at(int(times[k]))
            row = _row(track, T_camera_object, camera)
            rows += [(int(indices[k]), track.id, row)] if row else []
    content = "".join(f"{index} {number} {row}\n" for index, number, row in sorted(rows)).encode()
    write_file(path, lambda stream: stream.write(content))


def box_in_image(
    size: NDArray[np.float64], T_camera_object: NDArray[np.float64], camera: Camera
) -> NDArray[np.float64] | None:
    """Least and greatest u and v of the box of an object, (2, 2); None where no image shows it."""
    corners = _corners(size, T_camera_object)
    in_front = corners[corners[:, 2] > _NEAR]
    if not len(in_front):
        return None
    pixels = (in_front / in_front[:, 2:]) @ camera.K[:2].T
    box = np.stack([pixels.min(0), pixels.max(0)])
    outside = (box[1] < 0).any() or (box[0] > _last(camera)).any()
    return None if outside else box


def _corners(
    size: NDArray[np.float64], T_camera_object: NDArray[np.float64]
) -> NDArray[np.float64]:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 1)])
    result: NDArray[np.float64] = corners * size @ T_camera_object[:3, :3].T
    return result + T_camera_object[:3, 3]


def _last(camera: Camera) -> NDArray[np.int64]:
    return np.array([camera.width, camera.height]) - 1


def _row(track: Track, T_camera_object: NDArray[np.float64], camera: Camera) -> str:
    """A label without image and id; empty if the image does not show the box."""
    box = box_in_image(track.size, T_camera_object, camera)
    if box is None:
        return ""
    length, width, height = track.size
    (low, high), last = box, _last(camera)
    behind = (_corners(track.size, T_camera_object)[:, 2] <= _NEAR).any()
    truncated = int(behind or (low < 0).any() or (high > last).any())
    x, y, z = T_camera_object[:3, 3]
    forward = T_camera_object[:3, 0]
    rotation = np.arctan2(-forward[2], forward[0])
    alpha = np.angle(np.exp(1j * (rotation - np.arctan2(x, z))))
    numbers = [alpha, *low.clip(0, last), *high.clip(0, last)]
    numbers += [height, width, length, x, y, z, rotation]
    text = " ".join(f"{number:.4f}" for number in numbers)
    return f"{TYPES[track.kind]} {truncated} {_UNKNOWN_OCCLUSION} {text}"
