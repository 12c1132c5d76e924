"""Pictures of depth and labels, with OpenCV alone. All are BGR, uint8.

The colours of depth are the same in every picture, so pictures can be compared: viridis over the
logarithm of depth, yellow near and violet far. It is as even for colour-blind readers. Classes and
tracks have colours that they tell apart, too (blue and orange, and those of Okabe and Ito).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.errors import InputError
from docdepth.geometry.points import DYNAMIC, STATIC

Picture = NDArray[np.uint8]

NEAR, FAR = 3.0, 80.0
"""Depths of the first and the last colour [m]."""

GROUND_COLOR = (150, 100, 50)
STATIC_COLOR = (205, 205, 205)
DYNAMIC_COLOR = (0, 120, 255)
TRACK_COLORS = ((0, 159, 230), (233, 180, 86), (115, 158, 0), (167, 121, 204), (0, 94, 213))
"""Of tracks by turns: orange, sky blue, green, purple, vermilion."""

# Compared with ground truth: true positives, false negatives and false positives.
# They stand apart from each other, from ground, static points and the background for every reader.
FOUND_COLOR = (40, 245, 10)
MISSED_COLOR = (80, 70, 245)
FALSE_COLOR = (255, 80, 175)

# Ends of the scale of errors, equally light, since pure blue cannot be seen on a dark background.
TOO_NEAR_COLOR = (30, 115, 235)
TOO_FAR_COLOR = (245, 150, 60)

BACKGROUND = 24
ERROR_LIMIT = 0.1
"""Relative error whose colour is full."""
_TICKS = (3, 5, 10, 20, 40, 80, 160, 320)
_RESOLUTION_DEG, _ROW_DEG = 0.2, 0.4  # of a picture over azimuth and elevation
_ROW_HEIGHT = 6  # pixels; rings are farther apart than columns
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_LENGTHS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000)  # metres


def round_length(most: float) -> int:
    """A round number of metres below this, for the bar that shows the scale of a picture."""
    return max((metres for metres in _LENGTHS if metres < most), default=1)


def colors_of_classes(classid: NDArray[np.integer[Any]]) -> Picture:
    """Colour of each point or pixel by its class, uint8 (..., 3)."""
    palette = np.array([GROUND_COLOR, STATIC_COLOR, DYNAMIC_COLOR], np.uint8)
    return palette[(classid >= STATIC).astype(int) + (classid >= DYNAMIC)]


def colorize(
    depth: NDArray[np.floating[Any]], near: float = NEAR, far: float = FAR, bar: bool = True
) -> Picture:
    """Colour a depth map; pixels without depth stay dark.

    Parameters
    ----------
    depth : ndarray of float, shape (h, w)
        Metres, NaN = none.
    near, far : float
        Depths of the first and the last colour [m]; depths beyond get the same colours.
    bar : bool
        Draw the colour bar.

    Returns
    -------
    ndarray of uint8, shape (h, w, 3)
        BGR.
    """
    valid = np.isfinite(depth) & (depth > 0)
    share = np.log(np.where(valid, depth, near) / near) / float(np.log(far / near))
    colors = np.full((*depth.shape, 3), BACKGROUND, np.uint8)
    cv2.copyTo(_viridis(share), valid.astype(np.uint8), colors)
    return draw_bar(colors, near, far) if bar else colors


def reduced(picture: Picture, scale: float) -> Picture:
    """A picture made smaller; as it is where the scale is 1 or more."""
    if scale >= 1:
        return picture
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8)


def spread_depth(depth: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Sparse depth with each value over so many pixels to each side, the nearest on top."""
    near = np.where(np.isfinite(depth), depth, np.float32(np.inf))
    square = np.ones((2 * side + 1, 2 * side + 1), np.uint8)
    spread = cv2.erode(near, square, borderValue=np.inf)
    return np.where(np.isinf(spread), np.float32(np.nan), spread).astype(np.float32)


def overlay(
    depth: NDArray[np.floating[Any]],
    image: Picture | None = None,
    opacity: float = 0.6,
    near: float = NEAR,
    far: float = FAR,
) -> Picture:
    """Blend the colours of depth with the camera image; pixels without depth show the image, dark.

    Parameters
    ----------
    depth : ndarray of float, shape (h, w)
        Metres, NaN = none.
    image : ndarray of uint8, shape (h, w, 3), optional
        BGR. Without it the picture shows depth alone.
    opacity : float
        Weight of the colours, 0..1.
    near, far : float
        As for :func:`colorize`.
    """
    colors = colorize(depth, near, far, bar=False)
    if image is not None and image.shape != colors.shape:
        raise InputError(f"the image {image.shape} and the depth map {depth.shape} differ in size")
    return draw_bar(blended(colors, ~np.isnan(depth), image, opacity), near, far)


def blended(
    colors: Picture, known: NDArray[np.bool_], image: Picture | None, opacity: float
) -> Picture:
    """Colours over a grey image where something is known; elsewhere the image, dark.

    Without an image the colours stand alone, on a dark ground.
    """
    if image is None:
        alone = np.full_like(colors, BACKGROUND)
        return np.asarray(cv2.copyTo(colors, known.astype(np.uint8), alone), np.uint8)
    gray = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    mixed = cv2.addWeighted(colors, opacity, gray, 1 - opacity, 0)
    darker = cv2.convertScaleAbs(gray, alpha=0.5)
    return np.asarray(cv2.copyTo(mixed, known.astype(np.uint8), darker), np.uint8)


def error_picture(
    predicted: NDArray[np.floating[Any]], truth: NDArray[np.floating[Any]]
) -> Picture:
    """Colour the relative error of depth: orange too near, blue too far, white correct.

    Parameters
    ----------
    predicted, truth : ndarray of float, shape (h, w)
        Metres, NaN = none; pixels without one of them stay dark.
    """
    relative = (predicted - truth) / truth
    known = np.isfinite(relative)
    strength = np.clip(np.abs(np.where(known, relative, 0)) / ERROR_LIMIT, 0, 1)
    ends = np.where((relative < 0)[..., None], TOO_NEAR_COLOR, TOO_FAR_COLOR)
    colors = 255 + strength[..., None] * (ends - 255.0)
    picture = np.rint(colors).astype(np.uint8)
    picture[~known] = BACKGROUND
    return picture


def labels_from_above(
    points: NDArray[np.float32],
    classid: NDArray[np.uint16],
    truth: NDArray[np.bool_] | None = None,
    reach: float = 50.0,
    size: int = 800,
) -> Picture:
    """Draw the classes of a sweep from above: x up, y to the left, the sensor in the middle.

    Parameters
    ----------
    points : ndarray of float32, shape (N, 3)
        LiDAR frame [m].
    classid : ndarray of uint16, shape (N,)
        Ground below 50, static below 100, dynamic from 100 on.
    truth : ndarray of bool, shape (N,), optional
        Which points are really dynamic. With it, true positives are green, false negatives red
        and false positives violet; without it, dynamic points are orange.
    reach : float
        Distance from the sensor to the edges of the picture [m].
    size : int
        Width and height of the picture [pixels].
    """
    scale = size / (2 * reach)
    rows = np.floor((reach - points[:, 0]) * scale)
    columns = np.floor((reach - points[:, 1]) * scale)
    picture = np.full((size, size, 3), BACKGROUND, np.uint8)
    draw_classes(picture, rows, columns, classid, truth)
    return picture


def labels_in_range_image(
    points: NDArray[np.float32], classid: NDArray[np.uint16], truth: NDArray[np.bool_]
) -> Picture:
    """Draw the classes of a sweep over azimuth (forward in the middle) and elevation.

    The arguments are those of :func:`labels_from_above`.
    """
    ranges = np.linalg.norm(points, axis=1)
    seen = np.isfinite(ranges) & (ranges > 0)
    points, classid, truth = points[seen], classid[seen], truth[seen]
    elevation = np.degrees(np.arcsin(points[:, 2] / ranges[seen]))
    azimuth = np.degrees(-np.arctan2(points[:, 1], points[:, 0]))
    columns = np.floor((azimuth + 180) / _RESOLUTION_DEG) % round(360 / _RESOLUTION_DEG)
    top = float(elevation.max(initial=0.0))
    rows = np.floor((top - elevation) / _ROW_DEG)
    shape = (int(rows.max(initial=0)) + 1, round(360 / _RESOLUTION_DEG), 3)
    picture = np.full(shape, BACKGROUND, np.uint8)
    draw_classes(picture, rows, columns, classid, truth)
    return np.repeat(picture, _ROW_HEIGHT, axis=0)


def draw_bar(picture: Picture, near: float = NEAR, far: float = FAR) -> Picture:
    """Draw the colour bar of depth into the lower left corner of a copy, if there is room."""
    height, width = picture.shape[:2]
    length, thick = min(width // 3, 400), 10
    if length < 60 or height < 60:
        return picture
    result = picture.copy()
    x, y = 10, height - 14 - thick
    result[y - 16 : y + thick + 4, x - 4 : x + length + 24] //= 3
    result[y : y + thick, x : x + length] = _viridis(np.linspace(0, 1, length))[None]
    for depth in _TICKS:
        if near <= depth <= far:
            place = x + round((length - 1) * np.log(depth / near) / np.log(far / near))
            result[y - 3 : y, place] = 255
            text, left = f"{depth}" + " m" * (depth * 2 > far), (place - 4, y - 5)
            cv2.putText(result, text, left, _FONT, 0.38, (255, 255, 255), 1, cv2.LINE_AA)
    return result


def _viridis(share: NDArray[np.floating[Any]]) -> Picture:
    """Colours of numbers from 0 (yellow) to 1 (violet); shape (...) to (..., 3)."""
    steps = np.rint(255 * (1 - np.clip(share, 0, 1))).astype(np.uint8)
    # The dark end of viridis is hard to tell from where there is no depth.
    table = cv2.applyColorMap(
        np.linspace(20, 255, 256).astype(np.uint8)[:, None], cv2.COLORMAP_VIRIDIS
    )
    flat = cv2.applyColorMap(steps.reshape(-1, 1), table) if steps.size else np.empty((0, 1, 3))
    return np.asarray(flat, np.uint8).reshape(*steps.shape, 3)


def draw_classes(
    picture: Picture,
    rows: NDArray[np.floating[Any] | np.integer[Any]],
    columns: NDArray[np.floating[Any] | np.integer[Any]],
    classid: NDArray[np.uint16],
    truth: NDArray[np.bool_] | None = None,
) -> None:
    """Draw the classes of points (N,) at their rows and columns; ``truth`` as elsewhere."""
    height, width = picture.shape[:2]
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    dynamic, ground = classid >= DYNAMIC, classid < STATIC
    layers = [
        (ground, GROUND_COLOR),
        (~ground & ~dynamic, STATIC_COLOR),
        (dynamic, DYNAMIC_COLOR if truth is None else FALSE_COLOR),
    ]
    if truth is not None:
        layers += [(truth & ~dynamic, MISSED_COLOR), (truth & dynamic, FOUND_COLOR)]
    # Later layers cover earlier ones, so that the few dynamic points stay visible.
    for chosen, color in layers:
        chosen = chosen & inside
        picture[rows[chosen].astype(np.int64), columns[chosen].astype(np.int64)] = color
