"""The files of a calibration: what ``docdepth run`` takes, how good it is, and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np

from docdepth.calibration.board import Board
from docdepth.calibration.calibrate import BoardPair, Calibration
from docdepth.calibration.pictures import points_on_image
from docdepth.concurrency import Progress
from docdepth.datasets.files import read_image_of
from docdepth.geometry.camera import Camera
from docdepth.io.calibration import write_calibration
from docdepth.io.recorded_folder import write_output


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
    progress: Progress | None = None,
) -> None:
    """Write calibration, quality, and a picture of every pair.

    Parameters
    ----------
    folder : Path
        Created if it is not there.
    name : str
        Of the camera.
    board : Board
    pairs : sequence of BoardPair
        With their images.
    found : Calibration
    progress : callable, optional
        ``progress("pictures", done, total)``.

    Raises
    ------
    OSError
        The folder cannot be written.
    """
    lens = found.lens
    folder.mkdir(parents=True, exist_ok=True)
    more: dict[str, object] = {
        "camera": name,
        "T_camera_lidar": found.T_camera_lidar.tolist(),
        "board": vars(board),
        "quality": quality_of(found),
    }
    camera = Camera(lens.K, lens.width, lens.height)
    numbers = lens.distortion.tolist()
    write_calibration(folder, camera, found.T_camera_lidar, numbers, lens.model, write_output, more)
    for done, pair in enumerate(pairs, 1):
        if pair.image is not None:
            picture = points_on_image(read_image_of(pair.image), board, pair, found.solution)
            encoded = cv2.imencode(".jpg", picture)[1].tobytes()
            write_output(folder / f"{pair.name}.jpg", partial(_write, encoded))
        if progress is not None:
            progress("pictures", done, len(pairs))


def _write(content: bytes, stream: BinaryIO) -> None:
    stream.write(content)


def _short(number: Any) -> float:
    return round(float(number), 3)
