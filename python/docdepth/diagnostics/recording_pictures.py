"""Pictures of a recording: sweeps over each other by their poses, and points on images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import CameraStream, Dataset, usable_points
from docdepth.diagnostics.inspection import Inspection
from docdepth.errors import DocDepthError
from docdepth.geometry.ground_plane import GroundPlane, level_turn
from docdepth.geometry.se3 import inverse
from docdepth.geometry.trajectory import Trajectory
from docdepth.visualization.overlays import COLOR_NAMES, clouds_in_plane, points_on_image
from docdepth.visualization.pictures import Picture

_APART = 2.5  # metres between sweeps that are overlaid near each other
_REACH = 20.0  # metres around them
_SLAB = 4.0  # metres to each side that the view from the side shows
_WIDEST = 1300  # pixels; wider images are reduced
_MOST_CAMERAS = 12

Floats = NDArray[np.float64]


def pictures_of(recording: Dataset, result: Inspection) -> Iterator[tuple[Picture, str]]:
    """Pictures with their captions; none of what cannot be read.

    Parameters
    ----------
    recording : Dataset
    result : Inspection
    """
    if not result.sweeps:  # all are broken
        return
    try:
        yield from _sweeps_over_each_other(recording, result)
    except DocDepthError as error:
        result.note("no-picture", f"no picture of sweeps over each other: {error}")
    yield from _from_the_side(result)
    for name in list(recording.cameras)[:_MOST_CAMERAS]:
        try:
            yield from _on_image(recording, recording.cameras[name], result)
        except DocDepthError as error:
            result.note("no-picture", f"no picture of {name}: {error}")


def _sweeps_over_each_other(
    recording: Dataset, result: Inspection
) -> Iterator[tuple[Picture, str]]:
    poses, count = result.poses, len(recording)
    if poses is not None and count > 2:
        frames = [0, count // 2, count - 1]
        path = _in_frame_of(poses, frames[0], result.ground)
        clouds = _clouds(recording, result, frames, poses[frames])
        yield clouds_in_plane(clouds, path), f"by the given poses, from above: {_named(frames)}"
        frames = _near_each_other(poses, count // 2)
        clouds = _clouds(recording, result, frames, poses[frames])
        path = _in_frame_of(poses, frames[0], result.ground)[frames]
        yield (
            clouds_in_plane(clouds, path, reach=_REACH),
            f"the same close up: {_named(frames)}. Surfaces that do not move lie on each other if "
            "the poses are right",
        )
    for window in result.windows[:1]:
        steps = sorted({0, len(window.measured) // 2, len(window.measured) - 1})
        frames = [window.first + k for k in steps]
        clouds = _clouds(recording, result, frames, window.measured[steps])
        path = _in_frame_of(window.measured, 0, result.ground)
        yield (
            clouds_in_plane(clouds, path, reach=_REACH),
            f"registered without poses, from above: {_named(frames)}",
        )


def _from_the_side(result: Inspection) -> Iterator[tuple[Picture, str]]:
    frame = list(result.sweeps)[len(result.sweeps) // 2]
    points = result.sweeps[frame].points
    points = points[usable_points(points)]
    points = points[(np.abs(points[:, 1]) < _SLAB) & (np.abs(points[:, 0]) < 2 * _REACH)]
    if len(points):
        yield (
            clouds_in_plane([points], np.zeros((1, 3)), (2, 0)),
            f"frame {frame} as recorded, from the side: z up, x to the left",
        )


def _on_image(
    recording: Dataset, stream: CameraStream, result: Inspection
) -> Iterator[tuple[Picture, str]]:
    times = recording.times
    inside = np.flatnonzero((stream.times >= times[0]) & (stream.times <= times[-1]))
    every = inside if len(inside) else np.arange(len(stream.times))
    if not len(every):
        return
    image = int(every[len(every) // 2])
    frame = int(np.abs(times - stream.times[image]).argmin())
    points = recording.sweep(frame).points
    points = points[usable_points(points)].astype(np.float64)
    late = (int(stream.times[image]) - int(times[frame])) * 1e-9
    moved = ""
    if result.poses is not None and len(inside) and len(times) > 1:
        then = Trajectory(times, result.poses).interpolate(stream.times[image : image + 1])[0]
        T = inverse(then) @ result.poses[frame]
        points, moved = points @ T[:3, :3].T + T[:3, 3], ", moved to its time by the poses"
    picture = points_on_image(
        points, stream.camera, stream.T_camera_lidar, stream.rectified_image(image)
        if stream.images else None,
    )  # fmt: skip
    scale = min(1.0, _WIDEST / picture.shape[1])
    if scale < 1:
        picture = np.asarray(
            cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
        )
    yield (
        picture,
        f"{stream.name}: points of frame {frame} on image {stream.names[image]}, taken "
        f"{1000 * late:.0f} ms after its stamp{moved}",
    )


def _clouds(
    recording: Dataset, result: Inspection, frames: Sequence[int], poses: Floats
) -> list[NDArray[np.float32]]:
    """Points of sweeps in the frame of the first of them, turned so that the ground is level."""
    level, clouds = _level(result.ground), []
    for frame, pose in zip(frames, poses, strict=True):
        sweep = result.sweeps[frame] if frame in result.sweeps else recording.sweep(frame)
        T = inverse(poses[0]) @ pose
        points = sweep.points[usable_points(sweep.points)].astype(np.float64)
        points = (points @ T[:3, :3].T + T[:3, 3]) @ level.T
        clouds.append(points.astype(np.float32))
    return clouds


def _in_frame_of(poses: Floats, first: int, ground: GroundPlane | None) -> Floats:
    """Places of poses as :func:`_clouds` has points."""
    path: Floats = (inverse(poses[first]) @ poses)[:, :3, 3] @ _level(ground).T
    return path


def _near_each_other(poses: Floats, first: int) -> list[int]:
    """A frame, and two that are a few metres farther along the path."""
    places = poses[:, :3, 3]
    along = np.concatenate([[0], np.linalg.norm(np.diff(places, axis=0), axis=1).cumsum()])
    frames = [first]
    for _ in range(2):
        after = int(np.searchsorted(along, along[frames[-1]] + _APART))
        frames.append(min(max(after, frames[-1] + 1), len(poses) - 1))
    return sorted(set(frames))


def _named(frames: Sequence[int]) -> str:
    names = zip(frames, COLOR_NAMES, strict=False)
    return ", ".join(f"frame {frame} {color}" for frame, color in names)


def _level(ground: GroundPlane | None) -> Floats:
    """The turn (3, 3) that brings the ground's normal to z."""
    return np.eye(3) if ground is None else level_turn(ground.up)
