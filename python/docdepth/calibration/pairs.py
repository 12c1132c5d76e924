"""Pairs of an image and a sweep of the same still board, out of a recording."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import PATTERNS, Board
from docdepth.calibration.calibrate import BoardPair
from docdepth.calibration.corners import counted_corners, find_corners, shows_markers
from docdepth.calibration.find import FEWEST_BOARDS
from docdepth.calibration.sweeps import board_sweep
from docdepth.concurrency import Progress, null_progress
from docdepth.datasets import Dataset, ImageStream
from docdepth.datasets.files import read_image_of
from docdepth.errors import CalibrationError, DatasetError
from docdepth.geometry.points import evenly

Floats = NDArray[np.float64]

_STILLS = 0.8  # seconds between sweeps; if they are closer, some show how the board is moved
# Seconds between the images of such a recording that are looked at: stamps of 10 Hz jitter, so that
# every fourth one is a little less than 0.4 s later.
_STEP = 0.39
_STILL = 2.0  # pixels that corners move at most while the board stands
_FEWEST_STILL = 3  # images looked at in a row
_APART = 0.1  # seconds between image and sweep of a moment
_COUNTED = 3  # images in which checkerboards of other sizes are looked for


def board_pairs(
    recording: Dataset,
    stream: ImageStream,
    board: Board,
    boxes: Mapping[str, Floats] | None = None,
    progress: Progress = null_progress,
) -> tuple[list[BoardPair], tuple[int, int]]:
    """Find the checkerboard in the images, and read the sweeps that belong to them.

    If sweeps are a second or more apart, every one shows a pose of the board. In a recording
    without pauses, the moments are found at which the board stands still for a second.

    Parameters
    ----------
    boxes : dict of ndarray, shape (3, 2), optional
        Least and greatest x, y and z of the board in the LiDAR frame [m], by name of the image; of
        all images under "".

    Returns
    -------
    pairs : list of BoardPair
    size : (int, int)
        Width and height of the images in pixels.
    """
    boxes = boxes or {}
    unknown = sorted(boxes.keys() - {"", *stream.names})
    if unknown:
        raise CalibrationError(
            f"`boxes` names {unknown[0]}, but {stream.name} has no such image; there are "
            f"{', '.join(stream.names[:5])}{' and more' if len(stream.names) > 5 else ''}",
            code="unknown-image",
        )
    stills = _are_stills(recording.times)
    together = _stills(recording, stream) if stills else _moments(recording, stream)
    corners, sizes = _corners_of(stream, board, together, progress, stills)
    _check_sizes(stream, together, sizes)
    found = [k for k, one in enumerate(corners) if one is not None]
    enough = len(found) >= FEWEST_BOARDS
    shown = [together[found[len(found) // 2]]] if enough else together
    _check_count(stream, shown, board, enough)
    if not stills:
        kept = _standing(corners)
        if len(kept) < FEWEST_BOARDS <= len(found):
            raise CalibrationError(
                f"{recording.path} shows the board in {len(found)} images, but standing still for "
                f"a second at {len(kept)} moments, and {FEWEST_BOARDS} or more are needed: put it "
                "down in each pose for two seconds. If each image is another pose, say rate: 1 in "
                "docdepth.yaml",
                code="few-boards",
            )
        together, corners = [together[k] for k in kept], [corners[k] for k in kept]
    pairs = []
    for (image, index), one in zip(together, corners, strict=True):
        sweep, name = recording.sweep(index), stream.names[image]
        box = boxes.get(name, boxes.get(""))
        pairs.append(
            BoardPair(
                name, one, board_sweep(sweep.points, sweep.sensor_rig, box), stream.images[image]
            )
        )
    return pairs, sizes[0]


def _are_stills(times: NDArray[np.int64]) -> bool:
    return len(times) < 2 or float(np.median(np.diff(times))) >= 1e9 * _STILLS


def _stills(recording: Dataset, stream: ImageStream) -> list[tuple[int, int]]:
    """Image and sweep of each pose: by the numbers in their names, else by time."""
    if np.array_equal(stream.times, recording.times):
        swept = next(iter(recording.lidars.values())).names
        return _by_number(stream.names, swept) or [(k, k) for k in range(len(swept))]
    gap = float(np.median(np.diff(recording.times))) if len(recording) > 1 else np.inf
    return _by_time(recording, stream, range(len(recording)), 0.5 * gap)


def _by_number(images: Sequence[str], sweeps: Sequence[str]) -> list[tuple[int, int]]:
    """Pairs of names with one and the same number; empty where names do not tell."""
    numbers = [[_number(name) for name in names] for names in (images, sweeps)]
    if any(None in found or len(set(found)) < len(found) for found in numbers):
        return []
    alone = [n for n, number in zip(images, numbers[0], strict=True) if number not in numbers[1]]
    if alone:
        raise DatasetError(
            f"the image {alone[0]} has no sweep of the same number"
            f"{f', and {len(alone) - 1} more' if len(alone) > 1 else ''}; give images and sweeps "
            "that belong together the same number"
        )
    return [(k, numbers[1].index(number)) for k, number in enumerate(numbers[0])]


def _number(name: str) -> int | None:
    """The only number in a name; None if there is none or several."""
    found = re.findall(r"\d+", name)
    return int(found[0]) if len(found) == 1 else None


def _moments(recording: Dataset, stream: ImageStream) -> list[tuple[int, int]]:
    """Image and sweep about every ``_STEP`` seconds."""
    kept: list[tuple[int, int]] = []
    for image, sweep in _by_time(recording, stream, range(len(recording)), 1e9 * _APART):
        since = stream.times[image] - stream.times[kept[-1][0]] if kept else np.inf
        if since >= 1e9 * _STEP:
            kept.append((image, sweep))
    return kept


def _by_time(
    recording: Dataset, stream: ImageStream, sweeps: Sequence[int], most: float
) -> list[tuple[int, int]]:
    pairs: list[tuple[int, int]] = []
    for k in sweeps:
        away = np.abs(stream.times - recording.times[k])
        nearest = int(np.argmin(away))
        if away[nearest] <= most and (not pairs or pairs[-1][0] != nearest):
            pairs.append((nearest, k))
    if not pairs:
        raise DatasetError(
            f"{recording.path}: no image of {stream.name} is of the time of a sweep (at most "
            f"{most * 1e-9:.1f} s apart); are camera and LiDAR on one clock?"
        )
    return pairs


def _corners_of(
    stream: ImageStream,
    board: Board,
    together: Sequence[tuple[int, int]],
    progress: Progress,
    thorough: bool,
) -> tuple[list[Floats | None], list[tuple[int, int]]]:
    corners, sizes = [], []
    for done, (image, _) in enumerate(together, 1):
        picture = read_image_of(stream.images[image])
        sizes.append((picture.shape[1], picture.shape[0]))
        corners.append(find_corners(picture, board, thorough))
        progress("images", done, len(together))
    return corners, sizes


def _check_sizes(
    stream: ImageStream, together: Sequence[tuple[int, int]], sizes: Sequence[tuple[int, int]]
) -> None:
    for (image, _), size in zip(together, sizes, strict=True):
        if size != sizes[0]:
            raise DatasetError(
                f"{stream.images[image]} is {size[0]}x{size[1]} pixels, others of {stream.name} "
                f"are {sizes[0][0]}x{sizes[0][1]}; calibrate images of one size"
            )


def _check_count(
    stream: ImageStream, together: Sequence[tuple[int, int]], board: Board, found: bool
) -> None:
    """Refuse images of a checkerboard with more corners, or fewer if it was not found."""
    if board.pattern != PATTERNS[0]:
        return
    for k in evenly(len(together), _COUNTED):
        image = stream.images[together[k][0]]
        pixels = read_image_of(image)
        if not found and shows_markers(pixels):
            raise CalibrationError(
                f"{image} shows markers. A ChArUco board needs `pattern`; AprilGrids are not read",
                code="other-target",
            )
        count = counted_corners(pixels, board, found)
        if count is not None:
            raise CalibrationError(
                f"{image} shows a checkerboard of {count[0]}x{count[1]} inner corners, not "
                f"{board.columns}x{board.rows}; count the points where four squares meet, not the "
                "squares (`corners`). Circles and markers are no checkerboard",
                code="number-of-corners",
            )


def _standing(corners: Sequence[Floats | None]) -> list[int]:
    """The middle of each row of images in which the board stands still."""
    kept: list[int] = []
    begin = 0
    for k in range(len(corners) + 1):
        one, first = corners[k] if k < len(corners) else None, corners[begin]
        if one is not None and first is not None and _moved(first, one) < _STILL:
            continue
        if k - begin >= _FEWEST_STILL:
            kept.append((begin + k - 1) // 2)
        begin = min(k, len(corners) - 1)
    return kept


def _moved(a: Floats, b: Floats) -> float:
    """Pixels between corners, whichever end each begins at."""
    return float(min(np.abs(a - b).max(), np.abs(a - b[::-1]).max()))
