"""Sweeps drawn over each other, and points of a sweep on an image. All are BGR, uint8."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.geometry.camera import Camera
from docdepth.visualization.pictures import Picture, overlay, round_length

COLORS = ((90, 90, 255), (110, 220, 90), (255, 170, 70))
"""Of the first, second and third sweep: red, green, blue. Where all three are, it is white."""
COLOR_NAMES = ("red", "green", "blue")

_PATH = (0, 230, 255)
_BACKGROUND = 24
_NEAR = 0.1  # metres ahead of a camera; nearer points are not in front of it
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
    camera : Camera
    T_camera_lidar : ndarray of float64, shape (4, 4)
    image : ndarray of uint8, shape (h, w, 3), optional
        BGR; without it points stand alone.
    """
    x, y, z = (points @ T_camera_lidar[:3, :3].T + T_camera_lidar[:3, 3]).T
    ahead = z > _NEAR
    x, y, z = x[ahead], y[ahead], z[ahead]
    K = camera.K
    u, v = np.rint(K[0, 0] * x / z + K[0, 2]), np.rint(K[1, 1] * y / z + K[1, 2])
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    rows, columns, z = v[inside].astype(int), u[inside].astype(int), z[inside].astype(np.float32)
    np.minimum.at(depth, (rows, columns), z)
    side = max(round(_POINT * camera.width), 1)
    depth = cv2.erode(depth, np.ones((2 * side + 1, 2 * side + 1), np.uint8))  # the nearest wins
    depth[np.isinf(depth) | (depth > 1e30)] = np.nan
    return overlay(depth, image, 1.0)


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
