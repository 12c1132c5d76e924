"""The files of a calibration: what ``docdepth run`` takes, how good it is, and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from docdepth.calibration.board import Board
from docdepth.calibration.bundle import Solution
from docdepth.calibration.calibrate import BoardPair, Calibration
from docdepth.calibration.corners import board_pose
from docdepth.calibration.lens import Lens
from docdepth.concurrency import Progress, null_progress
from docdepth.datasets.files import read_image_of
from docdepth.geometry.camera import Camera
from docdepth.geometry.se3 import transform_points
from docdepth.io.atomic import write_output
from docdepth.io.calibration import write_calibration
from docdepth.io.images import encode_image
from docdepth.visualization.pictures import Picture, overlay, spread_depth


def quality_of(found: Calibration) -> dict[str, object]:
    """What a calibration is worth, ready for JSON.

    ``boards`` has for each board the RMS of its corners [px] and of its returns from the plane
    [cm], and how far the calibration of the others misses it (``left_out``, px and cm).
    """
    boards = {
        one.name: {
            "corners_px": round(pixels, 3),
            "plane_cm": round(100 * metres, 2),
            "left_out_px": round(one.pixels, 2),
            "left_out_cm": round(100 * one.metres, 2),
        }
        for one, (pixels, metres) in zip(found.boards, found.residuals, strict=True)
    }
    quality: dict[str, object] = {
        "boards": boards,
        "not_used": found.not_used,
        "left_out_px": round(float(np.median([one.pixels for one in found.boards])), 2),
        "uncertainty_deg": np.round(found.turn_deg, 4).tolist(),
        "uncertainty_cm": np.round(found.shift_cm, 3).tolist(),
    }
    if found.halves is not None:
        degrees, centimetres = found.halves.degrees, found.halves.centimetres
        quality["halves_deg"] = {"median": _short(np.median(degrees)), "most": _short(max(degrees))}
        quality["halves_cm"] = {
            "median": _short(np.median(centimetres)),
            "most": _short(max(centimetres)),
        }
    return quality


def write_result(
    folder: Path,
    name: str,
    board: Board,
    pairs: Sequence[BoardPair],
    found: Calibration,
    progress: Progress = null_progress,
) -> None:
    """Write calibration, quality, and a picture of every pair.

    Parameters
    ----------
    folder : Path
        Created if it is not there.
    name : str
        Of the camera.
    pairs : sequence of BoardPair
        With their images.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    lens = found.lens
    folder.mkdir(parents=True, exist_ok=True)
    more: dict[str, object] = {
        "board": vars(board),
        "quality": quality_of(found),
    }
    camera = Camera(lens.K, lens.width, lens.height)
    T, numbers = found.T_camera_lidar, lens.distortion.tolist()
    write_calibration(folder, camera, T, numbers, lens.model, write_output, more, name)
    for done, pair in enumerate(pairs, 1):
        if pair.image is not None:
            picture = points_on_image(read_image_of(pair.image), board, pair, found.solution)
            write_output(folder / f"{pair.name}.jpg", encode_image(picture, ".jpg"))
        progress("pictures", done, len(pairs))


def _short(number: Any) -> float:
    return round(float(number), 3)


Floats = NDArray[np.float64]

_NEAR, _FAR = 1.5, 30.0  # metres of the first and the last colour
_POINT = 1 / 1500  # half the side of a point, as a share of the image's width
_LINE = 1 / 640  # width of lines, as a share of the image's width
_OUTLINE = (255, 255, 255)
_CORNER = (80, 255, 80)
_ALONG = 20  # points of each side of the outline, which a lens may bend


def points_on_image(image: Picture, board: Board, pair: BoardPair, solution: Solution) -> Picture:
    """The returns of a sweep on its image, coloured by depth, with the outline of the board.

    Parameters
    ----------
    image : ndarray of uint8, shape (h, w, 3)
        BGR, as the camera took it.
    pair : BoardPair
        The outline is where its corners have it; without corners there is none.
    """
    lens, T = solution.lens, solution.T_camera_lidar
    points = transform_points(T, pair.sweep.points)
    side, thick = (max(round(share * lens.width), 1) for share in (_POINT, _LINE))
    depth = np.full((lens.height, lens.width), np.inf, np.float32)
    seen = _in_view(lens, points)
    pixels = np.rint(lens.project(points[seen])).astype(int)
    inside = lens.in_image(pixels)
    u, v = pixels[inside].T
    np.minimum.at(depth, (v, u), points[seen][inside, 2].astype(np.float32))
    picture = overlay(spread_depth(depth, side), image, 1.0, _NEAR, _FAR)
    if pair.corners is not None:
        pose = board_pose(pair.corners, board, lens)[0]
        corners = board.outline
        share = np.linspace(0, 1, _ALONG, endpoint=False)[:, None]
        sides = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, 0), strict=True)]
        outline = transform_points(pose, np.concatenate(sides))
        line = np.rint(lens.project(outline)).astype(np.int32)
        cv2.polylines(picture, [line], True, _OUTLINE, thick, cv2.LINE_AA)
        for u, v in np.rint(pair.corners).astype(int).tolist():
            cv2.circle(picture, (u, v), thick, _CORNER, 1, cv2.LINE_AA)
    return picture


def _in_view(lens: Lens, points: Floats) -> NDArray[np.bool_]:
    """Points (N, 3) of the camera that lie in the field of view.

    Far outside it the polynomial of the distortion folds back into the image.
    """
    u, v = np.linspace(0, lens.width - 1, _ALONG), np.linspace(0, lens.height - 1, _ALONG)
    border = [np.stack(np.broadcast_arrays(u, y), axis=1) for y in (0.0, lens.height - 1.0)]
    border += [np.stack(np.broadcast_arrays(x, v), axis=1) for x in (0.0, lens.width - 1.0)]
    widest = np.linalg.norm(lens.rays(np.concatenate(border)), axis=1).max()
    ahead = points[:, 2] > 1e-3
    away = np.hypot(points[:, 0], points[:, 1])
    return np.asarray(ahead & (away <= 1.05 * widest * points[:, 2]))
