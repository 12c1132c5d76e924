"""Pictures of a recording: sweeps over each other by their poses, and points on images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets import CameraStream, Dataset, usable_points
from docdepth.diagnostics.recording_checks import Inspection
from docdepth.errors import DocDepthError
from docdepth.geometry.camera import Camera, pixels_in_image
from docdepth.geometry.ground_plane import GroundPlane, level_turn
from docdepth.geometry.se3 import inverse, transform_points
from docdepth.geometry.trajectory import Trajectory
from docdepth.visualization.pictures import Picture, overlay, reduced, round_length, spread_depth

_APART = 2.5  # metres between sweeps that are overlaid near each other
_REACH = 20.0  # metres around them
_SLAB = 4.0  # metres to each side that the view from the side shows
_WIDEST = 1300  # pixels; wider images are reduced
_MOST_CAMERAS = 12

Floats = NDArray[np.float64]


def pictures_of(recording: Dataset, result: Inspection) -> Iterator[tuple[Picture, str]]:
    """Pictures with their captions; none of what cannot be read."""
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
    recorded = recording.sweep(frame).points
    points = recorded[usable_points(recorded)].astype(np.float64)
    late = (int(stream.times[image]) - int(times[frame])) * 1e-9
    moved = ""
    if result.poses is not None and len(inside) and len(times) > 1:
        then = Trajectory(times, result.poses).interpolate(stream.times[image : image + 1])[0]
        T = inverse(then) @ result.poses[frame]
        points, moved = transform_points(T, points), ", moved to its time by the poses"
    picture = points_on_image(
        points, stream.camera, stream.T_camera_lidar, stream.rectified_image(image)
        if stream.images else None,
    )  # fmt: skip
    yield (
        reduced(picture, _WIDEST / picture.shape[1]),
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
        points = transform_points(T, points) @ level.T
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


COLORS = ((90, 90, 255), (110, 220, 90), (255, 170, 70))
"""Of the first, second and third sweep: red, green, blue. Where all three are, it is white."""
COLOR_NAMES = ("red", "green", "blue")

_PATH = (0, 230, 255)
_BACKGROUND = 24
_POINT = 1 / 900  # half the side of a point, as a share of the image's width


def clouds_in_plane(
    clouds: Sequence[NDArray[np.floating]],
    path: NDArray[np.floating] | None = None,
    axes: tuple[int, int] = (0, 1),
    reach: float | None = None,
    size: int = 900,
) -> Picture:
    """Draw up to three clouds over each other, seen along an axis.

    Parameters
    ----------
    clouds : sequence of ndarray, shape (N, 3)
        In one frame, metres. Each has one of :data:`COLORS`; colours add up.
    path : ndarray, shape (n, 3), optional
        Places to join by a line.
    axes : (int, int)
        Axis that points up in the picture, and the one that points left; (2, 0) is from the side.
    reach : float, optional
        Metres from the middle to the edges; all but the farthest points fit if left out.
    size : int
        Width of the picture; its height is no more [pixels].
    """
    up, left = axes
    every = np.concatenate([cloud[:, [up, left]] for cloud in clouds])
    spread = np.quantile(every, [0.01, 0.99], axis=0) if len(every) else np.zeros((2, 2))
    if reach is None:
        low, high = spread
    else:
        middle = np.median(every, axis=0) if path is None else path[:, [up, left]].mean(axis=0)
        low, high = middle - reach, middle + reach
    scale = size / max(float((high - low).max()), 1.0)
    height, width = (max(round(float(s)), 60) for s in (high - low) * scale)
    picture = np.zeros((height, width, 3), np.int32)
    for cloud, color in zip(clouds, COLORS, strict=False):
        row = np.floor((high[0] - cloud[:, up]) * scale)
        column = np.floor((high[1] - cloud[:, left]) * scale)
        inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
        mask = np.zeros((height, width), np.bool_)
        mask[row[inside].astype(int), column[inside].astype(int)] = True
        picture[mask] += np.array(color)
    result = np.clip(picture, 0, 255).astype(np.uint8)
    result[(picture == 0).all(axis=2)] = _BACKGROUND
    if path is not None:
        line = (high - path[:, [up, left]]) * scale
        cv2.polylines(
            result, [np.rint(line[:, ::-1]).astype(np.int32)], False, _PATH, 1, cv2.LINE_AA
        )
    return _with_scale(result, scale)


def points_on_image(
    points: NDArray[np.floating],
    camera: Camera,
    T_camera_lidar: NDArray[np.float64],
    image: Picture | None,
) -> Picture:
    """The points of a sweep on the rectified image of a camera, coloured by depth.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        LiDAR frame at the time of the image, metres.
    T_camera_lidar : ndarray of float64, shape (4, 4)
    image : ndarray of uint8, shape (h, w, 3), optional
        BGR; without it points stand alone.
    """
    seen = transform_points(T_camera_lidar, points)
    rows, u, v = pixels_in_image(seen, camera)
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    np.minimum.at(depth, (v, u), seen[rows, 2].astype(np.float32))
    side = max(round(_POINT * camera.width), 1)
    return overlay(spread_depth(depth, side), image, 1.0)


def _with_scale(picture: Picture, scale: float) -> Picture:
    """A bar of a round length in the lower left corner."""
    height, width = picture.shape[:2]
    metres = round_length(width / 3 / scale)
    y, length = height - 12, round(metres * scale)
    cv2.line(picture, (10, y), (10 + length, y), (255, 255, 255), 2)
    cv2.putText(
        picture, f"{metres} m", (14, y - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1,
        cv2.LINE_AA,
    )  # fmt: skip
    return picture
