"""What is known of an image, as pictures of its size: depth, classes, tracks and layers (ours)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.datasets.base import CameraStream
from docdepth.geometry.camera import NEAREST, Camera, View, pixels_in_image
from docdepth.geometry.se3 import transform_points
from docdepth.geometry.track import BOX_EDGES, Track
from docdepth.visualization.pictures import TRACK_COLORS, Picture, blended, colors_of_classes

SEEN_COLORS = ((110, 110, 110), (178, 114, 0), (0, 120, 255))
"""Of the layer ``seen``: did not look there, agree, contradict."""
CONFIDENCE_COLORS = cv2.applyColorMap(
    np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_CIVIDIS
)[:, 0]
"""From :data:`DOUBTFUL` or less to 1."""
DOUBTFUL = 0.5
"""Confidence below which depth is rather wrong than right; most pixels are far above."""

_OPACITY = 0.65  # of colours over the image
_NO_DEPTH, _NO_INSTANCE = 255, 0  # in the layers


def photo_of(stream: CameraStream | None, name: str) -> Picture | None:
    """The rectified image of a camera with this name, if it is at hand."""
    if stream is None or name not in stream.names:
        return None
    return stream.rectified_image(stream.names.index(name))


def view_of_layer(name: str, values: NDArray[Any], image: Picture | None) -> Picture:
    """Draw the layer ``class``, ``confidence``, ``seen`` or ``instance`` over the image.

    Parameters
    ----------
    values : ndarray, shape (h, w)
        As a file of layers holds it.
    image : ndarray of uint8, shape (h, w, 3), optional
        BGR; dark where the layer holds nothing. Confidence alone is drawn without it, so that its
        colours can be compared with their scale.
    """
    known = values != (_NO_INSTANCE if name == "instance" else _NO_DEPTH)
    if name == "confidence":
        image, known = None, np.isfinite(values) & (values > 0)
        share = np.clip((np.where(known, values, 0) - DOUBTFUL) / (1 - DOUBTFUL), 0, 1)
        colors = CONFIDENCE_COLORS[np.rint(255 * share).astype(np.uint8)]
    elif name == "class":
        colors = colors_of_classes(values)
    elif name == "seen":
        colors = np.array(SEEN_COLORS, np.uint8)[np.where(known, values, 0)]
    else:
        colors = np.array(TRACK_COLORS, np.uint8)[values % len(TRACK_COLORS)]
    return blended(np.asarray(colors, np.uint8), known, image, _OPACITY)


def view_of_points(
    points: NDArray[np.floating], classid: NDArray[np.uint16], camera: Camera, image: Picture | None
) -> Picture:
    """Draw the classes of a sweep's points over the image, near ones over far ones.

    Parameters
    ----------
    points : ndarray, shape (N, 3)
        Camera frame [m].
    image : ndarray of uint8, shape (h, w, 3), optional
        BGR.
    """
    shape = (camera.height, camera.width)
    nothing = np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.bool_)
    picture = blended(*nothing, image, _OPACITY)
    shown, u, v = pixels_in_image(points, camera)
    order = np.argsort(-points[shown, 2], kind="stable")
    rows, columns, colors = v[order], u[order], colors_of_classes(classid[shown[order]])
    side = max(camera.width // 600, 1)  # pixels to either side
    # A point covers several pixels; all of a farther point are drawn before those of a nearer one.
    square = [(down, right) for down in range(-side, side) for right in range(-side, side)]
    rows = (rows[:, None] + [down for down, _ in square]).clip(0, camera.height - 1)
    columns = (columns[:, None] + [right for _, right in square]).clip(0, camera.width - 1)
    picture[rows.ravel(), columns.ravel()] = np.repeat(colors, len(square), axis=0)
    return picture


def draw_tracks(picture: Picture, tracks: Iterable[Track], view: View) -> None:
    """Draw the boxes of the tracks into a picture of a view, far ones first, with their ids."""
    camera, T_camera_world, time = view
    there = [
        (track, T_camera_world @ track.pose_at(time)) for track in tracks if track.covers(time)
    ]
    for track, T_camera_object in sorted(there, key=lambda item: -item[1][2, 3]):
        corners = transform_points(T_camera_object, track.corners)
        color = track_color(track.id)
        lines = [_clipped(corners[list(edge)]) for edge in BOX_EDGES]
        lines = [(line / line[:, 2:]) @ camera.K[:2].T for line in lines]
        lines = [line for line in lines if len(line) and np.abs(line).max() < 1e5]
        if not lines:
            continue
        every, size = np.concatenate(lines), (camera.width, camera.height)
        if (every.max(axis=0) < 0).any() or (every.min(axis=0) >= size).any():
            continue
        for line in lines:
            start, end = np.rint(line).astype(int).tolist()
            cv2.line(picture, start, end, color, 2, cv2.LINE_AA)
        left, top = every.min(axis=0).clip(0, (camera.width - 40, camera.height - 8))
        write_text(picture, str(track.id), (round(left) + 3, max(round(top) - 5, 14)), color)


def track_color(number: int) -> tuple[int, int, int]:
    """BGR colour of the track with this id."""
    return TRACK_COLORS[number % len(TRACK_COLORS)]


def write_text(
    picture: Picture, text: str, place: tuple[int, int], color: tuple[int, int, int]
) -> None:
    """Write text with a dark rim, so that it can be read on any ground."""
    # The rim is the text itself, moved: thicker letters of OpenCV 5 are wider as well.
    font, black = cv2.FONT_HERSHEY_SIMPLEX, (0, 0, 0)
    for x in (-1, 0, 1):
        for y in (-1, 0, 1):
            beside = (place[0] + x, place[1] + y)
            cv2.putText(picture, text, beside, font, 0.55, black, 2, cv2.LINE_AA)
    cv2.putText(picture, text, place, font, 0.55, color, 2, cv2.LINE_AA)


def _clipped(ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """The part of a line (2, 3) that lies ahead of the camera; empty where none does."""
    z = ends[:, 2]
    if (z >= NEAREST).all():
        return ends
    if (z < NEAREST).all():
        return ends[:0]
    behind = int(z[1] < NEAREST)
    result = ends.copy()
    result[behind] = ends[0] + (ends[1] - ends[0]) * (NEAREST - z[0]) / (z[1] - z[0])
    return result
