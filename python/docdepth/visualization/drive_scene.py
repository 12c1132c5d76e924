"""What a view in 3D shows of a run: points with colours, boxes of tracks, cameras with depth.

Each viewer, Open3D and rerun, draws this description.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.errors import InputError
from docdepth.geometry.camera import Camera, points_of
from docdepth.geometry.lidar_frame import LidarFrame
from docdepth.geometry.points import DYNAMIC
from docdepth.geometry.se3 import inverse, transform_points
from docdepth.geometry.track import Track, Tracks
from docdepth.geometry.trajectory import Trajectory
from docdepth.io.depth import described_maps, maps_in, read_depth
from docdepth.io.run_folder import RunFolder
from docdepth.visualization.image_views import photo_of
from docdepth.visualization.pictures import (
    DYNAMIC_COLOR,
    STATIC_COLOR,
    TRACK_COLORS,
    colors_of_classes,
)

Coloring: TypeAlias = Literal["class", "votes", "instance"]
"""What the colour of a point says."""

_UNKNOWN_COLOR = (90, 90, 90)  # BGR, of points without votes or instance


@dataclass(frozen=True)
class SweepScene:
    """A sweep with what moves around it.

    Attributes
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame [m].
    colors : ndarray of float64, shape (N, 3)
        RGB, 0..1.
    T_world_lidar : ndarray of float64, shape (4, 4)
    boxes : list of (Track, ndarray of float64, shape (4, 4))
        Tracks at the time of the sweep, and ``T_world_object``.
    """

    points: NDArray[np.float32]
    colors: NDArray[np.float64]
    T_world_lidar: NDArray[np.float64]
    boxes: list[tuple[Track, NDArray[np.float64]]]


@dataclass(frozen=True)
class CameraView:
    """A camera in the world, with or without a depth map."""

    camera: Camera
    T_world_camera: NDArray[np.float64]  # (4, 4)
    depth: NDArray[np.float32] | None = None  # (h, w): metres along the optical axis; NaN = none
    # (h, w, 3): rectified, BGR; colours the points of the depth map
    image: NDArray[np.uint8] | None = None


def sweep_scene(
    run: RunFolder,
    trajectory: Trajectory,
    index: int,
    color: Coloring,
    tracks: Tracks,
    around: int = 0,
) -> SweepScene:
    """A sweep of a run, and the static points of ``around`` sweeps before and after."""
    T_world_lidar, time = trajectory.poses[index], int(trajectory.times[index])
    points, colors = [], []
    for k in range(max(index - around, 0), min(index + around + 1, len(trajectory))):
        sweep, classid = run.classified_frame(k)
        seen, tones = sweep.points, point_colors(sweep, classid, color)
        if k != index:  # moving objects of other sweeps would leave trails
            kept, T = classid < DYNAMIC, inverse(T_world_lidar) @ trajectory.poses[k]
            seen = transform_points(T, seen).astype(np.float32)[kept]
            tones = tones[kept]
        points.append(seen)
        colors.append(tones)
    boxes = [(track, track.pose_at(time)) for track in tracks.between(time, time)]
    return SweepScene(np.concatenate(points), np.concatenate(colors), T_world_lidar, boxes)


def camera_views(
    run: RunFolder,
    trajectory: Trajectory,
    camera: str | None,
    stream: CameraStream | None,
    nearest: int | None = None,
) -> Iterator[tuple[int, CameraView]]:
    """A camera at the time [ns] of each of its depth maps, or of the one nearest to a time.

    Parameters
    ----------
    camera : str, optional
        Needed if the run has several.
    stream : CameraStream, optional
        The camera; its images are read.
    nearest : int, optional
        A time [ns].
    """
    if not maps_in(run.path / "depth") and not run.cameras:
        return
    folder = run.depth_folder(camera)
    pinhole, T_camera_lidar, _ = run.calibration(folder)
    depths = run.path / "depth" / folder
    files, maps = maps_in(depths), described_maps(depths)
    times = {name: maps[name][0] for name in files if name in maps}
    if nearest is not None and times:
        name = min(times, key=lambda name: abs(times[name] - nearest))
        times = {name: times[name]}
    for name, time in times.items():
        pose = trajectory.interpolate([time])[0] @ inverse(T_camera_lidar)
        depth, image = read_depth(files[name]), photo_of(stream, name)
        yield time, CameraView(pinhole, pose, depth, image)


def back_project(camera: Camera, depth: NDArray[np.float32]) -> NDArray[np.float64]:
    """3D points of the pixels with depth.

    Parameters
    ----------
    depth : ndarray of float32, shape (h, w)
        Metres along the optical axis; NaN = none.

    Returns
    -------
    ndarray of float64, shape (k, 3)
        Camera frame [m], row by row.
    """
    if depth.shape != (camera.height, camera.width):
        raise InputError(
            f"depth {depth.shape} does not fit the camera, {camera.height} x {camera.width}"
        )
    return points_of(camera.K, depth, np.flatnonzero(np.isfinite(depth)))


def point_colors(
    record: LidarFrame, classid: NDArray[np.uint16], color: Coloring
) -> NDArray[np.float64]:
    """RGB colour of each point of a frame, float64 (N, 3), 0..1."""
    if color == "class":
        return class_colors(classid)
    if color == "votes" and record.votes_static is not None and record.votes_dynamic is not None:
        return vote_colors(record.votes_static, record.votes_dynamic)
    if color == "instance" and record.instance is not None:
        return instance_colors(record.instance)
    raise InputError(f"frame {record.name} has no {color}: its classes are of another method")


def class_colors(classid: NDArray[np.uint16]) -> NDArray[np.float64]:
    """RGB colour of each point by its class, float64 (N, 3), 0..1."""
    return _rgb(colors_of_classes(classid))


def vote_colors(
    votes_static: NDArray[np.uint16], votes_dynamic: NDArray[np.uint16]
) -> NDArray[np.float64]:
    """RGB colour of each point by its votes, from static grey to dynamic orange; dark without."""
    count = votes_static.astype(np.float64) + votes_dynamic
    share = (votes_dynamic / np.maximum(count, 1))[:, None]
    colors = (1 - share) * STATIC_COLOR + share * DYNAMIC_COLOR
    return _rgb(np.where(count[:, None] > 0, colors, _UNKNOWN_COLOR))


def instance_colors(instance: NDArray[np.uint16]) -> NDArray[np.float64]:
    """RGB colour of each point by its track, dark without one."""
    colors = np.array(TRACK_COLORS)[instance % len(TRACK_COLORS)]
    return _rgb(np.where(instance[:, None] > 0, colors, _UNKNOWN_COLOR))


def _rgb(colors: NDArray[Any]) -> NDArray[np.float64]:
    """BGR of 0..255 as RGB of 0..1."""
    return np.asarray(colors[:, ::-1] / 255.0)
